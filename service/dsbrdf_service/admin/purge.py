"""The command ``dsbrdf purge``: remove what is older than a given age, also while a server runs.

Fits are removed when they ended longer ago, measurements when they were stored longer ago and no remaining fit of their
owner uses them, files after the last row of any owner. Files that have no row at all go only when that is asked for.
"""

import time
from collections.abc import Sequence
from contextlib import closing
from datetime import timedelta
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from dsbrdf.cli.arguments import print_json
from dsbrdf.cli.commands import new_application

from ..storage.blobs import Blobs
from ..storage.database import Database
from ..storage.removal import remove_files, remove_rows
from ..storage.schema import IS_UNFINISHED
from .data_folder import DataDir, Json, data_folder, refuse, run_on_folder

_PURPOSE = "Remove fits that ended long ago, measurements as old that no other fit uses, or files; a server may run."
_ROWS_PER_TRANSACTION = 50  # so that a running server waits for a moment at most

_OLD_FITS = f"FROM fits WHERE NOT {IS_UNFINISHED} AND coalesce(finished, created) < :before"
# A fit that remains keeps its measurement; an old fit is removed before.
_OLD_MEASUREMENTS = (
    "FROM measurements AS m WHERE created < :before AND NOT EXISTS (SELECT 1 FROM fits AS f"  # noqa: S608
    " WHERE f.owner = m.owner AND f.measurement = m.sha256"
    f" AND (f.{IS_UNFINISHED} OR coalesce(f.finished, f.created) >= :before))"
)


def purge(folder: Path, before: float | None, *, files_without_rows: bool = False) -> dict[str, int]:
    """Remove what is older than the time `before` [s since 1970], and perhaps the files that have no row.

    Return how many fits, measurements and files without rows that were, and how many bytes of files.

    Raises DataFolderError if the folder cannot be opened, or its database is damaged.
    """
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
    """Remove some old measurements; return how many, and how many bytes of files."""
    query = f"SELECT m.rowid, sha256 {_OLD_MEASUREMENTS} LIMIT {_ROWS_PER_TRANSACTION}"
    with database.transaction() as db:
        old = db.execute(query, {"before": before}).fetchall()
        unwanted = remove_rows(db, blobs, old)
    return len(old), sum(remove_files(database, blobs, unwanted))


def main(words: Sequence[str]) -> int:
    """Run the command with the words that follow it; return the exit code."""
    app = new_application("dsbrdf purge", _PURPOSE)
    app.default(_purge)
    return run_on_folder(app, words)


def _check_age(_: object, age: timedelta | None) -> None:
    if age is not None and age < timedelta():
        raise ValueError("an age is not negative; it is such as 30d")


def _purge(
    *,
    older_than: Annotated[
        timedelta | None, Parameter(validator=_check_age, metavar="AGE", help="Such as 30d, 12h or 45m.")
    ] = None,
    files_without_rows: Annotated[bool, Parameter(help="Remove the files that belong to no measurement.")] = False,
    data_dir: DataDir = None,
    json: Json = False,
) -> int:
    if older_than is None and not files_without_rows:
        return refuse("name what to remove: --older-than AGE, such as 30d, --files-without-rows, or both")
    before = None if older_than is None else time.time() - older_than.total_seconds()
    purged = purge(data_folder(data_dir), before, files_without_rows=files_without_rows)
    if json:
        print_json(purged)
    else:
        rows = f"{purged['fits']} fits, {purged['measurements']} measurements and {purged['files_without_rows']}"
        print(f"{rows} files without rows removed, {purged['bytes'] / 1e6:.1f} MB of files")
    return 0
