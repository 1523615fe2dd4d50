"""Points that are none are refused, with a sentence that names the fault."""

from collections.abc import Sequence

import numpy as np
import pytest

from tests.support.points import npy
from tests.support.server import Server, assert_problem


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ("", ["theta_half_deg", "omega_in"]),
        ("theta_half_deg=1", ["has theta_half_deg;", "theta_diff_deg"]),
        ("theta_half_deg=1&theta_diff_deg=1&omega_in=0,0,1&omega_out=0,0,1", ["theta_diff_deg and omega_in"]),
        ("theta_half_deg=1&omega_out=0,0,1", ["has theta_half_deg and omega_out;"]),
        (
            "&".join(["theta_half_deg=1"] * 2 + ["theta_diff_deg=1"] * 3),
            ["2 values of theta_half_deg", "3 values of theta_diff_deg", "one for all"],
        ),
        ("theta_half=1&theta_diff=1", ["'theta_half'", "theta_half_deg"]),
        ("theta_half_deg=x&theta_diff_deg=1", ["theta_half_deg", "'x'"]),
        ("theta_half_deg=-0.1&theta_diff_deg=1", ["theta_half_deg", "0 to 90", "-0.1"]),
        ("theta_half_deg=1&theta_diff_deg=90.1", ["theta_diff_deg", "90.1"]),
        ("theta_half_deg=90.00000000000001&theta_diff_deg=1", ["0 to 90", "90.00000000000001"]),
        ("theta_half_deg=nan&theta_diff_deg=1", ["theta_half_deg", "nan"]),
        ("omega_in=0,0,1&omega_out=0,1", ["omega_out", "x,y,z"]),
        ("omega_in=a,b,c&omega_out=0,0,1", ["omega_in", "a,b,c"]),
        ("omega_in=0,0,1.1&omega_out=0,0,1", ["omega_in", "unit"]),
        ("phi_diff_deg=1&omega_in=0,0,1&omega_out=0,0,1", ["has phi_diff_deg and omega_in"]),
        ("phi_diff_deg=1&theta_half_deg=1", ["has phi_diff_deg and theta_half_deg;"]),
        (
            "&".join(["theta_half_deg=1"] * 3 + ["theta_diff_deg=1", "phi_diff_deg=1", "phi_diff_deg=2"]),
            ["2 values of phi_diff_deg"],
        ),
        ("theta_half_deg=1_0&theta_diff_deg=1", ["theta_half_deg", "'1_0'"]),
        ("theta_half_deg=1&theta_diff_deg=1&phi_diff_deg=nan", ["phi_diff_deg", "finite"]),
        ("theta_half_deg=1&theta_diff_deg=1&phi_diff_deg=x", ["phi_diff_deg", "'x'"]),
        ("omega_in=nan,0,1&omega_out=0,0,1", ["omega_in", "NaN"]),
    ],
)
def test_invalid_points_are_named(server: Server, fitted: str, query: str, words: Sequence[str]) -> None:
    for path in ("brdf", "components/diffuse/brdf"):
        answer = server.http.get(f"/v1/fits/{fitted}/{path}?{query}")
        detail = assert_problem(answer, 422, "invalid-argument")
        for word in words:
            assert word in detail


def bad_npy() -> dict[str, bytes]:
    good = npy(np.ones((3, 2)))
    huge = good.replace(b"(3, 2)", b"(9999999999, 2)"[:6])
    return {
        "nothing": b"",
        "cut header": good[:40],
        "cut values": good[:-1],
        "one byte more": good + b"\0",
        "version 3": good[:6] + b"\x03" + good[7:],
        "objects": npy(np.array([[{}, {}]], dtype=object)),
        "integers": npy(np.ones((3, 2), dtype=int)),
        "text": npy(np.array([["1", "2"]])),
        "records": npy(np.zeros(3, dtype=[("a", "f8"), ("b", "f8")])),
        "shape of a vector": npy(np.ones(6)),
        "four columns": npy(np.ones((3, 4))),
        "promises more": huge,
        "negative shape": good.replace(b"(3, 2)", b"(-3,2)"),
        "code": good.replace(b"(3, 2)", b"exit()"),
        "long header": good[:8] + (60_000).to_bytes(2, "little") + b"(" * 60_000,
        "phi_diff not finite": npy(np.array([[1.0, 1.0, np.inf]])),
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
        b'{"theta_half_deg": [1]}',
        b'{"theta_half_deg": 1, "theta_diff_deg": 1}',
        b'{"theta_half_deg": [1, 2, 3], "theta_diff_deg": [1, 2]}',
        b'{"theta_half_deg": [NaN], "theta_diff_deg": [1]}',
        b'{"theta_half_deg": [null], "theta_diff_deg": [1]}',
        b'{"theta_half_deg": ["1"], "theta_diff_deg": [1]}',
        b'{"theta_half_deg": [true], "theta_diff_deg": [1]}',
        b'{"omega_in": [["0", 0, 1]], "omega_out": [[0, 0, 1]]}',
        b'{"theta_half_deg": [91], "theta_diff_deg": [1]}',
        b'{"theta_half_deg": [1], "theta_diff_deg": [1, 2, 3], "phi_diff_deg": [1, 2]}',
        b'{"theta_half_deg": [1], "theta_diff_deg": [1], "phi_diff_deg": ["1"]}',
        b'{"theta_half_deg": [1], "theta_diff_deg": [1], "phi_half_deg": [1]}',
        b'{"theta_half_deg": [1], "theta_diff_deg": [1], "omega_in": [[0, 0, 1]], "omega_out": [[0, 0, 1]]}',
        b'{"omega_in": [[0, 0, 1]], "omega_out": [[0, 0]]}',
        b'{"omega_in": [0, 0, 1], "omega_out": [0, 0, 1]}',
        b'{"omega_in": [[0, 0, 1e999]], "omega_out": [[0, 0, 1]]}',
        b'{"theta_half_deg": ' + b"[" * 30_000,
    ],
)
def test_invalid_json_is_refused(server: Server, fitted: str, body: bytes) -> None:
    answer = server.http.post(f"/v1/fits/{fitted}/brdf", content=body, headers={"Content-Type": "application/json"})
    assert_problem(answer, 422, "invalid-argument")
