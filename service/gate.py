"""The gate: who asks, whether that is allowed, and how often. Every request has an owner, whose rows it sees.

A key is asked for where other machines reach the service. On loopback there is a user without one, and then it has to
be this user who asks: not a page of another site that is open in the user's browser, nor one whose name has been made
to lead here.
"""

import math
import re

from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from service import problems
from service.keys import Keys
from service.problems import ProblemError
from service.rows import Caller, FitKey
from service.settings import Settings
from service.store import QueueQuotaError, StorageQuotaError

_PAGE = ("/docs", "/docs/page.js", "/docs/swagger-ui-bundle.js", "/docs/swagger-ui.css")
OPEN_PATHS = frozenset(("/health/live", "/health/ready", "/openapi.json", *_PAGE))  # they tell nothing of anyone

_CALLER = "dsbrdf.caller"  # member of the ASGI scope
_LOCAL = Caller()
# A name without a dot is the machine's or the local network's: nobody outside can make it lead here.
_LOCAL_NAME = re.compile(rb"([a-z0-9-]+|127(\.[0-9]{1,3}){3}|\[::1\])(:[0-9]{1,5})?", re.IGNORECASE)
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
        if scope["type"] == "http" and scope["path"] not in OPEN_PATHS:
            try:
                scope[_CALLER] = self._caller(scope["headers"])
                _check_path(scope["path"])
            except ProblemError as refusal:
                response = problems.response(refusal.kind, refusal.detail, scope["path"], refusal.headers)
                await response(scope, receive, send)
                return
        await self._app(scope, receive, send)

    def _caller(self, headers: _Headers) -> Caller:
        sent = [value for name, value in headers if name == b"authorization"]
        if not sent:
            return self._without_key(headers)
        scheme, _, text = sent[0].partition(b" ")
        # A key that is sent counts, also where none is needed; of two it would be unclear which.
        key = self._keys.find(text.strip(b" ")) if len(sent) == 1 and scheme.lower() == b"bearer" else None
        if key is None:
            detail = "The Authorization header holds no valid API key; send one key as 'Authorization: Bearer <key>'."
            raise ProblemError("unauthorized", detail, {"WWW-Authenticate": 'Bearer error="invalid_token"'})
        seconds = key.bucket.take()
        if seconds:
            detail = f"This key may make {key.bucket.rate:g} requests per second; ask again in {seconds:.3g} s."
            raise ProblemError("rate-limited", detail, {"Retry-After": str(math.ceil(seconds))})
        return key.caller

    def _without_key(self, headers: _Headers) -> Caller:
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
        return _LOCAL


def _check_path(path: str) -> None:
    if not path.isprintable():  # a route would take a line's end for the end of the path
        raise ProblemError("not-found", "No path here has control characters; GET /docs lists what there is.")


def _key_needed(detail: str) -> ProblemError:
    return ProblemError("unauthorized", detail, {"WWW-Authenticate": "Bearer"})


def over_quota(error: StorageQuotaError | QueueQuotaError) -> ProblemError:
    """Return the problem of a caller who wants more than it may have."""
    if isinstance(error, QueueQuotaError):
        return ProblemError("queue-quota", f"{error}; ask again when one has ended.", {"Retry-After": "5"})
    return ProblemError("storage-quota", f"{error}; delete what is not needed any more.")
