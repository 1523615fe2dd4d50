"""The SQLite database of a data folder, and the lock that keeps a second server out.

A server holds the lock as long as it runs. Commands open the database beside it, for a transaction now and then.
"""

import fcntl
import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import IO, Any

from service.storage.schema import DataFolderError, is_current, migrate

FILE_NAME = "dsbrdf.sqlite"
_PATIENCE = 5.0  # seconds that a server's transaction waits for those of others; then its client is told to come again
_PATIENCE_BESIDE = 30.0  # that a command's does


class DataFolderInUseError(DataFolderError):
    """Another process has opened the data folder."""


class DatabaseBusyError(sqlite3.OperationalError):
    """Other transactions have not let this one begin in time."""

    sqlite_errorcode = sqlite3.SQLITE_BUSY


class DatabaseLostError(OSError):
    """The database's file has been removed or replaced: what is written now would be lost with this process."""


class Database:
    """Two connections for every thread of this process: one that writes, and one that reads and never waits for it.

    Parameters
    ----------
    folder : Path
        Made if it does not exist, for its user alone.
    beside : bool
        Whether to go without the lock, so that a server may run or start meanwhile.

    Raises
    ------
    DataFolderError
        If another process holds the lock and it is needed, a newer release has written the database, or it is damaged.

    Attributes
    ----------
    patience : float
        Time that a transaction waits for its turn [s].
    """

    def __init__(self, folder: Path, *, beside: bool = False) -> None:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        self.patience = _PATIENCE_BESIDE if beside else _PATIENCE
        self._path = folder.resolve() / FILE_NAME
        self._lock, self._reading = threading.Lock(), threading.Lock()
        self._open = ExitStack()
        try:
            if not beside:
                self._open.enter_context(_lock(folder))
            self._db, self._reader = self._connection(), self._connection()
            self._bring_up_to_date(folder, locked=not beside)
            self._reader.execute("PRAGMA query_only = ON")
            self._version = self._data_version()
            self._identity = _identity(self._path)
        except sqlite3.DatabaseError as error:
            self.close()
            raise DataFolderError(f"the database {folder / FILE_NAME} cannot be opened: {error}") from error
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the connections and release the lock."""
        with self._lock, self._reading:
            self._open.close()

    def rows(self, query: str, *values: object) -> list[tuple[Any, ...]]:
        """Return what `query` selects."""
        with self._reading:
            return self._reader.execute(query, values).fetchall()

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """Write all or nothing; durable when it ends.

        Raises
        ------
        DatabaseBusyError, sqlite3.OperationalError
            If its turn has not come within `patience`.
        DatabaseLostError
            If the file is not where it was.
        """
        deadline = time.monotonic() + self.patience
        if not self._lock.acquire(timeout=self.patience):
            raise DatabaseBusyError("other transactions take too long")
        try:
            self._check_place()
            self._db.execute(f"PRAGMA busy_timeout = {max(0, round(1000 * (deadline - time.monotonic())))}")
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield self._db
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise
        finally:
            self._lock.release()

    def changed_by_others(self) -> bool:
        """Return whether another process has written since this was asked before, or since the database was opened."""
        with self._lock:
            before, self._version = self._version, self._data_version()
        return self._version != before

    def _data_version(self) -> int:
        (version,) = self._db.execute("PRAGMA data_version").fetchone()
        return int(version)

    def _connection(self) -> sqlite3.Connection:
        connection = sqlite3.connect(self._path, timeout=self.patience, isolation_level=None, check_same_thread=False)
        return self._open.enter_context(closing(connection))

    def _check_place(self) -> None:
        try:
            same = _identity(self._path) == self._identity
        except OSError:
            same = False
        if not same:
            raise DatabaseLostError(
                "its file has been removed or replaced while the service had it open; put it back, or start the "
                "service again"
            )

    def _bring_up_to_date(self, folder: Path, *, locked: bool) -> None:
        """Migrate; only who holds the lock may, since a server of an earlier release could be running."""
        for pragma in ("journal_mode = WAL", "synchronous = FULL"):
            self._db.execute(f"PRAGMA {pragma}")
        if locked:
            migrate(self._db)
        elif not is_current(self._db):
            with _lock(folder):
                migrate(self._db)


def _lock(folder: Path) -> IO[str]:
    """Return the open file that is the lock."""
    guard = (folder / "lock").open("w")
    try:
        fcntl.flock(guard, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        guard.close()
        raise DataFolderInUseError(f"the data folder {folder} is in use by another server") from None
    return guard


def _identity(path: Path) -> tuple[int, int]:
    """Return what stays the same as long as a file does."""
    status = path.stat()
    return status.st_dev, status.st_ino
