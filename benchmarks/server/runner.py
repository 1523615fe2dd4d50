"""Runs scenarios: each starts servers in a folder of its own, loads them, and returns rows of one table.

A server is a process that is observed from outside: its answers, its database, its files, and the processes that the
operating system shows. Random moments come from a generator whose seed is printed. A scenario that breaks off misses.
"""

import argparse
import json
import random
import sqlite3
import struct
import sys
import tempfile
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

import dsbrdf
from dsbrdf.data import synthetic_measurement
from dsbrdf.output import from_json
from dsbrdf_service.wire import from_wire
from tests.support.server import Server

MAX_SHOWN_FAULTS = 10
_MODEL_ARRAYS = ("theta_diff", "kappa", "gamma", "center", "delta")


class Row(NamedTuple):
    """One line of the table: the target, the measured value, and whether it reaches the target."""

    asked: str
    measured: str
    holds: bool


@dataclass
class Place:
    """The surroundings of a scenario: a folder with a short path, a MERL file, a seeded generator, and faults.

    `amount` says how often or how long the scenario repeats its event. With an interpreter of their own, servers are
    started as users start them, and not as forks, which start sooner.
    """

    folder: Path
    measurement: Path
    random: random.Random
    amount: float
    own_interpreter: bool = False
    faults: list[str] = field(default_factory=list)

    @property
    def times(self) -> int:
        """Number of repeats."""
        return int(self.amount)

    def expect(self, holds: bool, fault: str) -> None:
        """Record a fault unless a condition is true."""
        if not holds:
            self.faults.append(fault)

    def expect_soon(self, condition: Callable[[], bool], seconds: float, fault: str) -> None:
        """Record a fault unless a condition becomes true in time."""
        self.expect(becomes_true(condition, seconds), fault)

    def row(self, asked: str, measured: str) -> list[Row]:
        """Return the one row of a scenario that misses if there is a fault."""
        return [Row(asked, f"{measured}: {len(self.faults)} faults", not self.faults)]

    @contextmanager
    def server(self, folder: Path | None = None, **settings: str) -> Iterator[Server]:
        """Yield a server that is not started yet, with a folder of its own for temporary files."""
        temporary = self.folder / "temporary"
        temporary.mkdir(exist_ok=True)
        server = Server((folder or self.folder) / "data", **settings)
        server.own_interpreter = self.own_interpreter
        server.environment["TMPDIR"] = str(temporary)
        try:
            yield server
        finally:
            server.close()

    def variant(self, number: int) -> bytes:
        """Return the measurement with another digest: its last node, below the horizon, is not used by a fit."""
        return self.measurement.read_bytes()[:-8] + struct.pack("<d", -2.0 - number)

    def models(self, *choices: dict[str, Any]) -> list[dsbrdf.DSBRDF]:
        """Return the models that the library fits to the measurement, with options in their HTTP form."""
        return [_fitted(self.measurement, json.dumps(options)) for options in choices]


class Scenario(NamedTuple):
    """A function that returns rows, and how often or how long it repeats its event by default.

    What takes long or breaks things is run by name only.
    """

    run: Callable[[Place], list[Row]]
    amount: float = 1
    by_name_only: bool = False


@cache
def _fitted(measurement: Path, options: str) -> dsbrdf.DSBRDF:
    """Fit a model that several scenarios compare with, in one thread as the service does: more give other last bits."""
    with threadpool_limits(1), warnings.catch_warnings(action="ignore", category=dsbrdf.ConvergenceWarning):
        return dsbrdf.fit(dsbrdf.read_merl(measurement), from_wire(json.loads(options))).model


def run(scenario: Scenario, amount: float, seed: int, file: Path, *, own_interpreter: bool = False) -> list[Row]:
    """Run a scenario in a new folder; print its faults and return its rows."""
    # A short path: the names of sockets have to fit into a hundred characters.
    with tempfile.TemporaryDirectory(prefix="dsbrdf-") as folder:
        place = Place(Path(folder), file, random.Random(seed), amount, own_interpreter)
        try:
            rows = scenario.run(place)
        except Exception:
            place.faults.append(traceback.format_exc())
            rows = place.row("", "broken off")
    for fault in place.faults[:MAX_SHOWN_FAULTS]:
        print(f"  {fault}", file=sys.stderr, flush=True)
    return rows


def main(
    name: str,
    description: str | None,
    scenarios: Mapping[str, Scenario],
    argv: Sequence[str],
    *,
    unit: str = "times",
    own_interpreter: bool = False,
) -> int:
    """Run the scenarios of a benchmark and print the table; return 1 if a row is missed."""
    parser = argparse.ArgumentParser(prog=f"python -m benchmarks {name}", description=description)
    parser.add_argument("--only", nargs="+", choices=scenarios, metavar="NAME", help=f"some of: {', '.join(scenarios)}")
    parser.add_argument(f"--{unit}", type=float, dest="amount", metavar="N", help=f"{unit} of each, instead of its own")
    parser.add_argument("--seed", type=int, default=int(time.time()), help="of random moments (default: the time)")
    parser.add_argument("--file", type=Path, metavar="MERL", help="a measurement, instead of a generated one")
    arguments = parser.parse_args(argv)
    chosen = arguments.only or [name for name, one in scenarios.items() if not one.by_name_only]
    missed = False
    with tempfile.TemporaryDirectory(prefix="dsbrdf-") as folder:
        file = arguments.file or Path(folder) / "plastic.binary"
        if arguments.file is None:
            dsbrdf.write_merl(file, synthetic_measurement(noise=0.02, seed=1))
        print(f"seed {arguments.seed}\n| | asked | measured | seconds | |\n|---|---|---|---|---|", flush=True)
        for name in chosen:
            begin = time.monotonic()
            amount = arguments.amount or scenarios[name].amount
            rows = run(scenarios[name], amount, arguments.seed, file, own_interpreter=own_interpreter)
            seconds = f"{time.monotonic() - begin:.0f}"
            for asked, measured, holds in rows:
                verdict = "ok" if holds else "missed"
                print(f"| {name} | {asked} | {measured} | {seconds} | {verdict} |", flush=True)
                missed |= not holds
    return int(missed)


def becomes_true(condition: Callable[[], bool], seconds: float) -> bool:
    """Return whether a condition becomes true in time."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True


def same_bits(document: str, model: dsbrdf.DSBRDF) -> bool:
    """Return whether an exported model equals another one, bit for bit."""
    exported, _ = from_json(document)
    return all(np.array_equal(getattr(exported, name), getattr(model, name)) for name in _MODEL_ARRAYS)


def query_database(server: Server, query: str) -> list[tuple[Any, ...]]:
    """Query the database of a server directly."""
    connection = sqlite3.connect(f"file:{server.data_dir / 'dsbrdf.sqlite'}?mode=ro", uri=True, timeout=30)
    try:
        return connection.execute(query).fetchall()
    finally:
        connection.close()


def unfinished(server: Server) -> int:
    """Return how many fits wait or run."""
    ((count,),) = query_database(server, "SELECT count(*) FROM fits WHERE status IN ('accepted', 'running')")
    return int(count)


def leftovers(server: Server) -> list[str]:
    """Return temporary files of earlier processes, and files of measurements without a row."""
    known = {f"{sha256}.binary" for (sha256,) in query_database(server, "SELECT DISTINCT sha256 FROM measurements")}
    stray = [path for path in (server.data_dir / "blobs").rglob("*") if path.is_file() and path.name not in known]
    return [*temporary_files(server), *map(str, stray)]


def temporary_files(server: Server) -> list[str]:
    """Return temporary files of earlier processes."""
    stray = [*(server.data_dir / "tmp").iterdir(), *Path(server.environment["TMPDIR"]).iterdir()]
    # The sockets of the process that runs are in one folder; more than that is an earlier one's.
    stray += sorted((server.data_dir / "run").iterdir())[1:]
    return [str(path) for path in stray]


@contextmanager
def counted_workers(server: Server) -> Iterator[set[tuple[int, str]]]:
    """Collect the processes that compute fits, named by id and time of start, as the operating system shows them."""
    seen: set[tuple[int, str]] = set()
    over = threading.Event()

    def watch() -> None:
        while not over.wait(0.02):
            for pid in server.workers():
                try:
                    named = pid, Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[19]
                except OSError:
                    continue
                seen.add(named)

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield seen
    finally:
        over.set()
        thread.join()
