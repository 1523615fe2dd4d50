"""Write unfinished uploads and answers to files, and check the quotas of API keys."""

import asyncio
import sqlite3
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from weakref import WeakSet

from anyio import CapacityLimiter, to_thread

from dsbrdf.data.merl_validation import FILE_SIZE

from ..errors import InvalidKeyError, ProblemError
from .blobs import Blobs, Incoming, OpenFile
from .database import Database
from .schema import IS_UNFINISHED, Caller

in_thread = partial(to_thread.run_sync, limiter=CapacityLimiter(4))
"""Run a function of an upload in one of four threads, because each thread keeps the memory of its last piece."""
_STORED = (
    "SELECT (SELECT coalesce(sum(size), 0) FROM measurements WHERE owner = ?)"
    " + (SELECT coalesce(sum(size), 0) FROM fits WHERE owner = ?)"
)


@dataclass(eq=False)
class Hold:
    """Reserve disk space for an unfinished upload or an unread answer, as long as this object lives."""

    owner: str
    n_bytes: int


class Writing:
    """Write uploads in progress, and answers that clients have not read completely; both count in the key's quota."""

    def __init__(self, database: Database, blobs: Blobs) -> None:
        self._database = database
        self._blobs = blobs
        self._holds: WeakSet[Hold] = WeakSet()  # Only the event loop adds to this set, so no lock is needed.

    async def hold(self, caller: Caller, n_bytes: int, kind: str) -> Hold:
        """Reserve space for a file; raise ProblemError of a `kind` if the files in progress exceed the caller's quota.

        A caller whose quota is full may still have one file at a time, because the service may have the uploaded file
        already, and an answer is deleted when it has been read.
        """
        others = [hold.n_bytes for hold in self._holds if hold.owner == caller.owner]
        held = Hold(caller.owner, n_bytes)
        self._holds.add(held)
        if others:
            stored = await in_thread(self._stored, caller)
            if stored + sum(others) + n_bytes > caller.stored_bytes:
                self._holds.discard(held)
                said = f" and {len(others)} uploads and answers in progress take {sum(others) / 1e6:.1f} MB"
                raise _full(caller.stored_bytes, stored, said, kind)
        return held

    @asynccontextmanager
    async def incoming(self, caller: Caller) -> AsyncIterator[Incoming]:
        """Yield a new file, which is removed afterwards unless it was stored; raises the errors of `hold`."""
        held = await self.hold(caller, FILE_SIZE, "storage-quota")
        try:
            incoming = await in_thread(Incoming, self._blobs.temporary)
            try:
                yield incoming
            finally:
                await asyncio.shield(in_thread(incoming.discard))
        finally:
            self._holds.discard(held)

    @asynccontextmanager
    async def answer(self, caller: Caller, n_bytes: int) -> AsyncIterator[tuple[OpenFile, Path]]:
        """Yield an open file and its path, to which the block writes at most `n_bytes`.

        The content is deleted when the last reference to the open file ends. Raises ProblemError if the files in
        progress exceed the caller's quota.
        """
        held = await self.hold(caller, n_bytes, "too-many-at-once")
        try:
            with self._blobs.temporary_file(held) as (file, path):
                yield file, path
            held.n_bytes = file.size
        except BaseException:
            self._holds.discard(held)
            raise

    async def answer_with(self, caller: Caller, content: bytes) -> OpenFile:
        """Return a file with the content of an answer; raises the errors of `hold`."""
        async with self.answer(caller, len(content)) as (file, path):
            await in_thread(path.write_bytes, content)
        return file

    def _stored(self, caller: Caller) -> int:
        ((stored,),) = self._database.rows(_STORED, caller.owner, caller.owner)
        return int(stored)


def check_key(db: sqlite3.Connection, caller: Caller) -> None:
    """Raise InvalidKeyError if the caller's key has been revoked since the request began."""
    if db.execute("SELECT 1 FROM keys WHERE id = ? AND revoked IS NOT NULL", (caller.owner,)).fetchone():
        raise InvalidKeyError


def check_queue(db: sqlite3.Connection, caller: Caller) -> None:
    """Raise ProblemError if the caller's number of unfinished fits is at its limit."""
    query = f"SELECT count(*) FROM fits WHERE owner = ? AND {IS_UNFINISHED}"  # noqa: S608
    (unfinished,) = db.execute(query, (caller.owner,)).fetchone()
    if unfinished >= caller.queued_fits:
        detail = f"{unfinished} fits of this key are unfinished, which is the limit; try again when one has ended."
        raise ProblemError("queue-quota", detail)


def check_storage(db: sqlite3.Connection, caller: Caller, more: int, said: str) -> None:
    """Raise ProblemError if `more` bytes would exceed the caller's quota; `said` is the text before this number."""
    (stored,) = db.execute(_STORED, (caller.owner, caller.owner)).fetchone()
    if stored + more > caller.stored_bytes:
        raise _full(caller.stored_bytes, stored, f" and {said} {more / 1e6:.1f} MB")


def _full(allowed: float, stored: int, more: str, kind: str = "storage-quota") -> ProblemError:
    usage = f"this key has stored {stored / 1e6:.1f} of {allowed / 1e6:.1f} MB"
    remedy = "delete what is not needed any more"
    if kind != "storage-quota":
        remedy = f"read or close those answers, or {remedy}"
    return ProblemError(kind, f"{usage}{more}; {remedy}.")
