"""Values over HTTP are the library's, of as many points as is said; points that are none are refused by name."""

import io
import json
from typing import Any

import httpx
import numpy as np
import pytest

import dsbrdf
from dsbrdf.data import PHI_DIFF, THETA_DIFF, THETA_HALF
from dsbrdf.output import from_json
from dsbrdf_service.http.messages import NPY
from tests.support.models import pairs_of_directions
from tests.support.server import Server, assert_problem, npy

FROM_NPY = {"Content-Type": NPY}
NPY_BOTH_WAYS = {"Content-Type": NPY, "Accept": NPY}


@pytest.fixture(scope="session")
def url(server: Server, stored: str) -> str:
    answer = server.submit(stored, method="global", n_lobes=1, ring_lobes=0)
    assert answer.json()["status"] == "succeeded", answer.text
    return f"/v1/fits/{answer.json()['id']}/brdf"


@pytest.fixture(scope="session")
def model(server: Server, url: str) -> dsbrdf.DSBRDF:
    return from_json(server.http.get(url.replace("brdf", "export?format=json")).text)[0]


def as_text(vectors: np.ndarray[Any, np.dtype[np.float64]]) -> list[str]:
    return [",".join(repr(float(x)) for x in vector) for vector in vectors]


def close(answer: httpx.Response, expected: Any) -> None:
    assert answer.status_code == 200, answer.text
    np.testing.assert_allclose(answer.json()["values"], expected, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("count", [1, 3, 70])
def test_angles_equal_the_library(server: Server, url: str, model: dsbrdf.DSBRDF, count: int) -> None:
    degrees = np.random.default_rng(count).uniform(0, 90, size=(count, 3))
    degrees[:, 2] = 5.0 * degrees[:, 2] - 100.0
    expected = model.evaluate(*np.radians(degrees.T))
    names = ("theta_half_deg", "theta_diff_deg", "phi_diff_deg")
    columns = dict(zip(names, degrees.T.tolist(), strict=True))
    close(server.http.get(url, params=columns), expected)
    close(server.http.post(url, json=columns), expected)
    close(server.http.post(url, content=npy(degrees), headers=FROM_NPY), expected)
    at_90 = model.evaluate(*np.radians(degrees.T[:2]))
    assert count == 1 or not np.allclose(at_90, expected, rtol=1e-3, atol=0.0)
    close(server.http.get(url, params={name: columns[name] for name in names[:2]}), at_90)


@pytest.mark.parametrize("count", [1, 50])
def test_direction_pairs_equal_the_library(server: Server, url: str, model: dsbrdf.DSBRDF, count: int) -> None:
    omega_in, omega_out = pairs_of_directions(count)
    expected = model.evaluate_directions(omega_in, omega_out)
    close(server.http.get(url, params={"omega_in": as_text(omega_in), "omega_out": as_text(omega_out)}), expected)
    close(server.http.post(url, json={"omega_in": omega_in.tolist(), "omega_out": omega_out.tolist()}), expected)
    omega = np.stack([omega_in, omega_out], axis=1)
    for shape in ((-1, 6), (-1, 2, 3)):
        close(server.http.post(url, content=npy(omega.reshape(shape)), headers=FROM_NPY), expected)


@pytest.mark.parametrize(
    ("count", "dtype", "order"),
    [(2000, ">f8", "C"), (2000, "<f4", "F"), *((count, "<f8", "C") for count in (4097, 100_000))],
)
def test_npy_batch_is_answered(
    server: Server, url: str, model: dsbrdf.DSBRDF, count: int, dtype: str, order: str
) -> None:
    angles = np.random.default_rng(count).uniform(0, 90, size=(count, 2)).astype(dtype, order=order)  # type: ignore[call-overload]
    expected = model.evaluate(*np.radians(angles.astype(float).T))
    answer = server.http.post(url, content=npy(angles), headers=NPY_BOTH_WAYS)
    assert (answer.headers["content-type"], answer.headers["content-length"]) == (NPY, str(len(answer.content)))
    np.testing.assert_array_equal(np.load(io.BytesIO(answer.content), allow_pickle=False), expected)
    if count < 10_000:
        text = server.http.post(url, content=npy(angles), headers=FROM_NPY)
        assert text.headers["content-type"] == "application/json"
        np.testing.assert_array_equal(text.json()["values"], expected)


def test_invalid_point_at_the_end_of_a_large_batch_is_refused(server: Server, url: str) -> None:
    angles = np.full((100_000, 2), 45.0)
    angles[-1, 1] = 90.5
    answer = server.http.post(url, content=npy(angles), headers=NPY_BOTH_WAYS)
    assert "90.5" in assert_problem(answer, 422, "invalid-argument")
    omega = np.stack(pairs_of_directions(20_000), axis=1)
    omega[-1, 1] = 0.6, 0.0, -0.9
    answer = server.http.post(url, content=npy(omega), headers=NPY_BOTH_WAYS)
    assert "omega_out" in assert_problem(answer, 422, "invalid-argument")


def test_empty_npy_batch_has_no_values(server: Server, url: str) -> None:
    for shape in ((0, 2), (0, 3), (0, 6), (0, 2, 3)):
        answer = server.http.post(url, content=npy(np.zeros(shape)), headers=NPY_BOTH_WAYS)
        assert np.load(io.BytesIO(answer.content)).shape == (0, 3)


def test_batch_has_at_most_a_hundred_thousand_points(server: Server, url: str, model: dsbrdf.DSBRDF) -> None:
    omega_in, omega_out = pairs_of_directions(100_000)
    document = {"omega_in": omega_in.tolist(), "omega_out": omega_out.tolist()}
    answer = server.http.post(url, json=document, headers={"Accept": NPY})
    values = np.load(io.BytesIO(answer.content))
    np.testing.assert_array_equal(values[::999], model.evaluate_directions(omega_in[::999], omega_out[::999]))
    short = json.dumps(dict.fromkeys(("theta_half_deg", "theta_diff_deg"), [1] * 100_001), separators=(",", ":"))
    for content, media_type in ((short.encode(), "application/json"), (npy(np.ones((100_001, 2))), NPY)):
        answer = server.http.post(url, content=content, headers={"Content-Type": media_type})
        assert "100001 points" in assert_problem(answer, 413, "too-large")


def bad_npy() -> dict[str, bytes]:
    good = npy(np.ones((3, 2)))
    huge = good.replace(b"(3, 2)", b"(9999999999, 2)"[:6])
    return {
        "cut header": good[:40],
        "cut values": good[:-1],
        "objects": npy(np.array([[{}, {}]], dtype=object)),
        "shape of a vector": npy(np.ones(6)),
        "four columns": npy(np.ones((3, 4))),
        "promises more": huge,
        "code": good.replace(b"(3, 2)", b"exit()"),
        "a length that is True": npy(np.ones((1, 2))).replace(b"(1, 2), }  ", b"(True,2), }"),
        "long header": good[:8] + (60_000).to_bytes(2, "little") + b"(" * 60_000,
        "phi_diff not finite": npy(np.array([[1.0, 1.0, np.inf]])),
        "not a number": npy(np.full((3, 2), np.nan)),
        "not unit": npy(np.ones((3, 6))),
    }


@pytest.mark.parametrize("fault", bad_npy())
def test_invalid_npy_is_refused(server: Server, fitted: str, fault: str) -> None:
    answer = server.http.post(f"/v1/fits/{fitted}/brdf", content=bad_npy()[fault], headers=FROM_NPY)
    assert_problem(answer, 422, "invalid-argument")


def test_measured_values_are_exact_or_null(server: Server, stored: str, plastic: dsbrdf.Measurement) -> None:
    url = f"/v1/measurements/{stored}/brdf"
    row, diff, column = np.vstack([np.argwhere(plastic.valid)[::70_000], np.argwhere(~plastic.valid)[-1:]]).T
    angles = np.degrees([THETA_HALF[row], THETA_DIFF[diff], PHI_DIFF[column]])
    expected = [*plastic.values[:, row[:-1], diff[:-1], column[:-1]].T, None]
    names = ("theta_half_deg", "theta_diff_deg", "phi_diff_deg")
    document = dict(zip(names, angles.tolist(), strict=True))
    for answer in (server.http.get(url, params=document), server.http.post(url, json=document)):
        values = answer.json()["values"]
        assert values[-1] is None
        np.testing.assert_allclose(values[:-1], expected[:-1], rtol=1e-9)
    arrays = np.load(io.BytesIO(server.http.post(url, content=npy(angles.T), headers=NPY_BOTH_WAYS).content))
    assert np.isnan(arrays[-1]).all()
    np.testing.assert_allclose(arrays[:-1], expected[:-1], rtol=1e-9)
    below = server.http.get(url, params={"omega_in": "0,0,1", "omega_out": "0.6,0,-0.8"})
    assert below.json() == {"values": [None]}
    assert_problem(server.http.get(url, params={"theta_half_deg": 1}), 422, "invalid-argument")
    assert_problem(server.http.get(f"/v1/measurements/{'0' * 64}/brdf", params=document), 404, "not-found")
