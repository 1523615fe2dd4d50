"""API keys: who may send requests, and how many.

A key is ``dsbrdf_<id>_<secret>``. The database has the sha256 of its secret only: a secret of 32 random bytes cannot
be guessed from it, so nothing slower is needed. The id is public, and it is the owner of what is stored with the key.
"""

import hashlib
import hmac
import re
import secrets
import time
from contextlib import closing
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from ..storage.database import FILE_NAME, Database
from ..storage.schema import Caller

if TYPE_CHECKING:  # pydantic takes longer to import than `dsbrdf keys` to run
    from ..settings import Settings

_KEY = re.compile(rb"dsbrdf_([0-9a-f]{12})_([A-Za-z0-9_-]{43})")
_NO_SECRET = b"\0" * hashlib.sha256().digest_size
_MB = 1_000_000
_BURST_SECONDS = 5.0
_SHOWN = ("id", "name", "created", "revoked", "requests_per_second", "stored_mb", "queued_fits", "metrics")
_SELECT_ACTIVE = (
    "SELECT secret_sha256, coalesce(requests_per_second, ?), coalesce(stored_mb, ?), coalesce(queued_fits, ?), metrics"
    " FROM keys WHERE revoked IS NULL AND id = ?"
)


def add_key(database: Database, name: str, **fields: Any) -> tuple[str, str]:
    """Make a key, with other `fields` of its row; return its id and the key itself, which cannot be shown again."""
    key_id, secret = secrets.token_hex(6), secrets.token_urlsafe(32)
    digest = hashlib.sha256(secret.encode()).hexdigest()
    values = {"id": key_id, "name": name, "created": time.time(), "secret_sha256": digest, **fields}
    marks = ", ".join(f":{name}" for name in values)
    with database.transaction() as db:
        db.execute(f"INSERT INTO keys ({', '.join(values)}) VALUES ({marks})", values)  # noqa: S608
    return key_id, f"dsbrdf_{key_id}_{secret}"


def all_keys(database: Database) -> list[dict[str, Any]]:
    """Return every key without its secret, in the order in which they were made."""
    rows = database.rows(f"SELECT {', '.join(_SHOWN)} FROM keys ORDER BY rowid")  # noqa: S608
    return [dict(zip(_SHOWN, row, strict=True)) for row in rows]


def revoke_key(database: Database, key_id: str) -> bool:
    """Revoke a key and cancel its waiting fits, what is stored with it stays; return whether there was such a key."""
    now = time.time()
    with database.transaction() as db:
        waiting = "UPDATE fits SET status = 'cancelled', finished = ? WHERE owner = ? AND status = 'accepted'"
        db.execute(waiting, (now, key_id))
        query = "UPDATE keys SET revoked = coalesce(revoked, ?) WHERE id = ?"
        return db.execute(query, (now, key_id)).rowcount > 0


def has_active_key(folder: Path) -> bool:
    """Return whether a data folder, which need not exist, has a key that is not revoked."""
    if not (folder / FILE_NAME).exists():
        return False
    with closing(Database(folder, exclusive=False)) as database:
        return bool(database.rows("SELECT 1 FROM keys WHERE revoked IS NULL LIMIT 1"))


class Keys:
    """The active keys of a database, which is asked each time; `settings` has the limits of keys without their own."""

    def __init__(self, settings: "Settings") -> None:
        self._usual = settings.key_requests_per_second, settings.key_stored_mb, settings.key_queued_fits
        self._paid_until: dict[str, float] = {}  # by key: when its requests so far would end, one after the other

    def open(self, database: Database) -> None:
        """Set the database; before, there are no keys to ask for."""
        self._database = database

    def find(self, text: bytes) -> Caller | None:
        """Return whose key has this text; the time that it takes does not depend on which part of it is wrong."""
        parts = _KEY.fullmatch(text)
        if parts is None:
            return None
        key_id = parts[1].decode()
        row = self._database.row_now(_SELECT_ACTIVE, *self._usual, key_id)
        expected = _NO_SECRET if row is None else bytes.fromhex(row[0])
        right = hmac.compare_digest(hashlib.sha256(parts[2]).digest(), expected)
        if row is None or not right:
            return None
        _, rate, stored_mb, queued_fits, metrics = row
        return Caller(key_id, stored_mb * _MB, queued_fits, bool(metrics), rate)

    def wait(self, caller: Caller) -> float:
        """Count a request and return 0, or return the time until the next one may come [s].

        Those of five seconds, and one at least, may come at once.
        """
        now, each = monotonic(), 1.0 / caller.requests_per_second
        begin = max(now, self._paid_until.get(caller.owner, now))
        too_early = begin - now - max(0.0, _BURST_SECONDS - each)
        if too_early > 0.0:
            return too_early
        self._paid_until[caller.owner] = begin + each
        return 0.0

    def allows(self, caller: Caller) -> bool:
        """Return whether the key of a caller is still active; a caller without key is always allowed."""
        query = "SELECT 1 FROM keys WHERE id = ? AND revoked IS NULL"
        return not caller.owner or self._database.row_now(query, caller.owner) is not None
