"""The service with a Dask cluster: nothing lost, and readiness that says what is missing."""

import signal
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from tests.support.dask_cluster import DaskCluster
from tests.support.processes import alive, wait_until
from tests.support.server import QUICK, Server, assert_problem

PATIENCE = 120.0
MIDDLE: dict[str, Any] = {"n_lobes": 4, "em_iterations": 100}


@pytest.fixture
def serve(own_server: Callable[..., Server]) -> Callable[[DaskCluster], Server]:
    return lambda cluster: own_server(engine="dask", scheduler=cluster.address, workers="1")


def test_killed_server_leaves_no_fit_and_resumes_it(
    serve: Callable[[DaskCluster], Server], cluster: DaskCluster, data: bytes
) -> None:
    server = serve(cluster)
    sha256 = server.http.post("/v1/measurements", content=data).json()["sha256"]
    fits = [
        server.submit(sha256, prefer="respond-async", **options).json()["id"]
        for options in (MIDDLE, QUICK)  # one that takes long enough to be interrupted, and one that waits for it
    ]
    wait_until(lambda: bool(cluster.fitting()), PATIENCE)
    victims = cluster.fitting()
    server.stop(signal.SIGKILL)
    wait_until(lambda: not any(alive(pid) for pid in victims))
    server.start()
    before = server.memory()
    for fit_id in fits:
        assert server.http.get(f"/v1/fits/{fit_id}?wait=60").json()["status"] == "succeeded"
    assert server.memory() - before < 24  # neither the file (35 MB) nor what is made of it


def test_fits_wait_for_a_cluster(own_cluster: DaskCluster, tmp_path: Path, data: bytes) -> None:
    with closing(Server(tmp_path / "data", engine="dask", scheduler=own_cluster.address, workers="1")) as server:
        server.connect(server.launch())
        detail = assert_problem(server.http.get("/health/ready"), 503, "not-ready")
        assert f"The Dask scheduler at {own_cluster.address} cannot be reached" in detail
        sha256 = server.http.post("/v1/measurements", content=data).json()["sha256"]
        fit_id = server.submit(sha256, prefer="respond-async", **QUICK).json()["id"]
        assert server.status(fit_id) == "accepted"
        own_cluster.start_scheduler()
        wait_until(lambda: "has no workers" in server.http.get("/health/ready").text, PATIENCE)
        own_cluster.add_worker()
        wait_until(lambda: server.http.get("/health/ready").status_code == 200, PATIENCE)
        assert server.http.get(f"/v1/fits/{fit_id}?wait=60").json()["status"] == "succeeded"
