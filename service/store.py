"""The service's memory: SQLite rows and measurement files in one data folder; nothing else touches the disk.

Every method is safe to call from any thread and returns when the change is durable. A fit's result and its
state are written in one transaction. One process at a time may open a data folder.
"""

import fcntl
import json
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from service.blobs import Blobs, Incoming
from service.migrations import DataFolderError, migrate
from service.rows import UNFINISHED, FitRow, MeasurementRow, Status

_Row = TypeVar("_Row")

_SELECT_FIT = f"SELECT {FitRow.COLUMNS} FROM fits"  # noqa: S608 (constants only)
_SELECT_MEASUREMENT = f"SELECT {MeasurementRow.COLUMNS} FROM measurements"  # noqa: S608


class DataFolderInUseError(DataFolderError):
    """Another process has opened the data folder."""


class MissingMeasurementError(LookupError):
    """A fit was asked for of a measurement that is not stored."""


class QueueFullError(RuntimeError):
    """As many fits are waiting as may wait."""


class MeasurementInUseError(RuntimeError):
    """A measurement cannot be removed while fits of it are unfinished."""


class Store:
    """Rows and blobs below one folder.

    Parameters
    ----------
    folder : Path
        Made if it does not exist.

    Raises
    ------
    DataFolderError
        If another process has the folder open, or a newer release has written it.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self._guard = (folder / "lock").open("w")
        try:
            fcntl.flock(self._guard, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._guard.close()
            raise DataFolderInUseError(f"the data folder {folder} is in use by another server") from None
        self.blobs = Blobs(folder)
        self._lock = threading.Lock()
        self._db = sqlite3.connect(folder / "dsbrdf.sqlite", isolation_level=None, check_same_thread=False)
        for pragma in ("journal_mode = WAL", "synchronous = FULL"):
            self._db.execute(f"PRAGMA {pragma}")
        migrate(self._db)
        self._drop_strays()

    def close(self) -> None:
        """Release the folder."""
        with self._lock:
            self._db.close()
        self._guard.close()

    def add_measurement(self, incoming: Incoming, sha256: str, valid_nodes: int) -> tuple[MeasurementRow, bool]:
        """Keep a received file; the flag says whether it is new."""
        insert = (
            "INSERT INTO measurements (sha256, size, valid_nodes, created) VALUES (?, ?, ?, ?)"  # noqa: S608
            f" RETURNING {MeasurementRow.COLUMNS}"
        )
        with self._transaction() as db:
            known = db.execute(f"{_SELECT_MEASUREMENT} WHERE sha256 = ?", (sha256,)).fetchone()
            if known is not None:
                incoming.discard()
                return MeasurementRow.of(known), False
            values = (sha256, incoming.size, valid_nodes, time.time())
            (row,) = db.execute(insert, values).fetchall()
            self.blobs.place(incoming, sha256)
        return MeasurementRow.of(row), True

    def measurement(self, sha256: str) -> MeasurementRow | None:
        """Return a measurement's row."""
        return self._one(MeasurementRow.of, f"{_SELECT_MEASUREMENT} WHERE sha256 = ?", sha256)

    def measurements(self, limit: int, before: int | None) -> list[MeasurementRow]:
        """Return up to `limit` measurements, newest first, older than the row number `before`."""
        return self._page(MeasurementRow.of, _SELECT_MEASUREMENT, limit, before)

    def remove_measurement(self, sha256: str) -> bool:
        """Remove a measurement, its finished fits stay; return whether there was one.

        Raises
        ------
        MeasurementInUseError
            If fits of it are unfinished.
        """
        with self._transaction() as db:
            query = "SELECT count(*) FROM fits WHERE measurement = ? AND status IN ('accepted', 'running')"
            (unfinished,) = db.execute(query, (sha256,)).fetchone()
            if unfinished:
                raise MeasurementInUseError(f"{unfinished} unfinished fits use the measurement")
            removed = db.execute("DELETE FROM measurements WHERE sha256 = ?", (sha256,)).rowcount > 0
            # If the commit fails, the row stays without its file; if the file went after the commit, the same
            # file could come in between and be lost. The row is the smaller loss: it is dropped at the start.
            self.blobs.remove(sha256)
        return removed

    def add_fit(
        self,
        fit_id: str,
        measurement: str,
        options: Mapping[str, Any],
        versions: tuple[str, str],
        queue_limit: int,
    ) -> tuple[FitRow, bool]:
        """Accept a fit, or find the same one; the flag says whether it has to be computed.

        Parameters
        ----------
        fit_id, measurement : str
            Identities of the fit and of its measurement.
        options : mapping
            Options as on the wire.
        versions : tuple of str
            Of the algorithm and of the library.
        queue_limit : int
            How many fits may be waiting.

        Raises
        ------
        MissingMeasurementError
            If the measurement is not stored.
        QueueFullError
            If too many fits are waiting.
        """
        insert = (
            "INSERT INTO fits (id, measurement, options, algorithm, library, status, created)"  # noqa: S608
            f" VALUES (?, ?, ?, ?, ?, 'accepted', ?) RETURNING {FitRow.COLUMNS}"
        )
        with self._transaction() as db:
            values = db.execute(f"{_SELECT_FIT} WHERE id = ?", (fit_id,)).fetchone()
            known = None if values is None else FitRow.of(values)
            if known is not None and not known.repeatable:
                return known, False
            if db.execute("SELECT 1 FROM measurements WHERE sha256 = ?", (measurement,)).fetchone() is None:
                raise MissingMeasurementError(measurement)
            (waiting,) = db.execute("SELECT count(*) FROM fits WHERE status = 'accepted'").fetchone()
            if waiting >= queue_limit:
                raise QueueFullError(f"{waiting} fits are waiting")
            # A fit that runs once more starts anew, at the head of the list.
            db.execute("DELETE FROM fits WHERE id = ?", (fit_id,))
            new = (fit_id, measurement, json.dumps(options), *versions, time.time())
            (row,) = db.execute(insert, new).fetchall()
        return FitRow.of(row), True

    def fit(self, fit_id: str) -> FitRow | None:
        """Return a fit's row."""
        return self._one(FitRow.of, f"{_SELECT_FIT} WHERE id = ?", fit_id)

    def fits(self, limit: int, before: int | None) -> list[FitRow]:
        """Return up to `limit` fits, newest first, older than the row number `before`."""
        return self._page(FitRow.of, _SELECT_FIT, limit, before)

    def result(self, fit_id: str) -> str | None:
        """Return the document of a fit that succeeded."""
        return self._one(lambda row: str(row[0]), "SELECT result FROM fits WHERE id = ? AND result NOT NULL", fit_id)

    def start_fit(self, fit_id: str) -> FitRow | None:
        """Set an accepted fit running; None if it is not waiting any more."""
        change = "status = 'running', attempts = attempts + 1, started = ?"
        return self._advance(change, (time.time(),), fit_id, ("accepted",))

    def requeue_fit(self, fit_id: str) -> FitRow | None:
        """Set a running fit back to accepted; None if it does not run any more."""
        return self._advance("status = 'accepted', started = NULL", (), fit_id, ("running",))

    def complete_fit(self, fit_id: str, document: str, metrics: Mapping[str, float | None]) -> FitRow | None:
        """Write a running fit's result and its state; None if it does not run any more."""
        change = "status = 'succeeded', finished = ?, metrics = ?, result = ?"
        return self._advance(change, (time.time(), json.dumps(metrics), document), fit_id, ("running",))

    def fail_fit(self, fit_id: str, error: Mapping[str, str]) -> FitRow | None:
        """Write a fit's error and its state; None if it has ended already."""
        change = "status = 'failed', finished = ?, error = ?"
        return self._advance(change, (time.time(), json.dumps(error)), fit_id, UNFINISHED)

    def cancel_fit(self, fit_id: str) -> FitRow | None:
        """Mark an unfinished fit as cancelled; None if it has ended already."""
        return self._advance("status = 'cancelled', finished = ?", (time.time(),), fit_id, UNFINISHED)

    def remove_fit(self, fit_id: str) -> bool:
        """Remove a fit that has ended; return whether there was one."""
        query = "DELETE FROM fits WHERE id = ? AND status NOT IN ('accepted', 'running')"
        with self._transaction() as db:
            return db.execute(query, (fit_id,)).rowcount > 0

    def resume(self) -> list[FitRow]:
        """Set what an earlier process left running back to accepted; return all that wait, oldest first."""
        with self._transaction() as db:
            db.execute("UPDATE fits SET status = 'accepted', started = NULL WHERE status = 'running'")
            rows = db.execute(f"{_SELECT_FIT} WHERE status = 'accepted' ORDER BY seq")
            return [FitRow.of(row) for row in rows]

    def check(self) -> None:
        """Raise OSError or sqlite3.Error unless rows and files can be written."""
        with self._transaction():
            self.blobs.check()

    def _advance(
        self, change: str, values: tuple[object, ...], fit_id: str, states: tuple[Status, ...]
    ) -> FitRow | None:
        """Apply `change` to a fit that is in one of `states`."""
        marks = ", ".join("?" * len(states))
        query = f"UPDATE fits SET {change} WHERE id = ? AND status IN ({marks}) RETURNING {FitRow.COLUMNS}"  # noqa: S608
        with self._transaction() as db:
            rows = db.execute(query, (*values, fit_id, *states)).fetchall()
        return FitRow.of(rows[0]) if rows else None

    def _one(self, make: Callable[[tuple[Any, ...]], _Row], query: str, key: str) -> _Row | None:
        with self._lock:
            row = self._db.execute(query, (key,)).fetchone()
        return None if row is None else make(row)

    def _page(self, make: Callable[[tuple[Any, ...]], _Row], query: str, limit: int, before: int | None) -> list[_Row]:
        older, values = ("", (limit,)) if before is None else (" WHERE seq < ?", (before, limit))
        with self._lock:
            rows = self._db.execute(f"{query}{older} ORDER BY seq DESC LIMIT ?", values).fetchall()
        return [make(row) for row in rows]

    def _drop_strays(self) -> None:
        """Remove what an earlier process was writing when it ended: parts of files, files without row, and so on."""
        self.blobs.clear_temporary()
        files = set(self.blobs.all())
        with self._transaction() as db:
            rows = {sha256 for (sha256,) in db.execute("SELECT sha256 FROM measurements")}
            for sha256 in rows - files:
                db.execute("DELETE FROM measurements WHERE sha256 = ?", (sha256,))
        for sha256 in files - rows:
            self.blobs.remove(sha256)

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        with self._lock:
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield self._db
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise
