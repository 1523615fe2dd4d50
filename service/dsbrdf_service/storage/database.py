"""Open the SQLite database of a data folder, and hold the lock that keeps other servers out."""

import fcntl
import os
import shutil
import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any

from anyio import CapacityLimiter, to_thread

from ..errors import DatabaseLostError, DataFolderError
from .schema import VERSION, create_tables

FILE_NAME = "dsbrdf.sqlite"
RESERVE = "dsbrdf.reserve"
"""File that is deleted if the service starts on a full disk, to free space in which rows can be deleted."""
_BUSY_TIMEOUT_S = 5.0  # A transaction that waits longer for other transactions fails, and its request gets 503.
_MIN_DATABASE_BYTES = 512  # A shorter, non-empty file is refused, because SQLite would overwrite it.
_MIN_FREE_BYTES = 1 << 16  # With less free space, SQLite cannot create its files beside the database.
# With these codes, SQLite reports a fault of the disk or of the moment; others are faults of a row or of a query.
_PASSING = (
    *(sqlite3.SQLITE_FULL, sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_NOMEM),
    *(sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PROTOCOL),
)
_LOG_UNREADABLE = (
    *(sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY_CANTINIT, sqlite3.SQLITE_READONLY_DIRECTORY),
    sqlite3.SQLITE_READONLY_RECOVERY,
)
_RESTORE = "restore the folder from a copy; nothing in it has been changed"
_REMEDIES = {
    sqlite3.SQLITE_CORRUPT: _RESTORE,
    sqlite3.SQLITE_NOTADB: _RESTORE,
    sqlite3.SQLITE_BUSY: "another program uses it; try again when that has ended",
    sqlite3.SQLITE_FULL: "the disk is full; make room",
    **dict.fromkeys(
        (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM, sqlite3.SQLITE_READONLY),
        "the user that the service runs as has to be allowed to read and write the folder and what is in it",
    ),
}
in_write_thread = partial(to_thread.run_sync, limiter=CapacityLimiter(4))
"""Run a function that writes rows in a thread; readers have other threads and do not wait for writers."""


def is_passing(error: Exception) -> bool:
    """Return whether a failed use of the folder may succeed later, without a change of the database."""
    if not isinstance(error, sqlite3.Error):
        return isinstance(error, OSError)
    return getattr(error, "sqlite_errorcode", sqlite3.SQLITE_BUSY) & 0xFF in _PASSING


class Database:
    """The connections of this process: one connection writes; the others read and never wait for the writer.

    The folder is made if it does not exist, for the user of the service only. A server is `exclusive` and holds the
    lock on the folder as long as it runs; a command takes no lock, so that a server may run or start.

    Raises DataFolderError if the folder contains other data than a service's, another process holds a needed lock,
    another release has written the database, or the database is damaged; then nothing in the folder has changed.
    """

    def __init__(self, folder: Path, *, exclusive: bool = True) -> None:
        _claim(folder)
        self._path = folder.resolve() / FILE_NAME
        self._writer_lock, self._reader_lock = threading.Lock(), threading.Lock()
        self._written_at = float("-inf")
        try:
            with ExitStack() as resources:
                if exclusive:
                    resources.enter_context(_lock(folder))
                    if is_full(folder):
                        (folder / RESERVE).unlink(missing_ok=True)
                check_integrity(folder)
                with suppress(FileExistsError):  # SQLite gives its other files the access mode of this one.
                    os.close(os.open(self._path, os.O_CREAT | os.O_EXCL, 0o600))
                self._writer = resources.enter_context(closing(self._connection()))
                self._reader = resources.enter_context(closing(self._connection()))
                self._prompt_reader = resources.enter_context(closing(self._connection()))
                create_tables(self._writer)
                self._writer.execute("PRAGMA journal_mode = WAL")
                self._writer.execute("PRAGMA synchronous = FULL")
                self._reader.execute(
                    "SELECT 1 FROM sqlite_master"
                ).fetchall()  # This creates all files of the database, whose stat is recorded next.
                ours = [self._path.with_name(f"{FILE_NAME}{suffix}") for suffix in ("", "-wal", "-shm")]
                self._files = {path: path.stat() for path in ours}
                self._resources = resources.pop_all()
        except sqlite3.DatabaseError as error:
            raise _cannot_be_opened(folder, error) from error

    def close(self) -> None:
        """Close the connections and release the lock."""
        with self._writer_lock, self._reader_lock:
            self._resources.close()

    def rows(self, query: str, *values: object) -> list[tuple[Any, ...]]:
        """Return the rows that `query` selects."""
        with self._reader_lock:
            return self._reader.execute(query, values).fetchall()

    def row_now(self, query: str, *values: object) -> tuple[Any, ...] | None:
        """Return the first row that `query` selects, without waiting for other queries; the event loop may call this.

        Finding a row by an index takes some 10 microseconds.
        """
        row: tuple[Any, ...] | None = self._prompt_reader.execute(query, values).fetchone()
        return row

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """Open a transaction, which is written as a whole or not at all, and is durable when the block ends.

        Raises sqlite3.OperationalError if other transactions take too long, and DatabaseLostError if the database or
        its log has been removed or replaced before the end of the block.
        """
        if not self._writer_lock.acquire(timeout=_BUSY_TIMEOUT_S):
            raise sqlite3.OperationalError("other transactions take too long")
        try:
            self._check_files()
            with self._writer:  # This commits the transaction or rolls it back.
                self._writer.execute("BEGIN IMMEDIATE")
                yield self._writer
            self._check_files()  # If the log was deleted meanwhile, the written data would be lost.
            self._written_at = monotonic()
        finally:
            self._writer_lock.release()

    def check_writing(self, attempt: Callable[[sqlite3.Connection], object]) -> None:
        """Raise sqlite3.Error or OSError unless an `attempt` to write rows succeeds, whose changes are taken back.

        The check does not wait for other writers: while another transaction runs, a recent end of an earlier one proves
        that rows can be written.
        """
        self._check_files()
        if not self._writer_lock.acquire(blocking=False):
            if monotonic() - self._written_at > _BUSY_TIMEOUT_S:
                raise sqlite3.OperationalError("a transaction takes too long")
            return
        try:
            try:
                self._writer.execute("BEGIN IMMEDIATE")
                attempt(self._writer)
            finally:
                self._writer.rollback()
            # This writes the value that the database has already, because what is taken back never reaches the disk.
            self._writer.execute(f"PRAGMA user_version = {VERSION}")
        finally:
            self._writer_lock.release()

    def _connection(self) -> sqlite3.Connection:
        connection = sqlite3.connect(self._path, timeout=_BUSY_TIMEOUT_S, isolation_level=None, check_same_thread=False)
        # A text with a damaged byte can still be shown.
        connection.text_factory = partial(str, encoding="utf-8", errors="replace")
        return connection

    def _check_files(self) -> None:
        for path, status in self._files.items():
            with suppress(OSError):
                if os.path.samestat(path.stat(), status):
                    continue
            raise DatabaseLostError(
                f"{path.name} has been removed or replaced while the service had it open; put it back, or start the "
                "service again"
            )


def is_data_folder(folder: Path) -> bool:
    """Return whether a folder has a service's database."""
    return (folder / FILE_NAME).exists()


def check_integrity(folder: Path) -> None:
    """Read the whole database of a folder and raise DataFolderError if it is damaged; two gigabytes take a second.

    A damaged table can lack rows, and the service would answer as if their fits did not exist.
    """
    if not is_data_folder(folder):
        return
    try:
        ((fault,),) = read_only(folder, "PRAGMA integrity_check(1)")
    except sqlite3.DatabaseError as error:
        raise _cannot_be_opened(folder, error) from error
    if fault != "ok":
        first = " ".join(fault.split())
        raise DataFolderError(f"the database {folder / FILE_NAME} is damaged ({first}); {_RESTORE}")


def read_only(folder: Path, query: str, of_row: Callable[[tuple[Any, ...]], Any] = tuple) -> list[Any]:
    """Return `of_row` of each row that `query` selects from the database of a folder, without changing the folder.

    A connection that may write would, when closed, write the log of a damaged database into the database file. In a
    folder where nothing can be written, a database without a log is read as one that nobody changes.

    Raises OSError if such a folder has a log, which cannot be read there.
    """
    uri, log = f"{(folder / FILE_NAME).resolve().as_uri()}?mode=ro", folder / f"{FILE_NAME}-wal"
    try:
        return _selected(uri, query, of_row)
    except sqlite3.OperationalError as error:
        if error.sqlite_errorcode not in _LOG_UNREADABLE:
            raise
    if log.exists() and log.stat().st_size:
        raise OSError(f"{log.name} has changes that cannot be read in a read-only folder; copy the folder")
    return _selected(f"{uri}&immutable=1", query, of_row)


def _selected(uri: str, query: str, of_row: Callable[[tuple[Any, ...]], Any]) -> list[Any]:
    with closing(sqlite3.connect(uri, uri=True, timeout=_BUSY_TIMEOUT_S)) as connection:
        connection.text_factory = partial(str, encoding="utf-8", errors="surrogateescape")  # This keeps wrong bytes.
        return list(map(of_row, connection.execute(query)))


def own_folder(folder: Path) -> Path:
    """Make a folder in a data folder if it does not exist, and return it.

    Raises DataFolderError if its path is a file or a symbolic link.
    """
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise DataFolderError(f"{folder} is not a folder of the service; remove it, or give another data folder")
    folder.mkdir(exist_ok=True)
    return folder


def is_full(folder: Path) -> bool:
    """Return whether the disk of a folder has too little free space for SQLite."""
    return shutil.disk_usage(folder).free < _MIN_FREE_BYTES


def _claim(folder: Path) -> None:
    """Make the folder; raise DataFolderError if it contains files, but not the service's database."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except FileExistsError:
        reason = f"{folder} is not a folder; give a data folder that is new, empty or the service's"
        raise DataFolderError(reason) from None
    names = {path.name for path in folder.iterdir()}
    database = folder / FILE_NAME
    ours = database.is_file() and not database.is_symlink()
    if ours and (size := database.stat().st_size) < _MIN_DATABASE_BYTES:
        # A service that was killed at its first start leaves only an empty database file, which is accepted.
        ours = not size and names <= {FILE_NAME, f"{FILE_NAME}-journal"}
    if names and not ours:
        raise DataFolderError(
            f"{folder} has files of other programs and was not changed; "
            "give a data folder that is new, empty or made by the service"
        )


def _cannot_be_opened(folder: Path, error: sqlite3.DatabaseError) -> DataFolderError:
    """Return a DataFolderError for SQLite's error, with the remedy that fits the cause."""
    remedy = _REMEDIES.get(getattr(error, "sqlite_errorcode", 0) & 0xFF)  # The lower byte is the kind of error.
    if is_full(folder):  # SQLite reports a full disk as "disk I/O error".
        remedy = _REMEDIES[sqlite3.SQLITE_FULL]
    return DataFolderError(
        f"the database {folder / FILE_NAME} cannot be opened: {error}" + (f"; {remedy}" if remedy else "")
    )


@contextmanager
def _lock(folder: Path) -> Iterator[None]:
    """The exclusive lock on a folder; raise DataFolderError if another server holds it."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise DataFolderError(f"the data folder {folder} is in use by another server") from None
        yield
    finally:
        os.close(descriptor)
