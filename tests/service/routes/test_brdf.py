"""Values and components over HTTP are the library's."""

import io
from collections.abc import Sequence
from typing import Any

import httpx
import numpy as np
import pytest

import dsbrdf
from dsbrdf.output.serialize import from_json
from tests.support.server import Server, assert_problem

LABELS = ("specular_spike", "specular_lobe", "diffuse")


@pytest.fixture(scope="session")
def model(server: Server, fitted: str) -> dsbrdf.DSBRDF:
    """The model of the fit, without loss."""
    return from_json(server.http.get(f"/v1/fits/{fitted}/export?format=json").text)[0]


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
    omega[-1, 1] = 0.6, 0.0, -0.8
    answer = server.http.post(f"/v1/fits/{fitted}/brdf", content=npy(omega), headers=headers)
    assert "omega_out" in assert_problem(answer, 422, "invalid-argument")


@pytest.mark.parametrize("shape", [(0, 2), (0, 6), (0, 2, 3)])
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


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ("", ["theta_half_deg", "omega_in"]),
        ("theta_half_deg=1", ["has theta_half_deg;", "theta_diff_deg"]),
        ("omega_out=0,0,1", ["has omega_out;", "omega_in"]),
        ("theta_half_deg=1&theta_diff_deg=1&omega_in=0,0,1&omega_out=0,0,1", ["theta_diff_deg and omega_in"]),
        ("theta_half_deg=1&omega_out=0,0,1", ["has theta_half_deg and omega_out;"]),
        ("theta_half_deg=1&theta_half_deg=2&theta_diff_deg=1", ["2 values of theta_half_deg", "1 of theta_diff_deg"]),
        ("theta_half=1&theta_diff=1", ["'theta_half'", "theta_half_deg"]),
        ("theta_half_deg=x&theta_diff_deg=1", ["theta_half_deg", "'x'"]),
        ("theta_half_deg=&theta_diff_deg=1", ["theta_half_deg"]),
        ("theta_half_deg=-0.1&theta_diff_deg=1", ["theta_half_deg", "0 to 90", "-0.1"]),
        ("theta_half_deg=1&theta_diff_deg=90.1", ["theta_diff_deg", "90.1"]),
        ("theta_half_deg=90.00000000000001&theta_diff_deg=1", ["0 to 90", "90.00000000000001"]),
        ("theta_half_deg=nan&theta_diff_deg=1", ["theta_half_deg", "nan"]),
        ("theta_half_deg=inf&theta_diff_deg=1", ["theta_half_deg", "inf"]),
        ("omega_in=0,0,1&omega_out=0,1", ["omega_out", "x,y,z"]),
        ("omega_in=0,0,1&omega_out=0,0,1,0", ["omega_out", "x,y,z"]),
        ("omega_in=a,b,c&omega_out=0,0,1", ["omega_in", "a,b,c"]),
        ("omega_in=0,0,1.1&omega_out=0,0,1", ["omega_in", "unit"]),
        ("omega_in=0,0,0&omega_out=0,0,1", ["omega_in", "unit"]),
        ("omega_in=0,0,1&omega_out=0.6,0,-0.8", ["omega_out", "horizon"]),
        ("omega_in=nan,0,1&omega_out=0,0,1", ["omega_in", "NaN"]),
    ],
)
def test_invalid_points_are_named(server: Server, fitted: str, query: str, words: Sequence[str]) -> None:
    for path in ("brdf", "lobes/diffuse/brdf"):
        answer = server.http.get(f"/v1/fits/{fitted}/{path}?{query}")
        detail = assert_problem(answer, 422, "invalid-argument")
        for word in words:
            assert word in detail


def bad_npy() -> dict[str, bytes]:
    good = npy(np.ones((3, 2)))
    huge = good.replace(b"(3, 2)", b"(9999999999, 2)"[:6])
    return {
        "nothing": b"",
        "magic only": good[:6],
        "cut header": good[:40],
        "cut values": good[:-1],
        "one byte more": good + b"\0",
        "other magic": b"PK\x03\x04" + good,
        "version 3": good[:6] + b"\x03" + good[7:],
        "objects": npy(np.array([[{}, {}]], dtype=object)),
        "integers": npy(np.ones((3, 2), dtype=int)),
        "complex": npy(np.ones((3, 2), dtype=complex)),
        "text": npy(np.array([["1", "2"]])),
        "records": npy(np.zeros(3, dtype=[("a", "f8"), ("b", "f8")])),
        "shape of a vector": npy(np.ones(6)),
        "shape of a scalar": npy(1.0),
        "four columns": npy(np.ones((3, 4))),
        "promises more": huge,
        "negative shape": good.replace(b"(3, 2)", b"(-3,2)"),
        "code": good.replace(b"(3, 2)", b"exit()"),
        "long header": good[:8] + (60_000).to_bytes(2, "little") + b"(" * 60_000,
        "out of range": npy(np.full((3, 2), 91.0)),
        "not a number": npy(np.full((3, 2), np.nan)),
        "not unit": npy(np.ones((3, 6))),
    }


@pytest.mark.parametrize("fault", bad_npy())
def test_invalid_npy_is_refused(server: Server, fitted: str, fault: str) -> None:
    headers = {"Content-Type": "application/x-npy"}
    answer = server.http.post(f"/v1/fits/{fitted}/brdf", content=bad_npy()[fault], headers=headers)
    assert_problem(answer, 422, "invalid-argument")


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"{",
        b"[]",
        b"{}",
        b"7",
        b'{"theta_half_deg": [1]}',
        b'{"theta_half_deg": 1, "theta_diff_deg": 1}',
        b'{"theta_half_deg": [1], "theta_diff_deg": [1, 2]}',
        b'{"theta_half_deg": [NaN], "theta_diff_deg": [1]}',
        b'{"theta_half_deg": [null], "theta_diff_deg": [1]}',
        b'{"theta_half_deg": ["1"], "theta_diff_deg": [1]}',
        b'{"theta_half_deg": [true], "theta_diff_deg": [1]}',
        b'{"omega_in": [["0", 0, 1]], "omega_out": [[0, 0, 1]]}',
        b'{"theta_half_deg": [91], "theta_diff_deg": [1]}',
        b'{"theta_half_deg": [1], "theta_diff_deg": [1], "phi_diff_deg": [1]}',
        b'{"theta_half_deg": [1], "theta_diff_deg": [1], "omega_in": [[0, 0, 1]], "omega_out": [[0, 0, 1]]}',
        b'{"omega_in": [[0, 0, 1]], "omega_out": [[0, 0]]}',
        b'{"omega_in": [0, 0, 1], "omega_out": [0, 0, 1]}',
        b'{"omega_in": [[0, 0, 1]], "omega_out": []}',
        b'{"omega_in": [[0, 0, 2]], "omega_out": [[0, 0, 1]]}',
        b'{"omega_in": [[0, 0, 1e999]], "omega_out": [[0, 0, 1]]}',
        b'{"theta_half_deg": ' + b"[" * 30_000,
    ],
)
def test_invalid_json_is_refused(server: Server, fitted: str, body: bytes) -> None:
    answer = server.http.post(f"/v1/fits/{fitted}/brdf", content=body, headers={"Content-Type": "application/json"})
    assert_problem(answer, 422, "invalid-argument")


def test_unsupported_media_types_are_refused(server: Server, fitted: str) -> None:
    answer = server.http.post(f"/v1/fits/{fitted}/brdf", content=b"1 2", headers={"Content-Type": "text/csv"})
    assert "application/x-npy" in assert_problem(answer, 415, "unsupported-media-type")


def test_components_equal_the_library_and_sum_to_the_model(server: Server, fitted: str, model: dsbrdf.DSBRDF) -> None:
    items = server.http.get(f"/v1/fits/{fitted}/lobes").json()["items"]
    assert [item["label"] for item in items] == list(LABELS)
    for item, component in zip(items, dsbrdf.decompose(model), strict=True):
        assert item["lobes"] == list(component.lobes)
        np.testing.assert_allclose(item["albedo"], component.albedo, rtol=1e-12)
        if component.half_width is None:
            assert item["half_width_deg"] is None
            assert item["margin"] is None
        else:
            assert item["half_width_deg"] == pytest.approx(np.degrees(component.half_width), rel=1e-12)
            assert item["margin"] == pytest.approx(component.margin, rel=1e-12)
        np.testing.assert_array_equal(np.ravel(item["parameters"]["kappa"]), component.kappa.ravel())
        np.testing.assert_array_equal(item["parameters"]["delta"], component.delta)

    document = {"theta_half_deg": [0, 0.5, 5, 40, 80], "theta_diff_deg": [0, 80, 20, 60, 5]}
    whole = np.array(server.http.post(f"/v1/fits/{fitted}/brdf", json=document).json()["values"])
    parts = [
        server.http.post(f"/v1/fits/{fitted}/lobes/{label}/brdf", json=document).json()["values"] for label in LABELS
    ]
    np.testing.assert_allclose(np.sum(parts, axis=0), whole, rtol=1e-12)
    one = server.http.get(f"/v1/fits/{fitted}/lobes/diffuse/brdf?theta_half_deg=5&theta_diff_deg=20")
    np.testing.assert_allclose(one.json()["values"][0], parts[2][2], rtol=1e-12)
    for url in (f"/v1/fits/{fitted}/lobes/spike/brdf", f"/v1/fits/{fitted}/lobes/4/brdf"):
        assert_problem(server.http.get(url), 404, "not-found")
