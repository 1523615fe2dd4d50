"""Williams' test against independent quadrature, simulation, Student's t and hand-worked numbers."""

import dataclasses
import json
import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.williams_test import WilliamsRow, bic, isotonic_means, williams_critical_value, williams_test
from tests.support.isotonic import max_min_isotonic_means

# One-sided 1 % critical values of Williams' test for 1, 2, 3, 4 doses, equal group sizes, to the digits printed.


def test_isotonic_means_by_hand() -> None:
    # 3, 2 -> 2.5, 2.5; then 6, 4, 5: 6, 4 -> 5, 5, and 5 is no violator; 1 in front stays.
    np.testing.assert_allclose(isotonic_means([1, 3, 2, 6, 4, 5]), [1, 2.5, 2.5, 5, 5, 5], rtol=1e-15)
    # A late small mean pools everything before it that is larger: (4 + 5 + 0) / 3 = 3.
    np.testing.assert_allclose(isotonic_means([2, 4, 5, 0]), [2, 3, 3, 3], rtol=1e-15)
    np.testing.assert_array_equal(isotonic_means([7.0]), [7.0])


def test_isotonic_means_equal_the_max_min_formula() -> None:
    rng = np.random.default_rng(4)
    for n in range(1, 9):
        means = rng.standard_normal((50, n)).round(1)  # rounded: ties occur
        np.testing.assert_allclose([isotonic_means(m) for m in means], max_min_isotonic_means(means), atol=1e-14)


@pytest.mark.parametrize(
    ("means", "message"),
    [
        ([], r"means has the shape \(0,\), it must be"),
        ([[1.0, 2.0]], r"means has the shape \(1, 2\), it must be"),
        ([1.0, math.nan], "every mean must be finite"),
    ],
)
def test_isotonic_means_refuses(means: list[float], message: str) -> None:
    with pytest.raises(InvalidArgumentError, match=message):
        isotonic_means(means)


def test_worked_example() -> None:
    # Three numbers of lobes in three blocks. Means 4, 1, 2 for K = 1, 2, 3; grand mean 7/3, block means all 7/3,
    # so the residuals are the deviations from the row means: squares 1+1+0, 0+1+1, 1+0+1 = 6, on 2*2 = 4
    # degrees of freedom: s^2 = 1.5, and the standard error of a difference is sqrt(2 * 1.5 / 3) = 1.
    statistic = [[5.0, 3.0, 4.0], [1.0, 2.0, 0.0], [1.0, 2.0, 3.0]]
    result = williams_test(statistic, alpha=0.1)
    assert result.variance == pytest.approx(1.5, rel=1e-14)
    assert result.degrees_of_freedom == 4
    assert [row.n_lobes for row in result.table] == [1, 2, 3]
    np.testing.assert_allclose([row.mean for row in result.table], [4, 1, 2], rtol=1e-14)
    np.testing.assert_allclose([row.isotonic_mean for row in result.table], [4, 1, 2], rtol=1e-14)
    # K = 1: (4 - 2) / 1 = 2 against 2 doses; K = 2 is better than the control: (1 - 2) / 1.
    assert result.table[0].t == pytest.approx(2.0, rel=1e-14)
    assert result.table[1].t == pytest.approx(-1.0, rel=1e-14)
    assert result.table[0].critical_value == williams_critical_value(2, 4, 0.1)
    assert result.table[1].critical_value == williams_critical_value(1, 4, 0.1)
    assert (result.table[2].t, result.table[2].critical_value) == (None, None)
    assert [row.significant for row in result.table] == [True, False, False]
    assert result.n_lobes == 2
    # At 1 % (critical value above 3.7) the same numbers are not enough, and one lobe does.
    assert williams_test(statistic).n_lobes == 1


def test_residual_variance_is_that_of_a_linear_model_with_blocks() -> None:
    statistic = np.random.default_rng(8).standard_normal((4, 6))
    rows, columns = np.indices(statistic.shape)
    design = np.hstack([np.eye(4)[rows.ravel()], np.eye(6)[columns.ravel()]])
    fitted = design @ np.linalg.lstsq(design, statistic.ravel(), rcond=None)[0]
    result = williams_test(statistic)
    assert result.degrees_of_freedom == 24 - np.linalg.matrix_rank(design)
    expected = np.sum((statistic.ravel() - fitted) ** 2) / result.degrees_of_freedom
    assert result.variance == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("n_lobes_max", "n_blocks"), [(3, 2), (5, 9)])
def test_type_one_error_is_alpha(n_lobes_max: int, n_blocks: int) -> None:
    rng = np.random.default_rng(99)
    alpha, repeats = 0.05, 4000
    block_effects = 10.0 * rng.standard_normal((repeats, 1, n_blocks))
    draws = 2.0 + block_effects + rng.standard_normal((repeats, n_lobes_max, n_blocks))
    rate = np.mean([williams_test(draw, alpha).n_lobes > 1 for draw in draws])
    assert abs(rate - alpha) < 4.0 * math.sqrt(alpha * (1.0 - alpha) / repeats)


@pytest.mark.parametrize("enough", [1, 2, 3, 4, 5])
def test_finds_where_lobes_stop_paying(enough: int) -> None:
    rng = np.random.default_rng(enough)
    n_lobes = np.arange(1, 6)[:, np.newaxis]
    mean = 0.1 * np.maximum(enough - n_lobes, 0)
    noise = 0.02 * rng.standard_normal((200, 5, 54))
    chosen = [williams_test(mean + 3.0 * rng.standard_normal(54) + n).n_lobes for n in noise]
    assert min(chosen) == enough  # a step of 0.1 has a standard error of 0.004: never missed
    assert np.mean(np.asarray(chosen) == enough) >= 0.97  # at most 1 % too many in the long run
    # The other direction: if fewer lobes were better, one would do.
    assert williams_test(-mean + noise[0]).n_lobes == 1


def test_steps_down_from_the_largest_difference_and_stops() -> None:
    # Orthogonal noise: each row has mean 0 and the residual variance is the same for every choice of means.
    noise = 0.1 * np.array([[1, -1, 0, 0], [0, 0, 1, -1], [-1, 1, 0, 0], [0, 0, -1, 1]])
    # E_p is not monotone: K = 2 and 3 are far worse than the control, K = 1 much better than any.
    result = williams_test(noise + np.array([[-9.0], [4.0], [3.0], [0.0]]))
    # Pooling K = 1 (the largest dose) with its neighbours brings it below the control, so nothing is significant,
    np.testing.assert_allclose([row.isotonic_mean for row in result.table], [-2 / 3, -2 / 3, -2 / 3, 0], atol=1e-14)
    assert result.n_lobes == 1
    assert not any(row.significant for row in result.table)
    # and with a clear K = 1 the procedure goes on to K = 2, then stops at K = 3.
    result = williams_test(noise + np.array([[9.0], [4.0], [0.0], [0.0]]))
    assert [row.significant for row in result.table] == [True, True, False, False]
    assert result.n_lobes == 3


def test_a_row_after_the_first_stop_is_never_significant() -> None:
    # Craft t_1 of K = 2 between the critical values of one and of two doses, with K = 1 equal to K = 2:
    # K = 2 alone would be significant, but K = 1 is tested first and is not.
    noise = np.array([[1.0, -1.0, 0.0], [-1.0, 0.0, 1.0], [0.0, 1.0, -1.0]])  # s^2 = 6/4, standard error 1
    between = 0.5 * (williams_critical_value(1, 4) + williams_critical_value(2, 4))
    result = williams_test(noise + np.array([[between], [between], [0.0]]))
    second = result.table[1]
    assert second.t is not None
    assert second.critical_value is not None
    assert second.t > second.critical_value
    assert not second.significant
    assert result.n_lobes == 1


def test_ties_prefer_fewer_lobes() -> None:
    statistic = np.random.default_rng(3).standard_normal((5, 7))
    statistic[:] -= statistic.mean(axis=1, keepdims=True)
    result = williams_test(statistic)  # all means equal, up to rounding
    assert result.n_lobes == 1
    assert result.table[0].t == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("size", [1.0, 1e6])
def test_block_effects_do_not_matter(size: float) -> None:
    rng = np.random.default_rng(17)
    statistic = rng.standard_normal((5, 12)) + np.array([[3.0], [1.0], [0.2], [0.1], [0.0]])
    plain = williams_test(statistic)
    shifted = williams_test(statistic + size * rng.standard_normal(12))
    assert shifted.n_lobes == plain.n_lobes
    assert shifted.variance == pytest.approx(plain.variance, rel=1e-8)
    for a, b in zip(plain.table[:-1], shifted.table[:-1], strict=True):
        assert a.t == pytest.approx(b.t, abs=1e-8)
        assert a.significant == b.significant


def test_block_order_does_not_matter_and_scale_cancels() -> None:
    statistic = np.random.default_rng(5).standard_normal((4, 8)) + np.array([[2.0], [0.0], [0.0], [0.0]])
    plain, other = williams_test(statistic), williams_test(1e-3 * statistic[:, ::-1])
    assert other.n_lobes == plain.n_lobes
    assert [row.t for row in other.table[:-1]] == pytest.approx([row.t for row in plain.table[:-1]], rel=1e-10)


def test_one_number_of_lobes_is_the_answer() -> None:
    result = williams_test([[0.3, 0.5, 0.9]])
    assert result.n_lobes == 1
    assert result.degrees_of_freedom == 0
    (row,) = result.table
    assert row == WilliamsRow(1, row.mean, row.mean, None, None, False)
    assert row.mean == pytest.approx(17 / 30, rel=1e-14)


def test_zero_residual_variance_takes_the_means_as_exact() -> None:
    blocks = np.array([0.1, 0.7, 1e3])  # sums with these are not exact: only rounding is left as residual
    result = williams_test(np.array([[0.5], [0.2], [0.0], [0.0]]) + blocks)
    assert result.variance == 0.0
    assert [row.t for row in result.table] == [None] * 4
    assert [row.significant for row in result.table] == [True, True, False, False]
    assert result.n_lobes == 3
    assert williams_test(np.tile(blocks, (5, 1))).n_lobes == 1


def test_one_block_takes_the_means_as_exact() -> None:
    result = williams_test([[0.9], [0.4], [0.1], [0.1]])
    assert (result.variance, result.degrees_of_freedom) == (0.0, 0)
    assert [row.critical_value for row in result.table] == [None] * 4
    assert result.n_lobes == 3
    assert williams_test([[0.9], [0.4], [0.1]]).n_lobes == 3


def test_rows_are_plain_json() -> None:
    rng = np.random.default_rng(0)
    for statistic in (rng.standard_normal((5, 6)), np.zeros((3, 4)), np.ones((2, 1))):
        result = williams_test(statistic)
        text = json.dumps([dataclasses.asdict(row) for row in result.table], allow_nan=False)
        assert [row["n_lobes"] for row in json.loads(text)] == list(range(1, len(statistic) + 1))
        json.dumps(dataclasses.asdict(result), allow_nan=False)


@pytest.mark.parametrize(
    ("statistic", "message"),
    [
        ([1.0, 2.0], r"statistic has the shape \(2,\), it must be"),
        (np.zeros((0, 3)), r"statistic has the shape \(0, 3\), it must be"),
        (np.zeros((3, 0)), r"statistic has the shape \(3, 0\), it must be"),
        (np.zeros((22, 2)), "statistic has 22 rows, it may have 21 at most"),
        ([[1.0, math.nan], [1.0, 2.0]], "statistic holds NaN or infinity; every block must have a finite value"),
        ([[1.0, math.inf], [1.0, 2.0]], "statistic holds NaN or infinity; every block must have a finite value"),
    ],
)
def test_williams_test_refuses(statistic: NDArray[np.float64], message: str) -> None:
    with pytest.raises(InvalidArgumentError, match=message):
        williams_test(statistic)


def test_williams_test_checks_alpha_even_where_it_is_not_needed() -> None:
    with pytest.raises(InvalidArgumentError, match="alpha is 1"):
        williams_test([[0.0]], alpha=1.0)


def test_bic_differs_from_the_gaussian_likelihood_by_a_constant() -> None:
    rng = np.random.default_rng(11)
    x = np.linspace(-1.0, 1.0, 60)
    y = 1.0 + 2.0 * x + 0.1 * rng.standard_normal(60)
    residuals = [y - np.polynomial.Polynomial.fit(x, y, degree)(x) for degree in range(4)]
    full = [
        -2.0 * stats.norm.logpdf(r, scale=math.sqrt(np.mean(r**2))).sum() + p * math.log(60)
        for p, r in enumerate(residuals, start=1)
    ]
    ours = bic([np.sum(r**2) for r in residuals], 60, [1, 2, 3, 4])
    np.testing.assert_allclose(ours - full, -60 * (math.log(2.0 * math.pi) + 1.0), rtol=1e-12)
    assert int(np.argmin(ours)) == 1


def test_bic_broadcasts_and_takes_an_exact_fit() -> None:
    table = bic(np.ones((3, 1)), 100.0, np.arange(4))
    assert table.shape == (3, 4)
    np.testing.assert_allclose(np.diff(table, axis=1), math.log(100.0))
    assert bic(0.0, 10, 2) == -math.inf
    assert float(bic(10.0, 10, 2)) == pytest.approx(2.0 * math.log(10.0))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((-1.0, 10, 2), "squared_error must be finite and not negative"),
        ((math.nan, 10, 2), "squared_error must be finite and not negative"),
        ((1.0, 0, 2), "n_samples must be finite and positive"),
        ((1.0, 10, -1), "n_parameters must be finite and not negative"),
    ],
)
def test_bic_refuses(arguments: tuple[float, float, float], message: str) -> None:
    with pytest.raises(InvalidArgumentError, match=message):
        bic(*arguments)
