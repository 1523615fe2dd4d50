"""Define ``dsbrdf keys``, ``purge`` and ``doctor``, which work on a data folder, also while a server runs.

The age of a fit counts from its end. An old measurement is removed only if no remaining fit of its owner uses it.
"""

import os
import sqlite3
import time
from collections.abc import Sequence
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, Parameter
from cyclopts.validators import Number

from dsbrdf.cli.arguments import BAD_INPUT, print_error, print_json
from dsbrdf.cli.commands import Whole, new_application, run_words

from .. import DEFAULT_DATA_DIR
from ..errors import DataFolderError
from ..storage import maintenance
from ..storage.database import Database, is_data_folder
from ..storage.keys import add_key, all_keys, revoke_key

_MAX_NAME_LENGTH = 100
_TIME_COLUMNS = ("created", "revoked")
DataDir = Annotated[Path | None, Parameter(metavar="DIR", help="The service's folder.")]
Json = Annotated[bool, Parameter(help="Print one JSON document instead of text.")]


def _data_folder(given: Path | None, *, existing: bool = True) -> Path:
    """Return the given data folder, or the folder in ``DSBRDF_DATA_DIR``, or the default folder.

    Raises DataFolderError if an `existing` folder is needed, but no service has made the folder.
    """
    folder = given or Path(os.environ.get("DSBRDF_DATA_DIR") or DEFAULT_DATA_DIR)
    if existing and not is_data_folder(folder):
        raise DataFolderError(f"{folder} is no data folder of a service; name it with --data-dir")
    return folder


def _run_on_folder(app: App, words: Sequence[str]) -> int:
    """Run a command that uses a data folder, with the arguments `words`; report its errors and return the exit code."""
    try:
        return run_words(app, words)
    except BrokenPipeError:  # The caller handles the early end of the program that reads the output.
        raise
    except (DataFolderError, OSError) as error:
        return refuse(str(error))
    except sqlite3.Error as error:
        refuse(f"the database cannot be used: {error}")
        return 1


def refuse(reason: str) -> int:
    """Print why the command cannot be run; return the exit code."""
    print_error(reason)
    return BAD_INPUT


def keys(words: Sequence[str]) -> int:
    """Run the command with the arguments that follow its name; return the exit code."""
    app = new_application("dsbrdf keys", "Manage API keys of the service; a running server uses a change at once.")
    app.command(_add, name="add", help="Make a key and print it; it is not shown again.")
    app.command(_list, name="list", help="List the keys by their ids, without the keys themselves.")
    app.command(_revoke, name="revoke", help="Refuse a key from now on; its stored data is kept.")
    return (
        _run_on_folder(app, words) if words else refuse("name a command: add, list or revoke (see dsbrdf keys --help)")
    )


def _check_name(_: Any, text: str) -> None:
    if not 0 < len(text) <= _MAX_NAME_LENGTH or not text.isprintable() or text.isspace():
        raise ValueError(f"the name must have 1 to {_MAX_NAME_LENGTH} printable characters")


_Name = Annotated[str, Parameter(validator=_check_name, help="Name of the key's owner, for the list.")]
_Rate = Annotated[
    float | None,
    Parameter(validator=Number(gte=0.001, lt=10**9), metavar="N", help="Maximum rate; bursts may have 5 times more."),
]
_Bound = Annotated[int | None, Whole, Parameter(validator=Number(gte=0, lt=10**12))]
_StoredMb = Annotated[_Bound, Parameter(help="Maximum size of stored data [MB of 10^6 bytes].")]
_QueuedFits = Annotated[_Bound, Parameter(help="Maximum number of fits that wait or run.")]
_MayReadMetrics = Annotated[bool, Parameter(help="The key may read GET /metrics, the totals of all keys.")]
_KeyId = Annotated[str, Parameter(name="ID", allow_leading_hyphen=True, help="Id from dsbrdf keys list.")]


def _add(
    name: _Name,
    /,
    *,
    requests_per_second: _Rate = None,
    stored_mb: _StoredMb = None,
    queued_fits: _QueuedFits = None,
    metrics: _MayReadMetrics = False,
    data_dir: DataDir = None,
) -> None:
    folder = _data_folder(data_dir, existing=False)
    if not is_data_folder(folder):
        print_error(f"{folder.resolve()} becomes a new data folder; the key is for a server of that folder only")
    with closing(Database(folder, exclusive=False)) as database:
        limits = {"requests_per_second": requests_per_second, "stored_mb": stored_mb, "queued_fits": queued_fits}
        key_id, key = add_key(database, name, **limits, metrics=metrics)
    print_error(f"the key {key_id} of {name!r} is not shown again")
    print(key)


def _revoke(key_id: _KeyId, /, *, data_dir: DataDir = None) -> int:
    with closing(Database(_data_folder(data_dir), exclusive=False)) as database:
        if revoke_key(database, key_id):
            return 0
    # The message does not repeat the argument, because it could be a whole key.
    return refuse("there is no key with this id; dsbrdf keys list shows the ids")


def _list(*, data_dir: DataDir = None, json: Json = False) -> None:
    with closing(Database(_data_folder(data_dir), exclusive=False)) as database:
        rows = all_keys(database)
    for row in rows:
        row |= {name: row[name] and datetime.fromtimestamp(row[name], UTC).isoformat() for name in _TIME_COLUMNS}
        row["metrics"] = bool(row["metrics"])
    if json:
        print_json({"items": rows})
        return
    print(f"{'id':<14}{'created':<18}{'revoked':<18}{'requests/s':>12}{'MB':>10}{'fits':>10}  name")
    for row in rows:
        limits = (row[name] for name in ("requests_per_second", "stored_mb", "queued_fits"))
        rate, stored, fits = ("default" if limit is None else f"{limit:g}" for limit in limits)
        days = "".join(f"{(row[name] or '-')[:16].replace('T', ' '):<18}" for name in _TIME_COLUMNS)
        print(f"{row['id']:<14}{days}{rate:>12}{stored:>10}{fits:>10}  {row['name']}")


def purge(words: Sequence[str]) -> int:
    """Run the command with the arguments that follow its name; return the exit code."""
    app = new_application(
        "dsbrdf purge",
        "Remove old fits with measurements that no other fit uses, or files without a row, also while a server runs.",
    )
    app.default(_purge)
    return _run_on_folder(app, words)


def _check_age(_: object, age: timedelta | None) -> None:
    if age is not None and age < timedelta():
        raise ValueError("the age must not be negative; write it like 30d")


def _purge(
    *,
    older_than: Annotated[
        timedelta | None, Parameter(validator=_check_age, metavar="AGE", help="Minimum age, such as 30d or 12h.")
    ] = None,
    files_without_rows: Annotated[bool, Parameter(help="Remove files that belong to no measurement.")] = False,
    data_dir: DataDir = None,
    json: Json = False,
) -> int:
    if older_than is None and not files_without_rows:
        return refuse("name what to remove: --older-than AGE, such as 30d, --files-without-rows, or both")
    before = None if older_than is None else time.time() - older_than.total_seconds()
    purged = maintenance.purge_folder(_data_folder(data_dir), before, files_without_rows=files_without_rows)
    if json:
        print_json(purged)
    else:
        rows = f"{purged['fits']} fits, {purged['measurements']} measurements and {purged['files_without_rows']}"
        print(f"{rows} files without rows removed, {purged['bytes'] / 1e6:.1f} MB of files")
    return 0


def doctor(words: Sequence[str]) -> int:
    """Run the command with the arguments that follow its name; return the exit code."""
    app = new_application("dsbrdf doctor", "Check the database and every measurement, also while a server runs.")
    app.default(_examine)
    return _run_on_folder(app, words)


def _examine(*, data_dir: DataDir = None, json: Json = False) -> int:
    checks = {
        "database": maintenance.check_database,
        "measurements": maintenance.check_measurements,
        "files": maintenance.check_files,
    }
    folder, found = _data_folder(data_dir), []
    for name, check in checks.items():
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
