"""Limits that uvicorn lacks: the number of connections, long heads, slow clients, and what is not HTTP.

A connection that is refused here has not reached the application; the response is a problem document all the same.
"""

import asyncio
import fcntl
import resource
import termios
from array import array
from contextlib import suppress
from http import HTTPStatus
from typing import Any

from starlette.types import Message, Receive
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle

from ..errors import ProblemError
from ..settings import Settings
from .problems import problem_response
from .responses import with_security_headers

_CLOSE = {"Connection": "close"}
_READ_SIZE = 1 << 16  # bytes that are read from a connection at a time: there may be many
_LONG_READ_SIZE = 1 << 18  # of a long body, which so takes fewer turns of the event loop
_LONG_BODY = 1 << 20
_FEW_CONNECTIONS = 16  # with more of them, large pieces are memory that many slow senders would hold
_MAX_HEAD = 1 << 16  # bytes of a request's head, and of what frames its body
_MAX_FRAMING = 16  # bytes for each byte of a body that is sent in chunks


class _Connection(HttpToolsProtocol):
    """One client's connection; `connection_class` gives it its limits."""

    max_connections: int
    header_timeout: float  # seconds that a request's head may take to arrive
    idle_timeout: float  # seconds that a client may leave a response unread

    _n_received = _n_head = _n_body = 0  # bytes of the request that is being received

    _answering: RequestResponseCycle | None = None  # the request that is being answered; `cycle` is the last one
    _refusal: ProblemError | None = None  # of what followed it, sent when it has been answered

    _header_timer: asyncio.TimerHandle | None = None
    _write_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._read_at_a_time(_READ_SIZE)
        self._excess = len(self.connections) > self.max_connections
        self._update_header_timer()

    def data_received(self, data: bytes) -> None:
        if self._excess:
            detail = f"{self.max_connections} connections are open, the most allowed; try again later."
            self._refuse(ProblemError("overloaded", detail, _CLOSE))
            return
        if self._refusal is not None:
            return
        self._n_received += len(data)
        super().data_received(data)
        # The parser keeps the beginning of a line however long it becomes.
        if self._n_received > _MAX_HEAD + (1 + _MAX_FRAMING) * self._n_body:
            self.send_400_response("Too much")
        self._update_header_timer()

    def on_message_begin(self) -> None:
        super().on_message_begin()
        self._n_head = self._n_body = 0

    def on_url(self, url: bytes) -> None:
        self._count_head(len(url))
        super().on_url(url)

    def on_header(self, name: bytes, value: bytes) -> None:
        self._count_head(len(name) + len(value))
        super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """Begin to answer the request; HTTP/1.1 needs exactly one Host, and a host in the target overrides it."""
        if self.parser.get_http_version() == "1.1" and [name for name, _ in self.headers].count(b"host") != 1:
            raise ValueError("not one Host")
        if not self.url.startswith(b"/") and self.url != b"*":
            host = self.url.partition(b"://")[2].partition(b"/")[0].partition(b"?")[0]
            self.headers[:] = [(b"host", host) if name == b"host" else (name, value) for name, value in self.headers]
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        self._n_body += len(body)
        if self._n_body > _LONG_BODY and len(self.connections) <= _FEW_CONNECTIONS:
            self._read_at_a_time(_LONG_READ_SIZE)
        super().on_body(body)

    def on_message_complete(self) -> None:
        self._n_received = 0
        self._read_at_a_time(_READ_SIZE)
        super().on_message_complete()

    def _read_at_a_time(self, n_bytes: int) -> None:
        if hasattr(self.transport, "max_size"):  # of asyncio's transport, not of its interface
            self.transport.max_size = n_bytes

    def _count_head(self, n_bytes: int) -> None:
        self._n_head += n_bytes
        if self._n_head > _MAX_HEAD:
            raise ValueError("too long a head")  # the parser turns what its callbacks raise into its own error

    def _start_asgi_task(self, cycle: RequestResponseCycle, app: Any) -> None:
        self._answering = cycle
        super()._start_asgi_task(cycle, app)

    def on_response_complete(self) -> None:
        """Go on with the next request; when all are answered, send the refusal of what followed them."""
        super().on_response_complete()
        if self._refusal is not None and self._idle():
            self._refuse(self._refusal)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the timers, and tell the request that is being answered, behind which there may be others."""
        _cancel(self._header_timer)
        _cancel(self._write_timer)
        if self._answering is not None and not self._answering.response_complete:
            self._answering.disconnected = True
            self._answering.message_event.set()
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        super().pause_writing()
        self._await_progress(None)

    def resume_writing(self) -> None:
        _cancel(self._write_timer)
        super().resume_writing()

    def _await_progress(self, before: int | None) -> None:
        """Close the connection unless the client has read something since there were `before` bytes to send."""
        unread = self.transport.get_write_buffer_size() + _unacknowledged(self.transport)
        if before is not None and unread >= before:
            self.transport.abort()
            return
        self._write_timer = self.loop.call_later(self.idle_timeout, self._await_progress, unread)

    def send_400_response(self, msg: str) -> None:
        """Answer a request that is not HTTP with a problem document."""
        detail = f"{msg.rstrip('.')}: what was sent is not HTTP/1.1, or its head is too long."
        refusal = ProblemError("bad-request", detail, _CLOSE)
        if self._answering is None or self._idle():
            self._refuse(refusal)
        elif self._answering.more_body:  # it is the body of this request that is wrong
            if self._answering.response_started:
                self.transport.close()
            else:
                self._answering.disconnected = True  # what it answers comes too late
                self._answering.message_event.set()
                self._refuse(refusal)
        else:
            self._refusal = refusal
            if self.pipeline and self.cycle.more_body:  # the last request never comes to its end
                self.pipeline.popleft()

    def _update_header_timer(self) -> None:
        """Run the timer of a head only between requests."""
        if not self._idle():
            _cancel(self._header_timer)
            self._header_timer = None
        elif self._header_timer is None:
            self._header_timer = self.loop.call_later(self.header_timeout, self._on_header_timeout)

    def _idle(self) -> bool:
        return self._answering is None or self._answering.response_complete

    def _on_header_timeout(self) -> None:
        self._header_timer = None
        if self._idle():
            detail = f"The request's head took longer than the {self.header_timeout:g} s that it may take."
            self._refuse(ProblemError("request-timeout", detail, _CLOSE))

    def _refuse(self, error: ProblemError) -> None:
        """Send a problem document without the application, and close."""
        if not self.transport.is_closing():
            answer = problem_response(error, "/")
            head = [f"HTTP/1.1 {answer.status_code} {HTTPStatus(answer.status_code).phrase}".encode()]
            head += [name + b": " + value for name, value in with_security_headers(answer.raw_headers)]
            self.transport.write(b"\r\n".join([*head, b"", bytes(answer.body)]))
            self.transport.close()


def connection_class(settings: Settings) -> type[_Connection]:
    """Return the class of connections with the limits of `settings`; it leaves descriptors for as many files."""
    # Many may be idle, or are about to get the answer that their caller has too many requests in progress.
    most = 8 * settings.limit_concurrency
    descriptors, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    limits = {
        "max_connections": most if descriptors == resource.RLIM_INFINITY else min(most, descriptors // 2),
        "header_timeout": settings.header_timeout,
        "idle_timeout": settings.idle_timeout,
    }
    return type("Connection", (_Connection,), limits)


def _unacknowledged(transport: asyncio.Transport) -> int:
    """Return how many bytes the system has taken and the client has not; 0 where it cannot be asked."""
    connection, number = transport.get_extra_info("socket"), array("i", [0])
    with suppress(AttributeError, OSError):
        fcntl.ioctl(connection.fileno(), termios.TIOCOUTQ, number)
    return number[0]


def _cancel(timer: asyncio.TimerHandle | None) -> None:
    if timer is not None:
        timer.cancel()


class BodyTimeout:
    """An ASGI `receive` that refuses a body that arrives too slowly.

    Only the time spent waiting for the client counts, not what the service takes itself.

    It is refused after `idle_timeout` seconds without a byte, or when its mean rate after that time is below `min_rate`
    bytes per second; 0 allows any. `n_bytes` are the bytes received so far.
    """

    def __init__(self, receive: Receive, idle_timeout: float, min_rate: float) -> None:
        self.n_bytes = 0
        self._receive = receive
        self._idle_timeout = idle_timeout
        self._min_rate = min_rate
        self._waited = 0.0
        self._ended = False

    async def __call__(self) -> Message:
        """Return the next message; raise ProblemError if it takes too long."""
        if self._ended:  # the next message is the end of the connection, which may take any time
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
            raise ProblemError("request-timeout", detail, _CLOSE) from None
        self._waited += loop.time() - begin
        self.n_bytes += len(message.get("body", b""))
        self._ended = not message.get("more_body", False)
        return message
