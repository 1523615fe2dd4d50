"""Uploads in progress, and how much an API key may have."""

import asyncio
import sqlite3
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial

from anyio import CapacityLimiter, to_thread

from dsbrdf.data.merl_validation import FILE_SIZE

from ..errors import InvalidKeyError, ProblemError
from .blobs import Blobs, Incoming
from .database import Database
from .schema import IS_UNFINISHED, Caller

in_thread = partial(to_thread.run_sync, limiter=CapacityLimiter(4))
"""Calls what belongs to an upload, in few threads for all: each keeps the memory of its last piece."""
_STORED = (
    "SELECT (SELECT coalesce(sum(size), 0) FROM measurements WHERE owner = ?)"
    " + (SELECT coalesce(sum(size), 0) FROM fits WHERE owner = ?)"
)


class Uploads:
    """The uploads in progress, counted by owner: what they write takes room before it is stored."""

    def __init__(self, database: Database, blobs: Blobs) -> None:
        self._database = database
        self._blobs = blobs
        self._in_progress: Counter[str] = Counter()  # changed by the event loop alone

    @asynccontextmanager
    async def incoming(self, caller: Caller) -> AsyncIterator[Incoming]:
        """Yield a new file, which is removed afterwards unless it was stored; the upload counts as long as that takes.

        A caller without room may still send one file at a time, because that file may be stored already.

        Raises ProblemError if those in progress take all the room that the caller has left.
        """
        others = self._in_progress[caller.owner]
        self._in_progress[caller.owner] += 1
        try:
            await in_thread(self._check_room, caller, others)
            incoming = await in_thread(self._blobs.incoming)
            try:
                yield incoming
            finally:
                await asyncio.shield(in_thread(incoming.discard))
        finally:
            self._in_progress[caller.owner] -= 1
            self._in_progress += Counter()  # without those that have none

    def _check_room(self, caller: Caller, in_progress: int) -> None:
        ((stored,),) = self._database.rows(_STORED, caller.owner, caller.owner)
        if in_progress + 1 > max(1.0, (caller.stored_bytes - stored) / FILE_SIZE):
            uploads = f"{in_progress} upload{'s' if in_progress > 1 else ''} in progress"
            raise _full(caller.stored_bytes, stored, f" and {uploads}, which take the rest")


def check_key(db: sqlite3.Connection, caller: Caller) -> None:
    """Raise InvalidKeyError if the caller's key has been revoked since the request began."""
    if db.execute("SELECT 1 FROM keys WHERE id = ? AND revoked IS NOT NULL", (caller.owner,)).fetchone():
        raise InvalidKeyError


def check_queue(db: sqlite3.Connection, caller: Caller) -> None:
    """Raise ProblemError if the caller has as many unfinished fits as it may have."""
    query = f"SELECT count(*) FROM fits WHERE owner = ? AND {IS_UNFINISHED}"  # noqa: S608
    (unfinished,) = db.execute(query, (caller.owner,)).fetchone()
    if unfinished >= caller.queued_fits:
        detail = f"{unfinished} fits of this key are unfinished, the most allowed; ask again when one has ended."
        raise ProblemError("queue-quota", detail)


def check_storage(db: sqlite3.Connection, caller: Caller, more: int) -> None:
    """Raise ProblemError if the caller has no room for `more` bytes, or for one at least."""
    (stored,) = db.execute(_STORED, (caller.owner, caller.owner)).fetchone()
    if stored + max(more, 1) > caller.stored_bytes:
        measurement = f" and the measurement has {more / 1e6:.1f} MB" if more else ""
        raise _full(caller.stored_bytes, stored, measurement)


def _full(allowed: float, stored: int, more: str) -> ProblemError:
    usage = f"this key has stored {stored / 1e6:.1f} of {allowed / 1e6:.1f} MB"
    return ProblemError("storage-quota", f"{usage}{more}; delete what is not needed any more.")
