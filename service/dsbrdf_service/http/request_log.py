"""The outermost middleware: every request gets an id, a line in the log, and is counted; every response has the id.

It also limits the number of requests in progress and the time that a body may take to arrive.
"""

import asyncio
import logging
import re
import secrets
from time import perf_counter

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ..errors import ProblemError
from ..operations.logging import bind
from ..operations.metrics import NO_ROUTE, Metrics
from ..settings import Settings
from .limits import BodyTimeout
from .problems import problem_response
from .responses import with_security_headers

_ACCEPTABLE_ID = re.compile(rb"[A-Za-z0-9._-]{1,64}")
SAFE_METHODS = ("GET", "HEAD")
HEALTH = "/health/"
"""Prefix of the paths that are answered even when the service is overloaded."""

logger = logging.getLogger(__name__)


class RequestLogMiddleware:
    """Pure ASGI middleware, around everything else of the application."""

    def __init__(self, app: ASGIApp, settings: Settings, metrics: Metrics) -> None:
        self._app = app
        self._settings = settings
        self._metrics = metrics
        self._level_of_success = logging.INFO if settings.access_log else logging.DEBUG
        self._in_progress = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, log it and count it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        body = BodyTimeout(receive, self._settings.idle_timeout, self._settings.least_upload_rate)
        exchange = _Exchange(scope, send)
        bind("request_id", exchange.request_id)
        self._in_progress += 1
        self._metrics.requests_in_progress.inc()
        try:
            await self._answer(scope, body, exchange)
        finally:
            self._in_progress -= 1
            self._metrics.requests_in_progress.dec()
            self._log(scope, exchange, body.n_bytes)

    async def _answer(self, scope: Scope, receive: Receive, exchange: "_Exchange") -> None:
        path = scope["path"]
        if self._in_progress > self._settings.limit_concurrency and not path.startswith(HEALTH):
            detail = f"{self._settings.limit_concurrency} requests are in progress, the most allowed; ask again later."
            await problem_response(ProblemError("overloaded", detail), path)(scope, receive, exchange.send)
            return
        try:
            await self._app(scope, receive, exchange.send)
        except asyncio.CancelledError:
            # The server is stopping and has waited as long as it may; its task of this request ends here anyway.
            if exchange.status is None:
                detail = "The service is shutting down and cannot finish this request; ask again later."
                await problem_response(ProblemError("shutting-down", detail), path)(scope, receive, exchange.send)
        except Exception:
            # Answered with a problem document already, and logged then. An answer that broke off in the middle
            # is the server's to log and to cut off.
            if not exchange.complete:
                raise

    def _log(self, scope: Scope, exchange: "_Exchange", n_received: int) -> None:
        seconds = perf_counter() - exchange.begin
        method, status = scope["method"], exchange.status or 499  # the client went before there was an answer
        route = getattr(scope.get("route"), "path", NO_ROUTE)
        self._metrics.answered(method, route, status, seconds)
        self._metrics.uploaded_bytes.inc(n_received)
        if status >= 500:
            level = logging.ERROR if status == 500 else logging.WARNING
        elif status < 400 and method in SAFE_METHODS:
            level = self._level_of_success
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

    __slots__ = ("_head", "_send", "begin", "complete", "request_id", "status")

    def __init__(self, scope: Scope, send: Send) -> None:
        self.begin = perf_counter()
        self.status: int | None = None
        self.complete = False
        self._send = send
        self._head = scope["method"] == "HEAD"
        given = next((value for name, value in reversed(scope["headers"]) if name == b"x-request-id"), b"")
        self.request_id = given.decode() if _ACCEPTABLE_ID.fullmatch(given) else secrets.token_hex(8)

    async def send(self, message: Message) -> None:
        """Pass a part of the response on; its head gets the request's id."""
        if message["type"] == "http.response.start":
            self.status = message["status"]
            message["headers"] = with_security_headers(message.get("headers", ()))
            message["headers"].append((b"x-request-id", self.request_id.encode()))
        elif self._head:  # it has no body; what was about to make one learns that the request is over
            if self.complete:
                return
            message, self.complete = {"type": "http.response.body"}, True
        elif not message.get("more_body", False):
            self.complete = True
        await self._send(message)
