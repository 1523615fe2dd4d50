"""Measurement files on disk: written under a temporary name, then moved into place in one step.

A file goes only when its row is deleted by request; one that no row wants, or that has not the bytes that it is named
by, is moved to the folder ``lost``, and comes back when it is wanted.
"""

import errno
import hashlib
import logging
import os
import re
import secrets
import shutil
import stat
import tempfile
from collections.abc import Callable, Container, Iterator
from contextlib import contextmanager, suppress
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO

from .database import own_folder

_SUFFIX = ".binary"
_UPLOAD = "upload-"
_REMOVED = "removed-"
_ROOM = 1 << 24  # bytes of free disk space that writing to the database does not use up
_NAME = re.compile("[0-9a-f]{64}")

logger = logging.getLogger(__name__)


class Incoming:
    """A file that is being received; it is either placed by `Blobs.place` or discarded."""

    def __init__(self, folder: Path) -> None:
        descriptor, name = tempfile.mkstemp(prefix=_UPLOAD, dir=folder)
        self.path = Path(name)
        self.size = 0  # bytes so far
        self.sha256 = ""  # once it is closed
        self.valid_nodes = 0  # set by who has checked it; 0 of samples
        self._file: BinaryIO = os.fdopen(descriptor, "wb", buffering=0)
        self._digest = hashlib.sha256()

    def write(self, data: bytes | memoryview) -> None:
        """Append `data` to the file and to the digest."""
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest) :]
        self._digest.update(data)
        self.size += len(data)

    def read(self, start: int, size: int) -> bytes:
        """Return at most `size` bytes of what has been written."""
        return os.pread(self._file.fileno(), size, start)

    def close(self) -> None:
        """Make the content durable."""
        os.fsync(self._file.fileno())
        self._file.close()
        self.sha256 = self._digest.hexdigest()

    def discard(self) -> None:
        """Remove the file, unless it has been placed."""
        self._file.close()
        self.path.unlink(missing_ok=True)


class Blobs:
    """Measurement files, named by the sha256 of their bytes, in ``blobs``, ``tmp`` and ``lost`` of the data folder."""

    def __init__(self, folder: Path) -> None:
        self._blobs = folder / "blobs"
        self._lost = folder / "lost"  # made when it is needed
        self.temporary = folder / "tmp"  # also for request bodies that are too long for the memory
        self._verified: dict[str, tuple[int, ...]] = {}  # fingerprints of files whose bytes were found to be right

    def make_folders(self) -> None:
        """Make both folders if they do not exist; raise DataFolderError if something else is in their place."""
        own_folder(self._blobs)
        own_folder(self.temporary)

    def path(self, sha256: str) -> Path:
        """Return where the measurement `sha256` is, or would be."""
        return self._blobs / sha256[:2] / f"{sha256}{_SUFFIX}"

    def incoming(self) -> Incoming:
        """Return a new temporary file."""
        return Incoming(self.temporary)

    def place(self, incoming: Incoming) -> None:
        """Move a closed incoming file to its place; durable when this returns.

        A file in its place that has other bytes is moved to ``lost``: they may be those of another measurement.
        """
        sha256, target = incoming.sha256, self.path(incoming.sha256)
        if os.path.lexists(target) and self.damage(sha256) is not None:
            self.set_aside(sha256)
        self.take_back(sha256)
        self._move_to_place(incoming.path, sha256)
        self._verified[sha256] = _fingerprint(target.stat())

    def damage(self, sha256: str) -> str | None:
        """Return what is wrong with a measurement's file; None if it has the bytes that it is named by.

        They are read again only if the file has changed since.
        """
        try:
            with _opened(self.path(sha256)) as file:
                fingerprint = _fingerprint(os.fstat(file.fileno()))
                if self._verified.get(sha256) == fingerprint:
                    return None
                digest = hashlib.file_digest(file, "sha256")
        except OSError as error:
            if error.errno in (errno.EMFILE, errno.ENFILE):  # too many open files; the measurement may be sound
                raise
            return error.strerror or str(error)
        if digest.hexdigest() != sha256:
            return "its sha256 is another one"
        self._verified[sha256] = fingerprint
        return None

    def distrust(self, sha256: str) -> None:
        """Check a measurement's file at the next occasion, although it looks as it did: wrong bytes came out of it."""
        logger.error("the file of the measurement %s has changed while it was sent; the connection is closed", sha256)
        self._verified.pop(sha256, None)

    @contextmanager
    def removal(self) -> Iterator[Callable[[str], None]]:
        """Yield a function that removes a measurement's file.

        The files go when the block ends well; if it raises, they stay. If this process ends in the middle, the next
        start does the one or the other, as the rows say.
        """
        removed: list[tuple[Path, Path]] = []

        def remove(sha256: str) -> None:
            self._verified.pop(sha256, None)
            path, name = self.path(sha256), self.temporary / f"{_REMOVED}{sha256}-{secrets.token_hex(4)}"
            with suppress(FileNotFoundError):
                if shutil.disk_usage(self.temporary).free < _ROOM:  # the row's removal takes room: that of the file
                    path.unlink()
                else:
                    path.rename(name)
                    removed.append((path, name))

        try:
            yield remove
        except BaseException:
            for path, name in removed:
                with suppress(FileNotFoundError):
                    name.rename(path)
            raise
        for _, name in removed:
            name.unlink(missing_ok=True)

    def set_aside(self, sha256: str) -> None:
        """Move a measurement's file to ``lost``, under a new name."""
        self._verified.pop(sha256, None)
        path = self.path(sha256)
        own_folder(self._lost)
        path.rename(self._lost / f"{path.name}.{secrets.token_hex(4)}")
        _sync_folder(self._lost)

    def take_back(self, sha256: str) -> bool:
        """Return whether ``lost`` has the bytes of a measurement; they are moved to their place."""
        found = [path for path in self._lost.glob(f"{sha256}*") if _sha256_of(path) == sha256]
        if not found:
            return False
        for path in found:  # all have the same bytes
            self._move_to_place(path, sha256)
        return True

    def n_lost(self) -> int:
        """Return the number of files in ``lost``."""
        return sum(1 for _ in self._lost.glob("*"))

    def all(self) -> Iterator[str]:
        """Yield the sha256 of every file that is one of a measurement."""
        for path in self._blobs.glob(f"??/*{_SUFFIX}"):
            if _NAME.fullmatch(path.stem) and path == self.path(path.stem):
                yield path.stem

    def clear_temporary(self, wanted: Container[str]) -> None:
        """Remove what an earlier process was receiving or removing when it ended; a `wanted` measurement comes back."""
        for path in (*self.temporary.glob(f"{_UPLOAD}*"), *self.temporary.glob(f"{_REMOVED}*")):
            sha256 = path.name.removeprefix(_REMOVED)[:64]
            if sha256 in wanted and not self.path(sha256).exists():
                self._move_to_place(path, sha256)
            elif path.is_file():
                path.unlink()

    def _move_to_place(self, path: Path, sha256: str) -> None:
        target = self.path(sha256)
        if not target.parent.exists():
            target.parent.mkdir()
            _sync_folder(self._blobs)
        path.replace(target)
        _sync_folder(target.parent)

    def check(self) -> None:
        """Raise OSError unless a file can be written."""
        with tempfile.TemporaryFile(dir=self.temporary, buffering=0) as probe:
            probe.write(b"ready?")
            os.fsync(probe.fileno())


def _fingerprint(status: os.stat_result) -> tuple[int, ...]:
    """Return (inode, size, mtime, ctime), a fingerprint of the file's state; programs can set the mtime."""
    return status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns


def _opened(path: Path) -> BufferedReader:
    """Open a regular file; raise OSError if it is none, rather than wait for who writes to a pipe in its place."""
    file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError(errno.EINVAL, "it is no regular file")
    return file


def _sha256_of(path: Path) -> str | None:
    """Return the digest of a file; None if it cannot be read."""
    try:
        with _opened(path) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
