"""What the durability series share: a folder and a server, and what can be observed of it from outside."""

import json
import os
import random
import sqlite3
import struct
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import dsbrdf
from dsbrdf import read_merl
from dsbrdf.output import from_json
from dsbrdf_service.wire import from_wire
from tests.support.processes import ONE_CORE
from tests.support.server import Server

_ARRAYS = ("theta_diff", "kappa", "gamma", "center", "delta")


@dataclass
class Harness:
    """The surroundings of one series: a folder with a short path, a MERL file, a seeded generator, and faults.

    With an interpreter of their own, servers are started as users start them, and not as forks, which start sooner.
    """

    folder: Path
    measurement: Path
    random: random.Random
    faults: list[str] = field(default_factory=list)
    own_interpreter: bool = False

    def expect(self, holds: bool, fault: str) -> None:
        """Record a fault unless a condition is true."""
        if not holds:
            self.faults.append(fault)

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
        return list(_models(self.measurement, json.dumps(choices)))


@cache
def _models(measurement: Path, choices: str) -> tuple[dsbrdf.DSBRDF, ...]:
    """Return models that several series ask for, fitted once."""
    options = json.loads(choices)
    return tuple(_fitting_process().map(_model, [measurement] * len(options), options))


@cache
def _fitting_process() -> ProcessPoolExecutor:
    """Return the one process that fits for all series."""
    os.environ.update(ONE_CORE)  # for the process that is still to be started: more threads give other last bits
    return ProcessPoolExecutor(1, mp_context=get_context("spawn"))


def end_fitting_process() -> None:
    """End the process that fits for the series; it ends with this one, too."""
    _fitting_process().shutdown()
    _fitting_process.cache_clear()


def _model(measurement: Path, options: dict[str, Any]) -> dsbrdf.DSBRDF:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", dsbrdf.ConvergenceWarning)
        return dsbrdf.fit(read_merl(measurement), from_wire(options)).model


def same_bits(document: str, model: dsbrdf.DSBRDF) -> bool:
    """Return whether an exported model equals another one, bit for bit."""
    exported, _ = from_json(document)
    return all(np.array_equal(getattr(exported, name), getattr(model, name)) for name in _ARRAYS)


def query_database(server: Server, query: str) -> list[tuple[Any, ...]]:
    """Query the database of a server directly."""
    connection = sqlite3.connect(f"file:{server.data_dir / 'dsbrdf.sqlite'}?mode=ro", uri=True, timeout=30)
    try:
        return connection.execute(query).fetchall()
    finally:
        connection.close()


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


def becomes_true(condition: Callable[[], bool], seconds: float) -> bool:
    """Return whether a condition becomes true in time."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True


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
