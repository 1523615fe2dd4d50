"""Fits per second with one and two workers, on this machine and on a Dask cluster; and a cluster that is broken.

Every fit is the default one of the same measurement, over HTTP with a mask so small that it masks nothing; the rate
is that of so many fits begun at once, after two to warm up. Two workers need two idle cores. The cluster is started
as docs/cluster.md says, and gets one fit more than it has workers. ``--only workers schedulers`` kills those of a
service's cluster while it computes, so many times: every fit has to succeed.
"""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path

from benchmarks.server.runner import Place, Row, Scenario, query_database, unfinished
from benchmarks.server.runner import main as run_scenarios
from dsbrdf import FitOptions
from dsbrdf.engines import DaskEngine, Engine, Fault, FitTask, LocalEngine
from tests.support.dask_cluster import DaskCluster
from tests.support.processes import wait_until
from tests.support.server import Server

MIN_SPEEDUP = 1.8
PATIENCE_S = 600.0
N_FITS_AHEAD = 1  # A cluster gets more fits than it has workers, so that no worker waits.
_HARMLESS = 1e-6  # times a number: a mask that makes another fit and masks nothing
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
        wait_until(lambda: running.log().count("Registered to:") >= workers, PATIENCE_S)
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


def rate_over_http(place: Place, folder: Path, **settings: str) -> float:
    """Return the fits per second of a service, from the first request to the last response."""
    with place.server(folder, **settings) as server:
        server.start()
        sha256 = server.http.post("/v1/measurements", content=place.measurement.read_bytes()).json()["sha256"]
        for number in (98, 99):
            _submit(server, sha256, mask=_HARMLESS * number)
        wait_until(lambda: unfinished(server) == 0, PATIENCE_S)
        begin = time.perf_counter()
        asked = [_submit(server, sha256, mask=_HARMLESS * (100 + number)) for number in range(place.times)]
        for fit_id in asked:  # a wait costs the cores nothing, asking again and again would
            server.http.get(f"/v1/fits/{fit_id}", params={"wait": PATIENCE_S / 2}, timeout=PATIENCE_S)
        seconds = time.perf_counter() - begin
        place.expect(_states(server) == {"succeeded"}, f"fits have ended as {_states(server)}")
        return place.times / seconds


def speedup(measure: Callable[[Place, Path, int], float], place: Place) -> list[Row]:
    """Compare the rates of one and of two workers."""
    folders = [place.folder / name for name in ("one", "two")]
    for folder in folders:
        folder.mkdir()
    one, two = (measure(place, folder, workers) for workers, folder in enumerate(folders, 1))
    asked = f"{place.times} default fits on {os.cpu_count()} cores, two workers: >= {MIN_SPEEDUP} times the rate of one"
    return [Row(asked, f"{one:.3f} and {two:.3f} fits/s: {two / one:.2f}", two / one >= MIN_SPEEDUP)]


def _local(place: Place, _: Path, workers: int) -> float:
    return rate_of(LocalEngine(workers), place.measurement, place.times)


def _local_over_http(place: Place, folder: Path, workers: int) -> float:
    return rate_over_http(place, folder, workers=str(workers))


def _dask(place: Place, folder: Path, workers: int) -> float:
    with cluster(folder, workers) as running:
        return rate_of(DaskEngine(running.address, workers + N_FITS_AHEAD), place.measurement, place.times)


def _dask_over_http(place: Place, folder: Path, workers: int) -> float:
    with cluster(folder, workers) as running:
        sent = str(workers + N_FITS_AHEAD)
        return rate_over_http(place, folder, engine="dask", scheduler=running.address, workers=sent)


def killed(kill: Callable[[DaskCluster, Place], None], place: Place) -> list[Row]:
    """Kill workers or schedulers while a service computes: every requested fit has to succeed."""
    with (
        cluster(place.folder, 2) as running,
        place.server(engine="dask", scheduler=running.address, workers="1") as server,
    ):
        server.start()
        sha256 = server.http.post("/v1/measurements", content=place.measurement.read_bytes()).json()["sha256"]
        asked = 0
        for _ in range(place.times):
            while unfinished(server) < 4:
                _submit(server, sha256, **FOUR_LOBE_FIT, em_iterations=100 + asked)
                asked += 1
            wait_until(lambda: bool(running.fitting()), PATIENCE_S)
            time.sleep(place.random.uniform(0.0, 1.0))
            kill(running, place)
        place.expect_soon(lambda: unfinished(server) == 0, PATIENCE_S, "fits did not come to their end")
        place.expect(_states(server) == {"succeeded"}, f"fits have ended as {_states(server)}")
    return place.row(f"killed {place.times} times: no fit lost", f"{asked} fits")


def _kill_worker(running: DaskCluster, place: Place) -> None:
    running.kill_worker(place.random.choice(running.workers))
    running.add_worker()


def _kill_scheduler(running: DaskCluster, _: Place) -> None:
    running.kill_scheduler()
    for worker in list(running.workers):
        worker.wait(PATIENCE_S)  # Dask's workers end when their scheduler is lost
        running.workers.remove(worker)
    running.start_scheduler()
    for _worker in range(2):
        running.add_worker()


def _submit(server: Server, sha256: str, **options: object) -> str:
    return str(
        server.submit(sha256, "respond-async", **{"method": "global", **options}).raise_for_status().json()["id"]
    )


def _states(server: Server) -> set[str]:
    return {status for (status,) in query_database(server, "SELECT DISTINCT status FROM fits")}


SCENARIOS = {
    "local": Scenario(partial(speedup, _local), 24),
    "local-http": Scenario(partial(speedup, _local_over_http), 24),
    "dask": Scenario(partial(speedup, _dask), 24),
    "dask-http": Scenario(partial(speedup, _dask_over_http), 24),
    "workers": Scenario(partial(killed, _kill_worker), 20, by_name_only=True),
    "schedulers": Scenario(partial(killed, _kill_scheduler), 10, by_name_only=True),
}


def main(argv: Sequence[str]) -> int:
    """Print one table."""
    return run_scenarios("engines", __doc__, SCENARIOS, argv)
