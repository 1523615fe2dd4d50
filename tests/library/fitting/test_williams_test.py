"""Williams' test against simulation, a linear model and hand-worked numbers."""

import math

import numpy as np
import pytest
from numpy.typing import ArrayLike

from dsbrdf.fitting.williams_test import WilliamsRow, williams_critical_value, williams_test
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


@pytest.mark.parametrize(("n_lobes_max", "n_blocks"), [(3, 2), (5, 9)])
def test_type_one_error_is_alpha(n_lobes_max: int, n_blocks: int) -> None:
    rng = np.random.default_rng(99)
    alpha, repeats = 0.05, 4000
    block_effects = 10.0 * rng.standard_normal((repeats, 1, n_blocks))
    draws = 2.0 + block_effects + rng.standard_normal((repeats, n_lobes_max, n_blocks))
    rate = np.mean([chosen(draw, alpha) > 1 for draw in draws])
    assert abs(rate - alpha) < 4.0 * math.sqrt(alpha * (1.0 - alpha) / repeats)


@pytest.mark.parametrize("enough", [1, 2, 3, 4, 5])
def test_finds_where_lobes_stop_paying(enough: int) -> None:
    rng = np.random.default_rng(enough)
    n_lobes = np.arange(1, 6)[:, np.newaxis]
    mean = 0.1 * np.maximum(enough - n_lobes, 0)
    noise = 0.02 * rng.standard_normal((200, 5, 54))
    found = [chosen(mean + 3.0 * rng.standard_normal(54) + n) for n in noise]
    assert min(found) == enough  # a step of 0.1 has a standard error of 0.004: never missed
    assert np.mean(np.asarray(found) == enough) >= 0.97  # at most 1 % too many in the long run
    # The other direction: if fewer lobes were better, one would do.
    assert chosen(-mean + noise[0]) == 1


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


@pytest.mark.parametrize("size", [1.0, 1e6])
def test_block_effects_and_scale_do_not_matter(size: float) -> None:
    rng = np.random.default_rng(17)
    statistic = rng.standard_normal((5, 12)) + np.array([[3.0], [1.0], [0.2], [0.1], [0.0]])
    plain = williams_test(statistic)
    other = williams_test(1e-3 * (statistic + size * rng.standard_normal(12)))
    for a, b in zip(plain[:-1], other[:-1], strict=True):
        assert a.t == pytest.approx(b.t, abs=1e-8)
        assert a.significant == b.significant


def test_one_number_of_lobes_is_the_answer() -> None:
    (row,) = williams_test([[0.3, 0.5, 0.9]])
    assert row == WilliamsRow(1, row.mean, None, None, False)
    assert row.mean == pytest.approx(17 / 30, rel=1e-14)


def test_without_residual_variance_the_means_are_exact() -> None:
    blocks = np.array([0.1, 0.7, 1e3])  # sums with these are not exact: only rounding is left as residual
    rows = williams_test(np.array([[0.5], [0.2], [0.0], [0.0]]) + blocks)
    assert [row.t for row in rows] == [None] * 4
    assert [row.significant for row in rows] == [True, True, False, False]
    assert chosen(np.tile(blocks, (5, 1))) == 1
    one_block = williams_test([[0.9], [0.4], [0.1], [0.1]])
    assert [row.critical_value for row in one_block] == [None] * 4
    assert [row.significant for row in one_block] == [True, True, False, False]
