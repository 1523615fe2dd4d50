"""Count what is stored, and check whether rows can be read and written and the disk has space."""

import shutil
import sqlite3
from pathlib import Path

from .database import Database
from .files import check_key, check_storage
from .schema import Caller, Status
from .store import ADD_FIT, ADD_MEASUREMENT

_NOBODY = Caller("nobody")  # No API key has this id.


def fits_by_status(database: Database) -> dict[Status, int]:
    """Return the number of fits of all owners by status."""
    return dict(database.rows("SELECT status, count(*) FROM fits GROUP BY status"))


def measurement_bytes(database: Database) -> int:
    """Return the bytes of all files of measurements, each counted once."""
    ((size,),) = database.rows("SELECT coalesce(sum(size), 0) FROM (SELECT DISTINCT sha256, size FROM measurements)")
    return int(size)


def check_space(folder: Path, min_free_mb: int) -> None:
    """Raise RuntimeError if less than `min_free_mb` MB of the folder's disk is free."""
    free = shutil.disk_usage(folder).free >> 20
    if free < min_free_mb:
        raise RuntimeError(f"only {free} MB are free; the service needs {min_free_mb} MB")


def check_rows(database: Database) -> None:
    """Raise sqlite3.Error or OSError unless rows can be read, and those of an upload and a fit can be written."""

    def attempt(db: sqlite3.Connection) -> None:
        check_key(db, _NOBODY)
        check_storage(db, _NOBODY, 0, "")
        db.execute(ADD_MEASUREMENT, (*[_NOBODY.owner] * 3, None, 0, 0, 0.0)).fetchall()
        db.execute(ADD_FIT, (*[_NOBODY.owner] * 3, None, "", "{}", "", "", 0.0)).fetchall()

    for table in ("fits", "measurements", "keys"):
        database.rows(f"SELECT * FROM {table} ORDER BY rowid DESC LIMIT 1")  # noqa: S608
    database.check_writing(attempt)
