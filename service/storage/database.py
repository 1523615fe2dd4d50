"""The SQLite database of a data folder, and the lock that keeps a second server out.

A server holds the lock as long as it runs. Commands open the database without it, while a server may run.
"""

import fcntl
import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import IO, Any

from service.errors import DatabaseBusyError, DatabaseLostError, DataFolderError, DataFolderInUseError
from service.storage.schema import VERSION, create_tables, version_of

FILE_NAME = "dsbrdf.sqlite"
_BUSY_TIMEOUT = 5.0  # seconds that a server's transaction waits for others; then the client is asked to come again
_COMMAND_BUSY_TIMEOUT = 30.0  # seconds that a command's transaction waits


class Database:
    """Two connections that all threads of this process share: one writes, one reads and never waits for the writer.

    The folder is made if it does not exist, for its user alone. A server is `exclusive` and holds the lock; a command
    goes without, so that a server may run or start. `busy_timeout` is how long a transaction waits until it begins [s].

    Raises DataFolderError if another process holds the lock and it is needed, another release has written the
    database, or it is damaged.
    """

    def __init__(self, folder: Path, *, exclusive: bool = True) -> None:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        self.busy_timeout = _BUSY_TIMEOUT if exclusive else _COMMAND_BUSY_TIMEOUT
        self._path = folder.resolve() / FILE_NAME
        self._writer_lock, self._reader_lock = threading.Lock(), threading.Lock()
        self._resources = ExitStack()
        try:
            if exclusive:
                self._resources.enter_context(_lock(folder))
            self._writer, self._reader = self._connection(), self._connection()
            for pragma in ("journal_mode = WAL", "synchronous = FULL"):
                self._writer.execute(f"PRAGMA {pragma}")
            if exclusive:
                create_tables(self._writer)
            elif version_of(self._writer) != VERSION:
                with _lock(folder):  # one process at a time creates them
                    create_tables(self._writer)
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
        with self._writer_lock, self._reader_lock:
            self._resources.close()

    def rows(self, query: str, *values: object) -> list[tuple[Any, ...]]:
        """Return what `query` selects."""
        with self._reader_lock:
            return self._reader.execute(query, values).fetchall()

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """Write all or nothing; durable when it ends.

        Raises DatabaseBusyError, sqlite3.OperationalError if its turn has not come within `busy_timeout`. Raises
        DatabaseLostError if the file is not where it was.
        """
        deadline = time.monotonic() + self.busy_timeout
        if not self._writer_lock.acquire(timeout=self.busy_timeout):
            raise DatabaseBusyError("other transactions take too long")
        try:
            self._check_file()
            self._writer.execute(f"PRAGMA busy_timeout = {max(0, round(1000 * (deadline - time.monotonic())))}")
            self._writer.execute("BEGIN IMMEDIATE")
            try:
                yield self._writer
                self._writer.execute("COMMIT")
            except BaseException:
                if self._writer.in_transaction:
                    self._writer.execute("ROLLBACK")
                raise
        finally:
            self._writer_lock.release()

    def changed_by_others(self) -> bool:
        """Return whether another process has written since this was asked before, or since the database was opened."""
        with self._writer_lock:
            before, self._version = self._version, self._data_version()
        return self._version != before

    def _data_version(self) -> int:
        (version,) = self._writer.execute("PRAGMA data_version").fetchone()
        return int(version)

    def _connection(self) -> sqlite3.Connection:
        connection = sqlite3.connect(self._path, self.busy_timeout, isolation_level=None, check_same_thread=False)
        return self._resources.enter_context(closing(connection))

    def _check_file(self) -> None:
        try:
            same = _identity(self._path) == self._identity
        except OSError:
            same = False
        if not same:
            raise DatabaseLostError(
                "its file has been removed or replaced while the service had it open; put it back, or start the "
                "service again"
            )


def _lock(folder: Path) -> IO[str]:
    """Return the open file that is the lock."""
    file = (folder / "lock").open("w")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        raise DataFolderInUseError(f"the data folder {folder} is in use by another server") from None
    return file


def _identity(path: Path) -> tuple[int, int]:
    """Return (device, inode), which identify the file as long as it exists."""
    status = path.stat()
    return status.st_dev, status.st_ino
