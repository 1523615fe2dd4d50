"""How much an API key may have: bytes stored, uploads in progress among them, and unfinished fits."""

import sqlite3
import threading
from collections import Counter

from dsbrdf.data.merl_validation import FILE_SIZE
from service.errors import QueueQuotaError, StorageQuotaError
from service.storage.database import Database
from service.storage.schema import Caller

_STORED = (
    "SELECT (SELECT coalesce(sum(size), 0) FROM measurements WHERE owner = ?)"
    " + (SELECT coalesce(sum(size), 0) FROM fits WHERE owner = ?)"
)
_REMEDY = "delete what is not needed any more."


class Uploads:
    """The uploads in progress, counted by owner: what they write takes room before it is stored."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._lock = threading.Lock()
        self._in_progress: Counter[str] = Counter()

    def begin(self, caller: Caller) -> None:
        """Count one more of the caller's uploads.

        One at a time is let in by a caller that has no room left: its file may be one that is stored already.

        Raises StorageQuotaError if those in progress take all the room that the caller has left.
        """
        with self._lock:
            in_progress = self._in_progress[caller.owner]
            if caller.stored_bytes is not None:
                ((stored,),) = self._database.rows(_STORED, caller.owner, caller.owner)
                if in_progress >= max(1, (caller.stored_bytes - stored) // FILE_SIZE):
                    uploads = f"{in_progress} upload{'s' if in_progress > 1 else ''} in progress"
                    raise StorageQuotaError(f"{_usage(caller, stored)} and {uploads}, which take the rest; {_REMEDY}")
            self._in_progress[caller.owner] += 1

    def end(self, caller: Caller) -> None:
        """Remove an upload from the count, however it has ended."""
        with self._lock:
            self._in_progress[caller.owner] -= 1
            if not self._in_progress[caller.owner]:
                del self._in_progress[caller.owner]


def check_queue(db: sqlite3.Connection, caller: Caller) -> None:
    """Raise QueueQuotaError if the caller has as many unfinished fits as it may have."""
    if caller.queued_fits is None:
        return
    query = "SELECT count(*) FROM fits WHERE owner = ? AND status IN ('accepted', 'running')"
    (unfinished,) = db.execute(query, (caller.owner,)).fetchone()
    if unfinished >= caller.queued_fits:
        raise QueueQuotaError(
            f"{unfinished} fits of this key are unfinished, as many as may be; ask again when one has ended."
        )


def check_storage(db: sqlite3.Connection, caller: Caller, more: int) -> None:
    """Raise StorageQuotaError if the caller has no room for `more` bytes, or for one at least."""
    if caller.stored_bytes is None:
        return
    (stored,) = db.execute(_STORED, (caller.owner, caller.owner)).fetchone()
    if stored + max(more, 1) > caller.stored_bytes:
        measurement = f" and the measurement has {more / 1e6:.1f} MB" if more else ""
        raise StorageQuotaError(f"{_usage(caller, stored)}{measurement}; {_REMEDY}")


def _usage(caller: Caller, stored: int) -> str:
    return f"this key has stored {stored / 1e6:.1f} of {(caller.stored_bytes or 0) / 1e6:.1f} MB"
