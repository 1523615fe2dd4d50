"""The command ``dsbrdf doctor``: check the stored database and every stored file, without changing anything."""

import sqlite3
from collections.abc import Sequence
from pathlib import Path

from dsbrdf.cli.arguments import print_json
from dsbrdf.cli.commands import new_application

from ..storage.blobs import Blobs
from ..storage.database import read_only
from ..storage.schema import VERSION
from .data_folder import DataDir, Json, data_folder, run_on_folder


def main(words: Sequence[str]) -> int:
    """Run the command with the words that follow it; return the exit code."""
    app = new_application("dsbrdf doctor", "Check the service's database and every measurement; a server may run.")
    app.default(_examine)
    return run_on_folder(app, words)


def _examine(*, data_dir: DataDir = None, json: Json = False) -> int:
    folder, found = data_folder(data_dir), []
    for name, check in CHECKS.items():
        try:
            fine, detail = check(folder)
        except (OSError, sqlite3.Error) as error:
            fine, detail = False, str(error)
        found.append({"check": name, "fine": fine, "detail": detail})
        if not json:
            print(f"{'ok' if fine else 'WRONG':<7}{name + ':':<15} {detail}", flush=True)
    if json:
        print_json({"items": found})
    return 0 if all(item["fine"] for item in found) else 1


def _database(folder: Path) -> tuple[bool, str]:
    ((version,),) = read_only(folder, "PRAGMA user_version")
    if version != VERSION:
        return False, "another release made it, with other tables: use that release"
    faults = [fault for (fault,) in read_only(folder, "PRAGMA integrity_check(3)")]
    if faults != ["ok"]:
        return False, f"{'; '.join(faults)}: restore the folder from a copy"
    ((fits,),) = read_only(folder, "SELECT count(*) FROM fits")
    return True, f"intact, {fits} fits"


def _measurements(folder: Path) -> tuple[bool, str]:
    """Compare every file with the sha256 of its row; one whose row has gone meanwhile is no fault."""
    blobs = Blobs(folder)
    faults = {sha256: fault for sha256 in _stored(folder) if (fault := blobs.damage(sha256))}
    still = _stored(folder)
    for sha256 in faults.keys() & still:
        number = f"{len(faults)} of {len(still)} files are damaged or missing"
        return False, f"{number}, first {sha256} ({faults[sha256]}): upload that measurement again"
    return True, f"{len(still)} files are what their rows say"


def _files(folder: Path) -> tuple[bool, str]:
    files = set(Blobs(folder).all())  # before their rows: a file is placed before its row is committed
    if without := files - _stored(folder):
        return False, (
            f"{len(without)} of {len(files)} files have no row: a newer copy of the database may have them, an upload "
            "of the same measurement makes one, and dsbrdf purge --files-without-rows removes those that nobody needs"
        )
    return True, f"{len(files)} files have rows"


def _stored(folder: Path) -> set[str]:
    return {sha256 for (sha256,) in read_only(folder, "SELECT DISTINCT sha256 FROM measurements")}


CHECKS = {"database": _database, "measurements": _measurements, "files": _files}
"""A check returns whether all is well, and what it has found."""
