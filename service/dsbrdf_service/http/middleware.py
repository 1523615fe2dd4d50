"""Define the only middleware: it gives every request an id, bounds its head, body and answer, logs it and counts it.

The proxy in front of a public service (`docker/nginx.conf`) must limit slow request headers and floods of requests.
"""

import asyncio
import logging
import re
import secrets
from collections.abc import Awaitable, Callable
from functools import partial
from time import perf_counter
from typing import Any, TypeVar, cast

from starlette.requests import ClientDisconnect, Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from ..access import Access
from ..errors import ProblemError
from ..log import bind
from ..settings import Settings
from .messages import PIECE_BYTES
from .monitoring import NO_ROUTE, Metrics
from .problems import problem_of, problem_response

_READ_BYTES = 1 << 16
_MAX_LINE_BYTES = 8192  # Longer headers and addresses are refused.
_MAX_HEADERS = 100
_MAX_HEAD_BYTES = 1 << 16
_MAX_PIPELINED_REQUESTS = 64  # A client that sends more requests without reading answers is disconnected.
_LAST_READ_TIMEOUT_S = 0.05  # After a time limit, data that arrived while the process was stopped is still read.
# A request may have each of these headers only once, because it would be unclear which one counts.
_SINGLE_HEADERS = (b"host", b"origin", b"sec-fetch-site")
_CLOSE_HEADERS = {"Connection": "close"}
_NO_HTTP = "The request is not valid HTTP/1.1; send it with an HTTP client, without TLS unless a proxy adds it."
_HEAD_TOO_LONG = (
    f"The address has more than {_MAX_LINE_BYTES} bytes, or there are more than {_MAX_HEADERS} headers, "
    f"of {_MAX_LINE_BYTES} bytes each and {_MAX_HEAD_BYTES} together; send many points with POST."
)
ABORT = "dsbrdf.abort"
"""Member of the ASGI scope: a function that closes the connection at once, without sending buffered data."""
_ACCEPTABLE_ID = re.compile(rb"[A-Za-z0-9._-]{1,64}")
IS_HEAD = "dsbrdf.is_head"
"""Member of the ASGI scope of a HEAD, which routes see as a GET."""
# A browser must not run a response as a script or frame it; another site's page must not read it, nor a cache keep it.
_SECURITY_HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"vary", b"Authorization"),
    # The client may store a response, but must validate it with If-None-Match before each use.
    (b"cache-control", b"private, no-cache"),
)
_POLICY = b"content-security-policy"  # The web pages set their own policy instead of `_STRICT`.
_STRICT = b"default-src 'none'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
logger = logging.getLogger(__name__)
T = TypeVar("T")


class Connection(HttpToolsProtocol, asyncio.BufferedProtocol):
    """Receive requests in small pieces, and bound what an unread answer or an unfinished head takes.

    Without a buffer, asyncio would read 256 kB at a time, which every slow upload would keep in memory. Trailers after
    a body, which uvicorn adds to the headers of the request, do not change the headers that its answer reads.
    """

    # All connections can share one buffer, because its content is parsed before the next read.
    _received = memoryview(bytearray(_READ_BYTES))
    _n_head_bytes = 0  # Bytes of a head, or of the trailers after a body, that have come so far.

    def get_buffer(self, sizehint: int) -> memoryview:  # noqa: ARG002 (asyncio's signature)
        """Return the buffer for the next bytes."""
        return self._received

    def buffer_updated(self, nbytes: int) -> None:
        """Parse the bytes in the buffer; refuse a head as soon as it is too long, without waiting for its end."""
        self._n_head_bytes += nbytes
        self.data_received(bytes(self._received[:nbytes]))
        if self._n_head_bytes > _MAX_HEAD_BYTES and not self.transport.is_closing():
            if self.cycle is None or self.cycle.response_complete:
                refused = problem_response(ProblemError("head-too-long", _HEAD_TOO_LONG, _CLOSE_HEADERS), "")
                lines = [b"HTTP/1.1 431 ", *(b"%b: %b" % header for header in refused.raw_headers), b"", refused.body]
                self.transport.write(b"\r\n".join(lines))
            self.transport.close()

    def on_header(self, name: bytes, value: bytes) -> None:
        """Keep a header, unless there are too many headers, which `check_head` refuses."""
        if len(self.headers) <= _MAX_HEADERS:
            super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """Start to answer the request, or close the connection if too many requests wait on it."""
        self._n_head_bytes = 0
        if len(self.pipeline) >= _MAX_PIPELINED_REQUESTS:
            self.transport.abort()
            return
        super().on_headers_complete()
        self.headers = self.headers.copy()
        cast(dict[str, Any], self.scope)[ABORT] = self.transport.abort

    def on_body(self, body: bytes) -> None:
        """Pass on a piece of the body."""
        super().on_body(body)
        self._n_head_bytes = 0

    def on_message_complete(self) -> None:
        """End a request; the next bytes belong to another one."""
        super().on_message_complete()
        self._n_head_bytes = 0

    def send_400_response(self, msg: str) -> None:  # noqa: ARG002 (uvicorn's signature)
        """Answer bytes that are no HTTP, and close the connection."""
        refusal = problem_response(ProblemError("bad-request", _NO_HTTP, _CLOSE_HEADERS), "")
        head = b"".join(b"%b: %b\r\n" % pair for pair in (*refusal.raw_headers, *_SECURITY_HEADERS))
        self.transport.write(b"HTTP/1.1 400 Bad Request\r\n%b\r\n%b" % (head, bytes(refusal.body)))
        self.transport.close()


def check_head(scope: Scope, headers: dict[bytes, bytes]) -> None:
    """Raise ProblemError if the head of a request is too long, or does not name exactly one host.

    `headers` has the headers in `scope` by name.
    """
    sent = scope["headers"]
    lengths = [len(scope["path"]) + len(scope["query_string"]), *(len(name) + len(value) for name, value in sent)]
    if len(sent) > _MAX_HEADERS or max(lengths) > _MAX_LINE_BYTES or sum(lengths) > _MAX_HEAD_BYTES:
        raise ProblemError("head-too-long", _HEAD_TOO_LONG, _CLOSE_HEADERS)
    twice = len(headers) < len(sent) and any(sum(name == once for name, _ in sent) > 1 for once in _SINGLE_HEADERS)
    if twice or (b"host" not in headers and scope["http_version"] == "1.1"):
        detail = "The request must have exactly one header Host, and at most one header Origin."
        raise ProblemError("bad-request", detail, _CLOSE_HEADERS)


class _Pace:
    """Wait for a client to send or to read; `n_bytes` is the number of bytes that it has sent or read so far.

    The client is too slow after `max_idle_seconds` without a byte, or when its mean rate after that time is below
    `min_bytes_per_second`; 0 allows any rate. Only the time spent waiting for the client counts, not the time that the
    service takes.
    """

    def __init__(self, max_idle_seconds: float, min_bytes_per_second: float) -> None:
        self.max_idle_seconds, self.min_bytes_per_second = max_idle_seconds, min_bytes_per_second
        self.n_bytes, self._waited = 0, 0.0

    async def wait(self, call: Callable[[], Awaitable[T]]) -> T:
        """Return the result of `call`; raise TimeoutError if the client is too slow."""
        begin, timeout = perf_counter(), self.max_idle_seconds
        if self.min_bytes_per_second:
            timeout = min(timeout, timeout + self.n_bytes / self.min_bytes_per_second - self._waited)
        try:
            async with asyncio.timeout(timeout):
                result = await call()
        except TimeoutError:  # This process itself may have been stopped, so it looks once more.
            async with asyncio.timeout(_LAST_READ_TIMEOUT_S):
                result = await call()
        self._waited += min(perf_counter() - begin, timeout)
        return result


class _Body:
    """Wrap an ASGI `receive`, and refuse a body that arrives too slowly."""

    def __init__(self, receive: Receive, pace: _Pace) -> None:
        self._receive, self.pace, self._ended = receive, pace, False

    async def __call__(self) -> Message:
        """Return the next message of the body; raise ProblemError if the message takes too long."""
        if self._ended:  # The next message is the end of the connection, for which there is no time limit.
            return await self._receive()
        pace, self._ended = self.pace, True
        try:
            message = await pace.wait(self._receive)
        except TimeoutError:
            rate = (
                f", or came at less than {pace.min_bytes_per_second:g} bytes a second"
                if pace.min_bytes_per_second
                else ""
            )
            detail = f"The body stopped for {pace.max_idle_seconds:g} s{rate}; {pace.n_bytes} bytes had arrived."
            raise ProblemError("request-timeout", detail, _CLOSE_HEADERS) from None
        pace.n_bytes += len(message.get("body", b""))
        self._ended = not message.get("more_body", False)
        return message


class RequestLogMiddleware:
    """Wrap the whole application as pure ASGI middleware."""

    def __init__(self, app: ASGIApp, access: Access, settings: Settings, metrics: Metrics) -> None:
        self._app = app
        self._access = access
        self._limits = settings.max_idle_seconds, settings.min_upload_bytes_per_second
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, log it and count it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = dict(scope["headers"])
        body = _Body(receive, _Pace(*self._limits))
        exchange = _Exchange(scope, headers.get(b"x-request-id", b""), send, _Pace(*self._limits))
        bind("request_id", exchange.request_id)
        if exchange.method == "HEAD":
            scope = {**scope, "method": "GET", IS_HEAD: True}
        caller = None
        try:
            check_head(scope, headers)
            caller = self._access.admit(scope, headers)
            await self._app(scope, body, exchange.send)
        except asyncio.CancelledError:
            # The server is stopping and its waiting time is over, so it cancels the task of this request.
            detail = "The service is shutting down and cannot finish this request; repeat it later."
            await exchange.refuse(scope, ProblemError("shutting-down", detail))
        except Exception as error:
            await exchange.refuse(scope, error)
            if not (exchange.complete or exchange.given_up):
                raise  # A part of the answer has been sent, so the server logs the exception and closes the connection.
        finally:
            self._access.release(caller)
            self._log(scope, exchange, body.pace.n_bytes)

    def _log(self, scope: Scope, exchange: "_Exchange", n_received: int) -> None:
        seconds = perf_counter() - exchange.begin
        method, status = exchange.method, exchange.status or 499  # 499 means that the client left before the answer.
        route = getattr(scope.get("route"), "path", NO_ROUTE)
        self._metrics.answered(method, route, status, seconds)
        if status >= 500:
            level = logging.ERROR if status == 500 else logging.WARNING
        elif status < 400 and scope["method"] == "GET":
            level = logging.DEBUG
        else:
            level = logging.INFO
        if logger.isEnabledFor(level):
            client = scope.get("client")
            about = {
                "method": method,
                "path": scope["path"],
                "status": status,
                "seconds": round(seconds, 6),
                "client": client[0] if client else None,
                "received_bytes": n_received,
            }
            logger.log(level, "request", extra=about)


class _Exchange:
    """One request and the state of its response."""

    def __init__(self, scope: Scope, given_id: bytes, send: Send, pace: _Pace) -> None:
        self.begin = perf_counter()
        self.method = scope["method"]
        self._abort = scope.get(ABORT, lambda: None)
        self.status: int | None = None
        self.complete = self.given_up = False
        self._send, self._pace = send, pace
        self.request_id = given_id.decode() if _ACCEPTABLE_ID.fullmatch(given_id) else secrets.token_hex(8)

    async def refuse(self, scope: Scope, error: Exception) -> None:
        """Answer with a problem document, unless an answer has begun."""
        if self.status is None:
            request = Request(scope)
            await problem_response(problem_of(request, error), scope["path"])(scope, request.receive, self.send)

    async def send(self, message: Message) -> None:
        """Send a part of the response; add the request's id and protective headers to the response's head."""
        if message["type"] == "http.response.start":
            self.status = message["status"]
            headers = [*message.get("headers", ()), *_SECURITY_HEADERS, (b"x-request-id", self.request_id.encode())]
            if _POLICY not in dict(headers):
                headers.append((_POLICY, _STRICT))
            message["headers"] = headers
        elif self.method == "HEAD":  # The answer of a HEAD has no body, so the first piece of a body ends the answer.
            if self.complete:
                return
            message, self.complete = {"type": "http.response.body"}, True
        elif message.get("more_body", False) or len(message["body"]) > PIECE_BYTES:
            await self._send_in_pieces(message)
            return
        else:
            self.complete = True
        await self._send(message)

    async def _send_in_pieces(self, message: Message) -> None:
        """Send a part of a long answer; close the connection if the client reads more slowly than uploads may be."""
        body = message.get("body", b"")
        for start in range(0, max(len(body), 1), PIECE_BYTES):
            piece = body[start : start + PIECE_BYTES]
            is_last = start + PIECE_BYTES >= len(body) and not message.get("more_body", False)
            try:
                await self._pace.wait(partial(self._send, {**message, "body": piece, "more_body": not is_last}))
            except TimeoutError:
                self.given_up = True
                logger.info("gave up a client that does not read its answer")
                self._abort()
                await asyncio.sleep(0)  # In this pause, the server closes the aborted connection.
                raise ClientDisconnect from None
            self._pace.n_bytes += len(piece)
        self.complete = not message.get("more_body", False)
