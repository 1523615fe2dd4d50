"""Fit a model by the paper's procedure: Algorithm 1 on each of 18 slices of theta_diff (Nishino 2009, section 6).

The slices are 5 degrees apart. In each slice, lobes are sorted by kappa. The first lobes of all slices are one lobe of
the model, the second lobes are another lobe, and so on; kappa and gamma of a lobe are linear in theta_diff between
slices. Where theta_half < 1 degree, the mean difference between data and lobes is added to the model. If the number of
lobes is "auto", Williams' test chooses the smallest number that is not significantly worse than the largest.

The error of K lobes in one block, a slice of a channel (Nishino 2009, section 5), is

    E_p = - sum_n v_n L_n log p(theta_n) / sum_n v_n L_n,

where p is the mixture normalised over the nodes of the slice, L_n the data, and v_n the solid angle of node n. A
uniform density with the weight 0.01 is mixed into p, because otherwise the logarithm of a tail that underflows would
dominate the error.

The test was made for doses of a drug: here the largest K is the control, and dose i = 1 ... k removes i lobes, which
can only increase E_p. Let X_i be the mean of E_p at dose i over r blocks. Then (Williams 1971, Biometrics 27:103-117;
1972, Biometrics 28:519-531)

    M_i = max_{u <= i} min_{v >= i} mean(X_u, ..., X_v),    t_i = (M_i - X_0) / sqrt(2 s^2 / r),

where s^2 is the residual mean square after removing row and block effects. The largest dose is tested first, and each
smaller dose i only while the error with the larger doses was significantly worse, against the critical value of i
doses.

Critical values are exact. Under the null hypothesis, let z_i be independent standard normal variables. M_k <= c is
equivalent to this: the random walk with the steps z_k - c, z_(k-1) - c and so on stays at or below 0. The probability
of M_k <= c is (Spitzer 1956, Transactions AMS 82:323-339)

    H_0 = 1,    H_k(c) = (1/k) sum_{j=1..k} Phi(c sqrt(j)) H_{k-j}(c).

The probability of exceeding t is the mean of 1 - H_k(x + sqrt(2) t s) over the normal variable x of the control and
over s, where df s^2 has a chi-squared distribution with df degrees of freedom.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq, isotonic_regression
from scipy.special import gammainccinv, gammaincinv, gammaln, ndtr, stdtrit

from dsbrdf.arrays import Array, Indices, Mask
from dsbrdf.data.geometry import CENTER_CUTOFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.reduction import Profiles, interval_ends
from dsbrdf.errors import FitError
from dsbrdf.fitting.metrics import OUTSIDE_CENTER
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.report import FoundModel, KnotReport, SelectionStep
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.paper import em

_CONTROL = np.linspace(-9.0, 9.0, 91)
"""Nodes of a trapezium rule over x, the normal variable of the control.

Because the integrand is smooth and decays like a Gaussian, the error of the rule is at rounding level for up to 7
doses.
"""
_CONTROL_WEIGHT = np.exp(-0.5 * _CONTROL**2) * (0.2 / math.sqrt(2.0 * math.pi))
_LEGENDRE_NODES, _LEGENDRE_WEIGHTS = np.polynomial.legendre.leggauss(80)
# The integral over s, the estimated standard deviation, leaves out this probability at either end.
_CUT_OFF_PROBABILITY = 1e-18
# For larger values c, the probability that the statistic exceeds c is below 1e-30, so the integral leaves them out.
_CERTAIN_CRITICAL_VALUE = 18.0


@dataclass(frozen=True)
class WilliamsRow:
    """The result of the test for one number of lobes.

    Attributes
    ----------
    n_lobes : int
        Number of lobes.
    mean : float
        Mean of the statistic over the blocks.
    t : float or None
        Test statistic; None for the control, and if the residual variance is zero.
    critical_value : float or None
        Critical value for t; None for the control, and if the test has no degrees of freedom.
    significant : bool
        Whether this number of lobes is significantly worse than the control. The procedure ends at the first number
        that is not significantly worse; for all larger numbers, this is False.
    """

    n_lobes: int
    mean: float
    t: float | None
    critical_value: float | None
    significant: bool


def williams_test(statistic: ArrayLike, alpha: float = 0.01) -> tuple[WilliamsRow, ...]:
    """Compare every number of lobes with the largest number, the control.

    Row ``K - 1`` of the statistic (n_lobes_max, n_blocks) has E_p with K lobes in each block. `alpha` is the level of
    the one-sided test. The chosen number is the first that is not significant. If the residual variance is zero up to
    rounding, as for a single block, a mean that exceeds the mean of the control by more than rounding is significant.
    """
    values = np.asarray(statistic, dtype=np.float64)
    n_groups, n_blocks = values.shape
    degrees_of_freedom = (n_groups - 1) * (n_blocks - 1)
    rounding = 8.0 * float(np.finfo(np.float64).eps) * float(np.abs(values).max())
    # The mean of each block is subtracted, which reduces rounding errors and does not change the test.
    # Row i of the differences is dose i, and row 0 is the control.
    centred = (values - values.mean(axis=0))[::-1]
    means = centred.mean(axis=1)
    variance = float(np.sum((centred - means[:, np.newaxis]) ** 2)) / max(degrees_of_freedom, 1)
    squared_error = 2.0 * variance / n_blocks if variance > rounding**2 else 0.0
    differences = isotonic_regression(means[1:]).x - means[0] if n_groups > 1 else means[1:]
    grand_mean = float(values.mean())
    rows, going_down = [], True
    for dose in range(n_groups - 1, 0, -1):
        difference = float(differences[dose - 1])
        critical = williams_critical_value(dose, degrees_of_freedom, alpha) if degrees_of_freedom else None
        t = difference / math.sqrt(squared_error) if squared_error else None
        exceeds = difference > rounding if t is None or critical is None else t > critical
        going_down = going_down and exceeds
        rows.append(WilliamsRow(n_groups - dose, grand_mean + float(means[dose]), t, critical, going_down))
    return (*rows, WilliamsRow(n_groups, grand_mean + float(means[0]), None, None, False))


@lru_cache(maxsize=256)
def williams_critical_value(n_doses: int, degrees_of_freedom: float, alpha: float = 0.01) -> float:
    """Return the value that the statistic t of the largest of `n_doses` doses exceeds with probability `alpha`.

    The test is one-sided with equal group sizes (Williams 1971); under the null hypothesis, no dose has an effect.
    `alpha` must be at least 1e-6 and below 0.5.
    """
    # The critical value of Student's t test for the largest dose alone is a lower bound, here widened for rounding.
    lower = -float(stdtrit(degrees_of_freedom, alpha)) * 0.999 - 1e-3
    # Means over several doses have smaller variances, so that Bonferroni's inequality gives an upper bound.
    upper = -float(stdtrit(degrees_of_freedom, alpha / n_doses)) * 1.001 + 1e-3
    log_alpha = math.log(alpha)

    def excess(t: float) -> float:
        return math.log(_exceedance(t, n_doses, degrees_of_freedom)) - log_alpha

    return float(brentq(excess, lower, upper, xtol=1e-9, rtol=1e-12))


def _exceedance(t: float, n_doses: int, degrees_of_freedom: float) -> float:
    """Return the probability that the statistic of the largest dose exceeds `t` under the null hypothesis."""
    half = 0.5 * degrees_of_freedom
    first = math.sqrt(float(gammaincinv(half, _CUT_OFF_PROBABILITY)) / half)
    last = math.sqrt(float(gammainccinv(half, _CUT_OFF_PROBABILITY)) / half)
    # If the statistic t is large, only small standard deviations s contribute, so the integral leaves out larger ones.
    if t > 0:
        last = min(last, _CERTAIN_CRITICAL_VALUE / (math.sqrt(2.0) * t))
    s = first + 0.5 * (last - first) * (1.0 + _LEGENDRE_NODES)
    log_density = (
        (degrees_of_freedom - 1.0) * np.log(s) - half * s**2 + half * math.log(half) - float(gammaln(half))
    ) + math.log(2.0)
    weight = 0.5 * (last - first) * _LEGENDRE_WEIGHTS * np.exp(log_density)
    shifted = (math.sqrt(2.0) * t * s)[:, np.newaxis] + _CONTROL
    return float(weight @ (_leaves_half_line(shifted, n_doses) @ _CONTROL_WEIGHT))


def _leaves_half_line(c: Array, n_steps: int) -> Array:
    """Return ``1 - H_k(c)`` by Spitzer's identity, in a form that has small rounding errors for small results."""
    # Entry j - 1 of this list is 1 - Phi(c sqrt(j)), where Phi is the normal distribution function.
    single = [ndtr(-math.sqrt(j) * c) for j in range(1, n_steps + 1)]
    leaves = [np.zeros_like(c)]
    for k in range(1, n_steps + 1):
        terms = (single[j - 1] + leaves[k - j] * (1.0 - single[j - 1]) for j in range(1, k + 1))
        leaves.append(sum(terms, np.zeros_like(c)) / k)
    return leaves[n_steps]


MAX_AUTOMATIC_LOBES = 5
"""The test chooses among 1 to this number of lobes (Nishino 2009, section 5)."""
UNIFORM_FRACTION = 0.01
"""Weight of the uniform density that is mixed into the normalised mixture."""


def choose_n_lobes(
    theta_half: Array,
    mean: Array,
    weight: Array,
    within: Array,
    fit_slices: Callable[[int], em.SliceFits],
) -> tuple[int, tuple[SelectionStep, ...]]:
    """Fit 1, 2, ... lobes and choose a number by Williams' test; return the number, and the test of each number.

    The profiles of the slices are `mean`, `weight` and `within` (slices, N) at nodes theta_half (N,) [rad]; `within` is
    the sum of squared differences of samples from their mean, an error that every mixture has. `fit_slices` fits the
    slices with the number of lobes that is passed to it.
    """
    # A lobe has two parameters: with more lobes than half of the nodes, a slice would be fitted exactly.
    largest = int(np.clip(np.count_nonzero(weight, axis=1).min() // 2, 1, MAX_AUTOMATIC_LOBES))
    log_cos, errors, statistic = np.log(np.cos(theta_half)), [], []
    for n_lobes in range(1, largest + 1):
        found = fit_slices(n_lobes)
        curves = em.lobe_curves(log_cos, np.log(np.stack([found.kappa, found.gamma], axis=-1))).sum(axis=1)
        statistic.append(expected_negative_log_probability(theta_half, mean, weight > 0.0, curves))
        error = float(np.sum(weight * (curves - mean) ** 2 + within))
        n_samples = float(weight.sum())
        penalty = 2 * n_lobes * len(mean) * np.log(n_samples)
        errors.append((error, float(n_samples * np.log(error / n_samples) + penalty) if error > 0.0 else None))
    rows = williams_test(statistic)
    table = tuple(
        SelectionStep(row.n_lobes, row.mean, *found, row.t, row.critical_value, row.significant)
        for row, found in zip(rows, errors, strict=True)
    )
    return next(row.n_lobes for row in rows if not row.significant), table


def expected_negative_log_probability(theta_half: Array, mean: Array, used: Mask, curves: Array) -> Array:
    """Return E_p of each slice, shape (slices,); it is 0 for slices of zeros.

    `mean` and `curves` are data and mixtures (slices, N) [1/sr]; only the nodes in the mask `used` count.
    """
    solid_angle = used * np.sin(theta_half) * np.gradient(theta_half)
    light = solid_angle * mean
    tiny = np.finfo(float).tiny
    area, total = (
        np.maximum(np.sum(part, axis=1, keepdims=True), tiny) for part in (solid_angle, solid_angle * curves)
    )
    probability = (1.0 - UNIFORM_FRACTION) * curves / total + UNIFORM_FRACTION / area
    return np.asarray(-np.sum(light * np.log(probability), axis=1) / np.maximum(light.sum(axis=1), tiny))


PAPER_SLICES = np.radians(np.arange(0.0, 90.0, 5.0))
"""Angles theta_diff of the 18 slices of the paper, 0 to 85 degrees [rad]."""
_ANGLES = THETA_HALF[OUTSIDE_CENTER]
# Fraction of the progress at which the number of lobes has been chosen.
_SELECTION_PROGRESS = 0.8


def fit_slicewise(data: Profiles, options: FitOptions, progress: Callable[[float], None]) -> FoundModel:
    """Fit all slices of all channels in one batch; if the number of lobes is "auto", once for each possible number.

    `progress` is called with the completed fraction. Raises FitError if the options leave no data to fit.
    """
    rows = np.searchsorted(THETA_DIFF, PAPER_SLICES - 1e-9)
    kept = (THETA_HALF <= np.pi / 2 - options.resolved_mask * PAPER_SLICES[:, None] + 1e-9)[:, OUTSIDE_CENTER]
    mean, weight, within = (part[:, rows][:, :, OUTSIDE_CENTER] for part in (data.mean, data.weight, data.within))
    weight, within = np.where(kept, weight, 0.0), np.where(kept, within, 0.0)
    largest_kappa, n_nodes = _largest_kappa(data, rows), np.count_nonzero(weight, axis=2)

    def fit(chosen: Mask, n_lobes: int, done: float, share: float) -> em.SliceFits:
        """Run Algorithm 1 on slices in the mask (channels, slices); the progress rises from `done` by `share`."""
        return em.fit_slices(
            _ANGLES,
            mean[chosen],
            weight[chosen],
            n_lobes,
            iterations=options.em_iterations,
            robust=options.robust,
            largest_kappa=largest_kappa[chosen],
            on_iteration=lambda number: progress(done + share * (number / options.em_iterations)),
        )

    n_lobes, selection, done = options.n_lobes, tuple[SelectionStep, ...](), 0.0
    if n_lobes == "auto":
        compared = _compared(n_nodes)
        n_lobes, done, share = 1, _SELECTION_PROGRESS, _SELECTION_PROGRESS / MAX_AUTOMATIC_LOBES
        if compared.any():

            def compare(number: int) -> em.SliceFits:
                return fit(compared, number, (number - 1) * share, share)

            n_lobes, selection = choose_n_lobes(_ANGLES, mean[compared], weight[compared], within[compared], compare)
    # A slice with fewer nodes than parameters is not fitted, because its data do not determine the parameters.
    fitted = n_nodes >= 2 * n_lobes
    if not fitted.any(axis=1).all():
        raise FitError(
            "the mask and the horizon cutoff leave no slice with enough valid samples to fit: "
            "raise the horizon cutoff or lower the mask or the number of lobes"
        )
    slices = fit(fitted, n_lobes, done, 1.0 - done)
    nearest = _nearest_fitted(fitted)
    kappa, gamma = _spread(slices.kappa, fitted, nearest), _spread(slices.gamma, fitted, nearest)
    delta = _delta(data, rows, kappa, gamma)
    model = DSBRDF(PAPER_SLICES, np.expm1(kappa), kappa, gamma, delta=delta, interpolation="linear")
    bounds_hit = _bounds_hit(slices, largest_kappa[fitted])
    found = (_spread(part, fitted, nearest) for part in (slices.converged, slices.iterations, bounds_hit))
    return FoundModel(model, KnotReport.from_arrays(PAPER_SLICES, fitted, *found), selection=selection)


def _compared(n_nodes: Indices) -> Mask:
    """Return the mask of the slices on which numbers of lobes are compared, given the number of nodes of each slice.

    These slices have enough nodes for the largest number of lobes; if a channel has no such slice, at least two nodes.
    """
    enough = n_nodes >= 2 * MAX_AUTOMATIC_LOBES
    return enough if enough.any(axis=1).all() else n_nodes >= 2


def _largest_kappa(data: Profiles, rows: Indices) -> Array:
    """Return the kappa of a lobe whose height is twice the largest value of a slice, (channels, slices).

    Fits of a slice use this kappa as an upper bound. Data at theta_half below 1 degree are not fitted, so that without
    a bound a steep lobe could have any height there. A slice without data at theta_half below 1 degree has no bound of
    kappa.
    """
    centre_seen = np.any(data.weight[:, rows][:, :, ~OUTSIDE_CENTER] > 0, axis=2)
    return np.where(centre_seen, np.log1p(2.0 * data.mean[:, rows].max(axis=2)), np.inf)


def _nearest_fitted(fitted: Mask) -> Indices:
    """Return for each slice the index of the nearest fitted slice, or 0 if its channel has none, (channels, slices)."""
    index = np.arange(fitted.shape[1])
    distance = np.where(fitted[:, None, :], np.abs(index[:, None] - index), np.inf)
    return np.argmin(distance, axis=2)


def _spread(values: NDArray[Any], fitted: Mask, nearest: Indices) -> NDArray[Any]:
    """Copy values of fitted slices to all slices (channels, slices, ...); the nearest fitted slice fills a gap."""
    full = np.zeros((*fitted.shape, *values.shape[1:]), values.dtype)
    full[fitted] = values
    return full[np.arange(len(fitted))[:, None], nearest]


def _delta(data: Profiles, rows: Indices, kappa: Array, gamma: Array) -> Array:
    """Return the mean residual of each slice where theta_half < 1 degree, weighted by solid angle, (channels, slices).

    A negative mean residual becomes 0, because subtracting it could make the model negative between nodes. A slice
    without such data has the mean residual of the nearest slice.
    """
    center = np.flatnonzero(~OUTSIDE_CENTER)
    solid_angle = np.diff(-np.cos(interval_ends(THETA_HALF[center], CENTER_CUTOFF)))
    weight = data.weight[:, rows][:, :, center] * solid_angle
    # The logarithm of the cosine is computed from the sine, because the cosine loses the digits of small angles.
    log_cos = 0.5 * np.log1p(-(np.sin(THETA_HALF[center]) ** 2))
    lobes = np.expm1(kappa[..., None] * np.exp(gamma[..., None] * log_cos)).sum(axis=2)
    total = weight.sum(-1)
    residual = np.sum(weight * (data.mean[:, rows][:, :, center] - lobes), axis=-1) / np.where(total > 0, total, 1.0)
    return np.maximum(np.take_along_axis(residual, _nearest_fitted(total > 0), axis=1), 0.0)


def _bounds_hit(slices: em.SliceFits, largest_kappa: Array) -> Mask:
    """Return for each slice whether kappa or gamma of any lobe is at a bound."""
    low = (slices.kappa <= em.EM_KAPPA_BOUNDS[0] * (1 + 1e-9)) | (slices.gamma <= em.EM_GAMMA_BOUNDS[0] * (1 + 1e-9))
    highest = np.minimum(largest_kappa, em.EM_KAPPA_BOUNDS[1])[:, None]
    high = (slices.kappa >= highest * (1 - 1e-9)) | (slices.gamma >= em.EM_GAMMA_BOUNDS[1] * (1 - 1e-9))
    return np.any(low | high, axis=1)
