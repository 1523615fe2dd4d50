"""Measurement files on disk: written under a temporary name, then moved into place in one step."""

import errno
import hashlib
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from service.storage.database import own_folder

_SUFFIX = ".binary"
_UPLOAD = "upload-"
_NAME = re.compile("[0-9a-f]{64}")


class Incoming:
    """A file that is being received, of `size` bytes so far; it is either placed by `Blobs.place` or discarded."""

    def __init__(self, folder: Path) -> None:
        descriptor, name = tempfile.mkstemp(prefix=_UPLOAD, dir=folder)
        self.path = Path(name)
        self.size = 0
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

    def close(self) -> str:
        """Make the content durable and return its sha256."""
        os.fsync(self._file.fileno())
        self._file.close()
        return self._digest.hexdigest()

    def discard(self) -> None:
        """Remove the file, unless it has been placed."""
        self._file.close()
        with suppress(FileNotFoundError):
            self.path.unlink()


class Blobs:
    """Measurement files, named by the sha256 of their bytes, in ``blobs`` and ``tmp`` of the data folder."""

    def __init__(self, folder: Path) -> None:
        self._blobs = folder / "blobs"
        self.temporary = folder / "tmp"  # for bodies too that are too long for the memory
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

    def place(self, incoming: Incoming, sha256: str) -> None:
        """Move a closed incoming file to its place; durable when this returns."""
        target = self.path(sha256)
        if not target.parent.exists():
            target.parent.mkdir()
            _sync_folder(self._blobs)
        incoming.path.replace(target)
        self._verified[sha256] = _fingerprint(target.stat())
        _sync_folder(target.parent)

    def damage(self, sha256: str) -> str | None:
        """Return what is wrong with a measurement's file; None if it has the bytes that it is named by.

        They are read again only if the file has changed since.
        """
        try:
            with self.path(sha256).open("rb") as file:
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

    def remove(self, sha256: str) -> None:
        """Remove a measurement's file."""
        self._verified.pop(sha256, None)
        with suppress(FileNotFoundError):
            self.path(sha256).unlink()

    def all(self) -> Iterator[str]:
        """Yield the sha256 of every file that is one of a measurement."""
        for path in self._blobs.glob(f"??/*{_SUFFIX}"):
            if _NAME.fullmatch(path.stem) and path == self.path(path.stem):
                yield path.stem

    def clear_temporary(self) -> None:
        """Remove what an earlier process was receiving when it ended."""
        for path in self.temporary.glob(f"{_UPLOAD}*"):
            if path.is_file():
                path.unlink()

    def check(self) -> None:
        """Raise OSError unless a file can be written."""
        probe = self.incoming()
        try:
            probe.write(b"ready?")
            probe.close()
        finally:
            probe.discard()


def _fingerprint(status: os.stat_result) -> tuple[int, ...]:
    """Return (inode, size, mtime), a fingerprint of the file's state."""
    return status.st_ino, status.st_size, status.st_mtime_ns


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
