"""Define ``dsbrdf doctor``, which checks the stored database and every stored file without changing anything."""

import sqlite3
from collections.abc import Sequence
from pathlib import Path

from dsbrdf.cli.arguments import print_json
from dsbrdf.cli.commands import new_application

from ..storage import inspection
from .data_folder import DataDir, Json, data_folder, run_on_folder


def main(words: Sequence[str]) -> int:
    """Run the command with the arguments that follow its name; return the exit code."""
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
    if not inspection.is_of_this_release(folder):
        return False, "another release made it, with other tables: use that release"
    if faults := inspection.database_faults(folder):
        return False, f"{'; '.join(faults)}: restore the folder from a copy"
    return True, f"intact, {inspection.count_fits(folder)} fits"


def _measurements(folder: Path) -> tuple[bool, str]:
    faults = inspection.damaged_files(folder)
    n_files = len(inspection.measurements_with_rows(folder))
    for sha256, fault in faults.items():
        number = f"{len(faults)} of {n_files} files are damaged or missing"
        return False, f"{number}, first {sha256} ({fault}): upload that measurement again"
    return True, f"{n_files} files are what their rows say"


def _files(folder: Path) -> tuple[bool, str]:
    without, n_files = inspection.files_without_rows(folder)
    if without:
        return False, (
            f"{len(without)} of {n_files} files have no row: a newer copy of the database may have them, an upload "
            "of the same measurement makes one, and dsbrdf purge --files-without-rows removes those that nobody needs"
        )
    return True, f"{n_files} files have rows"


CHECKS = {"database": _database, "measurements": _measurements, "files": _files}
"""The checks in their order; each returns whether it found no fault, and one sentence."""
