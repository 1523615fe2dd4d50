"""Lobes are found where they are, and a lobe more is never worse."""

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf.data.grid import THETA_HALF
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import profiles
from dsbrdf.fitting.least_squares import FitData, ProfileProblem
from dsbrdf.fitting.matching_pursuit import Mixture, grow
from dsbrdf.model.hemi_epd import half_width

Array = NDArray[np.float64]

KNOTS = np.array([0, 15, 30, 45, 60, 75])
SHARE = np.arange(90.0) / 90.0
CHANNEL = np.array([1.0, 0.7, 1.2])[:, None, None]


def lobe(kappa: float, gamma: float, center: float = 0.0) -> Array:
    """Profile (3, 90, 90) of a lobe that grows towards grazing."""
    scale = kappa * CHANNEL * (1.0 + 0.3 * SHARE[:, None])
    return np.asarray(np.expm1(scale * np.cos(THETA_HALF - center) ** gamma))


def problem_of(mean: Array, smoothing: float = 1e-9) -> ProfileProblem:
    data = FitData(mean, np.full_like(mean, 180.0), np.zeros_like(mean), mean.max(axis=2))
    return ProfileProblem(data, KNOTS, KNOTS, smoothing=smoothing, coupling=0.0)


def relative_error(problem: ProfileProblem, mixture: Mixture) -> float:
    return float(problem.squared_error(mixture.lobes, mixture.unknowns).sum() / problem.signal.sum())


def nothing() -> None:
    """Nobody counts."""


@pytest.mark.parametrize(("kappa", "gamma"), [(4.0, 3000.0), (2.0, 60.0), (0.3, 1.0)])
def test_one_lobe_is_recovered(kappa: float, gamma: float) -> None:
    problem = problem_of(lobe(kappa, gamma))
    mixture = grow(problem, None, ring=False, tick=nothing)
    log_kappa, log_gamma, center = mixture.lobes.split(mixture.unknowns)
    expected = kappa * CHANNEL[:, 0] * (1.0 + 0.3 * SHARE[KNOTS])
    np.testing.assert_allclose(np.exp(log_kappa[:, :, 0]), expected, rtol=1e-3)
    np.testing.assert_allclose(np.exp(log_gamma[:, :, 0]), gamma, rtol=1e-2)
    assert (mixture.lobes.centered, mixture.lobes.rings, center.size) == (1, 0, 0)


def test_second_lobe_finds_what_the_first_leaves() -> None:
    problem = problem_of(lobe(4.0, 1000.0) + lobe(0.3, 1.0))
    one = grow(problem, None, ring=False, tick=nothing)
    two = grow(problem, one, ring=False, tick=nothing)
    assert relative_error(problem, one) > 1e-5
    assert relative_error(problem, two) < 1e-8
    log_kappa, log_gamma, _ = two.lobes.split(two.unknowns)
    widths = np.degrees(np.sort(half_width(np.exp(log_kappa), np.exp(log_gamma)), axis=2)).mean(axis=(0, 1))
    assert widths[0] < 3.0
    assert widths[1] > 40.0


def test_a_lobe_more_never_worsens_the_error(plastic: Measurement, matte: Measurement) -> None:
    for measurement in (plastic, matte):
        data = profiles(measurement)
        used = FitData(data.mean, data.weight, data.within, np.where(data.weight > 0, data.mean, 0.0).max(axis=2))
        problem = ProfileProblem(used, KNOTS, KNOTS)
        mixture, errors = None, []
        for ring in (False, False, True, False, True):
            mixture = grow(problem, mixture, ring=ring, tick=nothing)
            errors.append(relative_error(problem, mixture))
        assert np.all(np.diff(errors) <= 1e-6 * np.array(errors[:-1]) + 1e-9), errors


@pytest.mark.parametrize("center", [6.0, 25.0, 60.0])
def test_ring_is_found(center: float) -> None:
    problem = problem_of(lobe(1.0, 3.0) + lobe(1.0, 200.0, float(np.radians(center))))
    base = grow(problem, None, ring=False, tick=nothing)
    mixture = grow(problem, base, ring=True, tick=nothing)
    assert (mixture.lobes.centered, mixture.lobes.rings) == (1, 1)
    assert relative_error(problem, mixture) < 0.05 * relative_error(problem, base)
    np.testing.assert_allclose(np.degrees(mixture.lobes.split(mixture.unknowns)[2]), center, atol=1.0)


def test_rings_stay_behind_the_centred_lobes() -> None:
    problem = problem_of(lobe(1.0, 3.0) + lobe(1.0, 200.0, 0.5) + lobe(4.0, 2000.0))
    mixture = grow(problem, None, ring=False, tick=nothing)
    mixture = grow(problem, mixture, ring=True, tick=nothing)
    mixture = grow(problem, mixture, ring=False, tick=nothing)
    assert (mixture.lobes.centered, mixture.lobes.rings) == (2, 1)
    assert mixture.unknowns.shape == (3, KNOTS.size, 7)
    assert relative_error(problem, mixture) < 1e-3
    np.testing.assert_allclose(mixture.lobes.split(mixture.unknowns)[2], 0.5, atol=0.05)


def test_every_try_is_counted_and_can_be_stopped() -> None:
    problem = problem_of(lobe(2.0, 60.0))
    ticks: list[int] = []
    grow(problem, None, ring=False, tick=lambda: ticks.append(1))
    assert 1 <= len(ticks) <= 3

    def stop() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        grow(problem, None, ring=False, tick=stop)
