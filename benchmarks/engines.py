"""Fits per second with one and two workers, on this machine and on a Dask cluster; and a cluster that is broken.

Every fit is the default one of the same measurement, over HTTP with a mask so small that it masks nothing; the rate
is that of so many fits begun at once, after two to warm up. Two workers need two idle cores. The cluster is started
as docs/cluster.md says, and gets one fit more than it has workers. With --breaks, a service whose
cluster loses workers and schedulers while it computes: every fit has to succeed. The exit code is 1 if a row
is missed.
"""

import argparse
import os
import random
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from contextlib import closing, contextmanager
from pathlib import Path

import httpx

from dsbrdf import FitOptions, write_merl
from dsbrdf.data import synthetic_measurement
from dsbrdf.engines import DaskEngine, Engine, Fault, FitTask, LocalEngine
from tests.support.dask_cluster import DaskCluster
from tests.support.processes import wait_until
from tests.support.server import Server

ASKED = 1.8
PATIENCE = 600.0
_HARMLESS = 1e-6  # times a number: a mask that makes another fit and masks nothing
AHEAD = 1  # so many fits more than workers are sent to a cluster, so that no worker waits
CALM = {
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "500ms",
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "false",
}
"""Environment of scheduler and workers that docs/cluster.md recommends."""
FOUR_LOBE_FIT = {"method": "paper", "n_lobes": 4}
"""Options of the fits during kills: about a second each, and a kill every few seconds."""


@contextmanager
def cluster(folder: Path, workers: int) -> Iterator[DaskCluster]:
    """Run a cluster with workers of one thread each, ready to compute."""
    running = DaskCluster(folder / "cluster", **CALM)
    try:
        running.start_scheduler()
        for _ in range(workers):
            running.add_worker()
        wait_until(lambda: running.log().count("Registered to:") >= workers, PATIENCE)
        yield running
    finally:
        running.close()


def rate_of(engine: Engine, file: Path, count: int) -> float:
    """Return the fits per second of an engine."""

    def fit(times: int) -> None:
        fits = [engine.submit(FitTask(str(number), file, FitOptions()), lambda _: None) for number in range(times)]
        for outcome in (future.result() for future in as_completed(fits)):
            if isinstance(outcome, Fault):
                raise RuntimeError(outcome.message)  # noqa: TRY004 (an outcome, not an argument)

    with closing(engine):
        fit(2)
        begin = time.perf_counter()
        fit(count)
        return count / (time.perf_counter() - begin)


def rate_over_http(folder: Path, file: Path, count: int, **settings: str) -> float:
    """Return the fits per second of a service, from the first request to the last response."""
    server = Server(folder / "data", **settings)
    try:
        server.start()
        sha256 = server.http.post("/v1/measurements", content=file.read_bytes()).json()["sha256"]
        for number in (98, 99):
            _submit(server, sha256, mask=_HARMLESS * number)
        wait_until(lambda: _unfinished(server) == 0, PATIENCE)
        begin = time.perf_counter()
        asked = [_submit(server, sha256, mask=_HARMLESS * (100 + number)) for number in range(count)]
        for fit_id in asked:  # a wait costs the cores nothing, asking again and again would
            server.http.get(f"/v1/fits/{fit_id}", params={"wait": PATIENCE / 2}, timeout=PATIENCE)
        seconds = time.perf_counter() - begin
        if _states(server) != {"succeeded"}:
            raise RuntimeError(f"fits have ended as {_states(server)}")
        return count / seconds
    finally:
        server.close()


def rates(file: Path, count: int) -> bool:
    """Print a row for each engine; return whether all reach their targets."""
    print(f"{count} default fits; {os.cpu_count()} cores\n")
    print(f"| {'':24} | 1 worker [fits/s] | 2 workers | factor | asked |\n|---|---|---|---|---|")
    good = True
    for label, measure in _WAYS.items():
        one, two = (_in_folder(measure, workers, file, count) for workers in (1, 2))
        good &= two / one >= ASKED
        print(f"| {label:24} | {one:.3f} | {two:.3f} | {two / one:.2f} | >= {ASKED} |", flush=True)
    return good


def _in_folder(measure: Callable[[Path, int, Path, int], float], workers: int, file: Path, count: int) -> float:
    with tempfile.TemporaryDirectory(prefix="dsbrdf-") as folder:
        return measure(Path(folder), workers, file, count)


def _local(_: Path, workers: int, file: Path, count: int) -> float:
    return rate_of(LocalEngine(workers), file, count)


def _local_over_http(folder: Path, workers: int, file: Path, count: int) -> float:
    return rate_over_http(folder, file, count, workers=str(workers))


def _dask(folder: Path, workers: int, file: Path, count: int) -> float:
    with cluster(folder, workers) as running:
        return rate_of(DaskEngine(running.address, workers + AHEAD), file, count)


def _dask_over_http(folder: Path, workers: int, file: Path, count: int) -> float:
    with cluster(folder, workers) as running:
        sent = str(workers + AHEAD)
        return rate_over_http(folder, file, count, engine="dask", scheduler=running.address, workers=sent)


_WAYS = {
    "local engine": _local,
    "local, over HTTP": _local_over_http,
    "Dask engine": _dask,
    "Dask, over HTTP": _dask_over_http,
}


def breaks(file: Path, workers: int, schedulers: int, seed: int) -> bool:
    """Kill workers and schedulers while a service computes; print a row for each, return whether nothing was lost."""
    print("| killed | times | fits | lost | seconds |\n|---|---|---|---|---|")
    good = True
    for label, times, kill in (("worker", workers, _kill_worker), ("scheduler", schedulers, _kill_scheduler)):
        begin = time.perf_counter()
        with tempfile.TemporaryDirectory(prefix="dsbrdf-") as folder, cluster(Path(folder), 2) as running:
            fits, lost = _break(Path(folder), running, file, times, kill, random.Random(seed))
        good &= lost == 0
        print(f"| {label} | {times} | {fits} | {lost} | {time.perf_counter() - begin:.0f} |", flush=True)
    return good


def _break(
    folder: Path,
    running: DaskCluster,
    file: Path,
    times: int,
    kill: Callable[[DaskCluster, random.Random], None],
    moments: random.Random,
) -> tuple[int, int]:
    """Return the number of requested fits, and of those that have not succeeded."""
    server = Server(folder / "data", engine="dask", scheduler=running.address, workers="1")
    try:
        server.start()
        sha256 = server.http.post("/v1/measurements", content=file.read_bytes()).json()["sha256"]
        asked = 0
        for _ in range(times):
            while _unfinished(server) < 4:
                _submit(server, sha256, **FOUR_LOBE_FIT, em_iterations=100 + asked)
                asked += 1
            wait_until(lambda: bool(running.fitting()), PATIENCE)
            time.sleep(moments.uniform(0.0, 1.0))
            kill(running, moments)
        deadline = time.monotonic() + PATIENCE
        while _unfinished(server) and time.monotonic() < deadline:
            time.sleep(0.1)
        return asked, asked - sum(fit["status"] == "succeeded" for fit in _fits(server))
    finally:
        server.close()


def _kill_worker(running: DaskCluster, moments: random.Random) -> None:
    running.kill_worker(moments.choice(running.workers))
    running.add_worker()


def _kill_scheduler(running: DaskCluster, _: random.Random) -> None:
    running.kill_scheduler()
    for worker in list(running.workers):
        worker.wait(PATIENCE)  # Dask's workers end when their scheduler is lost
        running.workers.remove(worker)
    running.start_scheduler()
    for _worker in range(2):
        running.add_worker()


def _submit(server: Server, sha256: str, **options: object) -> str:
    answer = server.http.post(
        "/v1/fits", json={"measurement": sha256, "options": options}, headers={"Prefer": "respond-async"}
    )
    return str(answer.raise_for_status().json()["id"])


def _fits(server: Server) -> list[dict[str, object]]:
    found: list[dict[str, object]] = []
    url: httpx.URL | str | None = "/v1/fits?limit=100"
    while url is not None:
        answer = server.http.get(url).raise_for_status()
        found += answer.json()["items"]
        url = answer.links.get("next", {}).get("url")
    return found


def _states(server: Server) -> set[object]:
    return {fit["status"] for fit in _fits(server)}


def _unfinished(server: Server) -> int:
    return sum(fit["status"] in ("accepted", "running") for fit in _fits(server))


def main(argv: Sequence[str]) -> int:
    """Print one table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks engines", description=__doc__)
    parser.add_argument("--fits", type=int, default=24, metavar="N", help="fits for each rate, even (default: 24)")
    parser.add_argument("--breaks", action="store_true", help="break a cluster instead")
    parser.add_argument("--workers", type=int, default=20, metavar="N", help="workers to kill (default: 20)")
    parser.add_argument("--schedulers", type=int, default=10, metavar="N", help="schedulers to kill (default: 10)")
    parser.add_argument("--seed", type=int, default=0, help="of the moments (default: 0)")
    arguments = parser.parse_args(argv)
    with tempfile.TemporaryDirectory(prefix="dsbrdf-") as folder:
        file = Path(folder) / "paint.binary"
        write_merl(file, synthetic_measurement(roughness=0.06, noise=0.02))
        if arguments.breaks:
            return int(not breaks(file, arguments.workers, arguments.schedulers, arguments.seed))
        return int(not rates(file, arguments.fits))
