"""Williams' test against tables, a linear model and hand-worked numbers."""

import math

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy import stats

from dsbrdf.fitting.lobe_selection import WilliamsRow, williams_critical_value, williams_test
from tests.support.isotonic import max_min_isotonic_means


def chosen(statistic: ArrayLike, alpha: float = 0.01) -> int:
    """Smallest number of lobes that is not worse."""
    return next(row.n_lobes for row in williams_test(statistic, alpha) if not row.significant)


def test_worked_example() -> None:
    # Three numbers of lobes in three blocks. Means 4, 1, 2 for K = 1, 2, 3; grand mean 7/3, block means all 7/3,
    # so the residuals are the deviations from the row means: squares 1+1+0, 0+1+1, 1+0+1 = 6, on 2*2 = 4
    # degrees of freedom: s^2 = 1.5, and the standard error of a difference is sqrt(2 * 1.5 / 3) = 1.
    statistic = [[5.0, 3.0, 4.0], [1.0, 2.0, 0.0], [1.0, 2.0, 3.0]]
    one, two, control = williams_test(statistic, alpha=0.1)
    np.testing.assert_allclose([one.mean, two.mean, control.mean], [4, 1, 2], rtol=1e-14)
    # K = 1: (4 - 2) / 1 = 2 against 2 doses; K = 2 is better than the control: (1 - 2) / 1.
    assert [one.t, two.t] == pytest.approx([2.0, -1.0], rel=1e-14)
    assert one.critical_value == williams_critical_value(2, 4, 0.1)
    assert two.critical_value == williams_critical_value(1, 4, 0.1)
    assert control == WilliamsRow(3, control.mean, None, None, False)
    assert [one.significant, two.significant] == [True, False]
    # At 1 % (critical value above 3.7) the same numbers are not enough, and one lobe does.
    assert chosen(statistic) == 1


def test_statistic_has_the_variance_of_a_linear_model_with_blocks_and_isotonic_means() -> None:
    statistic = np.random.default_rng(8).standard_normal((4, 6))
    rows, columns = np.indices(statistic.shape)
    design = np.hstack([np.eye(4)[rows.ravel()], np.eye(6)[columns.ravel()]])
    fitted = design @ np.linalg.lstsq(design, statistic.ravel(), rcond=None)[0]
    variance = np.sum((statistic.ravel() - fitted) ** 2) / (24 - np.linalg.matrix_rank(design))
    means = statistic.mean(axis=1)[::-1]
    expected = (max_min_isotonic_means(means[None, 1:])[0] - means[0]) / math.sqrt(2.0 * variance / 6)
    assert [row.t for row in williams_test(statistic)[-2::-1]] == pytest.approx(expected.tolist(), rel=1e-12)


def test_type_one_error_is_alpha() -> None:
    rng = np.random.default_rng(99)
    draws = 2.0 + 10.0 * rng.standard_normal((4000, 1, 9)) + rng.standard_normal((4000, 5, 9))
    rate = np.mean([chosen(draw, 0.05) > 1 for draw in draws])
    assert abs(rate - 0.05) < 4.0 * math.sqrt(0.05 * 0.95 / 4000)


def test_steps_down_from_the_largest_difference_and_stops() -> None:
    # Orthogonal noise: each row has mean 0 and the residual variance is the same for every choice of means.
    noise = 0.1 * np.array([[1, -1, 0, 0], [0, 0, 1, -1], [-1, 1, 0, 0], [0, 0, -1, 1]])
    # E_p is not monotone: K = 2 and 3 are far worse than the control, K = 1 much better than any.
    # Pooling K = 1 (the largest dose) with its neighbours brings it below the control, so nothing is significant,
    assert not any(row.significant for row in williams_test(noise + np.array([[-9.0], [4.0], [3.0], [0.0]])))
    # and with a clear K = 1 the procedure goes on to K = 2, then stops at K = 3.
    rows = williams_test(noise + np.array([[9.0], [4.0], [0.0], [0.0]]))
    assert [row.significant for row in rows] == [True, True, False, False]


def test_a_row_after_the_first_stop_is_never_significant() -> None:
    # Craft t_1 of K = 2 between the critical values of one and of two doses, with K = 1 equal to K = 2:
    # K = 2 alone would be significant, but K = 1 is tested first and is not.
    noise = np.array([[1.0, -1.0, 0.0], [-1.0, 0.0, 1.0], [0.0, 1.0, -1.0]])  # s^2 = 6/4, standard error 1
    between = 0.5 * (williams_critical_value(1, 4) + williams_critical_value(2, 4))
    first, second, _ = williams_test(noise + np.array([[between], [between], [0.0]]))
    assert second.t is not None
    assert second.critical_value is not None
    assert second.t > second.critical_value
    assert not first.significant
    assert not second.significant


def test_without_residual_variance_the_means_are_exact() -> None:
    blocks = np.array([0.1, 0.7, 1e3])  # sums with these are not exact: only rounding is left as residual
    rows = williams_test(np.array([[0.5], [0.2], [0.0], [0.0]]) + blocks)
    assert [row.t for row in rows] == [None] * 4
    assert [row.significant for row in rows] == [True, True, False, False]
    assert chosen(np.tile(blocks, (5, 1))) == 1
    assert [row.critical_value for row in williams_test([[0.3, 0.5, 0.9]])] == [None]  # one number of lobes
    one_block = williams_test([[0.9], [0.4], [0.1], [0.1]])
    assert [row.critical_value for row in one_block] == [None] * 4
    assert [row.significant for row in one_block] == [True, True, False, False]


SPOT_VALUES = {
    20.0: (2.528, 2.584, 2.601, 2.609),
    60.0: (2.390, 2.435, 2.448, 2.453),
    1e6: (2.326, 2.366, 2.377, 2.382),
}


@pytest.mark.parametrize("degrees_of_freedom", SPOT_VALUES)
def test_critical_values_equal_the_tabulated_ones(degrees_of_freedom: float) -> None:
    computed = [williams_critical_value(n, degrees_of_freedom) for n in (1, 2, 3, 4)]
    # Half a unit of the last printed digit, and a hair for a table that rounds halves another way.
    np.testing.assert_allclose(computed, SPOT_VALUES[degrees_of_freedom], rtol=0, atol=5.5e-4)


@pytest.mark.parametrize("alpha", [1e-6, 0.01, 0.4])
def test_one_dose_is_student_t(alpha: float) -> None:
    for degrees_of_freedom in (1, 2, 10, 212, 1e6):
        expected = stats.t.isf(alpha, degrees_of_freedom)
        assert williams_critical_value(1, degrees_of_freedom, alpha) == pytest.approx(expected, rel=1e-6)
    # Below two degrees of freedom the density of s has a kink at 0, which Gauss-Legendre quadrature feels.
    assert williams_critical_value(1, 1.5) == pytest.approx(stats.t.isf(0.01, 1.5), rel=3e-5)
