"""Remove measurements and old fits, and find damage in a data folder.

A removal deletes rows first, then the files without remaining rows. A crash in between leaves a file without a row,
which `dsbrdf purge --files-without-rows` removes. The checks change nothing, even while a server runs; each returns
whether there is no fault, and a sentence.
"""

import shutil
import sqlite3
from collections.abc import Iterable, Sequence
from contextlib import closing
from pathlib import Path

from .database import RESERVE, Database, is_full, read_only
from .files import Blobs
from .schema import IS_UNFINISHED, VERSION, FitRow, MeasurementRow, columns

_SPARE_DISK_BYTES = 1 << 24  # With less free space, files are deleted first, so that the commit has space.
_ROWS_PER_TRANSACTION = 50  # A running server waits a few milliseconds for each transaction of this size.

_EVERY_FIT = f"SELECT {columns(FitRow)}, CAST(result AS BLOB), checksum FROM fits"  # noqa: S608
_EVERY_MEASUREMENT = f"SELECT {columns(MeasurementRow)} FROM measurements"  # noqa: S608
_OLD_FITS = f"FROM fits WHERE NOT {IS_UNFINISHED} AND coalesce(finished, created) < :before"
# A measurement stays as long as it has an unfinished fit, or a fit that ended after the given time.
_OLD_MEASUREMENTS = (
    "FROM measurements AS m WHERE created < :before AND NOT EXISTS (SELECT 1 FROM fits AS f"  # noqa: S608
    " WHERE f.owner = m.owner AND f.measurement = m.sha256"
    f" AND (f.{IS_UNFINISHED} OR coalesce(f.finished, f.created) >= :before))"
)


def remove_rows(db: sqlite3.Connection, blobs: Blobs, rows: Sequence[tuple[int, str]]) -> list[str]:
    """Delete rows of measurements, each given by rowid and sha256, in a write transaction.

    Return the sha256 of measurements that have no row any more. On a full disk, the files without rows are deleted at
    once, because the commit needs their space.
    """
    db.executemany("DELETE FROM measurements WHERE rowid = ?", [(rowid,) for rowid, _ in rows])
    unwanted = [sha256 for _, sha256 in rows if not _has_row(db, sha256)]
    # A restored copy of the data folder may lack the empty folder of temporary files, so its parent is asked.
    if unwanted and shutil.disk_usage(blobs.temporary.parent).free < _SPARE_DISK_BYTES:
        for sha256 in unwanted:
            blobs.remove(sha256)
    return unwanted


def remove_files(database: Database, blobs: Blobs, names: Iterable[str]) -> list[int]:
    """Remove the files of measurements that have no row; return their sizes.

    During the transaction, no upload can add a row for the same bytes; a file with an earlier row stays.
    """
    with database.transaction() as db:
        found = [blobs.remove(sha256) for sha256 in names if not _has_row(db, sha256)]
    return [size for size in found if size is not None]


def _has_row(db: sqlite3.Connection, sha256: str) -> bool:
    return db.execute("SELECT 1 FROM measurements WHERE sha256 = ?", (sha256,)).fetchone() is not None


def purge_folder(folder: Path, before: float | None, *, files_without_rows: bool = False) -> dict[str, int]:
    """Remove fits and measurements older than `before` [s since 1970], and optionally the files without rows.

    Return the numbers of removed fits, measurements and files without rows, and the bytes of all removed files.

    Raises DataFolderError if the folder cannot be opened, or its database is damaged.
    """
    if is_full(folder):  # A removal needs space for the log of the database first.
        (folder / RESERVE).unlink(missing_ok=True)
    blobs, purged = Blobs(folder), {"fits": 0, "measurements": 0, "files_without_rows": 0, "bytes": 0}
    with closing(Database(folder, exclusive=False)) as database:
        if before is not None:
            while gone := _remove_fits(database, before):
                purged["fits"] += gone
            while (removed := _remove_measurements(database, blobs, before))[0]:
                purged["measurements"] += removed[0]
                purged["bytes"] += removed[1]
        if files_without_rows:
            names = set(blobs.all()) - {sha256 for (sha256,) in database.rows("SELECT sha256 FROM measurements")}
            sizes = remove_files(database, blobs, names)
            purged["files_without_rows"] = len(sizes)
            purged["bytes"] += sum(sizes)
    return purged


def _remove_fits(database: Database, before: float) -> int:
    query = f"DELETE FROM fits WHERE rowid IN (SELECT rowid {_OLD_FITS} LIMIT {_ROWS_PER_TRANSACTION})"  # noqa: S608
    with database.transaction() as db:
        return db.execute(query, {"before": before}).rowcount


def _remove_measurements(database: Database, blobs: Blobs, before: float) -> tuple[int, int]:
    """Remove some old measurements; return their number and the bytes of the removed files."""
    query = f"SELECT m.rowid, sha256 {_OLD_MEASUREMENTS} LIMIT {_ROWS_PER_TRANSACTION}"
    with database.transaction() as db:
        old = db.execute(query, {"before": before}).fetchall()
        unwanted = remove_rows(db, blobs, old)
    return len(old), sum(remove_files(database, blobs, unwanted))


def check_database(folder: Path) -> tuple[bool, str]:
    """Read the whole database; return whether the database is intact, and a sentence about it."""
    if read_only(folder, "PRAGMA user_version") != [(VERSION,)]:
        return False, "another release made it, with other tables: use that release"
    faults = [fault for (fault,) in read_only(folder, "PRAGMA integrity_check(3)") if fault != "ok"]
    if faults:
        return False, f"{'; '.join(faults)}: restore the folder from a copy"
    rows = [*read_only(folder, _EVERY_FIT, FitRow.fault), *read_only(folder, _EVERY_MEASUREMENT, MeasurementRow.fault)]
    faults = [fault for fault in rows if fault]
    if faults:
        return False, f"{len(faults)} rows are damaged, first {faults[0]}: delete it, or restore the folder from a copy"
    ((n_fits,),) = read_only(folder, "SELECT count(*) FROM fits")
    return True, f"intact, {n_fits} fits"


def check_measurements(folder: Path) -> tuple[bool, str]:
    """Read the file of every measurement; return whether each has the sha256 in its row, and a sentence about them."""
    blobs = Blobs(folder)
    found = {sha256: blobs.fault(sha256) for sha256 in _stored(folder)}
    stored = _stored(folder)  # A file that was deleted with its row meanwhile is no fault.
    faults = [(sha256, fault) for sha256, fault in found.items() if fault and sha256 in stored]
    if faults:
        number = f"{len(faults)} of {len(stored)} files are damaged or missing"
        return False, f"{number}, first {faults[0][0]} ({faults[0][1]}): upload that measurement again"
    return True, f"{len(stored)} files are what their rows say"


def check_files(folder: Path) -> tuple[bool, str]:
    """Return whether every file has a row, and a sentence about the files."""
    # If rows were read first, a file that is uploaded in between would seem to have no row.
    files = set(Blobs(folder).all())
    without = files - _stored(folder)
    if without:
        return False, (
            f"{len(without)} of {len(files)} files have no row: a newer copy of the database may have them, an upload "
            "of the same measurement makes one, and dsbrdf purge --files-without-rows removes those that nobody needs"
        )
    return True, f"{len(files)} files have rows"


def _stored(folder: Path) -> set[str]:
    return {sha256 for (sha256,) in read_only(folder, "SELECT DISTINCT sha256 FROM measurements")}
