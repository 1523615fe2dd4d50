"""Limit the length of a request's head, and the time in which its body must arrive.

The proxy in front of a public service (`docker/nginx.conf`) must limit slow request headers, slow readers and floods of
requests.
"""

import asyncio
from typing import Any, cast

from starlette.types import Message, Receive, Scope
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from ..errors import ProblemError

_READ_BYTES = 1 << 16
_MAX_LINE_BYTES = 8192  # Longer headers and addresses are refused.
_MAX_HEADERS = 100
# A request may have each of these headers only once, because it would be unclear which one counts.
_SINGLE_HEADERS = (b"host", b"origin", b"sec-fetch-site")
_CLOSE_HEADERS = {"Connection": "close"}
ABORT = "dsbrdf.abort"
"""Member of the ASGI scope: a function that closes the connection at once, without sending buffered data."""


class Connection(HttpToolsProtocol, asyncio.BufferedProtocol):
    """Receive requests in small pieces, and keep trailers out of a request's headers, to which uvicorn adds them.

    Without a buffer, asyncio would read 256 kB at a time, which every slow upload would keep in memory.
    """

    # All connections can share one buffer, because its content is parsed before the next read.
    _received = memoryview(bytearray(_READ_BYTES))

    def get_buffer(self, sizehint: int) -> memoryview:  # noqa: ARG002 (asyncio's signature)
        """Return the buffer for the next bytes."""
        return self._received

    def buffer_updated(self, nbytes: int) -> None:
        """Parse the bytes in the buffer."""
        self.data_received(bytes(self._received[:nbytes]))

    def on_headers_complete(self) -> None:
        """Start to answer the request with a copy of its headers, which trailers after the body do not change."""
        super().on_headers_complete()
        self.headers = self.headers.copy()
        cast(dict[str, Any], self.scope)[ABORT] = self.transport.abort


def check_head(scope: Scope, headers: dict[bytes, bytes]) -> None:
    """Raise ProblemError if the head of a request is too long, or does not name exactly one host.

    `headers` has the headers in `scope` by name.
    """
    sent = scope["headers"]
    too_long = len(sent) > _MAX_HEADERS or len(scope["path"]) + len(scope["query_string"]) > _MAX_LINE_BYTES
    for name, value in sent:
        too_long = too_long or len(name) + len(value) > _MAX_LINE_BYTES
    if too_long:
        limits = f"an address of {_MAX_LINE_BYTES} bytes, and {_MAX_HEADERS} headers of {_MAX_LINE_BYTES} bytes each"
        raise ProblemError(
            "head-too-long", f"The request is longer than {limits}; send many points with POST.", _CLOSE_HEADERS
        )
    twice = len(headers) < len(sent) and any(sum(name == once for name, _ in sent) > 1 for once in _SINGLE_HEADERS)
    if twice or (b"host" not in headers and scope["http_version"] == "1.1"):
        raise ProblemError(
            "bad-request",
            "The request must have exactly one header Host, and at most one header Origin.",
            _CLOSE_HEADERS,
        )


class BodyTimeout:
    """Wrap an ASGI `receive`, and refuse a body that arrives too slowly.

    Only the time spent waiting for the client counts, not the time that the service takes.

    A body is refused after `idle_timeout` seconds without a byte, or when its mean rate after that time is below
    `min_rate` bytes per second; 0 allows any rate. `n_bytes` is the number of bytes received so far.
    """

    def __init__(self, receive: Receive, idle_timeout: float, min_rate: float) -> None:
        self.n_bytes = 0
        self._receive = receive
        self._idle_timeout = idle_timeout
        self._min_rate = min_rate
        self._waited = 0.0
        self._ended = False

    async def __call__(self) -> Message:
        """Return the next message of the body; raise ProblemError if the message takes too long."""
        if self._ended:  # The next message is the end of the connection, for which there is no time limit.
            return await self._receive()
        loop = asyncio.get_running_loop()
        begin = loop.time()
        timeout = self._idle_timeout
        if self._min_rate:
            timeout = min(timeout, self._idle_timeout + self.n_bytes / self._min_rate - self._waited)
        try:
            async with asyncio.timeout(timeout):
                message = await self._receive()
        except TimeoutError:
            self._ended = True
            rate = f", or came at less than {self._min_rate:g} bytes a second" if self._min_rate else ""
            detail = f"The body stopped for {self._idle_timeout:g} s{rate}; {self.n_bytes} bytes had arrived."
            raise ProblemError("request-timeout", detail, _CLOSE_HEADERS) from None
        self._waited += loop.time() - begin
        self.n_bytes += len(message.get("body", b""))
        self._ended = not message.get("more_body", False)
        return message
