"""Angles and directions, and a measurement between its nodes: exact, smooth, blind to what is not valid."""

import numpy as np
import pytest
from mpmath import cos as mp_cos  # type: ignore[import-untyped]
from mpmath import mp, mpf
from mpmath import sin as mp_sin
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import binary_erosion

from dsbrdf import InvalidArgumentError, Measurement, profiles, render_sphere
from dsbrdf.data import GRID_SHAPE, PHI_DIFF, THETA_DIFF, THETA_HALF, directions, half_difference
from dsbrdf.data.geometry import check_directions

Angles = tuple[np.ndarray, np.ndarray, np.ndarray]


def random_angles(count: int, seed: int = 0) -> Angles:
    generator = np.random.default_rng(seed)
    theta_half = np.pi / 2 * generator.uniform(0.0, 1.0, count) ** 2
    return theta_half, generator.uniform(0.0, np.pi / 2, count), generator.uniform(0.0, 2.0 * np.pi, count)


@pytest.fixture(scope="module")
def holed(plastic: Measurement) -> Measurement:
    """The plastic with a fifth of its nodes lost, and a block and whole lines besides; what is lost was enormous."""
    valid = plastic.valid & (np.random.default_rng(3).uniform(size=GRID_SHAPE) > 0.2)
    valid[10:20, 5:40, 30:50] = False
    valid[:, :, 100] = False
    valid[33] = False
    return Measurement.from_values(np.ma.masked_equal(np.where(valid, plastic.values, 1e6), 1e6))


def test_nodes_are_reproduced_beside_lost_ones(holed: Measurement) -> None:
    row, diff, column = np.nonzero(holed.valid)
    found = holed.interpolated.evaluate(THETA_HALF[row], THETA_DIFF[diff], PHI_DIFF[column])
    np.testing.assert_allclose(found, holed.values[:, holed.valid].T, rtol=1e-9)


def test_values_are_those_of_scipys_interpolator_of_the_logarithm(plastic: Measurement) -> None:
    # The cells with theta_half + theta_diff < 85 degrees have no node below the horizon.
    theta_half, theta_diff, phi_diff = random_angles(20_000)
    inside = theta_half + theta_diff < np.radians(83.0)
    theta_half, theta_diff, phi_diff = theta_half[inside], theta_diff[inside], phi_diff[inside]
    values = np.maximum(np.concatenate([plastic.values, plastic.values[..., :1]], axis=-1), 1e-3)
    axes = (np.arange(90.0), np.arange(90.0), np.arange(181.0))
    row = 90.0 * np.sqrt(theta_half / (np.pi / 2))
    points = np.stack([row, np.degrees(theta_diff), np.degrees(phi_diff) % 180.0], axis=-1)
    found = plastic.interpolated.evaluate(theta_half, theta_diff, phi_diff)
    for channel in range(3):
        expected = np.exp(RegularGridInterpolator(axes, np.log(values[channel]))(points))
        # The library adds 1e-6 before it takes the logarithm.
        np.testing.assert_allclose(found[:, channel], expected, rtol=1e-4)


@pytest.mark.parametrize("axis", range(3))
def test_there_are_no_steps(holed: Measurement, axis: int) -> None:
    interpolated = holed.interpolated
    generator = np.random.default_rng(axis)
    angles = list(random_angles(20_000, seed=axis))
    faces = (THETA_HALF, THETA_DIFF, np.radians(np.arange(361.0)))[axis]
    angles[axis] = generator.choice(faces[1:], angles[axis].size)
    before, after = list(angles), list(angles)
    before[axis], after[axis] = angles[axis] - 1e-9, angles[axis] + 1e-9
    np.testing.assert_allclose(interpolated.evaluate(*before), interpolated.evaluate(*after), rtol=1e-5)


def test_what_is_not_valid_does_not_leak_in(holed: Measurement) -> None:
    flat = Measurement.from_values(np.where(holed.valid, 0.25, 1e6) * np.ones((3, 1, 1, 1)), holed.valid)
    np.testing.assert_allclose(flat.interpolated.evaluate(*random_angles(50_000)), 0.25, rtol=1e-9)


def test_many_points_are_evaluated_as_one_by_one(plastic: Measurement) -> None:
    interpolated = plastic.interpolated
    theta_half, theta_diff, phi_diff = random_angles(150_000)
    together = interpolated.evaluate(theta_half, theta_diff, phi_diff)
    for i in (0, 65_535, 65_536, 149_999):
        np.testing.assert_array_equal(interpolated.evaluate(theta_half[i], theta_diff[i], phi_diff[i]), together[i])
    assert interpolated.evaluate(theta_half[:4, None], theta_diff[:3], 0.0).shape == (4, 3, 3)
    held = interpolated.evaluate([THETA_HALF[89], 0.0], [0.0, THETA_DIFF[89]], 0.3)  # beyond the last row
    np.testing.assert_allclose(interpolated.evaluate([np.pi / 2, 0.0], [0.0, np.pi / 2], 0.3), held, rtol=1e-12)


def test_a_measurement_is_evaluated_between_its_nodes_and_nan_where_nothing_was_measured(holed: Measurement) -> None:
    angles = random_angles(20_000, seed=1)
    found, everywhere = holed.evaluate(*angles), holed.interpolated.evaluate(*angles)
    known = np.isfinite(found)
    assert 0.1 < known.mean() < 0.9
    np.testing.assert_array_equal(found[known], everywhere[known])
    row, diff, column = np.argwhere(binary_erosion(~holed.valid))[::5000].T  # those with such nodes around them
    assert row.size > 10
    assert np.isnan(holed.evaluate(THETA_HALF[row], THETA_DIFF[diff], PHI_DIFF[column])).all()
    row, diff, column = np.argwhere(holed.valid)[::5000].T
    at_nodes = holed.evaluate(THETA_HALF[row], THETA_DIFF[diff], PHI_DIFF[column])
    np.testing.assert_allclose(at_nodes, holed.values[:, row, diff, column].T, rtol=1e-5)
    assert holed.evaluate(0.1, 0.2).shape == (3,)
    with pytest.raises(InvalidArgumentError, match="finite"):
        holed.evaluate(0.1, np.nan, 0.0)


def test_a_channel_below_0_beside_a_valid_one_is_0(plastic: Measurement) -> None:
    values = plastic.values.copy()
    values[2, :, 20:40] = -1e-3
    values[:, :, 50] = -1e-3  # A node is missing only without any channel that is 0 or more.
    partly = Measurement.from_values(values, plastic.valid)
    values[2, :, 20:40] = 0.0
    black = Measurement.from_values(values, plastic.valid)
    np.testing.assert_array_equal(partly.valid, black.valid)
    np.testing.assert_array_equal(partly.values[:, partly.valid], black.values[:, black.valid])
    angles = random_angles(20_000)
    np.testing.assert_array_equal(partly.evaluate(*angles), black.evaluate(*angles))
    np.testing.assert_array_equal(render_sphere(partly, size=16), render_sphere(black, size=16))
    np.testing.assert_array_equal(profiles(partly).folded.mean, profiles(black).folded.mean)


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
    theta_half = pytest.approx(np.arctan2(0.6, 0.8), abs=1e-15)
    # The sign of a zero must not make phi_diff pi.
    for tilted in ([0.6, 0.0, 0.8], [-0.36, 0.48, 0.8], [-0.36, -0.48, 0.8]):
        assert [float(v) for v in half_difference(tilted, tilted)] == [theta_half, 0.0, 0.0]
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
