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
    # Rows get an owner: '' is who needs no key. Now `seq` counts the rows of each owner, so that the cursor of a page
    # does not tell how many rows others have. `size` of a fit is that of its result, which counts as stored bytes.
    """
    CREATE TABLE owned_measurements (
        owner TEXT NOT NULL,
        seq INTEGER NOT NULL,
        sha256 TEXT NOT NULL,
        size INTEGER NOT NULL,
        valid_nodes INTEGER NOT NULL,
        created REAL NOT NULL,
        UNIQUE (owner, sha256),
        UNIQUE (owner, seq)
    ) STRICT;
    INSERT INTO owned_measurements SELECT '', seq, sha256, size, valid_nodes, created FROM measurements ORDER BY seq;
    DROP TABLE measurements;
    ALTER TABLE owned_measurements RENAME TO measurements;
    CREATE INDEX measurements_by_sha256 ON measurements (sha256);
    CREATE TABLE owned_fits (
        owner TEXT NOT NULL,
        seq INTEGER NOT NULL,
        id TEXT NOT NULL,
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
        size INTEGER NOT NULL DEFAULT 0,
        UNIQUE (owner, id),
        UNIQUE (owner, seq),
        CHECK ((status = 'succeeded') = (result IS NOT NULL)),
        CHECK ((status = 'failed') = (error IS NOT NULL))
    ) STRICT;
    INSERT INTO owned_fits SELECT
        '', seq, id, measurement, options, algorithm, library, status, attempts, metrics, error, created, started,
        finished, result, coalesce(length(CAST(result AS BLOB)), 0) FROM fits ORDER BY seq;
    DROP TABLE fits;
    ALTER TABLE owned_fits RENAME TO fits;
    CREATE INDEX fits_by_status ON fits (status, owner);
    CREATE INDEX fits_by_measurement ON fits (measurement, owner);
    CREATE INDEX fits_by_size ON fits (owner, size);
    CREATE TABLE keys (
        id TEXT NOT NULL PRIMARY KEY,
        name TEXT NOT NULL,
        secret_sha256 TEXT NOT NULL,
        created REAL NOT NULL,
        revoked REAL,
        requests_per_second REAL,
        stored_mb INTEGER,
        queued_fits INTEGER
    ) STRICT;
    """,
    # How often the service has broken off while a fit ran: no fault of the fit, unless it happens again and again.
    """
    ALTER TABLE fits ADD COLUMN interruptions INTEGER NOT NULL DEFAULT 0;
    """,
)


class DataFolderError(RuntimeError):
    """A data folder cannot be opened; the message says why."""


def is_current(connection: sqlite3.Connection) -> bool:
    """Return whether the database has the newest version."""
    return _version(connection) == len(STEPS)


def migrate(connection: sqlite3.Connection) -> None:
    """Bring the database to the newest version, each step in a transaction of its own.

    Raises
    ------
    DataFolderError
        If the database was written by a newer release.
    """
    version = _version(connection)
    if version > len(STEPS):
        raise DataFolderError(
            f"the database has schema version {version}, but this release knows versions up to {len(STEPS)}; "
            "run the newer release that wrote it"
        )
    for number, step in enumerate(STEPS[version:], start=version + 1):
        connection.execute("BEGIN IMMEDIATE")
        try:
            for statement in step.split(";"):
                connection.execute(statement)
            connection.execute(f"PRAGMA user_version = {number}")
            connection.execute("COMMIT")
        except BaseException:
            if connection.in_transaction:
                connection.execute("ROLLBACK")
            raise


def _version(connection: sqlite3.Connection) -> int:
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    return int(version)
