"""The gate: who asks, whether that is allowed, and how often. Every request has an owner, whose rows it sees.

A key is asked for where other machines reach the service. On loopback there is a user without one, and then it has to
be this user who asks: not a page of another site that is open in the user's browser, nor one whose name has been made
to lead here.
"""

import asyncio
import math
import re

from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.access.keys import ActiveKey, Keys
from service.http import problems
from service.http.problems import ProblemError
from service.settings import Settings
from service.storage.quota import QueueQuotaError, StorageQuotaError
from service.storage.rows import Caller, FitKey

_PAGE = ("/docs", "/docs/page.js", "/docs/swagger-ui-bundle.js", "/docs/swagger-ui.css")
OPEN_PATHS = frozenset(("/health/live", "/health/ready", "/openapi.json", *_PAGE))  # they tell nothing of anyone

_CALLER = "dsbrdf.caller"  # member of the ASGI scope
_LOCAL = Caller()
# A name without a dot is the machine's or the local network's: nobody outside can make it lead here.
_LOCAL_NAME = re.compile(rb"([a-z0-9-]+|127(\.[0-9]{1,3}){3}|\[::1\])(:[0-9]{1,5})?", re.IGNORECASE)
_GONE: Message = {"type": "http.disconnect"}
_EVENTS = b"text/event-stream"
_Headers = list[tuple[bytes, bytes]]


def caller_of(request: Request) -> Caller:
    """Return who asks, and how much it may have."""
    caller: Caller = request.scope[_CALLER]
    return caller


def owner_of(request: Request) -> str:
    """Return whose rows the request may see: the id of its key, or '' without one."""
    return caller_of(request).owner


def fit_of(request: Request, fit_id: str) -> FitKey:
    """Return the name of the caller's fit `fit_id`."""
    return FitKey(owner_of(request), fit_id)


class Gate:
    """Pure ASGI middleware around the routes.

    Parameters
    ----------
    app : ASGIApp
        What it guards.
    settings : Settings
    keys : Keys
    """

    def __init__(self, app: ASGIApp, settings: Settings, keys: Keys) -> None:
        self._app = app
        self._keys = keys
        self._needs_key = settings.require_keys or not (settings.loopback or settings.insecure)
        self._local_only = settings.loopback and not settings.insecure

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request in, or answer why not."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        try:
            key = self._admitted(scope)
        except ProblemError as refusal:
            await _refuse(refusal, scope, receive, send)
            return
        if key is None:
            await self._app(scope, receive, send)
        else:
            await _Exchange(key, receive, send).run(self._app, scope)

    def _admitted(self, scope: Scope) -> ActiveKey | None:
        """Return the key of a request that is let in, if it has one; otherwise raise ProblemError."""
        _check_framing(scope["headers"])
        if scope["path"] in OPEN_PATHS:
            return None
        key = self._key(scope["headers"])
        scope[_CALLER] = _LOCAL if key is None else key.caller
        _check_path(scope["path"])
        return key

    def _key(self, headers: _Headers) -> ActiveKey | None:
        """Return the key of a request; None is the local user, who needs none."""
        sent = [value for name, value in headers if name == b"authorization"]
        if not sent:
            self._check_local(headers)
            return None
        scheme, _, text = sent[0].partition(b" ")
        # A key that is sent counts, also where none is needed; of two it would be unclear which.
        key = self._keys.find(text.strip(b" ")) if len(sent) == 1 and scheme.lower() == b"bearer" else None
        if key is None:
            raise _invalid_key()
        seconds = key.bucket.take()
        if seconds:
            detail = f"This key may make {key.bucket.rate:g} requests per second; ask again in {seconds:.3g} s."
            raise ProblemError("rate-limited", detail, {"Retry-After": str(math.ceil(seconds))})
        return key

    def _check_local(self, headers: _Headers) -> None:
        if self._needs_key:
            raise _key_needed("An API key is needed here; send it as 'Authorization: Bearer <key>'.")
        if self._local_only:
            hosts = [value for name, value in headers if name == b"host"]
            if not all(_LOCAL_NAME.fullmatch(host) for host in hosts):
                raise _key_needed(
                    "Without an API key the service goes by 127.0.0.1, localhost and names without a dot only."
                )
            origins = [value.partition(b"://")[2] for name, value in headers if name == b"origin"]
            if not all(origin in hosts for origin in origins):
                raise _key_needed("Without an API key the service does not answer to pages of other sites.")


class _Exchange:
    """A request with a key. When the key is revoked, its routes see the client go, and the client sees an end.

    An answer that has begun and has an end of its own is sent whole.
    """

    def __init__(self, key: ActiveKey, receive: Receive, send: Send) -> None:
        self._key = key
        self._receive = receive
        self._send = send
        self._has_more_body = True
        self._begun = False
        self._endless = False
        self._broken_off = False

    async def run(self, app: ASGIApp, scope: Scope) -> None:
        """Answer the request, to its end or to that of the key."""
        await app(scope, self.receive, self.send)
        if self._broken_off and self._begun:
            await self._send({"type": "http.response.body"})
        elif self._broken_off:
            await _refuse(_invalid_key(), scope, self._receive, self._send)

    async def receive(self) -> Message:
        """Return what comes from the client, or that it has gone."""
        if self._has_more_body:
            message = await self._receive()
            self._has_more_body = message.get("more_body", False)
        else:
            message = await self._next()
        if self._key.revoked.is_set() and self._can_break_off:
            self._broken_off = True
            return _GONE
        return message

    @property
    def _can_break_off(self) -> bool:
        return self._endless or not self._begun

    async def _next(self) -> Message:
        """Return what comes behind the body, but wait no longer than the key is good."""
        coming = asyncio.ensure_future(self._receive())
        revoked = asyncio.ensure_future(self._key.revoked.wait())
        try:
            await asyncio.wait((coming, revoked), return_when=asyncio.FIRST_COMPLETED)
            return _GONE if self._can_break_off and not coming.done() else await coming
        finally:
            coming.cancel()
            revoked.cancel()

    async def send(self, message: Message) -> None:
        """Pass a part of the answer on."""
        if self._broken_off:
            return
        if message["type"] == "http.response.start":
            self._begun = True
            self._endless = any(value.startswith(_EVENTS) for _, value in message["headers"])
        await self._send(message)


async def _refuse(refusal: ProblemError, scope: Scope, receive: Receive, send: Send) -> None:
    response = problems.response(refusal.kind, refusal.detail, scope["path"], refusal.headers)
    await response(scope, receive, send)


def _check_framing(headers: _Headers) -> None:
    names = {name for name, _ in headers}
    if b"transfer-encoding" in names and b"content-length" in names:  # a proxy may see another end than this server
        detail = "The body's end is told twice, by Content-Length and by Transfer-Encoding; send one of them."
        raise ProblemError("bad-request", detail, {"Connection": "close"})


def _check_path(path: str) -> None:
    if not path.isprintable():  # a route would take a line's end for the end of the path
        raise ProblemError("not-found", "No path here has control characters; GET /docs lists what there is.")


def _invalid_key() -> ProblemError:
    detail = "The Authorization header holds no valid API key; send one key as 'Authorization: Bearer <key>'."
    return ProblemError("unauthorized", detail, {"WWW-Authenticate": 'Bearer error="invalid_token"'})


def _key_needed(detail: str) -> ProblemError:
    return ProblemError("unauthorized", detail, {"WWW-Authenticate": "Bearer"})


def over_quota(error: StorageQuotaError | QueueQuotaError) -> ProblemError:
    """Return the problem of a caller who wants more than it may have."""
    if isinstance(error, QueueQuotaError):
        return ProblemError("queue-quota", f"{error}; ask again when one has ended.", {"Retry-After": "5"})
    return ProblemError("storage-quota", f"{error}; delete what is not needed any more.")
