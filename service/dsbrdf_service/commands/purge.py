"""The command ``dsbrdf purge``: remove what is older than a given age, also while a server runs.

Fits are removed when they ended longer ago, measurements when they were stored longer ago and no remaining fit of their
owner uses them, files with the last row of any owner.
"""

import re
import sqlite3
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Annotated, Any

from cyclopts import CoercionError, Parameter, Token

from dsbrdf.cli.arguments import print_json
from dsbrdf.cli.commands import new_application

from ..storage.blobs import Blobs
from ..storage.database import Database, check_integrity
from ..storage.schema import IS_UNFINISHED
from . import DataDir, Json, data_folder, run_on_folder

_AGE = re.compile(r"([0-9]{1,6})([smhdw])")
_SECONDS = {"s": 1, "m": 60, "h": 3600, "d": 86400, "w": 7 * 86400}
_PURPOSE = "Remove fits that ended long ago, and measurements as old that no other fit uses; a server may run."
_ROWS_PER_TRANSACTION = 50  # so that a running server waits for a moment at most

_OLD_FITS = f"FROM fits WHERE NOT {IS_UNFINISHED} AND coalesce(finished, created) < :before"
# A fit that remains keeps its measurement; an old fit is removed before.
_OLD_MEASUREMENTS = (
    "FROM measurements AS m WHERE created < :before AND NOT EXISTS (SELECT 1 FROM fits AS f"  # noqa: S608
    " WHERE f.owner = m.owner AND f.measurement = m.sha256"
    f" AND (f.{IS_UNFINISHED} OR coalesce(f.finished, f.created) >= :before))"
)


def purge(folder: Path, before: float, *, dry_run: bool = False) -> dict[str, int]:
    """Remove what is older than the time `before` [s since 1970]; return how many rows, and bytes of files.

    Raises DataFolderError if the folder cannot be opened, or its database is damaged.
    """
    check_integrity(folder)
    with closing(Database(folder, exclusive=False)) as database:
        if dry_run:
            return _counted(database, before)
        fits = measurements = freed = 0
        while gone := _remove_fits(database, before):
            fits += gone
        while gone_now := _remove_measurements(database, Blobs(folder), before):
            measurements += len(gone_now)
            freed += sum(gone_now)
    return {"fits": fits, "measurements": measurements, "bytes": freed}


def _counted(database: Database, before: float) -> dict[str, int]:
    with database.transaction() as db:
        values = {"before": before}
        (fits,) = db.execute(f"SELECT count(*) {_OLD_FITS}", values).fetchone()
        old = db.execute(f"SELECT sha256, size, count(*) {_OLD_MEASUREMENTS} GROUP BY sha256", values).fetchall()
        last = [size for sha256, size, rows in old if rows == _rows_of(db, sha256)]
    return {"fits": fits, "measurements": sum(rows for *_, rows in old), "bytes": sum(last)}


def _remove_fits(database: Database, before: float) -> int:
    query = f"DELETE FROM fits WHERE rowid IN (SELECT rowid {_OLD_FITS} LIMIT {_ROWS_PER_TRANSACTION})"  # noqa: S608
    with database.transaction() as db:
        return db.execute(query, {"before": before}).rowcount


def _remove_measurements(database: Database, blobs: Blobs, before: float) -> list[int]:
    """Remove some old measurements; return for each how many bytes it has freed."""
    query = f"SELECT m.rowid, sha256, size {_OLD_MEASUREMENTS} LIMIT {_ROWS_PER_TRANSACTION}"
    freed = []
    with blobs.removal() as remove_file, database.transaction() as db:
        for rowid, sha256, size in db.execute(query, {"before": before}).fetchall():
            db.execute("DELETE FROM measurements WHERE rowid = ?", (rowid,))
            last = _rows_of(db, sha256) == 0
            if last:  # inside the transaction: an upload of the same bytes comes before it or after it
                remove_file(sha256)
            freed.append(size if last else 0)
    return freed


def _rows_of(db: sqlite3.Connection, sha256: str) -> int:
    (number,) = db.execute("SELECT count(*) FROM measurements WHERE sha256 = ?", (sha256,)).fetchone()
    return int(number)


def main(words: Sequence[str]) -> int:
    """Run the command with the words that follow it; return the exit code."""
    app = new_application("dsbrdf purge", _PURPOSE)
    app.default(_purge)
    return run_on_folder(app, words)


def _age(_: Any, tokens: Sequence[Token]) -> int:
    (token,) = tokens
    parts = _AGE.fullmatch(token.value)
    if parts is None:
        raise CoercionError(
            f"--older-than: {token.value[:40]!r} is no number with a unit (s, m, h, d or w), such as 30d"
        )
    return int(parts[1]) * _SECONDS[parts[2]]


def _purge(
    *,
    older_than: Annotated[int, Parameter(converter=_age, metavar="AGE", help="Such as 30d, 12h or 45m.")],
    dry_run: Annotated[bool, Parameter(help="Only report what would be removed.")] = False,
    data_dir: DataDir = None,
    json: Json = False,
) -> None:
    purged = purge(data_folder(data_dir), time.time() - older_than, dry_run=dry_run)
    if json:
        print_json({**purged, "dry_run": dry_run})
    else:
        removed = f"{purged['fits']} fits and {purged['measurements']} measurements"
        print(f"{removed} {'would be ' * dry_run}removed, {purged['bytes'] / 1e6:.1f} MB of files")
