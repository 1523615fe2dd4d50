"""Values over HTTP are the library's."""

import io
from typing import Any

import httpx
import numpy as np
import pytest

import dsbrdf
from dsbrdf.output.serialize import from_json
from tests.support.server import Server, assert_problem


@pytest.fixture(scope="session")
def model(server: Server, fitted: str) -> dsbrdf.DSBRDF:
    """The model of the fit, without loss."""
    return from_json(server.http.get(f"/v1/fits/{fitted}/export?format=json").text)[0]


@pytest.fixture(scope="session")
def elongated(server: Server, stored: str) -> str:
    """The id of a fit whose values depend on phi_diff."""
    answer = server.submit(stored, method="global", n_lobes=1, ring_lobes=0)
    assert answer.json()["status"] == "succeeded", answer.text
    fit_id: str = answer.json()["id"]
    return fit_id


def directions(count: int, seed: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    vectors[:, 2] = np.abs(vectors[:, 2])
    unit: np.ndarray[Any, np.dtype[np.float64]] = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return unit


def as_text(vectors: np.ndarray[Any, np.dtype[np.float64]]) -> list[str]:
    return [",".join(repr(float(x)) for x in vector) for vector in vectors]


def npy(array: Any) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, np.asarray(array))
    return buffer.getvalue()


def close(answer: httpx.Response, expected: Any) -> None:
    assert answer.status_code == 200, answer.text
    np.testing.assert_allclose(answer.json()["values"], expected, rtol=1e-12, atol=1e-15)


def test_single_point_equals_the_library(server: Server, fitted: str, model: dsbrdf.DSBRDF) -> None:
    answer = server.http.get(f"/v1/fits/{fitted}/brdf", params={"theta_half_deg": 10, "theta_diff_deg": 30})
    close(answer, [model.evaluate(np.radians(10), np.radians(30))])


@pytest.mark.parametrize("count", [1, 3, 200])
def test_several_points_equal_the_library(server: Server, fitted: str, model: dsbrdf.DSBRDF, count: int) -> None:
    theta_half, theta_diff = np.random.default_rng(count).uniform(0, 90, size=(2, count))
    query = {"theta_half_deg": theta_half.tolist(), "theta_diff_deg": theta_diff.tolist()}
    close(
        server.http.get(f"/v1/fits/{fitted}/brdf", params=query),
        model.evaluate(np.radians(theta_half), np.radians(theta_diff)),
    )


def test_what_is_given_once_counts_for_all_points(server: Server, elongated: str) -> None:
    model = from_json(server.http.get(f"/v1/fits/{elongated}/export?format=json").text)[0]
    url, theta_half, phi_diff = f"/v1/fits/{elongated}/brdf", [0, 10, 20], [5, 25, 85]
    expected = model.evaluate(np.radians(theta_half), np.radians(30), np.radians(phi_diff))
    query = {"theta_half_deg": theta_half, "theta_diff_deg": [30], "phi_diff_deg": phi_diff}
    close(server.http.get(url, params=query), expected)
    close(server.http.post(url, json=query), expected)
    two = server.http.get(f"{url}?theta_half_deg=0&theta_half_deg=10&theta_diff_deg=30")
    close(two, model.evaluate(np.radians([0, 10]), np.radians(30)))
    omega_in, omega_out = directions(4, 0), directions(1, 1)
    expected = model.evaluate_directions(omega_in, omega_out)
    close(server.http.get(url, params={"omega_in": as_text(omega_in), "omega_out": as_text(omega_out)}), expected)
    close(server.http.post(url, json={"omega_in": omega_in.tolist(), "omega_out": omega_out.tolist()}), expected)


def test_values_depend_on_phi_diff(server: Server, elongated: str) -> None:
    model = from_json(server.http.get(f"/v1/fits/{elongated}/export?format=json").text)[0]
    theta_half, theta_diff, phi_diff = 20.0, 50.0, np.array([0.0, 35.0, 90.0, -35.0, 400.0])
    expected = model.evaluate(np.radians(theta_half), np.radians(theta_diff), np.radians(phi_diff))
    assert expected[0, 0] != pytest.approx(expected[2, 0], rel=0.01)
    columns = {
        "theta_half_deg": [theta_half] * 5,
        "theta_diff_deg": [theta_diff] * 5,
        "phi_diff_deg": phi_diff.tolist(),
    }
    url = f"/v1/fits/{elongated}/brdf"
    close(server.http.get(url, params=columns), expected)
    close(server.http.post(url, json=columns), expected)
    headers = {"Content-Type": "application/x-npy"}
    close(server.http.post(url, content=npy(np.transpose([*columns.values()])), headers=headers), expected)
    left_out = server.http.get(url, params={"theta_half_deg": theta_half, "theta_diff_deg": theta_diff})
    close(left_out, expected[2:3])
    omega = directions(300, 6), directions(300, 7)
    document = {"omega_in": omega[0].tolist(), "omega_out": omega[1].tolist()}
    close(server.http.post(url, json=document), model.evaluate_directions(*omega))


def test_value_below_the_horizon_is_0_and_fails_no_batch(server: Server, elongated: str) -> None:
    url = f"/v1/fits/{elongated}/brdf"
    vectors = [[0.0, 0.0, 1.0], [0.6, 0.0, -0.8], [0.0, 0.0, -1.0]]
    pairs = [(first, second) for first in vectors for second in vectors]
    document = {"omega_in": [first for first, _ in pairs], "omega_out": [second for _, second in pairs]}
    values = np.array(server.http.post(url, json=document).json()["values"])
    assert np.all(values[0] > 0.0)
    np.testing.assert_array_equal(values[1:], 0.0)
    columns = {"theta_half_deg": [60, 60], "theta_diff_deg": [60, 60], "phi_diff_deg": [0, 90]}
    below, above = server.http.post(url, json=columns).json()["values"]
    assert below == [0.0, 0.0, 0.0]
    assert min(above) > 0.0


@pytest.mark.parametrize("count", [1, 3, 100])
def test_direction_pairs_equal_the_library(server: Server, fitted: str, model: dsbrdf.DSBRDF, count: int) -> None:
    omega_in, omega_out = directions(count, 1), directions(count, 2)
    query = {"omega_in": as_text(omega_in), "omega_out": as_text(omega_out)}
    expected = model.evaluate_directions(omega_in, omega_out)
    close(server.http.get(f"/v1/fits/{fitted}/brdf", params=query), expected)
    document = {"omega_in": omega_in.tolist(), "omega_out": omega_out.tolist()}
    close(server.http.post(f"/v1/fits/{fitted}/brdf", json=document), expected)


def test_points_at_the_edges_of_the_hemisphere_are_accepted(server: Server, fitted: str, model: dsbrdf.DSBRDF) -> None:
    query = {"theta_half_deg": [0, 90, 0, 90], "theta_diff_deg": [0, 0, 90, 90]}
    expected = model.evaluate(np.radians([0, 90, 0, 90]), np.radians([0, 0, 90, 90]))
    close(server.http.get(f"/v1/fits/{fitted}/brdf", params=query), expected)
    opposite = {"omega_in": "1,0,0", "omega_out": "-1,0,0"}
    close(
        server.http.get(f"/v1/fits/{fitted}/brdf", params=opposite),
        [model.evaluate_directions([1.0, 0, 0], [-1.0, 0, 0])],
    )


@pytest.mark.parametrize("dtype", ["<f8", ">f8", "<f4"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_npy_batch_of_angles_equals_the_library(
    server: Server, fitted: str, model: dsbrdf.DSBRDF, dtype: str, order: str
) -> None:
    angles = np.random.default_rng(3).uniform(0, 90, size=(20_000, 2)).astype(dtype, order=order)  # type: ignore[call-overload]
    headers = {"Content-Type": "application/x-npy", "Accept": "application/x-npy"}
    answer = server.http.post(f"/v1/fits/{fitted}/brdf", content=npy(angles), headers=headers)
    assert answer.headers["content-type"] == "application/x-npy"
    values = np.load(io.BytesIO(answer.content), allow_pickle=False)
    radians = np.radians(angles.astype(float))
    np.testing.assert_allclose(values, model.evaluate(radians[:, 0], radians[:, 1]), rtol=1e-12)


@pytest.mark.parametrize("shape", [(-1, 6), (-1, 2, 3)])
def test_npy_batch_of_directions_equals_the_library(
    server: Server, fitted: str, model: dsbrdf.DSBRDF, shape: tuple[int, ...]
) -> None:
    omega = np.stack([directions(10_000, 4), directions(10_000, 5)], axis=1)
    expected = model.evaluate_directions(omega[:, 0], omega[:, 1])
    headers = {"Content-Type": "application/x-npy"}
    close(server.http.post(f"/v1/fits/{fitted}/brdf", content=npy(omega.reshape(shape)), headers=headers), expected)


@pytest.mark.parametrize("count", [4096, 4097, 131_072, 131_073, 300_000])
def test_large_batch_is_streamed_completely(server: Server, fitted: str, model: dsbrdf.DSBRDF, count: int) -> None:
    angles = np.random.default_rng(count).uniform(0, 90, size=(count, 2))
    expected = model.evaluate(np.radians(angles[:, 0]), np.radians(angles[:, 1]))
    headers = {"Content-Type": "application/x-npy", "Accept": "application/x-npy"}
    answer = server.http.post(f"/v1/fits/{fitted}/brdf", content=npy(angles), headers=headers)
    assert answer.headers["content-length"] == str(len(answer.content))
    np.testing.assert_array_equal(np.load(io.BytesIO(answer.content), allow_pickle=False), expected)
    if count < 10_000:
        del headers["Accept"]
        text = server.http.post(f"/v1/fits/{fitted}/brdf", content=npy(angles), headers=headers)
        assert text.headers["content-type"] == "application/json"
        np.testing.assert_array_equal(text.json()["values"], expected)


def test_invalid_point_at_the_end_of_a_large_batch_is_refused(server: Server, fitted: str) -> None:
    angles = np.full((150_000, 2), 45.0)
    angles[-1, 1] = 90.5
    headers = {"Content-Type": "application/x-npy", "Accept": "application/x-npy"}
    answer = server.http.post(f"/v1/fits/{fitted}/brdf", content=npy(angles), headers=headers)
    assert "90.5" in assert_problem(answer, 422, "invalid-argument")
    omega = np.stack([directions(20_000, 4), directions(20_000, 5)], axis=1)
    omega[-1, 1] = 0.6, 0.0, -0.9
    answer = server.http.post(f"/v1/fits/{fitted}/brdf", content=npy(omega), headers=headers)
    assert "omega_out" in assert_problem(answer, 422, "invalid-argument")


@pytest.mark.parametrize("shape", [(0, 2), (0, 3), (0, 6), (0, 2, 3)])
def test_empty_npy_batch_has_no_values(server: Server, fitted: str, shape: tuple[int, ...]) -> None:
    headers = {"Content-Type": "application/x-npy", "Accept": "application/x-npy"}
    answer = server.http.post(f"/v1/fits/{fitted}/brdf", content=npy(np.zeros(shape)), headers=headers)
    assert np.load(io.BytesIO(answer.content)).shape == (0, 3)


def test_json_points_can_be_answered_as_npy(server: Server, fitted: str, model: dsbrdf.DSBRDF) -> None:
    document = {"theta_half_deg": [1, 2], "theta_diff_deg": [3, 4]}
    for accept in (
        "application/x-npy",
        "application/json;q=0.5, application/x-npy",
        "application/x-npy, */*",
        "application/json;q=0, */*",
        "application/*, application/json;q=0.1",
    ):
        answer = server.http.post(f"/v1/fits/{fitted}/brdf", json=document, headers={"Accept": accept})
        assert answer.headers["content-type"] == "application/x-npy"
        assert np.load(io.BytesIO(answer.content)).shape == (2, 3)
    for accept in (
        "*/*",
        "",
        "application/json",
        "application/x-npy;q=0.1, application/json",
        "application/x-npy;q=0, */*",
    ):
        answer = server.http.post(f"/v1/fits/{fitted}/brdf", json=document, headers={"Accept": accept})
        assert answer.headers["content-type"] == "application/json"
    refused = server.http.post(f"/v1/fits/{fitted}/brdf", json=document, headers={"Accept": "text/html"})
    assert_problem(refused, 406, "not-acceptable")


def test_leading_white_space_of_a_batch_is_ignored(server: Server, fitted: str, model: dsbrdf.DSBRDF) -> None:
    body = b" " * 200 + b'\n{ "omega_out": [[0, 0, 1]],\n "omega_in": [[0, 0, 1]] }'
    answer = server.http.post(f"/v1/fits/{fitted}/brdf", content=body, headers={"Content-Type": "application/json"})
    assert answer.json()["values"] == [model.evaluate(0.0, 0.0).tolist()]


def test_empty_batch_has_no_values(server: Server, fitted: str) -> None:
    document: dict[str, list[float]] = {"theta_half_deg": [], "theta_diff_deg": []}
    assert server.http.post(f"/v1/fits/{fitted}/brdf", json=document).json() == {"values": []}


def test_unsupported_media_types_are_refused(server: Server, fitted: str) -> None:
    answer = server.http.post(f"/v1/fits/{fitted}/brdf", content=b"1 2", headers={"Content-Type": "text/csv"})
    assert "application/x-npy" in assert_problem(answer, 415, "unsupported-media-type")
