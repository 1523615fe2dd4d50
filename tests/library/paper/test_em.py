"""Algorithm 1 of Nishino 2009 on a batch against its plain SciPy version on the raw samples, and each step alone."""

from functools import partial

import numpy as np
import pytest
from scipy.optimize import brentq, least_squares, minimize_scalar

from dsbrdf import Measurement, Profiles, profiles
from dsbrdf.arrays import Array
from dsbrdf.data import PHI_DIFF, THETA_DIFF, THETA_HALF
from dsbrdf.paper import em
from tests.support.models import plain_lobe
from tests.support.soak import repeats

CUTOFF = float(np.radians(80.0))
ITERATIONS = repeats(3, 6)  # One of the plain version takes a tenth of a second.
OUTSIDE = np.radians(1.0) <= THETA_HALF
ANGLES = THETA_HALF[OUTSIDE]


def raw_slice(measurement: Measurement, channel: int, row: int) -> tuple[Array, Array]:
    """Theta_half and values (N,) of the valid samples within the cutoff and the perimeter mask, beyond 1 degree."""
    half, phi = np.meshgrid(THETA_HALF, PHI_DIFF, indexing="ij")
    diff = THETA_DIFF[row]
    lowest = np.cos(half) * np.cos(diff) - np.abs(np.sin(half) * np.sin(diff) * np.cos(phi))
    kept = measurement.valid[:, row, :] & (half >= np.radians(1.0)) & (half <= np.pi / 2 - diff + 1e-9)
    kept &= lowest >= np.cos(CUTOFF) - 1e-12
    return half[kept], measurement.values[channel, :, row, :][kept]


def initial_parameters(theta_half: Array, value: Array, n_lobes: int) -> Array:
    """Log kappa and log gamma, shape (n_lobes, 2): kappa from the peak, gamma from the half width, then halves."""
    nodes = np.unique(theta_half)
    means = np.array([value[theta_half == node].mean() for node in nodes])
    peak = means.max()
    kappa = np.log1p(peak)
    angle = nodes[min(np.flatnonzero(means >= peak / 2)[-1] + 1, len(nodes) - 1)]

    def above_half(log_gamma: float) -> float:
        return float(plain_lobe(angle, kappa, np.exp(log_gamma)) - peak / 2)

    gamma = np.exp(brentq(above_half, -20.0, 30.0, xtol=1e-14, rtol=1e-14))
    return np.log([[kappa / 2**k, gamma / 2**k] for k in range(n_lobes)])


def algorithm_1(theta_half: Array, value: Array, n_lobes: int, iterations: int) -> Array:
    """Kappa and gamma, shape (n_lobes, 2), after exactly so many iterations, sorted by kappa.

    The E-step in NumPy, the M-step one call of SciPy for each lobe.
    """

    def residual(parameters: Array, target: Array) -> Array:
        return plain_lobe(theta_half, *np.exp(parameters)) - target

    parameters = initial_parameters(theta_half, value, n_lobes)
    for _ in range(iterations):
        lobes = np.array([plain_lobe(theta_half, *np.exp(p)) for p in parameters])
        targets = lobes / lobes.sum(axis=0) * value
        fit = partial(least_squares, residual, method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
        pairs = zip(parameters, targets, strict=True)
        parameters = np.array([fit(start, args=(target,)).x for start, target in pairs])
    found = np.exp(parameters)
    return np.asarray(found[np.argsort(-found[:, 0])])


def mixture(kappa: Array, gamma: Array) -> Array:
    return np.asarray(plain_lobe(ANGLES, kappa[..., None], gamma[..., None]).sum(axis=1))


def slice_of(data: Profiles, channel: int, row: int) -> tuple[Array, Array]:
    kept = THETA_HALF <= np.pi / 2 - THETA_DIFF[row] + 1e-9
    return data.mean[channel, row, OUTSIDE], np.where(kept, data.weight[channel, row], 0.0)[OUTSIDE]


@pytest.mark.parametrize("n_lobes", [1, 3])
def test_batch_gives_the_curves_of_plain_scipy_on_the_raw_samples(plastic: Measurement, n_lobes: int) -> None:
    slices, data = [(0, 0), (2, 0), (2, 35), (1, 60)], profiles(plastic, horizon_cutoff=CUTOFF)
    mean, weight = (np.array(part) for part in zip(*(slice_of(data, *which) for which in slices), strict=True))
    found = em.fit_slices(ANGLES, mean, weight, n_lobes, iterations=ITERATIONS)
    # The plain version knows no bounds: these slices must not need them.
    assert found.gamma.min() > 1e-3
    assert np.all(np.diff(found.kappa, axis=1) < 0.0)
    curves = mixture(found.kappa, found.gamma)
    for which, curve, iterations in zip(slices, curves, found.iterations.tolist(), strict=True):
        expected = algorithm_1(*raw_slice(plastic, *which), n_lobes, iterations)
        reference = mixture(expected[None, :, 0], expected[None, :, 1])[0]
        assert np.linalg.norm(curve - reference) < 1e-6 * np.linalg.norm(reference)


def fitted_alone(data: Array, bounds: tuple[float, float], *, kappa: float | None = None) -> float:
    """The gamma of a lobe with this kappa that fits data best, or the kappa of one with the lowest gamma, by SciPy."""

    def cost(log: float) -> float:
        lobe = (np.exp(log), em.EM_GAMMA_BOUNDS[0]) if kappa is None else (kappa, np.exp(log))
        return float(np.sum((plain_lobe(ANGLES, *lobe) - data) ** 2))

    return float(np.exp(minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 1e-10}).x))


def test_gamma_keeps_above_its_bound_and_kappa_is_fitted_to_it() -> None:
    mean = 0.02 * (1.0 + 2.0 * (ANGLES / ANGLES[-1]) ** 2)  # they rise towards the horizon
    found = em.fit_slices(ANGLES, mean[None], np.ones((1, ANGLES.size)), 1)
    assert found.gamma[0, 0] == pytest.approx(em.EM_GAMMA_BOUNDS[0], rel=1e-12)
    assert found.kappa[0, 0] == pytest.approx(fitted_alone(mean, (-8.0, 0.0)), rel=1e-6)


def test_robust_option_resists_a_spike() -> None:
    kappa, gamma = np.array([[2.0]]), np.array([[30.0]])
    mean = mixture(kappa, gamma)
    mean[0, 25] *= 8.0
    weight = np.ones_like(mean)
    plain = em.fit_slices(ANGLES, mean, weight, 1)
    robust = em.fit_slices(ANGLES, mean, weight, 1, robust=True)
    assert abs(plain.gamma[0, 0] / 30.0 - 1.0) > 0.05  # the spike does harm
    assert robust.kappa[0, 0] == pytest.approx(2.0, rel=1e-3)
    assert robust.gamma[0, 0] == pytest.approx(30.0, rel=1e-3)


def test_kappa_keeps_below_its_bound_and_gamma_is_fitted_to_it() -> None:
    # Steep data just outside one degree, none within: without a bound the peak goes where nothing holds it.
    mean = plain_lobe(ANGLES, 12.0, 2e4)[None]
    weight = np.ones_like(mean)
    free = em.fit_slices(ANGLES, mean, weight, 1)
    bounded = em.fit_slices(ANGLES, mean, weight, 1, largest_kappa=np.array([8.0]))
    assert free.kappa[0, 0] == pytest.approx(12.0, rel=1e-6)
    assert bounded.kappa[0, 0] == pytest.approx(8.0, rel=1e-12)
    assert bounded.gamma[0, 0] == pytest.approx(fitted_alone(mean[0], (8.0, 11.0), kappa=8.0), rel=1e-6)


def test_more_lobes_than_data_have_stay_finite() -> None:
    mean, weight = np.zeros((2, 2, ANGLES.size))  # The second slice is black.
    mean[0, 3:6], weight[0, 3:6], weight[1] = [1e5, 2e5, 1e4], 1.0, 1.0
    found = em.fit_slices(ANGLES, mean, weight, 8)
    assert np.isfinite([found.kappa, found.gamma]).all()
    np.testing.assert_array_equal(em.e_step(np.zeros((1, 4, 3))), 0.25)  # where all lobes underflow
    assert np.isfinite(mixture(found.kappa, found.gamma)).all()
