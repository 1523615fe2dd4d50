"""Make, list, revoke and find API keys.

A key is ``dsbrdf_<id>_<secret>``. The database stores only the sha256 of the secret: a secret of 32 random bytes cannot
be guessed from its hash, so a slow hash would not be safer. Data that are stored with a key belong to its id, which is
public.
"""

import hashlib
import secrets
import time
from contextlib import closing
from pathlib import Path
from typing import Any

from .database import Database, is_data_folder
from .schema import ROW_SIZE

_SHOWN = ("id", "name", "created", "revoked", "requests_per_second", "stored_mb", "queued_fits", "metrics")
_SELECT_ACTIVE = (
    "SELECT secret_sha256, coalesce(requests_per_second, ?), coalesce(stored_mb, ?), coalesce(queued_fits, ?), metrics"
    " FROM keys WHERE revoked IS NULL AND id = ?"
)


def add_key(database: Database, name: str, **fields: Any) -> tuple[str, str]:
    """Make a key and its row, with further `fields`; return the id and the key, whose secret is not stored."""
    key_id, secret = secrets.token_hex(6), secrets.token_urlsafe(32)
    digest = hashlib.sha256(secret.encode()).hexdigest()
    values = {"id": key_id, "name": name, "secret_sha256": digest, "created": time.time(), **fields}
    marks = ", ".join(f":{column}" for column in values)
    with database.transaction() as db:
        db.execute(f"INSERT INTO keys ({', '.join(values)}) VALUES ({marks})", values)  # noqa: S608
    return key_id, f"dsbrdf_{key_id}_{secret}"


def all_keys(database: Database) -> list[dict[str, Any]]:
    """Return every key without its secret, the oldest key first."""
    rows = database.rows(f"SELECT {', '.join(_SHOWN)} FROM keys ORDER BY rowid")  # noqa: S608
    return [dict(zip(_SHOWN, row, strict=True)) for row in rows]


def revoke_key(database: Database, key_id: str) -> bool:
    """Revoke a key and cancel its waiting fits; return whether the key existed.

    Fits and measurements of the key stay.
    """
    now = time.time()
    with database.transaction() as db:
        waiting = "UPDATE fits SET status = 'cancelled', finished = ?, size = ? WHERE owner = ? AND status = 'accepted'"
        db.execute(waiting, (now, ROW_SIZE, key_id))
        query = "UPDATE keys SET revoked = coalesce(revoked, ?) WHERE id = ?"
        return db.execute(query, (now, key_id)).rowcount > 0


def has_active_key(folder: Path) -> bool:
    """Return whether a data folder, which need not exist, has a key that is not revoked."""
    if not is_data_folder(folder):
        return False
    with closing(Database(folder, exclusive=False)) as database:
        return bool(database.rows("SELECT 1 FROM keys WHERE revoked IS NULL LIMIT 1"))


def active_key(database: Database, key_id: str, *usual: float) -> tuple[str, float, int, int, int] | None:
    """Return the secret's sha256 and the limits of a key, or None if no active key has this id.

    The query is quick enough for the event loop.

    The `usual` limits replace missing limits of the key: requests per second, stored MB, queued fits. The last returned
    number tells whether the key may read the metrics.
    """
    return database.row_now(_SELECT_ACTIVE, *usual, key_id)


def is_active(database: Database, key_id: str) -> bool:
    """Return whether a key exists and is not revoked; the query is quick enough for the event loop."""
    return database.row_now("SELECT 1 FROM keys WHERE id = ? AND revoked IS NULL", key_id) is not None
