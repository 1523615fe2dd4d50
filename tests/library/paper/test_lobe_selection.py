import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.special import stdtrit

from dsbrdf import FitOptions, Profiles, fit
from dsbrdf.arrays import Array
from dsbrdf.data import THETA_HALF
from dsbrdf.fitting import OUTSIDE_CENTER
from dsbrdf.paper import WilliamsRow, em, williams_critical_value, williams_test
from dsbrdf.paper.paper_method import UNIFORM_FRACTION, choose_n_lobes, expected_negative_log_probability
from tests.support.models import plain_lobe
from tests.support.reproduced import assert_reproduced, of_fit

ANGLES = THETA_HALF[OUTSIDE_CENTER]
LOBES = np.array([[4.0, 1500.0], [1.5, 40.0], [0.3, 1.0]])


def slices_of(n_lobes: int, noise: float = 0.02, count: int = 12) -> Array:
    random = np.random.default_rng(n_lobes)
    factor = random.uniform(0.8, 1.2, (count, n_lobes, 2))
    kappa, gamma = np.moveaxis(LOBES[:n_lobes] * factor, -1, 0)[..., None]
    curves = plain_lobe(ANGLES, kappa, gamma).sum(axis=1)
    return np.asarray(curves * (1.0 + noise * random.standard_normal(curves.shape)))


@pytest.mark.parametrize("n_lobes", [1, 2])
def test_separated_lobes_are_counted(n_lobes: int) -> None:
    mean = slices_of(n_lobes)
    weight, none = np.full(mean.shape, 180.0), np.zeros_like(mean)
    fit_with = partial(em.fit_slices, ANGLES, mean, weight, iterations=60)
    chosen, table = choose_n_lobes(ANGLES, mean, weight, none, fit_with)
    assert chosen == n_lobes
    assert [row.n_lobes for row in table] == [1, 2, 3, 4, 5]
    assert [row.significant for row in table] == [k < n_lobes for k in range(1, 6)]


def test_table_holds_the_test_the_error_and_the_criterion() -> None:
    mean = slices_of(2, count=9)
    weight = np.random.default_rng(0).uniform(50.0, 180.0, mean.shape)
    within = np.random.default_rng(1).uniform(0.0, 0.1, mean.shape)
    fits = {k: em.fit_slices(ANGLES, mean, weight, k, iterations=30) for k in range(1, 6)}
    chosen, table = choose_n_lobes(ANGLES, mean, weight, within, fits.__getitem__)
    statistic, n = [], weight.sum()
    for k, row in zip(range(1, 6), table, strict=True):
        lobes = plain_lobe(ANGLES, fits[k].kappa[..., None], fits[k].gamma[..., None])
        curves = lobes.sum(axis=1)
        error = np.sum(weight * (curves - mean) ** 2) + within.sum()
        assert row.squared_error == pytest.approx(error, rel=1e-12)
        # Twice the log-likelihood of Gaussian residuals of this variance, up to a constant, and log(n) a parameter.
        assert row.bic == pytest.approx(-2.0 * n * np.log(np.sqrt(n / error)) + 2 * k * 9 * np.log(n), rel=1e-12)
        statistic.append(expected_negative_log_probability(ANGLES, mean, weight > 0, curves))
        assert row.e_p == pytest.approx(np.mean(statistic[-1]), rel=1e-12)
    expected = williams_test(statistic)
    assert chosen == next(test.n_lobes for test in expected if not test.significant)
    for row, test in zip(table, expected, strict=True):
        assert row.t == (None if test.t is None else pytest.approx(test.t, rel=1e-12))
        assert (row.critical_value, row.significant) == (test.critical_value, test.significant)


def test_expected_negative_log_probability_is_that_of_a_loop() -> None:
    random = np.random.default_rng(3)
    mean, curves = random.uniform(0.1, 2.0, (2, 1, ANGLES.size))
    used = random.uniform(size=ANGLES.size) > 0.2
    areas = np.where(used, np.sin(ANGLES) * np.gradient(ANGLES), 0.0).tolist()
    total = sum(area * curve for area, curve in zip(areas, curves[0], strict=True))
    light = logs = 0.0
    for area, value, curve in zip(areas, mean[0], curves[0], strict=True):
        logs -= area * value * np.log((1.0 - UNIFORM_FRACTION) * curve / total + UNIFORM_FRACTION / sum(areas))
        light += area * value
    found = expected_negative_log_probability(ANGLES, mean, used[None], curves)
    assert found == pytest.approx(logs / light, rel=1e-12)


@pytest.mark.filterwarnings("ignore::dsbrdf.errors.ConvergenceWarning")
def test_papers_method_chooses_and_says_so(plastic_profiles: Profiles) -> None:
    options, shares = FitOptions(method="paper", em_iterations=3), list[float]()
    chosen = fit(plastic_profiles, options, progress=shares.append)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert shares == sorted(shares)
    assert_reproduced("fit/paper", of_fit(chosen), 1e-3)
    report = chosen.report
    assert [row.n_lobes for row in report.selection] == [1, 2, 3, 4, 5]
    assert report.options.n_lobes == "auto"
    n_lobes = [row.significant for row in report.selection].index(False) + 1
    result = fit(plastic_profiles, replace(options, n_lobes=n_lobes))
    assert chosen.model == result.model
    assert report.n_numbers == result.model.n_numbers
    assert result.report.selection == ()
    json.dumps(report.to_dict(), allow_nan=False)


def chosen(statistic: ArrayLike, alpha: float = 0.01) -> int:
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
    # With means 2, 4, 1 the first two break the order: both are (3 - 1) / 1. What blocks have in common does not count.
    turned = np.array([[3.0, 1.0, 2.0], [4.0, 5.0, 3.0], [0.0, 1.0, 2.0]])
    one, two, _ = williams_test(turned + np.array([0.0, 100.0, -7.0]))
    assert [one.t, two.t] == pytest.approx([2.0, 2.0], rel=1e-12)


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


def test_one_dose_is_student_t() -> None:
    for degrees_of_freedom, alpha in ((1, 1e-6), (2, 1e-6), (212, 0.4)):
        expected = -stdtrit(degrees_of_freedom, alpha)
        assert williams_critical_value(1, degrees_of_freedom, alpha) == pytest.approx(expected, rel=1e-6)
