"""A mixed load for a long time, and the memory, descriptors, threads and disk that the server uses meanwhile.

The samples are in out/soak.csv, the server's log in out/soak.log. Drift is the median over the last fifth of the time
against the median over the second fifth; the first fifth is warm-up. A row is missed if a response is wrong, if memory
has drifted by more than 2 %, or if descriptors have not stayed flat: their median may not grow by more than 3, and when
the clients have gone there are as many as before they came, but for 3.
"""

import csv
import shutil
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import NamedTuple

from benchmarks.server.clients import StatefulClient, running_clients
from benchmarks.server.runner import Place, Row, Scenario
from benchmarks.server.runner import main as run_scenarios
from tests.support.server import Server

N_CLIENTS = 8
OUT = Path("out")
INTERVAL_S = 3.0
MAX_MEMORY_DRIFT = 0.02
MAX_NEW_DESCRIPTORS = 3


class Sample(NamedTuple):
    """What the server uses at one moment; resident memory in MB, of the web process and of its helpers."""

    seconds: float
    web_mb: float
    helpers_mb: float
    descriptors: int
    threads: int
    folder_mb: float


def soak(place: Place) -> list[Row]:
    """Load a server, save the samples, and compare the end with the beginning."""
    clients = [StatefulClient(number, place) for number in range(N_CLIENTS)]
    samples: list[Sample] = []
    with place.server(workers="2") as server:
        server.start()
        server.http.close()
        before, begin = _sample(server, 0.0).descriptors, time.monotonic()
        with running_clients(clients, str(server.http.base_url)):
            while (now := time.monotonic() - begin) < 60.0 * place.amount:
                samples.append(_sample(server, now))
                time.sleep(INTERVAL_S)
        time.sleep(5.0)  # connections close, and fits that nobody waits for end
        after = _sample(server, 0.0).descriptors
        server.stop()
    OUT.mkdir(exist_ok=True)
    shutil.copy(server.log, OUT / "soak.log")
    with (OUT / "soak.csv").open("w", newline="") as file:
        csv.writer(file).writerows([Sample._fields, *samples])
    answers = sum((client.answers for client in clients), Counter[int]())
    n_traces = server.log.read_text().count("Traceback")
    responses = f"{answers.total()} responses, {dict(sorted(answers.items()))}, {n_traces} stack traces"
    asked = f"{N_CLIENTS} clients for {place.amount:g} minutes: no wrong response"
    return [*place.row(asked, responses), *_drifts(samples, before, after)]


def _drifts(samples: Sequence[Sample], before: int, after: int) -> list[Row]:
    fifth = max(len(samples) // 5, 1)
    early, late = (
        Sample(*(median(column) for column in zip(*part, strict=True)))
        for part in (samples[fifth : 2 * fifth], samples[-fifth:])
    )
    rows = []
    for name in Sample._fields[1:]:
        then, now, most = getattr(early, name), getattr(late, name), max(getattr(sample, name) for sample in samples)
        measured = f"{then:.1f}, {now:.1f} ({100 * (now / then - 1):+.1f} %), highest {most:.1f}"
        asked, holds = f"{name}: second fifth, last fifth", True
        if name == "web_mb":
            asked, holds = f"{asked}: at most 2 % more", now <= (1 + MAX_MEMORY_DRIFT) * then
        elif name == "descriptors":
            asked, measured = f"{asked}: at most 3 more", f"{measured}; without clients {before} before, {after} after"
            holds = max(now - then, after - before) <= MAX_NEW_DESCRIPTORS
        rows.append(Row(asked, measured, holds))
    return rows


def _sample(server: Server, seconds: float) -> Sample:
    pid = server.process.pid
    status = _status(pid)
    return Sample(
        round(seconds, 1),
        status["VmRSS"] / 1024,
        sum(_status(helper)["VmRSS"] for helper in server.helpers()) / 1024,
        sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir()),
        status["Threads"],
        sum(path.stat().st_size for path in server.data_dir.rglob("*") if path.is_file()) / 2**20,
    )


def _status(pid: int) -> dict[str, int]:
    """Return the numbers in the status of a process, memory in kB."""
    lines = (line.partition(":") for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    return {name: int(value.split()[0]) for name, _, value in lines if value.split()[:1] and value.split()[0].isdigit()}


def main(argv: Sequence[str]) -> int:
    """Print the table."""
    scenarios = {"soak": Scenario(soak, 30.0)}
    return run_scenarios("soak", __doc__, scenarios, argv, unit="minutes", own_interpreter=True)
