"""Define ``dsbrdf purge``, which removes fits and measurements older than a given age, also while a server runs.

The age of a fit counts from its end. An old measurement is removed only if no remaining fit of its owner uses it. The
file of a measurement is removed after the last row that refers to the file. The option `--files-without-rows` removes
files to which no row refers.
"""

import time
from collections.abc import Sequence
from datetime import timedelta
from typing import Annotated

from cyclopts import Parameter

from dsbrdf.cli.arguments import print_json
from dsbrdf.cli.commands import new_application

from ..storage.maintenance import purge
from .data_folder import DataDir, Json, data_folder, refuse, run_on_folder

_PURPOSE = "Remove fits that ended long ago, measurements as old that no other fit uses, or files; a server may run."


def main(words: Sequence[str]) -> int:
    """Run the command with the arguments that follow its name; return the exit code."""
    app = new_application("dsbrdf purge", _PURPOSE)
    app.default(_purge)
    return run_on_folder(app, words)


def _check_age(_: object, age: timedelta | None) -> None:
    if age is not None and age < timedelta():
        raise ValueError("the age must not be negative; write it like 30d")


def _purge(
    *,
    older_than: Annotated[
        timedelta | None, Parameter(validator=_check_age, metavar="AGE", help="Such as 30d, 12h or 45m.")
    ] = None,
    files_without_rows: Annotated[bool, Parameter(help="Remove the files that belong to no measurement.")] = False,
    data_dir: DataDir = None,
    json: Json = False,
) -> int:
    if older_than is None and not files_without_rows:
        return refuse("name what to remove: --older-than AGE, such as 30d, --files-without-rows, or both")
    before = None if older_than is None else time.time() - older_than.total_seconds()
    purged = purge(data_folder(data_dir), before, files_without_rows=files_without_rows)
    if json:
        print_json(purged)
    else:
        rows = f"{purged['fits']} fits, {purged['measurements']} measurements and {purged['files_without_rows']}"
        print(f"{rows} files without rows removed, {purged['bytes'] / 1e6:.1f} MB of files")
    return 0
