"""Define ``dsbrdf keys``, which adds, lists and revokes API keys, also while a server runs."""

from collections.abc import Sequence
from contextlib import closing
from datetime import UTC, datetime
from typing import Annotated, Any

from cyclopts import Parameter
from cyclopts.validators import Number

from dsbrdf.cli.arguments import print_error, print_json
from dsbrdf.cli.commands import Whole, new_application

from ..storage.database import Database, is_data_folder
from ..storage.keys import add_key, all_keys, revoke_key
from .data_folder import DataDir, Json, data_folder, refuse, run_on_folder

_MAX_NAME_LENGTH = 100
_TIME_COLUMNS = ("created", "revoked")


def main(words: Sequence[str]) -> int:
    """Run the command with the arguments that follow its name; return the exit code."""
    app = new_application("dsbrdf keys", "API keys of the service; a running server heeds a change at once.")
    app.command(_add, name="add", help="Make a key and print it, this once.")
    app.command(_list, name="list", help="Print the keys, without their secrets.")
    app.command(_revoke, name="revoke", help="Refuse a key from now on; what is stored with it stays.")
    return (
        run_on_folder(app, words) if words else refuse("name a command: add, list or revoke (see dsbrdf keys --help)")
    )


def _check_name(_: Any, text: str) -> None:
    if not 0 < len(text) <= _MAX_NAME_LENGTH or not text.isprintable() or text.isspace():
        raise ValueError(f"the name must have 1 to {_MAX_NAME_LENGTH} printable characters")


_Name = Annotated[str, Parameter(validator=_check_name, help="Whose key it is, for the list.")]
_Rate = Annotated[
    float | None,
    Parameter(validator=Number(gte=0.001, lt=10**9), metavar="N", help="Five times as many may come at once."),
]
_Bound = Annotated[int | None, Whole, Parameter(validator=Number(gte=0, lt=10**12))]
_StoredMb = Annotated[_Bound, Parameter(help="Most that may be stored [MB of 10^6 bytes].")]
_QueuedFits = Annotated[_Bound, Parameter(help="Most fits that may wait or run.")]
_MayReadMetrics = Annotated[bool, Parameter(help="It may read GET /metrics, the totals of all keys.")]
_KeyId = Annotated[str, Parameter(name="ID", allow_leading_hyphen=True, help="As the list shows it.")]


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
    folder = data_folder(data_dir, existing=False)
    if not is_data_folder(folder):
        print_error(f"{folder.resolve()} becomes a new data folder; the key is for a server of that folder only")
    with closing(Database(folder, exclusive=False)) as database:
        limits = {"requests_per_second": requests_per_second, "stored_mb": stored_mb, "queued_fits": queued_fits}
        key_id, key = add_key(database, name, **limits, metrics=metrics)
    print_error(f"the key {key_id} of {name!r} is shown this once")
    print(key)


def _revoke(key_id: _KeyId, /, *, data_dir: DataDir = None) -> int:
    with closing(Database(data_folder(data_dir), exclusive=False)) as database:
        if revoke_key(database, key_id):
            return 0
    # The message does not repeat the argument, because it could be a whole key.
    return refuse("there is no key with this id; dsbrdf keys list shows the ids")


def _list(*, data_dir: DataDir = None, json: Json = False) -> None:
    with closing(Database(data_folder(data_dir), exclusive=False)) as database:
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
