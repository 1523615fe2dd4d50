"""The service with a Dask cluster: nothing lost, and readiness that says what is missing."""

import signal
from collections.abc import Callable
from typing import Any

import pytest

from tests.support.dask_cluster import DaskCluster
from tests.support.processes import alive, wait_until
from tests.support.server import QUICK, Server

PATIENCE = 120.0
MIDDLE: dict[str, Any] = {"n_lobes": 4, "em_iterations": 100}


@pytest.fixture
def serve(own_server: Callable[..., Server]) -> Callable[[DaskCluster], Server]:
    return lambda cluster: own_server(engine="dask", scheduler=cluster.address, workers="1")


@pytest.mark.soak
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
