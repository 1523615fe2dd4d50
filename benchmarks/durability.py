"""What the service does under kills, many clients and a full disk: one row a series, with its target and its result.

Every series has a real server to itself, in a process of its own, and looks at it from outside: its answers, its
database, its files, and the processes that the operating system shows. Random moments come from a generator whose
seed is printed. The exit code is 1 if a row is missed.
"""

import argparse
import random
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks.durability_series import concurrency, crashes, restores
from benchmarks.durability_series.harness import Harness
from dsbrdf import write_merl
from dsbrdf.data import synthetic_measurement

_SHOWN = 10  # faults of a series


class Series(NamedTuple):
    """A row: how often its event happens, what is asked of the service then, and what makes it happen."""

    times: int
    asked: str
    run: Callable[[Harness, int], str]


SERIES = {
    "queue": Series(500, "500 queued fits: 0 lost, 0 computed twice", concurrency.queued),
    "server-kill": Series(
        50, "kill -9 of the server: 0 accepted fits lost, 0 orphans, 0 temporary files", crashes.server_killed
    ),
    "child-kill": Series(100, "kill -9 of a child: only that fit affected, typed error", crashes.child_killed),
    "memory": Series(20, "out of memory: only that fit affected, typed error", crashes.out_of_memory),
    "terminate": Series(20, "SIGTERM: out within 10 s, fits resume", crashes.terminated),
    "uploads": Series(32, "32 uploads, a third vanish: nothing left behind", concurrency.uploads),
    "same-file": Series(50, "50 clients with one file: one blob, one fit", concurrency.same_file),
    "restores": Series(
        200,
        "an older or damaged database, damaged files: no file gone, no wrong byte, one sentence or a working service",
        restores.restored,
    ),
    "disk": Series(5, "disk full: 507, nothing lost, recovers", concurrency.full_disk),
}


def run(name: str, times: int, seed: int, measurement: Path) -> tuple[str, list[str]]:
    """Run one series; return what was measured, and its faults."""
    # A short path: the names of sockets have to fit into a hundred characters.
    with tempfile.TemporaryDirectory(prefix="dsbrdf-") as folder:
        harness = Harness(Path(folder), measurement, random.Random(seed))
        try:
            measured = SERIES[name].run(harness, times)
        except Exception:
            harness.faults.append(traceback.format_exc())
            measured = "broken off"
    return measured, harness.faults


def main(argv: Sequence[str]) -> int:
    """Print a table with a row for each series."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks durability", description=__doc__)
    parser.add_argument("--only", choices=SERIES, metavar="NAME", help=f"one series of: {', '.join(SERIES)}")
    parser.add_argument("--times", type=int, metavar="N", help="how often, instead of what is asked")
    parser.add_argument("--seed", type=int, default=int(time.time()), help="of the random moments (default: the time)")
    arguments = parser.parse_args(argv)
    missed = 0
    with tempfile.TemporaryDirectory() as folder:
        measurement = Path(folder) / "plastic.binary"
        write_merl(measurement, synthetic_measurement(noise=0.02, seed=1))
        print(f"seed {arguments.seed}\n| series | asked | measured | seconds | |\n|---|---|---|---|---|", flush=True)
        for name in [arguments.only] if arguments.only else SERIES:
            begin = time.monotonic()
            measured, faults = run(name, arguments.times or SERIES[name].times, arguments.seed, measurement)
            seconds = f"{time.monotonic() - begin:.0f}"
            verdict = "missed" if faults else "ok"
            print(f"| {name} | {SERIES[name].asked} | {measured} | {seconds} | {verdict} |", flush=True)
            for fault in faults[:_SHOWN]:
                print(f"  {name}: {fault}", file=sys.stderr, flush=True)
            missed += bool(faults)
    return 1 if missed else 0
