"""Store the rows and files of measurements and fits in one data folder.

Every method is safe to call from any thread and returns when the change is durable.
"""

import hashlib
import json
import logging
import os
import shutil
import sqlite3
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import dsbrdf

from ..errors import FitNotFoundError, MeasurementDamagedError, MeasurementNotFoundError, ProblemError
from .atlas import ATLAS, atlas_result, atlas_row
from .database import RESERVE, Database, own_folder
from .files import Blobs, Incoming, Writing, check_key, check_queue, check_storage
from .maintenance import remove_files, remove_rows
from .schema import (
    IS_UNFINISHED,
    ROW_SIZE,
    UNFINISHED,
    UNFINISHED_SIZE,
    Caller,
    FitKey,
    FitRow,
    MeasurementRow,
    Status,
    checksum,
    columns,
)

logger = logging.getLogger(__name__)

_RESERVE_BYTES = 1 << 22
_SELECT_FIT = f"SELECT {columns(FitRow)} FROM fits"  # noqa: S608 (constants only)
_SELECT_MEASUREMENT = f"SELECT {columns(MeasurementRow)} FROM measurements"  # noqa: S608
_WHERE_FIT = "WHERE owner = ? AND id = ?"
_WHERE_MEASUREMENT = "WHERE owner = ? AND sha256 = ?"
_SELECT_THE_FIT = f"{_SELECT_FIT} {_WHERE_FIT}"
_NEXT = "(SELECT coalesce(max(seq), 0) + 1 FROM {} WHERE owner = ?)"
# A repeated fit gets a new row, so that it comes first in lists.
ADD_FIT = (
    "REPLACE INTO fits (seq, owner, id, name, measurement, options, algorithm, library, status, created)"  # noqa: S608
    f" VALUES ({_NEXT.format('fits')}, ?, ?, ?, ?, ?, ?, ?, 'accepted', ?) RETURNING {columns(FitRow)}"
)
ADD_MEASUREMENT = (
    "INSERT INTO measurements (seq, owner, sha256, name, size, valid_nodes, created)"  # noqa: S608
    f" VALUES ({_NEXT.format('measurements')}, ?, ?, ?, ?, ?, ?) ON CONFLICT (owner, sha256) DO UPDATE"
    f" SET name = coalesce(excluded.name, name) RETURNING {columns(MeasurementRow)}"
)
_NAME_FIT = f"UPDATE fits SET name = ? {_WHERE_FIT} RETURNING {columns(FitRow)}"  # noqa: S608


def fit_identity(sha256: str, options: Mapping[str, Any]) -> str:
    """Return the id of a fit: a hash of the measurement, the options in JSON types and the algorithm's version."""
    parts = {"measurement": sha256, "options": dict(options), "algorithm": dsbrdf.ALGORITHM_VERSION}
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:32]


class Store:
    """Manage rows and files in one folder, which a `Database` makes and locks; raises the errors of `Database`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.database = Database(folder)
        self.blobs = Blobs(folder)
        self.writing = Writing(self.database, self.blobs)
        self.running = folder.resolve() / "run"  # Files in this folder are needed only while the service runs.
        try:
            self.blobs.make_folders()
            self.blobs.clear_temporary()
            for left in own_folder(self.running).glob("pymp-*"):  # multiprocessing leaves these folders after a kill.
                shutil.rmtree(left, ignore_errors=True)
            with suppress(OSError):  # A full disk has no space for this file, and the service starts without it.
                (folder / RESERVE).touch(mode=0o600)
                (folder / RESERVE).write_bytes(bytes(_RESERVE_BYTES))
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the database and release the lock on the folder."""
        self.database.close()

    def keep_temporary_files(self) -> None:
        """Keep temporary files of this process, such as the fork server's socket, where the next start deletes them."""
        # A socket's path has at most 107 characters, so the folder is named by its descriptor, which is always short.
        descriptor = Path(f"/proc/self/fd/{os.open(self.running, os.O_RDONLY)}")
        if descriptor.is_dir():
            tempfile.tempdir = str(descriptor)

    def add_measurement(
        self, caller: Caller, incoming: Incoming, name: str | None = None
    ) -> tuple[MeasurementRow, bool]:
        """Store a closed file as a measurement; return its row, and whether the caller did not have it yet.

        A given name replaces the earlier name.

        Raises ProblemError if the caller's quota would be exceeded, or the caller's key has been revoked.
        """
        sha256 = incoming.sha256
        with self.database.transaction() as db:
            check_key(db, caller)
            query = f"SELECT 1 FROM measurements {_WHERE_MEASUREMENT}"  # noqa: S608
            new = db.execute(query, (caller.owner, sha256)).fetchone() is None
            if new:
                check_storage(db, caller, incoming.size, "the measurement has")
            values = (caller.owner, caller.owner, sha256, name, incoming.size, incoming.valid_nodes, time.time())
            (row,) = db.execute(ADD_MEASUREMENT, values).fetchall()
            # An existing file is replaced too, which repairs damage and does not reveal that another key has the file.
            self.blobs.place(incoming)
        return MeasurementRow.from_values(row), new

    def measurement(self, owner: str, sha256: str) -> MeasurementRow:
        """Return a measurement's row; raise MeasurementNotFoundError if there is no such measurement."""
        for row in self.database.rows(f"{_SELECT_MEASUREMENT} {_WHERE_MEASUREMENT}", owner, sha256):
            return MeasurementRow.from_values(row)
        raise MeasurementNotFoundError(sha256)

    def sound_file(self, sha256: str) -> Path:
        """Check a measurement's file by its sha256 and return its path.

        Raises MeasurementDamagedError if the file is missing or damaged, and OSError if the folder cannot be used.
        """
        try:
            damage = self.blobs.damage(sha256)
        except OSError:
            self.blobs.check()  # A file is missing only where other files can be written and read.
            damage = self.blobs.fault(sha256)
        if damage is not None:
            raise MeasurementDamagedError(damage)
        return self.blobs.path(sha256)

    def measurement_file(self, owner: str, sha256: str) -> tuple[MeasurementRow, Path]:
        """Check the file of an owner's measurement by its sha256, and return its row and path.

        Raises the errors of `sound_file`, and MeasurementNotFoundError if the owner has no such measurement.
        """
        row = self.measurement(owner, sha256)
        try:
            return row, self.sound_file(sha256)
        except MeasurementDamagedError as error:
            self.measurement(owner, sha256)  # This raises if the measurement was deleted, which is no damage.
            logger.error("the file of the measurement %s is damaged: %s", sha256, error)  # noqa: TRY400 (no traceback)
            raise

    def measurements(self, owner: str, limit: int, before: int | None, name: str | None = None) -> list[MeasurementRow]:
        """Return up to `limit` measurements, newest first, with `seq` below `before` and optionally one name."""
        page = self._page(_SELECT_MEASUREMENT, owner, limit, before, name=name)
        return list(map(MeasurementRow.from_values, page))

    def remove_measurement(self, owner: str, sha256: str) -> bool:
        """Remove an owner's measurement, and its file if no owner has it any more; return whether it existed.

        Finished fits of the measurement stay. Raises ProblemError if the measurement has unfinished fits.
        """
        with self.database.transaction() as db:
            query = f"SELECT count(*) FROM fits WHERE measurement = ? AND owner = ? AND {IS_UNFINISHED}"  # noqa: S608
            (unfinished,) = db.execute(query, (sha256, owner)).fetchone()
            if unfinished:
                detail = f"{unfinished} unfinished fits use the measurement; cancel them or wait until they have ended."
                raise ProblemError("measurement-in-use", detail)
            query = f"SELECT rowid, sha256 FROM measurements {_WHERE_MEASUREMENT}"  # noqa: S608
            rows = db.execute(query, (owner, sha256)).fetchall()
            unwanted = remove_rows(db, self.blobs, rows)
        try:
            if unwanted:
                remove_files(self.database, self.blobs, unwanted)
        except (OSError, sqlite3.Error) as error:  # The measurement is deleted even if its file stays.
            logger.warning("the file of the deleted measurement %s stays: %s", sha256, error)
        return bool(rows)

    def add_fit(
        self, caller: Caller, sha256: str, options: Mapping[str, Any], queue_limit: int, name: str | None = None
    ) -> tuple[FitRow, bool]:
        """Accept a fit of a stored measurement, or find an equal fit; return its row, and whether it must be computed.

        `options` are in JSON types; without a `name`, the fit gets the name of its measurement.

        Raises MeasurementNotFoundError if the caller has no such measurement, and ProblemError if `queue_limit` fits
        are waiting, a quota is reached or the caller's key has been revoked.
        """
        key = FitKey(caller.owner, fit_identity(sha256, options))
        found = next(map(FitRow.from_values, self.database.rows(_SELECT_THE_FIT, *key)), None)
        # An equal fit that has the name already is returned without a transaction, which would wait for other writers.
        if found is not None and not found.repeatable and name in (None, found.name):
            return found, False
        with self.database.transaction() as db:
            check_key(db, caller)
            known = next(map(FitRow.from_values, db.execute(_SELECT_THE_FIT, key).fetchall()), None)
            if known is not None and not known.repeatable:
                (row,) = db.execute(_NAME_FIT, (name or known.name, *key)).fetchall()
                return FitRow.from_values(row), False
            query = f"SELECT name FROM measurements {_WHERE_MEASUREMENT}"  # noqa: S608
            stored = db.execute(query, (caller.owner, sha256)).fetchone()
            if stored is None:
                raise MeasurementNotFoundError(sha256)
            name = name or (known and known.name) or stored[0]
            check_queue(db, caller)
            check_storage(db, caller, UNFINISHED_SIZE, "the fit may take")
            (waiting,) = db.execute("SELECT count(*) FROM fits WHERE status = 'accepted'").fetchone()
            if waiting >= queue_limit:
                detail = f"{waiting} fits are waiting, which is the limit; the measurement is stored, try again later."
                raise ProblemError("queue-full", detail)
            versions = dsbrdf.ALGORITHM_VERSION, dsbrdf.__version__
            new = (caller.owner, *key, name, sha256, json.dumps(options), *versions, time.time())
            (row,) = db.execute(ADD_FIT, new).fetchall()
        return FitRow.from_values(row), True

    def fit(self, key: FitKey) -> FitRow:
        """Return a fit's row; raise FitNotFoundError if there is no such fit."""
        for row in self.database.rows(_SELECT_THE_FIT, *key):
            return FitRow.from_values(row)
        if key.id in ATLAS:
            return atlas_row(key)
        raise FitNotFoundError(key.id)

    def rename_fit(self, key: FitKey, name: str | None) -> FitRow:
        """Give a fit another name, or none; raise FitNotFoundError if there is no such fit."""
        with self.database.transaction() as db:
            for row in db.execute(_NAME_FIT, (name, *key)).fetchall():
                return FitRow.from_values(row)
        raise FitNotFoundError(key.id)

    def fits(
        self,
        owner: str,
        limit: int,
        before: int | None,
        name: str | None = None,
        status: Status | None = None,
        measurement: str | None = None,
    ) -> list[FitRow]:
        """Return up to `limit` fits with `seq` below `before`, newest first, of a name, status or measurement."""
        page = self._page(_SELECT_FIT, owner, limit, before, name=name, status=status, measurement=measurement)
        return list(map(FitRow.from_values, page))

    def fits_of(self, owner: str, sha256: str, limit: int) -> list[str]:
        """Return the ids of a measurement's fits, newest first."""
        query = "SELECT id FROM fits WHERE measurement = ? AND owner = ? ORDER BY seq DESC LIMIT ?"
        return [fit_id for (fit_id,) in self.database.rows(query, sha256, owner, limit)]

    def result(self, key: FitKey) -> bytes:
        """Return the JSON document of a fit that succeeded, byte for byte as the fit's process wrote it.

        Raises FitNotFoundError if there is no such fit, and ProblemError if the document is missing or damaged.
        """
        return self._result(key)[0]

    def thumbnail(self, key: FitKey) -> bytes:
        """Return the thumbnail of a fit; raise the errors of `result`, and ProblemError if no thumbnail is stored."""
        picture = self._result(key)[1]
        if picture is None:
            detail = "The fit is stored without a thumbnail; figures/sphere.png of the fit draws its sphere."
            raise ProblemError("not-found", detail)
        return picture

    def _result(self, key: FitKey) -> tuple[bytes, bytes | None]:
        query = f"SELECT status, CAST(result AS BLOB), thumbnail, metrics, checksum FROM fits {_WHERE_FIT}"  # noqa: S608
        rows = self.database.rows(query, *key)
        if not rows:
            if key.id in ATLAS:
                return atlas_result(key.id), None
            raise FitNotFoundError(key.id)
        status, document, thumbnail, metrics, written = rows[0]
        if status in UNFINISHED:
            detail = f"The fit is {status} and has no model yet; wait until it has succeeded."
            raise ProblemError("fit-not-finished", detail)
        if document is None:
            raise ProblemError("fit-without-result", f"The fit {status} and has no model; its document says why.")
        if checksum(metrics, document) != written:
            detail = "The stored result of the fit is damaged; delete the fit and fit the measurement again."
            raise ProblemError("fit-without-result", detail)
        return document, thumbnail

    def result_stamp(self, key: FitKey) -> int | None:
        """Return the checksum of a fit's result, None without a result; the query suits the event loop."""
        row = self.database.row_now(f"SELECT checksum FROM fits {_WHERE_FIT} AND status = 'succeeded'", *key)  # noqa: S608
        stamp: int | None = row[0] if row is not None else 0 if key.id in ATLAS else None
        return stamp

    def start_fit(self, key: FitKey) -> FitRow | None:
        """Mark a fit as running, also after the loss of its process; return None if the fit has ended already."""
        change = "status = 'running', attempts = attempts + 1, started = ?"
        return self._advance(change, (time.time(),), key)

    def complete_fit(
        self, key: FitKey, document: str, metrics: Mapping[str, float | None], thumbnail: bytes | None = None
    ) -> FitRow | None:
        """Write the result and the state of a running fit; return None if the fit is not running."""
        change = "status = 'succeeded', finished = ?, metrics = ?, result = ?, thumbnail = ?, size = ?, checksum = ?"
        content, written = document.encode(), json.dumps(metrics)
        size = ROW_SIZE + len(content) + len(thumbnail or b"")
        values = (time.time(), written, document, thumbnail, size, checksum(written, content))
        return self._advance(change, values, key, "status = 'running'")

    def fail_fit(self, key: FitKey, error: Mapping[str, str]) -> None:
        """Write the error and the state of a fit that has not ended; no column is read, because it may be damaged."""
        query = f"UPDATE fits SET status = 'failed', finished = ?, error = ?, size = ? {_WHERE_FIT} AND {IS_UNFINISHED}"  # noqa: S608
        with self.database.transaction() as db:
            db.execute(query, (time.time(), json.dumps(error), ROW_SIZE, *key))

    def cancel_fit(self, key: FitKey) -> FitRow | None:
        """Mark an unfinished fit as cancelled; return None if the fit has ended already."""
        return self._advance("status = 'cancelled', error = NULL, finished = ?, size = ?", (time.time(), ROW_SIZE), key)

    def remove_fit(self, key: FitKey) -> bool:
        """Remove a fit that has ended; return whether such a fit existed."""
        query = f"DELETE FROM fits {_WHERE_FIT} AND NOT {IS_UNFINISHED}"  # noqa: S608
        with self.database.transaction() as db:
            return db.execute(query, key).rowcount > 0

    def resume(self) -> list[FitKey]:
        """Reset fits that an earlier process left running to accepted; return all accepted fits, oldest first.

        Starts by an earlier process do not count as attempts. Unfinished fits of another version of the algorithm fail,
        because their ids include a version that this release does not compute.
        """
        other = f"The service has another fit algorithm since this fit was accepted, {dsbrdf.ALGORITHM_VERSION}; send "
        fault = {"origin": "system", "type": "OtherRelease", "message": f"{other}the request again for a new fit."}
        with self.database.transaction() as db:
            change = "UPDATE fits SET status = 'failed', finished = ?, error = ?, size = ?"
            values = time.time(), json.dumps(fault), ROW_SIZE, dsbrdf.ALGORITHM_VERSION
            db.execute(f"{change} WHERE {IS_UNFINISHED} AND algorithm != ?", values)
            db.execute("UPDATE fits SET status = 'accepted', started = NULL, attempts = 0 WHERE status = 'running'")
            rows = db.execute("SELECT owner, id FROM fits WHERE status = 'accepted' ORDER BY rowid")
            return [FitKey(*row) for row in rows]

    def _advance(
        self, change: str, values: tuple[object, ...], key: FitKey, condition: str = IS_UNFINISHED
    ) -> FitRow | None:
        """Apply `change` to a fit that meets the condition, and return its row; return None for any other fit."""
        query = f"UPDATE fits SET {change} {_WHERE_FIT} AND {condition} RETURNING {columns(FitRow)}"  # noqa: S608
        with self.database.transaction() as db:
            return next(map(FitRow.from_values, db.execute(query, (*values, *key)).fetchall()), None)

    def _page(self, select: str, owner: str, limit: int, before: int | None, **wanted: str | None) -> list[Any]:
        conditions = {"owner = ?": owner, "seq < ?": before, **{f"{name} = ?": wanted[name] for name in wanted}}
        given = {condition: value for condition, value in conditions.items() if value is not None}
        query = f"{select} WHERE {' AND '.join(given)} ORDER BY seq DESC LIMIT ?"
        return self.database.rows(query, *given.values(), limit)
