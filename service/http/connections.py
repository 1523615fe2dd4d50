"""What uvicorn leaves open about connections: their number, slow clients, and an answer to what is not HTTP.

Nothing that is refused here has reached the application; its answers are problem documents all the same.
"""

import asyncio
import resource
from http import HTTPStatus

from uvicorn.protocols.http.h11_impl import H11Protocol

from service.http import problems
from service.http.security_headers import secured
from service.settings import Settings


class Connection(H11Protocol):
    """One client's connection; `connection_class` gives it its limits.

    Attributes
    ----------
    most : int
        Connections that may be open at once.
    head_seconds : float
        Time that a request's head may take to arrive, the first one's from when the connection was made [s].
    silence_seconds : float
        Time that a client may leave an answer unread [s].
    """

    most: int
    head_seconds: float
    silence_seconds: float

    _head_timer: asyncio.TimerHandle | None = None
    _write_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for the first request."""
        super().connection_made(transport)
        self._one_too_many = len(self.connections) > self.most
        self._watch_head()

    def data_received(self, data: bytes) -> None:
        """Take the next bytes; those of a connection too many get 503."""
        if self._one_too_many:
            self._refuse("overloaded", f"{self.most} connections are open, as many as may; try again later.")
            return
        super().data_received(data)
        self._watch_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the timers."""
        _cancel(self._head_timer)
        _cancel(self._write_timer)
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        """Begin to wait for the client to read what has been sent."""
        super().pause_writing()
        self._write_timer = self.loop.call_later(self.silence_seconds, self.transport.abort)

    def resume_writing(self) -> None:
        """Go on writing."""
        _cancel(self._write_timer)
        super().resume_writing()

    def send_400_response(self, msg: str) -> None:
        """Answer what is not HTTP."""
        if not self._idle() and self.cycle.response_started:
            self.transport.close()  # in the middle of another answer
            return
        self._refuse("bad-request", f"{msg.rstrip('.')}: what was sent is not HTTP/1.1, or its head is too long.")

    def _watch_head(self) -> None:
        """Let the timer run exactly while a request's head is being waited for."""
        if not self._idle():
            _cancel(self._head_timer)
            self._head_timer = None
        elif self._head_timer is None:
            self._head_timer = self.loop.call_later(self.head_seconds, self._head_is_late)

    def _idle(self) -> bool:
        """Return whether no request is being answered."""
        return not self.cycle or self.cycle.response_complete

    def _head_is_late(self) -> None:
        self._head_timer = None
        if self._idle():
            detail = f"The request's head took longer than the {self.head_seconds:g} s that it may take."
            self._refuse("request-timeout", detail)

    def _refuse(self, kind: str, detail: str) -> None:
        """Answer with a problem document, without the application, and close."""
        if not self.transport.is_closing():
            answer = problems.response(kind, detail, "/", {"Connection": "close"})
            head = [f"HTTP/1.1 {answer.status_code} {HTTPStatus(answer.status_code).phrase}".encode()]
            head += [name + b": " + value for name, value in secured(answer.raw_headers)]
            self.transport.write(b"\r\n".join([*head, b"", bytes(answer.body)]))
            self.transport.close()


def connection_class(settings: Settings) -> type[Connection]:
    """Return the class of connections that have the limits of `settings`, and leave room for as many files."""
    most = 2 * settings.limit_concurrency  # some are idle, and a request too many gets its answer from `Observe`
    descriptors, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    limits = {
        "most": most if descriptors == resource.RLIM_INFINITY else min(most, descriptors // 2),
        "head_seconds": settings.head_seconds,
        "silence_seconds": settings.silence_seconds,
    }
    return type("Connection", (Connection,), limits)


def _cancel(timer: asyncio.TimerHandle | None) -> None:
    if timer is not None:
        timer.cancel()
