import numpy as np
import pytest
from mpmath import cos as mp_cos  # type: ignore[import-untyped]
from mpmath import mp, mpf
from mpmath import sin as mp_sin

from dsbrdf import InvalidArgumentError
from dsbrdf.data import directions, half_difference
from dsbrdf.data.geometry import check_directions


def exact_directions(
    theta_half: float, theta_diff: float, phi_diff: float, phi_half: float
) -> tuple[list[mpf], list[mpf]]:
    th, td, pd, ph = (mpf(angle) for angle in (theta_half, theta_diff, phi_diff, phi_half))
    result = []
    for sign in (1, -1):
        x, y, z = sign * mp_sin(td) * mp_cos(pd), sign * mp_sin(td) * mp_sin(pd), mp_cos(td)
        x, z = mp_cos(th) * x + mp_sin(th) * z, mp_cos(th) * z - mp_sin(th) * x
        result.append([mp_cos(ph) * x - mp_sin(ph) * y, mp_sin(ph) * x + mp_cos(ph) * y, z])
    return result[0], result[1]


ANGLES = [
    (1e-9, 1e-9, 1.0, 0.3),
    (1e-9, 0.7, 2.0, 0.3),
    (0.7, 1e-9, 2.0, 0.3),
    (1e-15, 0.5, 1.0, 2.0),
    (0.5, 1e-15, 1.0, 2.0),
    (np.pi / 2 - 1e-9, 1e-9, np.pi / 2, 0.1),
    (1e-9, np.pi / 2 - 1e-9, 0.4, 0.1),
    (0.3, np.pi / 2 - 1e-5, np.pi / 2, 4.0),
    (np.pi / 4, np.pi / 4, 0.0, 0.0),
    (np.pi / 4, np.pi / 4, np.pi, 0.0),
    (0.2, 0.9, 2 * np.pi - 1e-9, 0.0),
    (1e-160, 1e-160, 1.0, 0.0),
    *np.random.default_rng(8).uniform(0.0, (1.5, 1.5, 6.2, 6.2), (50, 4)).tolist(),
]
"""Delicate points, and others."""


def test_directions_against_50_digits() -> None:
    for angles in ANGLES:
        with mp.workdps(50):
            expected = [[float(v) for v in omega] for omega in exact_directions(*angles)]
        np.testing.assert_allclose(directions(*angles), expected, rtol=0, atol=3e-16, err_msg=str(angles))


def test_half_difference_is_the_inverse_of_directions() -> None:
    for angles in ANGLES:
        omega_in, omega_out = directions(*angles)
        total = omega_in + omega_out
        half, diff, phi = half_difference(omega_in, omega_out)
        assert half >= 0.0
        assert 0.0 <= diff <= np.pi / 2
        again = directions(half, diff, phi, np.arctan2(total[1], total[0]))
        tolerance = 1e-15 / np.cos(angles[1])  # the sum of directions that are nearly opposite has few digits
        np.testing.assert_allclose(again, (omega_in, omega_out), rtol=0, atol=tolerance, err_msg=str(angles))


def test_named_singular_points() -> None:
    normal = np.array([0.0, 0.0, 1.0])
    assert [float(v) for v in half_difference(normal, normal)] == [0.0, 0.0, 0.0]
    assert [float(v) for v in half_difference([-0.0, -0.0, 1.0], [-0.0, -0.0, 1.0])] == [0.0, 0.0, 0.0]
    tilted = np.array([0.6, 0.0, 0.8])
    assert [float(v) for v in half_difference(tilted, tilted)] == [pytest.approx(np.arctan2(0.6, 0.8), abs=1e-15), 0, 0]
    # Mirror directions share the normal as half vector; phi_diff is then the azimuth of omega_in.
    half, diff, phi = half_difference([0.0, 0.6, 0.8], [0.0, -0.6, 0.8])
    assert float(half) == 0.0
    assert float(diff) == pytest.approx(np.arctan2(0.6, 0.8), abs=1e-15)
    assert float(phi) == np.pi / 2


@pytest.mark.parametrize("azimuth", [0.0, 1.0, 2.0, 4.0])
def test_opposite_directions_at_the_horizon_take_the_normal(azimuth: float) -> None:
    omega_in = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    half, diff, phi = half_difference(omega_in, -omega_in)
    assert float(half) == 0.0
    assert float(diff) == pytest.approx(np.pi / 2, abs=1e-15)
    assert float(phi) == pytest.approx(azimuth, abs=1e-15)
    rounded = [np.cos(azimuth + np.pi), np.sin(azimuth + np.pi), np.cos(np.pi / 2)]
    assert float(half_difference(omega_in, rounded)[0]) == 0.0


def test_phi_diff_is_within_a_turn() -> None:
    phi = half_difference(*directions(0.5, 0.5, [-1e-17, -1e-300, 2 * np.pi, -1.0]))[2]
    assert ((phi >= 0.0) & (phi < 2 * np.pi)).all()


def test_broadcasting_equals_a_loop() -> None:
    half, diff, phi = np.array([[0.1], [0.9]]), np.array([0.2, 0.4, 0.8]), 0.7
    both = np.array(directions(half, diff, phi))
    assert both.shape == (2, 2, 3, 3)
    for i, j in np.ndindex(2, 3):
        np.testing.assert_array_equal(both[:, i, j], directions(half[i, 0], diff[j], phi))
    assert all(angle.shape == (2, 3) for angle in half_difference(both[0], both[1, 0, 0]))


def test_check_directions_scales_to_unit_length() -> None:
    rough = np.array([[0.6000002, 0.0, 0.8], [0.0, 0.0, 1.0]])
    unit = check_directions("omega_in", rough)
    np.testing.assert_allclose(np.linalg.norm(unit, axis=-1), 1.0, rtol=0, atol=3e-16)
    np.testing.assert_allclose(unit, rough, atol=1e-6)
    assert rough[0, 0] == 0.6000002
    assert check_directions("omega_in", [1.0, 0.0, -1e-17])[2] == 0.0
    assert check_directions("omega_in", np.empty((0, 3))).shape == (0, 3)


@pytest.mark.parametrize(
    ("omega", "message"),
    [
        ([0.0, 1.0], r"omega_out must have the shape \(\.\.\., 3\), not \(2,\)"),
        (1.0, r"omega_out must have the shape"),
        ([0.0, np.nan, 1.0], r"omega_out contains NaN or infinity"),
        ([0.0, np.inf, 1.0], r"omega_out contains NaN or infinity"),
        ([[0.0, 0.0, 1.0], [0.0, 0.0, 1.00001]], r"omega_out must be of unit length \(to 1e-06\), not 1\.00001"),
        ([0.6, 0.0, -0.8], r"omega_out must lie on or above the horizon \(z >= 0\); its smallest z is -0\.8"),
        (["a", "b", "c"], r"omega_out must be an array of real numbers"),
    ],
)
def test_check_directions_names_the_fault(omega: object, message: str) -> None:
    with pytest.raises(InvalidArgumentError, match=message):
        check_directions("omega_out", omega)  # type: ignore[arg-type]
