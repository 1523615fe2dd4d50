"""The SQLite database of a data folder, and the lock that keeps a second server out.

A server holds the lock as long as it runs. Commands open the database beside it, for a transaction now and then.
"""

import fcntl
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from service.migrations import DataFolderError, is_current, migrate

FILE_NAME = "dsbrdf.sqlite"
_BUSY_SECONDS = 30.0  # that a transaction waits for the one of another process


class DataFolderInUseError(DataFolderError):
    """Another process has opened the data folder."""


class Database:
    """One connection, for every thread of this process.

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
    """

    def __init__(self, folder: Path, *, beside: bool = False) -> None:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._guard = None if beside else _lock(folder)
        self._lock = threading.Lock()
        self._db = sqlite3.connect(
            folder / FILE_NAME, timeout=_BUSY_SECONDS, isolation_level=None, check_same_thread=False
        )
        try:
            for pragma in ("journal_mode = WAL", "synchronous = FULL"):
                self._db.execute(f"PRAGMA {pragma}")
            self._bring_up_to_date(folder)
            self._version = self._data_version()
        except sqlite3.DatabaseError as error:
            self.close()
            raise DataFolderError(f"the database {folder / FILE_NAME} cannot be opened: {error}") from error
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the connection and release the lock."""
        with self._lock:
            self._db.close()
        if self._guard is not None:
            self._guard.close()

    def rows(self, query: str, *values: object) -> list[tuple[Any, ...]]:
        """Return what `query` selects."""
        with self._lock:
            return self._db.execute(query, values).fetchall()

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """Write all or nothing; durable when it ends."""
        with self._lock:
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield self._db
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise

    def changed_by_others(self) -> bool:
        """Return whether another process has written since this was asked before, or since the database was opened."""
        with self._lock:
            before, self._version = self._version, self._data_version()
        return self._version != before

    def _data_version(self) -> int:
        (version,) = self._db.execute("PRAGMA data_version").fetchone()
        return int(version)

    def _bring_up_to_date(self, folder: Path) -> None:
        """Migrate; only who holds the lock may, since a server of an earlier release could be running."""
        if self._guard is not None:
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
