"""The end of measurements: first their rows, then the files that no row wants any more.

What is broken off in between leaves a file without a row: it stays where it is until `dsbrdf purge` is told to remove
such files. No file goes on doubt.
"""

import shutil
import sqlite3
from collections.abc import Iterable, Sequence
from contextlib import suppress

from .blobs import Blobs
from .database import Database

_ROOM = 1 << 24  # bytes of free disk space that writing to the database does not use up


def remove_rows(db: sqlite3.Connection, blobs: Blobs, rows: Sequence[tuple[int, str]]) -> list[str]:
    """Delete rows of measurements, each given by rowid and sha256, in a write transaction.

    Return the measurements that have no row then. On a full disk their files go at once: to commit takes their room.
    """
    db.executemany("DELETE FROM measurements WHERE rowid = ?", [(rowid,) for rowid, _ in rows])
    unwanted = [sha256 for _, sha256 in rows if not _has_row(db, sha256)]
    if unwanted and shutil.disk_usage(blobs.temporary).free < _ROOM:
        for sha256 in unwanted:
            blobs.path(sha256).unlink(missing_ok=True)
    return unwanted


def remove_files(database: Database, blobs: Blobs, names: Iterable[str]) -> list[int]:
    """Remove the files of measurements that have no row; return their sizes.

    An upload of the same bytes comes before this transaction, which then finds its row, or after it.
    """
    sizes = []
    with database.transaction() as db:
        for sha256 in names:
            if not _has_row(db, sha256):
                path = blobs.path(sha256)
                with suppress(FileNotFoundError):
                    sizes.append(path.lstat().st_size)
                    path.unlink()
    return sizes


def _has_row(db: sqlite3.Connection, sha256: str) -> bool:
    return db.execute("SELECT 1 FROM measurements WHERE sha256 = ?", (sha256,)).fetchone() is not None
