"""The number of lobes, and whether rings pay: right on materials made of known lobes."""

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf.data.grid import CENTER_CUTOFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.reduction import Profiles, profiles
from dsbrdf.data.synthetic import model_measurement
from dsbrdf.fitting.least_squares import FitData, Lobes, ProfileProblem
from dsbrdf.fitting.lobe_selection import (
    BACKGROUND,
    INDIFFERENCE,
    LARGEST_AUTOMATIC,
    choose_n_lobes,
    expected_negative_log_probability,
    find_structure,
)
from dsbrdf.fitting.matching_pursuit import Mixture
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import fit
from dsbrdf.fitting.williams_test import bic, williams_critical_value
from dsbrdf.model.dsbrdf import DSBRDF
from tests.support.mixtures import choose, mixture

Array = NDArray[np.float64]

KNOTS = np.array([0, 20, 40, 60])


def noisy_profiles(model: DSBRDF, seed: int = 0) -> Profiles:
    return profiles(model_measurement(model, noise=0.02, seed=seed))


def fit_data(data: Profiles) -> FitData:
    return FitData(data.mean, data.weight, data.within, np.where(data.weight > 0, data.mean, 0.0).max(axis=2))


def with_ring(model: DSBRDF, center: float, kappa: float, gamma: float) -> DSBRDF:
    """The model and one ring lobe more, its center in degrees."""
    one = np.ones((3, model.theta_diff.size, 1))
    return DSBRDF(
        model.theta_diff,
        np.concatenate([model.kappa, kappa * one], axis=2),
        np.concatenate([model.gamma, gamma * one], axis=2),
        np.concatenate([model.center, np.radians(center) * one], axis=2),
        model.delta,
    )


def plain_e_p(
    data: FitData, row: int, columns: NDArray[np.intp], channel: int, lobes: list[tuple[float, float]]
) -> float:
    """Nishino 2009, section 5, as a loop: -E[log p] under the data, p with a hundredth of a uniform density."""
    used = [int(i) for i in columns if data.weight[channel, row, i] > 0]
    step = np.gradient(THETA_HALF[columns])
    area = model_energy = data_energy = 0.0
    parts = []
    for place, i in enumerate(columns):
        if int(i) not in used or THETA_HALF[i] < CENTER_CUTOFF:
            continue
        solid_angle = float(np.sin(THETA_HALF[i]) * step[place])
        value = sum(float(np.expm1(k * np.cos(THETA_HALF[i]) ** g)) for k, g in lobes)
        area += solid_angle
        model_energy += solid_angle * value
        data_energy += solid_angle * data.mean[channel, row, i]
        parts.append((solid_angle * data.mean[channel, row, i], value))
    total = 0.0
    for energy, value in parts:
        total -= energy * np.log((1 - BACKGROUND) * value / model_energy + BACKGROUND / area)
    return float(total / data_energy)


def test_e_p_agrees_with_a_plain_loop() -> None:
    data = fit_data(noisy_profiles(mixture(2, 0)))
    columns = np.arange(1, 90, 2)
    random = np.random.default_rng(1)
    kappa, gamma = random.uniform(0.1, 3.0, (3, KNOTS.size, 2)), random.uniform(1.0, 300.0, (3, KNOTS.size, 2))
    mixed = Mixture(Lobes(2), np.concatenate([np.log(kappa), np.log(gamma)], axis=2))
    found = expected_negative_log_probability(ProfileProblem(data, KNOTS, KNOTS, columns), mixed).reshape(3, -1)
    for channel in range(3):
        for d, row in enumerate(KNOTS):
            lobes = list(zip(kappa[channel, d].tolist(), gamma[channel, d].tolist(), strict=True))
            expected = plain_e_p(data, int(row), columns, channel, lobes)
            assert found[channel, d] == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_e_p_is_smallest_for_the_distribution_of_the_data() -> None:
    truth = mixture(2, 3)
    data = fit_data(profiles(model_measurement(truth)))
    problem = ProfileProblem(data, KNOTS, KNOTS)
    kappa, gamma, _, _ = truth.parameters_at(THETA_DIFF[KNOTS])
    right = np.concatenate([np.log(np.moveaxis(kappa, 1, 0)), np.log(np.moveaxis(gamma, 1, 0))], axis=2)
    best = expected_negative_log_probability(problem, Mixture(Lobes(2), right))
    for column in range(4):
        for shift in (-0.3, 0.3):
            wrong = right.copy()
            wrong[:, :, column] += shift
            assert np.all(expected_negative_log_probability(problem, Mixture(Lobes(2), wrong)) > best)


def test_e_p_is_nan_without_data() -> None:
    data = fit_data(noisy_profiles(mixture(1, 0)))
    data.weight[1, 20] = 0.0
    mixed = Mixture(Lobes(1), np.zeros((3, KNOTS.size, 2)))
    found = expected_negative_log_probability(ProfileProblem(data, KNOTS, KNOTS), mixed).reshape(3, -1)
    assert np.isnan(found[1, 1])
    assert np.isfinite(np.delete(found.ravel(), KNOTS.size + 1)).all()


@pytest.mark.parametrize("n_lobes", [1, 2, 3])
@pytest.mark.parametrize("seed", [0, 1])
def test_automatic_numbers_are_right(n_lobes: int, seed: int) -> None:
    assert choose(n_lobes, seed) == (n_lobes, 0)


@pytest.mark.parametrize(("center", "gamma"), [(20.0, 150.0), (45.0, 100.0)])
def test_ring_is_added_where_it_pays(center: float, gamma: float) -> None:
    truth = with_ring(mixture(2, 1), center, 1.0, gamma)
    result = fit(noisy_profiles(truth))
    rings = np.any(result.model.center > 0, axis=(0, 1))
    assert rings.sum() == 1
    assert [row["pays"] for row in result.report.rings] in ([True], [True, False])
    np.testing.assert_allclose(np.degrees(result.model.center[:, :, rings]), center, atol=1.0)
    assert result.report.rings[0]["squared_error"] > 0.0


def test_ring_lobes_asked_for_are_there_even_where_they_do_not_pay() -> None:
    data = noisy_profiles(mixture(1, 0))
    result = fit(data, FitOptions(n_lobes=1, ring_lobes=2))
    assert result.model.n_lobes == 3
    assert len(result.report.rings) == 2
    none = fit(data, FitOptions(n_lobes=1, ring_lobes=0))
    assert none.model.n_lobes == 1
    assert not none.model.center.any()
    assert none.report.rings == []


def test_table_holds_every_number_of_lobes() -> None:
    ticks: list[int] = []
    data = fit_data(noisy_profiles(mixture(2, 0)))
    structure = find_structure(data, KNOTS, "auto", 0, lambda: ticks.append(1))
    table = structure.selection
    assert structure.mixture.lobes == Lobes(2)
    assert [row["n_lobes"] for row in table] == list(range(1, LARGEST_AUTOMATIC + 1))
    assert len(ticks) >= LARGEST_AUTOMATIC
    errors = np.array([row["squared_error"] for row in table])
    assert np.all(errors[1:] <= errors[:-1] * (1.0 + 1e-5))
    assert [row["significant"] for row in table] == [True, False, False, False, False]
    columns = np.flatnonzero(data.weight.sum(axis=(0, 1)) > 0)[::2]
    n_samples = np.count_nonzero(data.weight[:, KNOTS][:, :, columns])
    for row in table:
        assert row["bic"] == pytest.approx(bic(row["squared_error"], n_samples, 3 * KNOTS.size * 2 * row["n_lobes"]))
    first = table[0]
    assert first["critical_value"] == pytest.approx(williams_critical_value(4, 4 * (3 * KNOTS.size - 1)))
    assert first["t"] > first["critical_value"]
    assert table[1]["critical_value"] == pytest.approx(williams_critical_value(3, 3 * (3 * KNOTS.size - 1)))
    assert all(row["t"] is None for row in table[2:])


def test_differences_that_matter_to_nobody_do_not_decide(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = ProfileProblem(fit_data(noisy_profiles(mixture(1, 0))), KNOTS, KNOTS)
    mixtures = [Mixture(Lobes(k), np.zeros((3, KNOTS.size, 2 * k))) for k in (1, 2, 3)]
    random = np.random.default_rng(0)

    def choose_with(loss: float) -> int:
        scatter = 1e-6 * random.standard_normal((3, 12))
        answers = iter(scatter + np.array([loss, 0.0, 0.0])[:, None])
        monkeypatch.setattr("dsbrdf.fitting.lobe_selection.expected_negative_log_probability", lambda *_: next(answers))
        return choose_n_lobes(problem, problem, mixtures)[0]

    assert choose_with(0.9 * INDIFFERENCE) == 1
    assert choose_with(1.1 * INDIFFERENCE) == 2


def test_fixed_number_is_taken_and_tabulated_up_to_it() -> None:
    data = fit_data(noisy_profiles(mixture(3, 0)))
    structure = find_structure(data, KNOTS, 2, 0, lambda: None)
    assert structure.mixture.lobes == Lobes(2)
    assert [row["n_lobes"] for row in structure.selection] == [1, 2]
