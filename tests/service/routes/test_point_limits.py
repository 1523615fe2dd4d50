"""How many points one request may have: as many as is said, and not one more."""

import io
import json
from collections.abc import Callable

import httpx
import numpy as np

from tests.support.points import npy
from tests.support.server import QUICK, Server, assert_problem

NPY = "application/x-npy"


def npy_batch(server: Server, fit: str, count: int) -> httpx.Response:
    headers = {"Content-Type": NPY, "Accept": NPY}
    return server.http.post(f"/v1/fits/{fit}/brdf", content=npy(np.zeros((count, 3))), headers=headers)


def json_batch(server: Server, fit: str, count: int) -> httpx.Response:
    document = {"theta_half_deg": [10] * count, "theta_diff_deg": [20] * count, "phi_diff_deg": [30] * count}
    return server.http.post(f"/v1/fits/{fit}/brdf", json=document)


def test_batch_has_the_points_that_the_setting_allows(own_server: Callable[..., Server], data: bytes) -> None:
    server = own_server(max_points="100")
    fit = server.http.post("/v1/fits", params=QUICK, content=data).json()["id"]
    for batch in (npy_batch, json_batch):
        assert batch(server, fit, 100).status_code == 200
        assert_problem(batch(server, fit, 101), 413, "too-large")


def test_json_batch_has_a_hundred_thousand_points(server: Server, fitted: str) -> None:
    def send(count: int) -> httpx.Response:
        up = [[0, 0, 1]] * count
        body = json.dumps({"omega_in": up, "omega_out": up}, separators=(",", ":"))
        headers = {"Content-Type": "application/json", "Accept": NPY}
        return server.http.post(f"/v1/fits/{fitted}/brdf", content=body, headers=headers)

    assert np.load(io.BytesIO(send(100_000).content)).shape == (100_000, 3)
    assert "100000 points" in assert_problem(send(100_001), 413, "too-large")


def test_npy_batch_has_a_million_points(server: Server, fitted: str) -> None:
    assert_problem(npy_batch(server, fitted, 1_000_001), 413, "too-large")
