"""Admit or refuse requests, and limit the rate and the number of simultaneous requests of each caller.

An API key is needed if other machines can reach the service. On loopback, the local user needs no key. Two kinds of
requests reach loopback but are not from the local user, and are refused: requests of another site's page in the user's
browser, and requests to a foreign host name that was made to resolve to this machine.
"""

import hashlib
import hmac
import math
import re
from collections import Counter
from time import monotonic

from prometheus_client import Gauge
from starlette.types import Scope

from .errors import InvalidKeyError, ProblemError
from .settings import Settings
from .storage.database import Database
from .storage.keys import active_key, is_active
from .storage.schema import Caller

_KEY = re.compile(rb"dsbrdf_([0-9a-f]{12})_([A-Za-z0-9_-]{43})")
_NO_SECRET = b"\0" * hashlib.sha256().digest_size
_MB = 1_000_000
_BURST_SECONDS = 5.0
HEALTH = ("/health/live", "/health/ready")
"""Paths that are answered to everyone, even when the service is overloaded."""
CALLER = "dsbrdf.caller"
"""Member of the ASGI scope: the `Caller`, whose measurements and fits the request may use."""
CALLER_NAME = "dsbrdf.caller_name"
"""Member of the ASGI scope: the key or the address under which the request is counted."""
# The web page and the documentation need no key, because they show no data of a caller.
_OPEN = re.compile(r"/(compare|docs|openapi\.json)?|/(fits|measurements|page|docs)/[0-9A-Za-z._-]{1,100}")
_LOCAL = Caller()
# Host names without a dot are allowed, because only the local network can make such a name resolve to this machine.
_LOCAL_NAME = re.compile(rb"([a-z0-9-]+|127(\.[0-9]{1,3}){3}|\[::1\])(:[0-9]{1,5})?", re.IGNORECASE)


class Keys:
    """Find keys in the database at each request, so that a change of a key applies at once.

    `settings` has the limits of keys that have no limits of their own.
    """

    def __init__(self, settings: Settings) -> None:
        self._usual = settings.key_requests_per_second, settings.key_stored_mb, settings.key_queued_fits
        self._next_due: dict[str, float] = {}  # For each key, the time when its next evenly spaced request is due.

    def open(self, database: Database) -> None:
        """Set the database in which keys are found; this is called before the first request."""
        self._database = database

    def find(self, text: bytes) -> Caller | None:
        """Return the caller whose key has this text, or None; the duration does not reveal which part is wrong."""
        parts = _KEY.fullmatch(text)
        if parts is None:
            return None
        key_id = parts[1].decode()
        row = active_key(self._database, key_id, *self._usual)
        expected = _NO_SECRET if row is None else bytes.fromhex(row[0])
        right = hmac.compare_digest(hashlib.sha256(parts[2]).digest(), expected)
        if row is None or not right:
            return None
        _, rate, stored_mb, queued_fits, metrics = row
        return Caller(key_id, stored_mb * _MB, queued_fits, bool(metrics), rate)

    def wait(self, caller: Caller) -> float:
        """Count a request of a caller and return 0, or return the time after which a request is allowed [s].

        A burst may have as many requests as are allowed in five seconds, but at least one.
        """
        now, each = monotonic(), 1.0 / caller.requests_per_second
        begin = max(now, self._next_due.get(caller.owner, now))
        too_early = begin - now - max(0.0, _BURST_SECONDS - each)
        if too_early > 0.0:
            return too_early
        self._next_due[caller.owner] = begin + each
        return 0.0

    def allows(self, caller: Caller) -> bool:
        """Return whether the key of a caller is still active; a caller without key is always allowed."""
        return not caller.owner or is_active(self._database, caller.owner)


class Access:
    """Admit or refuse requests; a single caller can have at most half of the allowed requests in progress."""

    def __init__(self, settings: Settings, keys: Keys, in_progress: Gauge) -> None:
        self._keys = keys
        self._needs_key = settings.require_keys or not (settings.loopback or settings.insecure)
        self._local_only = settings.loopback and not settings.insecure
        self._free = self._places = settings.limit_concurrency
        self._in_progress: Counter[str] = Counter()  # Requests by API key, or by address if a client has no key.
        in_progress.set_function(lambda: self._places - self._free)

    def admit(self, scope: Scope, headers: dict[bytes, bytes]) -> str | None:
        """Count a request and return its key or its client's address; return None for a path in `HEALTH`.

        Raises ProblemError if the request is not allowed, if the number of requests in progress is at its limit, or if
        the caller already has as many requests in progress as could still be admitted.
        """
        path = scope["path"]
        if path in HEALTH:
            return None
        if not self._free:
            detail = f"{self._places} requests are in progress, which is the limit; try again later."
            raise ProblemError("overloaded", detail)
        caller = str((scope.get("client") or ("",))[0])
        if not _OPEN.fullmatch(path):
            scope[CALLER] = _LOCAL
            if b"authorization" in headers:
                scope[CALLER] = self._owner(scope)
                caller = f"key {scope[CALLER].owner}"
            else:
                self._check_local(headers)
            if not path.isprintable():  # A route would take the text before a line break for the path.
                raise ProblemError("not-found", "The path has a control character; GET /docs lists all paths.")
        scope[CALLER_NAME] = caller
        number = self._in_progress[caller]
        if number >= self._free:
            detail = f"{number} of your requests are in progress, which is the limit now; wait until some have ended."
            raise ProblemError("too-many-at-once", detail, {"Connection": "close"})
        self._in_progress[caller] = number + 1
        self._free -= 1
        return caller

    def release(self, caller: str | None) -> None:
        """Count a request as ended."""
        if caller is not None:
            self._free += 1
            self._in_progress[caller] -= 1
            if not self._in_progress[caller]:
                del self._in_progress[caller]

    def _owner(self, scope: Scope) -> Caller:
        """Check the API key of a request, count the request, and return the owner of the key.

        A key is checked even if the service needs no key. A request with two keys is refused, because it is unclear
        which one counts.
        """
        sent = [value for name, value in scope["headers"] if name == b"authorization"]
        scheme, _, text = sent[0].partition(b" ")
        caller = self._keys.find(text.strip(b" ")) if len(sent) == 1 and scheme.lower() == b"bearer" else None
        if caller is None:
            raise InvalidKeyError
        if seconds := self._keys.wait(caller):
            rate = f"{caller.requests_per_second:g} requests per second"
            detail = f"This key may make {rate}; try again in {seconds:.3g} s."
            raise ProblemError("rate-limited", detail, {"Retry-After": str(math.ceil(seconds))})
        return caller

    def _check_local(self, headers: dict[bytes, bytes]) -> None:
        """Raise ProblemError unless a request without a key comes from the local user."""
        if self._needs_key:
            detail = "The request has no API key, but this service needs one; send it as 'Authorization: Bearer <key>'."
            raise ProblemError("unauthorized", detail, {"WWW-Authenticate": "Bearer"})
        if not self._local_only:
            return
        host, origin = headers.get(b"host"), headers.get(b"origin")
        if host is not None and not _LOCAL_NAME.fullmatch(host):
            detail = "Without an API key, the host in the address must be 127.0.0.1, localhost or a name without a dot."
            raise ProblemError("misdirected", detail)
        from_elsewhere = origin is not None and origin.partition(b"://")[2] != host
        if from_elsewhere or headers.get(b"sec-fetch-site", b"none") not in (b"same-origin", b"none"):
            detail = "Without an API key, pages of other sites cannot use the service; open its own page or send a key."
            raise ProblemError("foreign-origin", detail)
