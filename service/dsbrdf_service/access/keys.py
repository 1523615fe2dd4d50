"""Manage API keys and their limits.

A key is ``dsbrdf_<id>_<secret>``. The database stores only the sha256 of the secret: a secret of 32 random bytes cannot
be guessed from its hash, so a slow hash would not be safer. Data that are stored with a key belong to its id, which is
public.
"""

import hashlib
import hmac
import re
import secrets
from time import monotonic
from typing import TYPE_CHECKING, Any

from ..storage.database import Database
from ..storage.keys import active_key, insert_key, is_active
from ..storage.schema import Caller

if TYPE_CHECKING:  # At runtime, this import would load pydantic, which takes longer than `dsbrdf keys` itself.
    from ..settings import Settings

_KEY = re.compile(rb"dsbrdf_([0-9a-f]{12})_([A-Za-z0-9_-]{43})")
_NO_SECRET = b"\0" * hashlib.sha256().digest_size
_MB = 1_000_000
_BURST_SECONDS = 5.0


def add_key(database: Database, name: str, **fields: Any) -> tuple[str, str]:
    """Make a key and its row, with further `fields`; return the id and the key, whose secret is not stored."""
    key_id, secret = secrets.token_hex(6), secrets.token_urlsafe(32)
    digest = hashlib.sha256(secret.encode()).hexdigest()
    insert_key(database, {"id": key_id, "name": name, "secret_sha256": digest, **fields})
    return key_id, f"dsbrdf_{key_id}_{secret}"


class Keys:
    """Find keys in the database at each request, so that a change of a key applies at once.

    `settings` has the limits of keys that have no limits of their own.
    """

    def __init__(self, settings: "Settings") -> None:
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
