"""Store measurement files on disk, and reserve space for unfinished uploads and unread answers.

A file is written under a temporary name. It gets its final name, the sha256 of its content, before its row is committed
and is deleted after its row (see `maintenance`), so that every row has a file. Before a file is read, its sha256 is
checked, but the sha256 is computed again only if the file has changed.
"""

import asyncio
import errno
import hashlib
import os
import re
import sqlite3
import stat
import tempfile
import weakref
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import BinaryIO
from weakref import WeakSet

from anyio import CapacityLimiter, to_thread

from ..errors import InvalidKeyError, ProblemError
from .database import Database, own_folder
from .schema import IS_UNFINISHED, Caller

_SUFFIX = ".binary"
PREFIX = "upload-"
"""Beginning of the names of temporary files; other files in that folder do not belong to the service."""
_NAME = re.compile("[0-9a-f]{64}")
in_thread = partial(to_thread.run_sync, limiter=CapacityLimiter(4))
"""Run a function of an upload in one of four threads, because each thread keeps the memory of its last piece."""
_STORED = (
    "SELECT (SELECT coalesce(sum(size), 0) FROM measurements WHERE owner = ?)"
    " + (SELECT coalesce(sum(size), 0) FROM fits WHERE owner = ?)"
)


class Incoming:
    """Write a file that is being received; `Blobs.place` stores it, or `discard` removes it."""

    def __init__(self, folder: Path) -> None:
        descriptor, name = tempfile.mkstemp(prefix=PREFIX, dir=folder)
        self.path = Path(name)
        self.size = 0  # [bytes]
        self.sha256 = ""  # `close` sets this digest.
        self.valid_nodes = 0  # Number of grid nodes with a value, set by the caller; 0 for samples.
        self._file: BinaryIO = os.fdopen(descriptor, "wb", buffering=0)
        self._digest = hashlib.sha256()

    def write(self, data: bytes | memoryview) -> None:
        """Append `data` to the file and to the digest."""
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest) :]
        self._digest.update(data)
        self.size += len(data)

    def close(self) -> None:
        """Write the content durably to the disk, close the file, and set its digest."""
        os.fsync(self._file.fileno())
        self._file.close()
        self.sha256 = self._digest.hexdigest()

    def discard(self) -> None:
        """Remove the file, unless `Blobs.place` has moved it."""
        self._file.close()
        self.path.unlink(missing_ok=True)


class OpenFile:
    """Read an open file, which stays readable after its deletion and is closed with the last reference to it."""

    def __init__(self, descriptor: int, hold: object = None) -> None:
        self._descriptor = descriptor
        self._hold = hold
        weakref.finalize(self, os.close, descriptor)

    @property
    def size(self) -> int:
        """The length of the file [bytes]."""
        return os.fstat(self._descriptor).st_size

    def read(self, n_bytes: int, position: int) -> bytes:
        """Return at most `n_bytes` bytes that begin at a position."""
        return os.pread(self._descriptor, n_bytes, position)


class Blobs:
    """Manage measurement files, named by the sha256 of their bytes, in ``blobs`` and ``tmp`` of the data folder."""

    def __init__(self, folder: Path) -> None:
        self._blobs = folder / "blobs"
        self.temporary = folder / "tmp"
        self._identity: list[tuple[int, int]] = []
        # Stat of each file when its sha256 was last correct, so that an unchanged file need not be read again.
        self._sound: dict[str, tuple[int, ...]] = {}

    def make_folders(self) -> None:
        """Make the folders of complete and of incoming files; raise DataFolderError if a path is no folder."""
        own_folder(self._blobs)
        own_folder(self.temporary)
        self._identity = self._found()

    def path(self, sha256: str) -> Path:
        """Return the path of the measurement `sha256`, which need not exist."""
        return self._blobs / sha256[:2] / f"{sha256}{_SUFFIX}"

    @contextmanager
    def temporary_file(self, hold: object) -> Iterator[tuple[OpenFile, Path]]:
        """Yield an open file and its path, to which the block writes; the path is removed when the block ends.

        The open file keeps a reference to `hold`, so that its disk space stays reserved until the file is closed.
        """
        descriptor, name = tempfile.mkstemp(prefix=PREFIX, dir=self.temporary)
        file = OpenFile(descriptor, hold)
        try:
            yield file, Path(name)
        finally:
            Path(name).unlink()

    def place(self, incoming: Incoming) -> None:
        """Move a closed incoming file to its final name; the move is durable when this returns.

        A file that exists already is replaced, so that the duration does not reveal whether another key has this file.
        """
        target = self.path(incoming.sha256)
        if not target.parent.exists():
            target.parent.mkdir()
            _sync_folder(self._blobs)
        incoming.path.replace(target)
        _sync_folder(target.parent)
        self._sound[incoming.sha256] = _stamp(target.stat())

    def damage(self, sha256: str) -> str | None:
        """Return what is wrong with a measurement's file, or None if its bytes have the sha256 in its name.

        All bytes are read, unless they were correct before and the file's stat has not changed. Raises OSError if the
        file cannot be read.
        """
        path = self.path(sha256)
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):  # A pipe is not opened, because that could block.
            return "it is no regular file"
        if self._sound.get(sha256) == _stamp(status):
            return None
        with path.open("rb") as file:
            right = hashlib.file_digest(file, "sha256").hexdigest() == sha256
        if right:
            self._sound[sha256] = _stamp(status)
        return None if right else "its sha256 is another one"

    def remove(self, sha256: str) -> int | None:
        """Remove the file of a measurement; return its size, or None if there is no file."""
        self._sound.pop(sha256, None)
        with suppress(FileNotFoundError):
            size = (path := self.path(sha256)).lstat().st_size
            path.unlink()
            return size
        return None

    def fault(self, sha256: str) -> str | None:
        """Return what is wrong with a measurement's file, also if it cannot be read; otherwise None."""
        try:
            return self.damage(sha256)
        except OSError as error:
            return error.strerror or str(error)

    def all(self) -> Iterator[str]:
        """Yield the sha256 of every measurement's file."""
        for path in self._blobs.glob(f"??/*{_SUFFIX}"):
            if _NAME.fullmatch(path.stem) and path == self.path(path.stem):
                yield path.stem

    def clear_temporary(self) -> None:
        """Remove the files that an earlier process was receiving when it ended."""
        for folder in (self.temporary, self._blobs):
            for path in folder.glob(f"{PREFIX}*"):
                if path.is_file():
                    path.unlink()

    def check(self) -> None:
        """Raise OSError unless the folders are those of the start, and a file can be written and moved to its place."""
        if self._identity != self._found():
            raise FileNotFoundError(errno.ENOENT, f"{self._blobs.name}/ or {self.temporary.name}/ has been replaced")
        probe = Incoming(self.temporary)
        try:
            probe.write(b"ready?")
            probe.close()
            probe.path.rename(self._blobs / probe.path.name).unlink()
        finally:
            probe.discard()

    def _found(self) -> list[tuple[int, int]]:
        """Return what identifies the two folders as they are now."""
        return [(status.st_dev, status.st_ino) for status in (self._blobs.stat(), self.temporary.stat())]


def _stamp(status: os.stat_result) -> tuple[int, ...]:
    """Return the fields of a file's stat that change whenever the file is written or replaced."""
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns


def _sync_folder(folder: Path) -> None:
    """Write a folder durably to the disk, where the file system can do that; SQLite does the same."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:
            raise
    finally:
        os.close(descriptor)


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
            ((stored,),) = await in_thread(self._database.rows, _STORED, caller.owner, caller.owner)
            if stored + sum(others) + n_bytes > caller.stored_bytes:
                self._holds.discard(held)
                said = f" and {len(others)} uploads and answers in progress take {sum(others) / 1e6:.1f} MB"
                raise _full(caller.stored_bytes, stored, said, kind)
        return held

    @asynccontextmanager
    async def incoming(self, caller: Caller) -> AsyncIterator[Incoming]:
        """Yield a new file, which is removed afterwards unless it was stored; raises the errors of `hold`."""
        from dsbrdf.data.merl_validation import FILE_SIZE  # The commands keys and purge answer without NumPy.

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
