"""Examine a data folder without changing it, even while a server runs; each check returns whether there is no fault."""

from pathlib import Path

from .blobs import Blobs
from .database import read_only
from .schema import VERSION


def check_database(folder: Path) -> tuple[bool, str]:
    """Read the whole database; return whether the database is intact, and a sentence about it."""
    if read_only(folder, "PRAGMA user_version") != [(VERSION,)]:
        return False, "another release made it, with other tables: use that release"
    faults = [fault for (fault,) in read_only(folder, "PRAGMA integrity_check(3)") if fault != "ok"]
    if faults:
        return False, f"{'; '.join(faults)}: restore the folder from a copy"
    ((n_fits,),) = read_only(folder, "SELECT count(*) FROM fits")
    return True, f"intact, {n_fits} fits"


def check_measurements(folder: Path) -> tuple[bool, str]:
    """Read the file of every measurement; return whether each has the sha256 in its row, and a sentence about them."""
    blobs = Blobs(folder)
    faults = {sha256: fault for sha256 in _stored(folder) if (fault := blobs.damage(sha256))}
    stored = _stored(folder)  # A file that was deleted with its row meanwhile is no fault.
    damaged = [sha256 for sha256 in faults if sha256 in stored]
    if damaged:
        number = f"{len(damaged)} of {len(stored)} files are damaged or missing"
        return False, f"{number}, first {damaged[0]} ({faults[damaged[0]]}): upload that measurement again"
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
    """Return the sha256 of every measurement that has a row."""
    return {sha256 for (sha256,) in read_only(folder, "SELECT DISTINCT sha256 FROM measurements")}
