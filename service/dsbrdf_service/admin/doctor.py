"""Define ``dsbrdf doctor``, which checks the stored database and every stored file without changing anything."""

import sqlite3
from collections.abc import Sequence

from dsbrdf.cli.arguments import print_json
from dsbrdf.cli.commands import new_application

from ..storage.maintenance import check_database, check_files, check_measurements
from .data_folder import DataDir, Json, data_folder, run_on_folder

_CHECKS = {"database": check_database, "measurements": check_measurements, "files": check_files}


def main(words: Sequence[str]) -> int:
    """Run the command with the arguments that follow its name; return the exit code."""
    app = new_application("dsbrdf doctor", "Check the service's database and every measurement; a server may run.")
    app.default(_examine)
    return run_on_folder(app, words)


def _examine(*, data_dir: DataDir = None, json: Json = False) -> int:
    folder, found = data_folder(data_dir), []
    for name, check in _CHECKS.items():
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
