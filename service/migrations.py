"""Versions of the database schema: ``PRAGMA user_version`` counts the steps that have been applied.

Steps are only ever appended; a database of an earlier release is brought up to date when it is opened.
"""

import sqlite3

STEPS = (
    """
    CREATE TABLE measurements (
        seq INTEGER PRIMARY KEY AUTOINCREMENT,
        sha256 TEXT NOT NULL UNIQUE,
        size INTEGER NOT NULL,
        valid_nodes INTEGER NOT NULL,
        created REAL NOT NULL
    ) STRICT;
    CREATE TABLE fits (
        seq INTEGER PRIMARY KEY AUTOINCREMENT,
        id TEXT NOT NULL UNIQUE,
        measurement TEXT NOT NULL,
        options TEXT NOT NULL,
        algorithm TEXT NOT NULL,
        library TEXT NOT NULL,
        status TEXT NOT NULL
            CHECK (status IN ('accepted', 'running', 'succeeded', 'failed', 'cancelled')),
        attempts INTEGER NOT NULL DEFAULT 0,
        metrics TEXT,
        error TEXT,
        created REAL NOT NULL,
        started REAL,
        finished REAL,
        result TEXT,
        CHECK ((status = 'succeeded') = (result IS NOT NULL)),
        CHECK ((status = 'failed') = (error IS NOT NULL))
    ) STRICT;
    CREATE INDEX fits_by_status ON fits (status);
    CREATE INDEX fits_by_measurement ON fits (measurement);
    """,
)


class DataFolderError(RuntimeError):
    """A data folder cannot be opened; the message says why."""


def migrate(connection: sqlite3.Connection) -> None:
    """Bring the database to the newest version, each step in a transaction of its own.

    Raises
    ------
    DataFolderError
        If the database was written by a newer release.
    """
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    if version > len(STEPS):
        raise DataFolderError(
            f"the database has schema version {version}, but this release knows versions up to {len(STEPS)}; "
            "run the newer release that wrote it"
        )
    for number, step in enumerate(STEPS[version:], start=version + 1):
        connection.executescript(f"BEGIN IMMEDIATE;{step};PRAGMA user_version = {number};COMMIT;")
