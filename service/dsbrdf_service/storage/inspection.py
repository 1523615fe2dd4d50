"""Examine a data folder without changing it, even while a server runs."""

from pathlib import Path

from .blobs import Blobs
from .database import read_only
from .schema import VERSION


def is_of_this_release(folder: Path) -> bool:
    """Return whether the database has the tables of this release."""
    return read_only(folder, "PRAGMA user_version") == [(VERSION,)]


def database_faults(folder: Path) -> list[str]:
    """Read the whole database, and return its first faults."""
    return [fault for (fault,) in read_only(folder, "PRAGMA integrity_check(3)") if fault != "ok"]


def count_fits(folder: Path) -> int:
    """Return the number of fits, in any state."""
    return int(read_only(folder, "SELECT count(*) FROM fits")[0][0])


def measurements_with_rows(folder: Path) -> set[str]:
    """Return the sha256 of every measurement that has a row."""
    return {sha256 for (sha256,) in read_only(folder, "SELECT DISTINCT sha256 FROM measurements")}


def damaged_files(folder: Path) -> dict[str, str]:
    """Read every measurement's file, and return the faults by sha256.

    A measurement whose row is deleted meanwhile has no fault.
    """
    blobs = Blobs(folder)
    faults = {sha256: fault for sha256 in measurements_with_rows(folder) if (fault := blobs.damage(sha256))}
    still = measurements_with_rows(folder)
    return {sha256: fault for sha256, fault in faults.items() if sha256 in still}


def files_without_rows(folder: Path) -> tuple[set[str], int]:
    """Return the sha256 of files that have no row, and the number of all files."""
    files = set(Blobs(folder).all())  # Files are listed before rows, because a file is stored before its row.
    return files - measurements_with_rows(folder), len(files)
