"""Critical values of Williams' test against independent quadrature, simulation and Student's t."""

import math
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from dsbrdf.fitting import williams_test as selection
from dsbrdf.fitting.williams_test import williams_critical_value
from tests.support.isotonic import max_min_isotonic_means

SPOT_VALUES = {
    20.0: (2.528, 2.584, 2.601, 2.609),
    60.0: (2.390, 2.435, 2.448, 2.453),
    1e6: (2.326, 2.366, 2.377, 2.382),
}


@cache
def null_statistic(n_doses: int, degrees_of_freedom: float, size: int) -> NDArray[np.float64]:
    """Draws of Williams' statistic of the largest dose when no dose has an effect; the same for every level."""
    rng = np.random.default_rng(2012)
    largest = max_min_isotonic_means(rng.standard_normal((size, n_doses)))[:, -1]
    control = rng.standard_normal(size)
    s = np.sqrt(rng.chisquare(degrees_of_freedom, size) / degrees_of_freedom)
    return (largest - control) / (math.sqrt(2.0) * s)


def stays_below_by_recursion(c: float, n_steps: int) -> float:
    """P(all partial sums of z_j - c are <= 0) by propagating the density of the walk on a Gauss-Legendre grid."""
    nodes, weights = np.polynomial.legendre.leggauss(400)
    lowest = -n_steps * c - 12.0 * math.sqrt(n_steps) if c > 0 else -12.0 * math.sqrt(n_steps) + n_steps * c
    position, weights = 0.5 * lowest * (1.0 - nodes), -0.5 * lowest * weights
    density = stats.norm.pdf(position + c)
    for _ in range(n_steps - 1):
        density = stats.norm.pdf(position[:, np.newaxis] - position + c) @ (weights * density)
    return float(weights @ density)


@pytest.mark.parametrize("degrees_of_freedom", SPOT_VALUES)
def test_critical_values_equal_the_tabulated_ones(degrees_of_freedom: float) -> None:
    computed = [williams_critical_value(n, degrees_of_freedom) for n in (1, 2, 3, 4)]
    # Half a unit of the last printed digit, and a hair for a table that rounds halves another way.
    np.testing.assert_allclose(computed, SPOT_VALUES[degrees_of_freedom], rtol=0, atol=5.5e-4)


@pytest.mark.parametrize("alpha", [1e-6, 0.01, 0.05, 0.4])
@pytest.mark.parametrize("degrees_of_freedom", [1, 2, 3, 10, 54, 212, 1e4, 1e6])
def test_one_dose_is_student_t(degrees_of_freedom: float, alpha: float) -> None:
    expected = stats.t.isf(alpha, degrees_of_freedom)
    assert williams_critical_value(1, degrees_of_freedom, alpha) == pytest.approx(expected, rel=1e-6)


def test_fractional_degrees_of_freedom_below_two() -> None:
    # The density of s has a kink at 0 there, which Gauss-Legendre quadrature feels.
    assert williams_critical_value(1, 1.5) == pytest.approx(stats.t.isf(0.01, 1.5), rel=3e-5)


@pytest.mark.parametrize("n_steps", [1, 2, 3, 4, 7])
@pytest.mark.parametrize("c", [-1.0, 0.0, 0.7, 2.5])
def test_spitzer_identity_equals_propagating_the_walk(c: float, n_steps: int) -> None:
    leaves = float(selection._leaves_half_line(np.array([c]), n_steps)[0])
    assert 1.0 - leaves == pytest.approx(stays_below_by_recursion(c, n_steps), rel=1e-10, abs=1e-13)


@pytest.mark.parametrize(("n_doses", "degrees_of_freedom"), [(2, 1), (4, 6), (7, 20), (4, 212)])
@pytest.mark.parametrize("alpha", [0.01, 0.05])
def test_critical_values_against_simulation(n_doses: int, degrees_of_freedom: float, alpha: float) -> None:
    size = 200_000
    drawn = null_statistic(n_doses, degrees_of_freedom, size)
    rate = np.mean(drawn > williams_critical_value(n_doses, degrees_of_freedom, alpha))
    assert abs(rate - alpha) < 4.0 * math.sqrt(alpha * (1.0 - alpha) / size)


def test_critical_values_do_not_depend_on_the_quadrature(monkeypatch: pytest.MonkeyPatch) -> None:
    cases = [(7, df, alpha) for df in (1.0, 20.0, 1e6) for alpha in (1e-6, 0.01, 0.3)]
    cases.append((2, 5.0, 0.01))
    coarse = [selection.williams_critical_value.__wrapped__(*case) for case in cases]
    x = np.linspace(-10.0, 10.0, 201)
    nodes, weights = np.polynomial.legendre.leggauss(160)
    monkeypatch.setattr(selection, "_CONTROL", x)
    monkeypatch.setattr(selection, "_CONTROL_WEIGHT", stats.norm.pdf(x) * 0.1)
    monkeypatch.setattr(selection, "_LEGENDRE_NODES", nodes)
    monkeypatch.setattr(selection, "_LEGENDRE_WEIGHTS", weights)
    fine = [selection.williams_critical_value.__wrapped__(*case) for case in cases]
    np.testing.assert_allclose(coarse, fine, rtol=1e-7)
