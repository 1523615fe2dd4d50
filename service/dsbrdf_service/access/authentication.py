"""Authentication: whose request it is, whether it is allowed, how often, and how many at once.

A key is needed where other machines can reach the service. On loopback the local user needs none; the request must then
be this user's own: not one from a page of another site in the user's browser, nor one to a foreign host name that has
been made to resolve to this machine.
"""

import math
import re
import sqlite3
from collections import Counter

from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from ..errors import InvalidKeyError, ProblemError
from ..http.limits import check_head
from ..http.problems import problem_of, problem_response
from ..http.request_log import HEALTH
from ..http.static_files import PAGE_PATHS, STATIC_FILES
from ..settings import Settings
from ..storage.schema import Caller
from .keys import ActiveKey, Keys

# They show nothing that belongs to a key.
OPEN_PATHS = frozenset(("/health/live", "/health/ready", "/openapi.json", *STATIC_FILES))

CALLER = "dsbrdf.caller"  # members of the ASGI scope: whose rows a request sees,
CALLER_NAME = "dsbrdf.caller_name"  # and whom it counts for, a key or an address
_LOCAL = Caller()
# A name without a dot is the machine's or the local network's: nobody outside can make it resolve to this machine.
_LOCAL_NAME = re.compile(rb"([a-z0-9-]+|127(\.[0-9]{1,3}){3}|\[::1\])(:[0-9]{1,5})?", re.IGNORECASE)
_Headers = list[tuple[bytes, bytes]]


class AuthenticationMiddleware:
    """Pure ASGI middleware around the routes: lets a request in with its caller, or refuses it."""

    def __init__(self, app: ASGIApp, settings: Settings, keys: Keys) -> None:
        self._app = app
        self._keys = keys
        self._needs_key = settings.require_keys or not (settings.loopback or settings.insecure)
        self._local_only = settings.loopback and not settings.insecure
        self._free = settings.limit_concurrency
        self._in_progress: Counter[str] = Counter()  # requests of each key, or of each address without one

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or answer with a problem document."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        try:
            self._check(scope)
            caller = self._begin(scope)
        except (ProblemError, sqlite3.Error) as error:  # the latter where keys cannot be read
            refusal = problem_response(problem_of(Request(scope), error), scope["path"])
            await refusal(scope, receive, send)
            return
        try:
            await self._app(scope, receive, send)
        finally:
            self._end(caller)

    def _begin(self, scope: Scope) -> str | None:
        """Count a request and return whose it is, a key's or an address's; None if it asks for the service's health.

        Raises ProblemError if a caller has more requests in progress than places are free: one can take half of all.
        """
        if scope["path"].startswith(HEALTH):
            return None
        owner = scope[CALLER].owner if CALLER in scope else ""
        caller = f"key {owner}" if owner else str((scope.get("client") or ("",))[0])
        scope[CALLER_NAME] = caller
        number = self._in_progress[caller]
        if number >= self._free:
            detail = f"{number} requests of this caller are in progress, the most allowed now; wait for some to end."
            raise ProblemError("too-many-at-once", detail, {"Connection": "close"})
        self._in_progress[caller] = number + 1
        self._free -= 1
        return caller

    def _end(self, caller: str | None) -> None:
        if caller is not None:
            self._free += 1
            self._in_progress[caller] -= 1
            if not self._in_progress[caller]:
                del self._in_progress[caller]

    def _check(self, scope: Scope) -> None:
        """Set the caller of a request that is allowed; otherwise raise ProblemError."""
        check_head(scope)
        if scope["path"] in OPEN_PATHS or PAGE_PATHS.fullmatch(scope["path"]):
            return
        key = self._key(scope)
        scope[CALLER] = _LOCAL if key is None else key.caller
        if not scope["path"].isprintable():  # a route would take a line break for the end of the path
            raise ProblemError("not-found", "No path here has control characters; GET /docs lists what there is.")

    def _key(self, scope: Scope) -> ActiveKey | None:
        """Return the key of a request, and count it; None is the local user, who needs none."""
        headers: _Headers = scope["headers"]
        sent = [value for name, value in headers if name == b"authorization"]
        if not sent:
            self._check_local(headers)
            return None
        scheme, _, text = sent[0].partition(b" ")
        # A key that is sent is checked even where none is needed; with two it would be unclear which one counts.
        key = self._keys.find(text.strip(b" ")) if len(sent) == 1 and scheme.lower() == b"bearer" else None
        if key is None:
            raise InvalidKeyError
        if seconds := key.rate_limit.take():
            detail = f"This key may make {key.rate_limit.rate:g} requests per second; ask again in {seconds:.3g} s."
            raise ProblemError("rate-limited", detail, {"Retry-After": str(math.ceil(seconds))})
        return key

    def _check_local(self, headers: _Headers) -> None:
        """Check that it is the local user who asks."""
        if self._needs_key:
            detail = "An API key is needed here; send it as 'Authorization: Bearer <key>'."
            raise ProblemError("unauthorized", detail, {"WWW-Authenticate": "Bearer"})
        if self._local_only:
            hosts = [value for name, value in headers if name == b"host"]
            if not all(_LOCAL_NAME.fullmatch(host) for host in hosts):
                detail = "Without an API key the service answers to 127.0.0.1, localhost and names without a dot only."
                raise ProblemError("misdirected", detail)
            if _from_another_site(headers):
                detail = "Without an API key the service does not answer to pages of other sites."
                raise ProblemError("foreign-origin", detail)


def _from_another_site(headers: _Headers) -> bool:
    """Return whether a browser says that a page of another site has sent a request."""
    hosts = [value for name, value in headers if name == b"host"]
    origins = [value.partition(b"://")[2] for name, value in headers if name == b"origin"]
    sites = [value for name, value in headers if name == b"sec-fetch-site"]
    return not (all(site in (b"same-origin", b"none") for site in sites) and all(origin in hosts for origin in origins))
