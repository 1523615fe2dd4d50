"""B-splines over theta_diff: within their control values, and SciPy's at every angle."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from dsbrdf.arrays import Array
from dsbrdf.model.splines import (
    DEGREE,
    knot_vector,
    n_control_values,
    roughness,
    spline_basis,
)

KNOTS = [np.array([0.0, 0.3]), np.array([0.1, 0.4, 1.0]), np.radians([0.0, 20.0, 40.0, 55.0, 65.0, 72.0, 77.0, 89.0])]


@pytest.mark.parametrize("knots", KNOTS)
def test_basis_is_scipys_clamped_spline_held_beyond_the_knots(knots: Array) -> None:
    points = np.append(np.linspace(0.0, np.pi / 2, 101), knots)
    clamped = np.concatenate([[knots[0]] * DEGREE, knots, [knots[-1]] * DEGREE])
    np.testing.assert_array_equal(knot_vector(knots), clamped)
    expected = BSpline(clamped, np.eye(n_control_values(knots.size)), 3)(np.clip(points, knots[0], knots[-1]))
    np.testing.assert_allclose(spline_basis(knots, points), expected, atol=1e-14)
    assert spline_basis(knots, points).min() == 0.0


def test_a_single_knot_is_a_constant() -> None:
    assert n_control_values(1) == 1
    assert spline_basis(np.array([0.4]), np.array([0.0, 0.4, 1.2])).tolist() == [[1.0]] * 3


@pytest.mark.parametrize("count", [1, 2, 3, 9])
def test_roughness_is_the_squared_second_difference(count: int) -> None:
    form = roughness(count)
    values = np.random.default_rng(count).normal(size=count)
    assert form.shape == (count, count)
    assert values @ form @ values == pytest.approx(np.sum(np.diff(values, 2) ** 2), abs=1e-12)
