"""Define the tables of the database, and their rows as frozen dataclasses; times are seconds since 1970.

``PRAGMA user_version`` is a hash of the definition of the tables, so that no release misreads another release's tables.
"""

import json
import math
import sqlite3
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, Literal, NamedTuple, get_args

from ..errors import DataFolderError

# The column `owner` is the id of an API key, or '' for requests without a key.
# `seq` counts the rows of each owner, so that the cursor of a page does not reveal how many rows other owners have.
# `size` of a fit is its size on the disk, which counts in the quota of its key.
# `checksum` covers the metrics and the result of a fit, because SQLite does not notice swapped pages.
# A limit of a key that is NULL means the server's default.
# `metrics` of a key tells whether the key may read ``/metrics``, the totals of all keys.
ROW_SIZE = 2_000  # [bytes] Size of a fit's row with its index entries, without the result.
UNFINISHED_SIZE = 100_000  # [bytes] Size with which an unfinished fit counts in the quota; few results are larger.
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
        checksum INTEGER, size INTEGER NOT NULL DEFAULT {UNFINISHED_SIZE},
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
ROW_DAMAGED = "RowDamaged"
"""The `type` of the error of a fit whose row cannot be read."""
_MAX_UNIX_TIME_S = 253_402_300_800.0  # The year 10000, which no date can have.
_FAULT = {"origin", "type", "message"}
_DOCUMENTS = {"options": True, "metrics": False, "error": False}  # Columns of JSON, and whether each needs a value.
VERSION = zlib.crc32(_TABLES.encode()) >> 1  # This number changes with the tables; SQLite keeps 31 bits.

Status = Literal["accepted", "running", "succeeded", "failed", "cancelled"]
UNFINISHED: tuple[Status, ...] = ("accepted", "running")
IS_UNFINISHED = f"status IN {UNFINISHED}"  # Python writes a tuple as SQL writes a list.


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
            "the database belongs to another program; give a data folder that is new, empty or made by the service"
        )
    connection.executescript(f"BEGIN IMMEDIATE; {_TABLES} PRAGMA user_version = {VERSION}; COMMIT;")


def checksum(metrics: str | None, result: bytes) -> int:
    """Return the checksum of a fit's metrics and result."""
    return zlib.crc32(result, zlib.crc32((metrics or "").encode()))


class FitKey(NamedTuple):
    """Identify a fit by owner and id; equal requests of two owners have equal ids, but make two fits."""

    owner: str
    id: str

    def __str__(self) -> str:
        return f"{self.owner}/{self.id}" if self.owner else self.id


@dataclass(frozen=True)
class Caller:
    """Describe the sender of a request, who may use the rows of one owner, and the sender's limits."""

    owner: str = ""  # The id of the API key that was sent.
    stored_bytes: float = math.inf
    queued_fits: float = math.inf
    metrics: bool = True  # Whether the caller may read the totals of all keys.
    requests_per_second: float = math.inf


def _parse(named: dict[str, Any], name: str, is_needed: bool) -> bool:
    """Replace a JSON text among the values of a row by its object; return False if it is damaged."""
    if named[name] is None:
        return not is_needed
    try:
        named[name] = json.loads(named[name])
    except (TypeError, ValueError):
        return False
    return isinstance(named[name], dict) and (name != "error" or named[name].keys() == _FAULT)


@cache
def columns(row: type) -> str:
    """Return the names of a row's columns as a list in SQL."""
    return ", ".join(field.name for field in fields(row))


def _are_texts(values: Iterable[Any]) -> bool:
    """Return whether the texts among values are UTF-8; other bytes were read as surrogates, which have no encoding."""
    return all(value.encode(errors="ignore").decode() == value for value in values if isinstance(value, str))


def _checked_time(value: Any) -> float | None:
    """Return a time; a damaged one becomes 1970, so that a list with it can be shown."""
    return value if value is None or (isinstance(value, float) and 0 <= value < _MAX_UNIX_TIME_S) else 0.0


@dataclass(frozen=True)
class MeasurementRow:
    """Describe a stored measurement; `seq` counts the measurements of its owner."""

    owner: str
    seq: int
    name: str | None
    sha256: str
    size: int
    valid_nodes: int
    created: float

    @classmethod
    def from_values(cls, values: tuple[Any, ...]) -> "MeasurementRow":
        """Make a row from the values of its `columns`."""
        return cls(*(*values[:-1], _checked_time(values[-1]) or 0.0))

    @classmethod
    def fault(cls, values: tuple[Any, ...]) -> str | None:
        """Return which measurement is damaged, if the values of its `columns` are."""
        row = cls.from_values(values)
        return None if row.created == values[-1] and _are_texts(values) else f"the measurement {row.sha256}"

    @property
    def on_grid(self) -> bool:
        """Whether the measurement is a MERL file; otherwise it has scattered samples."""
        return self.valid_nodes > 0


@dataclass(frozen=True)
class FitRow:
    """Describe a fit without its result; `seq` counts the fits of its owner.

    `attempts` counts the processes that were started for the fit since the start of the service.
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
        """Make a row from the values of its `columns`; a damaged row becomes a failed fit, which can be deleted."""
        named = dict(zip(cls.__dataclass_fields__, values, strict=True))
        named |= {name: _checked_time(named[name]) for name in ("created", "started", "finished")}
        named["created"] = named["created"] or 0.0
        damaged = [name for name, is_needed in _DOCUMENTS.items() if not _parse(named, name, is_needed)]
        if named["status"] not in get_args(Status):
            damaged.append("status")
        if damaged:
            message = f"The row of this fit is damaged ({', '.join(damaged)}); delete it and send the request again."
            named |= {"options": {}, "metrics": None, "status": "failed"}
            named["error"] = {"origin": "system", "type": ROW_DAMAGED, "message": message}
        return cls(**named)

    @classmethod
    def fault(cls, values: tuple[Any, ...]) -> str | None:
        """Return which fit is damaged, if the values of its `columns`, its result and their checksum are."""
        *values_of_row, result, written = values
        row, named = cls.from_values(tuple(values_of_row)), dict(zip(cls.__dataclass_fields__, values, strict=False))
        is_sound = (
            (row.error or {}).get("type") != ROW_DAMAGED
            and (row.created, row.started, row.finished) == (named["created"], named["started"], named["finished"])
            and (result is None or checksum(named["metrics"], result) == written)
            and _are_texts(values_of_row)
        )
        return None if is_sound else f"the fit {row.id}"

    @property
    def key(self) -> FitKey:
        """The owner and the id."""
        return FitKey(self.owner, self.id)

    @property
    def ended(self) -> bool:
        """Whether the fit has succeeded, failed or been cancelled."""
        return self.status not in UNFINISHED

    @property
    def repeatable(self) -> bool:
        """Whether an equal request computes the fit again: the fit was cancelled, or failed with the right input."""
        return self.status == "cancelled" or (self.error is not None and self.error["origin"] != "input")
