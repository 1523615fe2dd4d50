"""The tables of the database, and their rows as frozen dataclasses; times are seconds since 1970.

``PRAGMA user_version`` holds a hash of the tables' definition, so that no release misreads another one's.
"""

import json
import math
import sqlite3
import zlib
from dataclasses import dataclass, fields
from typing import Any, Literal, NamedTuple

from ..errors import DataFolderError

# `owner` is the id of an API key, '' without keys. `seq` counts the rows of each owner, so that the cursor of a page
# does not tell how many rows others have. `size` of a fit is what it takes on the disk, with or without a
# result: it counts as stored bytes. `checksum` is that of metrics and result, which lie on pages of their own: if two
# of those change places, SQLite does not notice. A limit of a key that is NULL is the server's default; `metrics` is
# whether it may read ``/metrics``, which has the totals of all keys.
ROW_SIZE = 2_000  # bytes that a fit takes with its places in the indexes, without its result
_TABLES = f"""
    CREATE TABLE IF NOT EXISTS measurements (
        owner TEXT NOT NULL, seq INTEGER NOT NULL, name TEXT, sha256 TEXT NOT NULL, size INTEGER NOT NULL,
        valid_nodes INTEGER NOT NULL, created REAL NOT NULL,
        UNIQUE (owner, sha256), UNIQUE (owner, seq)
    ) STRICT;
    CREATE INDEX IF NOT EXISTS measurements_by_sha256 ON measurements (sha256);
    CREATE INDEX IF NOT EXISTS measurements_by_name ON measurements (owner, name, seq);
    CREATE TABLE IF NOT EXISTS fits (
        owner TEXT NOT NULL, seq INTEGER NOT NULL, name TEXT, id TEXT NOT NULL, measurement TEXT NOT NULL,
        options TEXT NOT NULL, algorithm TEXT NOT NULL, library TEXT NOT NULL,
        status TEXT NOT NULL CHECK (status IN ('accepted', 'running', 'succeeded', 'failed', 'cancelled')),
        attempts INTEGER NOT NULL DEFAULT 0,
        metrics TEXT, error TEXT, created REAL NOT NULL, started REAL, finished REAL,
        result TEXT, -- JSON, as HTTP sends it
        thumbnail BLOB, -- PNG
        checksum INTEGER, size INTEGER NOT NULL DEFAULT {ROW_SIZE},
        UNIQUE (owner, id), UNIQUE (owner, seq),
        CHECK ((status = 'succeeded') = (result IS NOT NULL)), CHECK ((status = 'failed') = (error IS NOT NULL))
    ) STRICT;
    CREATE INDEX IF NOT EXISTS fits_by_status ON fits (status, owner);
    CREATE INDEX IF NOT EXISTS fits_by_measurement ON fits (measurement, owner);
    CREATE INDEX IF NOT EXISTS fits_by_name ON fits (owner, name, seq);
    CREATE INDEX IF NOT EXISTS fits_by_size ON fits (owner, size);
    CREATE TABLE IF NOT EXISTS keys (
        id TEXT NOT NULL PRIMARY KEY, name TEXT NOT NULL, secret_sha256 TEXT NOT NULL, created REAL NOT NULL,
        revoked REAL, requests_per_second REAL, stored_mb INTEGER, queued_fits INTEGER,
        metrics INTEGER NOT NULL DEFAULT 0
    ) STRICT;
"""
VERSION = zlib.crc32(_TABLES.encode()) >> 1  # another one whenever the tables are; SQLite keeps 31 bits of it

Status = Literal["accepted", "running", "succeeded", "failed", "cancelled"]
UNFINISHED: tuple[Status, ...] = ("accepted", "running")
IS_UNFINISHED = f"status IN {UNFINISHED}"  # for SQL, which writes a tuple as Python does


def create_tables(connection: sqlite3.Connection) -> None:
    """Create the tables in an empty database; another process may do so at the same time.

    Raises DataFolderError if another release or another program has written the database.
    """
    query = "SELECT user_version, (SELECT count(*) FROM sqlite_master) FROM pragma_user_version"
    version, n_tables = connection.execute(query).fetchone()
    if version == VERSION:
        return
    if version:
        raise DataFolderError(
            "the database was made by another release, which has other tables; serve it with that release, or give "
            "a data folder that is new or empty"
        )
    if n_tables:
        raise DataFolderError(
            "the database is another program's; give a data folder that is new, empty or the service's"
        )
    connection.executescript(f"BEGIN IMMEDIATE; {_TABLES} PRAGMA user_version = {VERSION}; COMMIT;")


def checksum(metrics: str | None, result: bytes) -> int:
    """Return the checksum of what a fit has given."""
    return zlib.crc32(result, zlib.crc32((metrics or "").encode()))


class FitKey(NamedTuple):
    """What names a fit: the same request of two owners has the same id, and makes two fits."""

    owner: str
    id: str

    def __str__(self) -> str:
        return f"{self.owner}/{self.id}" if self.owner else self.id


@dataclass(frozen=True)
class Caller:
    """Who asks, and how much they may have at once; rows are seen by their owner only."""

    owner: str = ""  # id of the key that was sent
    stored_bytes: float = math.inf
    queued_fits: float = math.inf
    metrics: bool = True  # whether they may see the totals of all
    requests_per_second: float = math.inf


def columns(row: type) -> str:
    """Return the columns of a row, which has a field for each."""
    return ", ".join(field.name for field in fields(row))


@dataclass(frozen=True)
class MeasurementRow:
    """A stored measurement; `seq` counts the measurements of its owner."""

    owner: str
    seq: int
    name: str | None
    sha256: str
    size: int
    valid_nodes: int
    created: float

    @property
    def on_grid(self) -> bool:
        """Whether it is a MERL file, which has nodes; else it is a table of scattered samples."""
        return self.valid_nodes > 0


@dataclass(frozen=True)
class FitRow:
    """A fit's state without its result; options as on the wire; `seq` counts the fits of its owner.

    `attempts` counts the processes that were started for it since the start of the service.
    """

    owner: str
    seq: int
    name: str | None
    id: str
    measurement: str
    status: Status
    attempts: int
    created: float
    started: float | None
    finished: float | None
    options: dict[str, Any]
    algorithm: str
    library: str
    metrics: dict[str, float | None] | None
    error: dict[str, str] | None

    @classmethod
    def from_values(cls, values: tuple[Any, ...]) -> "FitRow":
        """Make a row of the values of its `columns`."""
        named = dict(zip((field.name for field in fields(cls)), values, strict=True))
        for name in ("options", "metrics", "error"):
            try:
                named[name] = None if named[name] is None else json.loads(named[name])
            except ValueError:
                raise sqlite3.DatabaseError(f"the {name} of the fit {named['id']} are damaged") from None
        return cls(**named)

    @property
    def key(self) -> FitKey:
        """What names the fit."""
        return FitKey(self.owner, self.id)

    @property
    def ended(self) -> bool:
        """Whether the fit is over, well or not."""
        return self.status not in UNFINISHED

    @property
    def repeatable(self) -> bool:
        """Whether the same request computes it once more: not where its input is at fault."""
        return self.status == "cancelled" or (self.error is not None and self.error["origin"] != "input")
