"""A mixed load for a long time, and the memory, descriptors, threads and disk that the server uses meanwhile.

The samples are in out/soak.csv, the server's log in out/soak.log. Drift is the median over the last
fifth of the time against the median over the second fifth; the first fifth is warm-up. The exit code is 1 if there was
an answer of 500 or more or any other wrong one, if memory has drifted by more than 2 %, or if descriptors have not
stayed flat: their median may not grow by more than 3, and when the clients have gone there are as many as before they
came, but for 3.
"""

import argparse
import csv
import random
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import NamedTuple

from benchmarks.durability_series.harness import Harness
from benchmarks.load import CLIENT_STEPS, Client, Tally
from dsbrdf import write_merl
from dsbrdf.data import synthetic_measurement
from tests.support.server import Server

_OUT = Path("out")
_INTERVAL = 3.0  # seconds
_MAX_MEMORY_DRIFT = 0.02
_MAX_NEW_DESCRIPTORS = 3
_N_SHOWN_FAULTS = 10


class Sample(NamedTuple):
    """What the server uses at one moment; resident memory in MB, of the web process and of its helpers."""

    seconds: float
    web_mb: float
    helpers_mb: float
    descriptors: int
    threads: int
    folder_mb: float
    answers: int


def main(argv: Sequence[str]) -> int:
    """Print a table, and save the samples."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0, help="how long (default: 30)")
    parser.add_argument("--seed", type=int, default=int(time.time()), help="of the load (default: the time)")
    arguments = parser.parse_args(argv)
    with tempfile.TemporaryDirectory(prefix="dsbrdf-") as folder:
        measurement = Path(folder) / "plastic.binary"
        write_merl(measurement, synthetic_measurement(noise=0.02, seed=1))
        harness = Harness(Path(folder), measurement, random.Random(arguments.seed), own_interpreter=True)
        samples, idle, tally = soak(harness, 60.0 * arguments.minutes)
        log = (Path(folder) / "data.log").read_text()
    _OUT.mkdir(exist_ok=True)
    _write(samples, _OUT / "soak.csv")
    (_OUT / "soak.log").write_text(log)
    print(f"seed {arguments.seed}")
    return _judge(samples, idle, tally, log)


def soak(harness: Harness, seconds: float) -> tuple[list[Sample], tuple[int, int], Tally]:
    """Load a server; return the samples, the numbers of descriptors before and after, and the responses."""
    tally = Tally()
    samples: list[Sample] = []
    with harness.server(workers="2") as server:
        server.start()
        server.http.close()
        before = _sample(server, 0.0, tally).descriptors
        with _clients(harness, str(server.http.base_url), tally):
            begin = time.monotonic()
            while (now := time.monotonic() - begin) < seconds:
                samples.append(_sample(server, now, tally))
                time.sleep(_INTERVAL)
        time.sleep(5.0)  # connections close, and fits that nobody waits for end
        after = _sample(server, 0.0, tally).descriptors
        server.stop()
    return samples, (before, after), tally


@contextmanager
def _clients(harness: Harness, address: str, tally: Tally) -> Iterator[None]:
    over = threading.Event()
    with ThreadPoolExecutor(len(CLIENT_STEPS)) as pool:
        futures = []
        for number, step in enumerate(CLIENT_STEPS):
            bodies = [harness.variant(2 * number + i) for i in range(2)]
            client = Client(address, bodies, tally, harness.random.getrandbits(32))
            futures.append(pool.submit(client.run, step, over))
        try:
            yield
        finally:
            over.set()
    for future in futures:
        future.result()


def _sample(server: Server, seconds: float, tally: Tally) -> Sample:
    pid = server.process.pid
    status = _status(pid)
    return Sample(
        round(seconds, 1),
        status["VmRSS"] / 1024,
        sum(_status(helper)["VmRSS"] for helper in server.helpers()) / 1024,
        sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir()),
        status["Threads"],
        sum(path.stat().st_size for path in server.data_dir.rglob("*") if path.is_file()) / 2**20,
        sum(tally.answers.values()),
    )


def _status(pid: int) -> dict[str, int]:
    """Return the numbers in the status of a process, memory in kB."""
    lines = (line.partition(":") for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    return {name: int(value.split()[0]) for name, _, value in lines if value.split()[:1] and value.split()[0].isdigit()}


def _judge(samples: Sequence[Sample], idle: tuple[int, int], tally: Tally, log: str) -> int:
    """Print the table; return 1 if a target is not reached."""
    fifth = len(samples) // 5
    early, late = (
        [median(column) for column in zip(*part, strict=True)]
        for part in (samples[fifth : 2 * fifth], samples[-fifth:])
    )
    peak = [max(column) for column in zip(*samples, strict=True)]
    print("| | second fifth | last fifth | drift | highest |\n|---|---|---|---|---|")
    for name, then, now, most in zip(Sample._fields, early, late, peak, strict=True):
        if name not in ("seconds", "answers"):
            print(f"| {name} | {then:.1f} | {now:.1f} | {100 * (now / then - 1):+.1f} % | {most:.1f} |")
    statuses = Counter[int]()
    for (_, _, status), count in tally.answers.items():
        statuses[status] += count
    minutes = samples[-1].seconds / 60
    print(f"{sum(statuses.values())} answers in {minutes:.1f} minutes: {dict(sorted(statuses.items()))}")
    print(f"descriptors without clients: {idle[0]} before, {idle[1]} after")
    print(f"stack traces in the log: {log.count('Traceback')}")
    names = Sample._fields
    web, descriptors = names.index("web_mb"), names.index("descriptors")
    misses = tally.faults[:_N_SHOWN_FAULTS]
    if tally.server_errors():
        misses.append(f"{tally.server_errors()} answers of 500 or more")
    if late[web] > (1 + _MAX_MEMORY_DRIFT) * early[web]:
        misses.append("the memory of the web process has drifted")
    if late[descriptors] > early[descriptors] + _MAX_NEW_DESCRIPTORS or idle[1] > idle[0] + _MAX_NEW_DESCRIPTORS:
        misses.append("descriptors are not flat")
    for miss in misses:
        print(f"missed: {miss}", file=sys.stderr)
    return 1 if misses else 0


def _write(samples: Sequence[Sample], path: Path) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(Sample._fields)
        writer.writerows(samples)
