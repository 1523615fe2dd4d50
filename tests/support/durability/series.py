"""The durability series: one row for each, what is asked of the service beside what makes it happen."""

import random
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from tests.support.durability import concurrency, crashes, restores
from tests.support.durability.harness import Harness


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
