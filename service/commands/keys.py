"""The command ``dsbrdf keys``: add, list and revoke API keys, also while a server runs."""

import argparse
import math
import re
import sys
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import asdict, astuple
from datetime import UTC, datetime
from pathlib import Path

from dsbrdf.cli.arguments import Parser, add_json_option, print_json

from ..access.keys import KeyLimits, KeyRow, add_key, all_keys, revoke_key
from ..storage.database import FILE_NAME, Database
from . import add_data_dir, refuse, run_in_folder

_MAX_NAME = 100


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return the exit code."""
    arguments = _parser().parse_args(argv)

    def work(folder: Path) -> int:
        if not (folder / FILE_NAME).exists():
            place = folder.resolve()
            sys.stderr.write(
                f"dsbrdf: {place} becomes a new data folder; the key is for a server of that folder only\n"
            )
        with closing(Database(folder, exclusive=False)) as database:
            code: int = arguments.run(database, arguments)
            return code

    return run_in_folder(arguments, work, existing=arguments.run is not _add)


def _add(database: Database, arguments: argparse.Namespace) -> int:
    limits = KeyLimits(arguments.requests_per_second, arguments.stored_mb, arguments.queued_fits)
    row, key = add_key(database, arguments.name, limits, metrics=arguments.metrics)
    sys.stderr.write(f"dsbrdf: the key {row.id} of {row.name!r} is shown this once\n")
    print(key)
    return 0


def _list(database: Database, arguments: argparse.Namespace) -> int:
    rows = all_keys(database)
    if arguments.json:
        print_json({"items": [_document(row) for row in rows]})
        return 0
    print(f"{'id':<14}{'created':<18}{'used':<18}{'revoked':<18}{'requests/s':>12}{'MB':>10}{'fits':>10}  name")
    for row in rows:
        rate, stored, fits = ("default" if limit is None else f"{limit:g}" for limit in astuple(row.limits))
        times = "".join(f"{_day(seconds):<18}" for seconds in (row.created, row.used, row.revoked))
        print(f"{row.id:<14}{times}{rate:>12}{stored:>10}{fits:>10}  {row.name}")
    return 0


def _revoke(database: Database, arguments: argparse.Namespace) -> int:
    if not revoke_key(database, arguments.id):
        # The argument is not repeated: it could be a whole key.
        return refuse("there is no key with this id; dsbrdf keys list shows the ids")
    return 0


def _document(row: KeyRow) -> dict[str, object]:
    document = asdict(row)
    for name in ("created", "used", "revoked"):
        document[name] = None if document[name] is None else _time(document[name]).isoformat()
    return document | document.pop("limits")


def _time(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)


def _day(seconds: float | None) -> str:
    return "-" if seconds is None else f"{_time(seconds):%Y-%m-%d %H:%M}"


def _name(text: str) -> str:
    if not 0 < len(text) <= _MAX_NAME or not text.isprintable() or text.isspace():
        raise argparse.ArgumentTypeError(f"a name has 1 to {_MAX_NAME} printable characters")
    return text


def _rate(text: str) -> float:
    with suppress(ValueError):
        rate = float(text)
        if math.isfinite(rate) and rate >= 0.001:
            return rate
    raise argparse.ArgumentTypeError(f"{text} is not a rate; 0.001 or more is")


def _count(text: str) -> int:
    if re.fullmatch("[0-9]{1,12}", text) is None:
        raise argparse.ArgumentTypeError(f"{text} is not a bound; a whole number from 0 is")
    return int(text)


def _parser() -> Parser:
    parser = Parser(prog="dsbrdf keys", description="API keys of the service; a running server heeds a change at once.")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    add = commands.add_parser("add", help="make a key and print it, this once")
    add.set_defaults(run=_add)
    add.add_argument("name", type=_name, metavar="NAME", help="whose key it is, for the list")
    add.add_argument("--requests-per-second", type=_rate, metavar="N", help="five times as many may come at once")
    add.add_argument("--stored-mb", type=_count, metavar="N", help="most that may be stored [MB of 10^6 bytes]")
    add.add_argument("--queued-fits", type=_count, metavar="N", help="most fits that may wait or run")
    add.add_argument("--metrics", action="store_true", help="it may read GET /metrics, the totals of all keys")
    listing = commands.add_parser("list", help="print the keys, without their secrets")
    listing.set_defaults(run=_list)
    add_json_option(listing)
    revoke = commands.add_parser("revoke", help="refuse a key from now on; what is stored with it stays")
    revoke.set_defaults(run=_revoke)
    revoke.add_argument("id", metavar="ID", help="as the list shows it")
    for command in (add, listing, revoke):
        add_data_dir(command)
    return parser
