"""Knots stand where the data are and matter; the spline between them is the natural one."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from dsbrdf.data.grid import THETA_DIFF
from dsbrdf.fitting.knot_placement import place_knots
from dsbrdf.model.splines import knot_angles, parameter_spline, roughness, spline_basis

Array = NDArray[np.float64]

ROWS = np.arange(90)


def flat(rows: Array | range | slice = slice(None)) -> tuple[Array, Array]:
    """Profiles that are 1 everywhere, with weight on some rows only."""
    weight = np.zeros((3, 90, 90))
    weight[:, rows] = 1.0
    return np.ones((3, 90, 90)), weight


def spread(knots: NDArray[np.intp]) -> tuple[int, int]:
    steps = np.diff(knots)
    return int(steps.min()), int(steps.max())


def test_equal_rows_get_knots_at_equal_distances() -> None:
    knots = place_knots(*flat(), 10)
    assert (knots[0], knots[-1], knots.size) == (0, 89, 10)
    assert spread(knots) in {(9, 10), (10, 10), (9, 11)}


def test_no_knot_lies_beyond_the_cutoff() -> None:
    knots = place_knots(*flat(slice(0, 60)), 10)
    assert (knots[0], knots[-1], knots.size) == (0, 59, 10)


def test_missing_region_takes_no_knots() -> None:
    mean, weight = flat()
    weight[:, 30:60] = 0.0
    knots = place_knots(mean, weight, 12)
    assert (knots[0], knots[-1]) == (0, 89)
    assert not np.any((knots >= 30) & (knots < 60))
    assert np.sum(knots < 30) == np.sum(knots >= 60) == 6


def test_knots_gather_where_the_signal_is() -> None:
    mean, weight = flat()
    mean *= np.where(ROWS < 70, 1.0, 100.0)[:, None]
    knots = place_knots(mean, weight, 14)
    assert np.sum(knots >= 70) > 14 * 20 / 90 + 2  # more than their share of the rows
    assert np.sum(knots < 70) >= 4  # and the rest is not given up
    assert place_knots(1e3 * mean, weight, 14).tolist() == knots.tolist()  # whatever the unit


def test_cube_root_of_the_signal_decides_how_many() -> None:
    mean, weight = flat()
    mean *= np.where(ROWS < 45, 1.0, 8.0)[:, None]  # squared signal 64 times, density 4 times as large
    knots = place_knots(mean, weight, 41)
    assert np.sum(knots >= 45) / np.sum(knots < 45) == pytest.approx(4.0, rel=0.2)


@pytest.mark.parametrize("rows", [[5], [5, 40], [3, 4, 5, 6]])
def test_fewer_rows_than_knots(rows: list[int]) -> None:
    assert place_knots(*flat(np.array(rows)), 14).tolist() == rows


def test_rows_without_any_signal_are_shared_out_evenly() -> None:
    _, weight = flat()
    knots = place_knots(np.zeros((3, 90, 90)), weight, 10)
    assert (knots[0], knots[-1], knots.size) == (0, 89, 10)


@pytest.mark.parametrize("knots", [[0.0, 0.3], [0.0, 0.2, 1.0], [0.1, 0.15, 0.7, 0.9, 1.5]])
def test_basis_is_the_natural_cubic_spline(knots: list[float]) -> None:
    points = np.linspace(knots[0], knots[-1], 101)
    values = np.random.default_rng(1).normal(size=len(knots))
    expected = CubicSpline(knots, values, bc_type="natural")(points)
    np.testing.assert_allclose(spline_basis(np.array(knots), points) @ values, expected, atol=1e-12)


def test_basis_is_linear_between_two_knots_and_reproduces_constants() -> None:
    points = np.array([0.0, 0.25, 0.5, 1.0])
    np.testing.assert_allclose(
        spline_basis(np.array([0.0, 1.0]), points), np.stack([1 - points, points], 1), atol=1e-15
    )
    np.testing.assert_allclose(spline_basis(THETA_DIFF[[0, 9, 50, 79]], THETA_DIFF).sum(axis=1), 1.0, atol=1e-13)


def test_basis_is_held_beyond_the_knots() -> None:
    knots = np.array([0.2, 0.5, 0.9])
    np.testing.assert_allclose(spline_basis(knots, np.array([0.0, 0.2, 0.9, 1.5])), np.eye(3)[[0, 0, 2, 2]], atol=1e-15)


def test_single_knot_is_a_constant() -> None:
    assert spline_basis(np.array([0.4]), np.array([0.0, 0.4, 1.2])).tolist() == [[1.0]] * 3
    assert parameter_spline(np.array([0.4]), np.array([[7.0, 8.0]]))(0.9).tolist() == [7.0, 8.0]


@pytest.mark.parametrize("knots", [[0.0, 1.0], [0.0, 10.0, 20.0, 30.0], [0.0, 3.0, 40.0, 41.0, 79.0]])
def test_roughness_vanishes_on_straight_lines_only(knots: list[float]) -> None:
    form = roughness(np.array(knots))
    line = 0.3 + 0.7 * np.array(knots)
    assert line @ form @ line == pytest.approx(0.0, abs=1e-12 * float(line @ line))
    eigenvalues = np.linalg.eigvalsh(form)
    assert np.sum(eigenvalues > 1e-9) == max(len(knots) - 2, 0)
    assert eigenvalues.min() > -1e-12
    np.testing.assert_allclose(form, form.T)


def test_roughness_is_the_squared_second_difference_whatever_the_unit() -> None:
    values = np.array([1.0, 4.0, 2.0, 2.5])
    form = roughness(np.array([0.0, 1.0, 2.0, 3.0]))
    assert values @ form @ values == pytest.approx(0.25 * np.sum(np.diff(values, 2) ** 2), rel=1e-12)
    np.testing.assert_allclose(roughness(np.array([0.0, 2.0, 7.0])), roughness(np.array([0.0, 20.0, 70.0])), rtol=1e-12)


def test_knot_angles() -> None:
    np.testing.assert_allclose(knot_angles(np.array([0, 45, 79])), np.radians([0.0, 45.0, 79.0]))
