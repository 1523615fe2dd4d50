r"""The paper's number of lobes: the smallest that Williams' step-down test does not find worse than the largest.

For K = 1, 2, ... lobes and each block, a slice of a channel (Nishino 2009, section 5), smaller is better of

    E_p = - sum_n v_n L_n log p(theta_n) / sum_n v_n L_n,

where p is the mixture normalised over the nodes that the slice has, L_n the data and v_n the solid angle of node n; a
hundredth of a uniform density is mixed into p, so that a tail in which a fit has underflowed does not decide alone.

The largest K is the control; dose i = 1 ... k takes i lobes away, which can only make E_p larger. With means X over r
blocks (Williams 1971, Biometrics 27:103-117; 1972, Biometrics 28:519-531),

    M_i = max_{u <= i} min_{v >= i} mean(X_u, ..., X_v),    t_i = (M_i - X_0) / sqrt(2 s^2 / r),

s^2 being the residual mean square after removing row and block effects. The largest dose is tested first, and dose i,
against the critical value of i doses, only if every larger one was significant.

Critical values are exact. Under the null let z_i be independent standard normal: M_k <= c says that the random walk
with the steps z_k - c, z_(k-1) - c, ... stays at or below 0, of which the probability is (Spitzer 1956, Trans. AMS
82:323-339)

    H_0 = 1,    H_k(c) = (1/k) sum_{j=1..k} Phi(c sqrt(j)) H_{k-j}(c).

What is left is the mean of 1 - H_k(x + sqrt(2) t s) over the control's normal x and over s with df s^2 ~ chi^2_df.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq, isotonic_regression
from scipy.special import gammainccinv, gammaincinv, gammaln, ndtr, stdtrit

from dsbrdf.arrays import Array, Mask
from dsbrdf.fitting.report import SelectionStep
from dsbrdf.paper import em

# The trapezium rule converges faster than any power on an entire integrand with Gaussian decay: at this step
# its error is at rounding level for up to 7 doses.
_CONTROL = np.linspace(-9.0, 9.0, 91)
_CONTROL_WEIGHT = np.exp(-0.5 * _CONTROL**2) * (0.2 / math.sqrt(2.0 * math.pi))
_LEGENDRE_NODES, _LEGENDRE_WEIGHTS = np.polynomial.legendre.leggauss(80)
# Probability that is cut off at either end of the distribution of s.
_CUT_OFF_PROBABILITY = 1e-18
# Beyond this value of c, 1 - H averaged over the control is below 1e-30.
_CERTAIN_CRITICAL_VALUE = 18.0


@dataclass(frozen=True)
class WilliamsRow:
    """Result of the test for one number of lobes.

    Attributes
    ----------
    n_lobes : int
        Number of lobes.
    mean : float
        Mean of the statistic over the blocks.
    t : float or None
        Test statistic; None for the control, and where the residual variance is zero.
    critical_value : float or None
        Critical value for t; None for the control, and without degrees of freedom.
    significant : bool
        Whether the number is significantly worse than the control. After the first number that is not, the procedure
        ends, and all further numbers are False.
    """

    n_lobes: int
    mean: float
    t: float | None
    critical_value: float | None
    significant: bool


def williams_test(statistic: ArrayLike, alpha: float = 0.01) -> tuple[WilliamsRow, ...]:
    """Compare every number of lobes with the largest; the first that is not significant is the choice.

    Row ``K - 1`` of the statistic (n_lobes_max, n_blocks) has E_p of the fit with K lobes in each block, `alpha` is the
    level of the one-sided test. Without residual variance, up to rounding, as with a single block, the means count as
    exact: a K whose isotonic mean is above the control's by more than rounding is worse.
    """
    values = np.asarray(statistic, dtype=np.float64)
    n_groups, n_blocks = values.shape
    degrees_of_freedom = (n_groups - 1) * (n_blocks - 1)
    rounding = 8.0 * float(np.finfo(np.float64).eps) * float(np.abs(values).max())
    # Differences from the block means are all that the test depends on; they keep their digits better.
    # From here on, row i is dose i, and row 0 the control.
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
    """Value that the statistic of the largest of so many doses beside the control exceeds with probability `alpha`.

    It is one-sided, with equal group sizes (Williams 1971) and no effect of any dose; alpha is 1e-6 to below 0.5.
    """
    # The largest dose alone is Student's t, a lower bound; no trailing mean has a larger variance, so that
    # Bonferroni's inequality gives an upper bound. Both are widened for rounding.
    lower = -float(stdtrit(degrees_of_freedom, alpha)) * 0.999 - 1e-3
    upper = -float(stdtrit(degrees_of_freedom, alpha / n_doses)) * 1.001 + 1e-3
    log_alpha = math.log(alpha)

    def excess(t: float) -> float:
        return math.log(_exceedance(t, n_doses, degrees_of_freedom)) - log_alpha

    return float(brentq(excess, lower, upper, xtol=1e-9, rtol=1e-12))


def _exceedance(t: float, n_doses: int, degrees_of_freedom: float) -> float:
    """Probability that the statistic of the largest dose exceeds `t` under the null."""
    half = 0.5 * degrees_of_freedom
    first = math.sqrt(float(gammaincinv(half, _CUT_OFF_PROBABILITY)) / half)
    last = math.sqrt(float(gammainccinv(half, _CUT_OFF_PROBABILITY)) / half)
    # With few degrees of freedom and a large t, only small s contribute.
    if t > 0:
        last = min(last, max(_CERTAIN_CRITICAL_VALUE / (math.sqrt(2.0) * t), 2.0 * first))
    s = first + 0.5 * (last - first) * (1.0 + _LEGENDRE_NODES)
    log_density = (
        (degrees_of_freedom - 1.0) * np.log(s) - half * s**2 + half * math.log(half) - float(gammaln(half))
    ) + math.log(2.0)
    weight = 0.5 * (last - first) * _LEGENDRE_WEIGHTS * np.exp(log_density)
    shifted = (math.sqrt(2.0) * t * s)[:, np.newaxis] + _CONTROL
    return float(weight @ (_leaves_half_line(shifted, n_doses) @ _CONTROL_WEIGHT))


def _leaves_half_line(c: Array, n_steps: int) -> Array:
    """``1 - H_k(c)`` by Spitzer's identity, written for the complements so that small tails keep digits."""
    # Each is 1 - Phi(c sqrt(j)).
    single = [ndtr(-math.sqrt(j) * c) for j in range(1, n_steps + 1)]
    leaves = [np.zeros_like(c)]
    for k in range(1, n_steps + 1):
        terms = (single[j - 1] + leaves[k - j] * (1.0 - single[j - 1]) for j in range(1, k + 1))
        leaves.append(sum(terms, np.zeros_like(c)) / k)
    return leaves[n_steps]


LARGEST_AUTOMATIC = 5
"""Upper bound of the automatic number of lobes (Nishino 2009, section 5)."""
BACKGROUND = 0.01
"""Weight of the uniform density that is mixed into the probability."""


def choose_n_lobes(
    theta_half: Array,
    mean: Array,
    weight: Array,
    within: Array,
    fit_slices: Callable[[int], em.SliceFits],
) -> tuple[int, tuple[SelectionStep, ...]]:
    """Fit every number of lobes and choose one; return it, and a row for 1, 2, ... lobes.

    The slices have profiles mean, weight and within (slices, N) at nodes theta_half (N,) [rad]; `within` is the squared
    error that no mixture can avoid. `fit_slices` fits them with a number of lobes.
    """
    # More lobes than half of the nodes of a slice would fit anything.
    largest = int(np.clip(np.count_nonzero(weight, axis=1).min() // 2, 1, LARGEST_AUTOMATIC))
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
    """E_p of each slice, shape (slices,); 0 for slices of zeros.

    Data and mixtures are of shape (slices, N) [1/sr]; the nodes `used` of each slice count.
    """
    solid_angle = used * np.sin(theta_half) * np.gradient(theta_half)
    light = solid_angle * mean
    tiny = np.finfo(float).tiny
    area, total = (
        np.maximum(np.sum(part, axis=1, keepdims=True), tiny) for part in (solid_angle, solid_angle * curves)
    )
    probability = (1.0 - BACKGROUND) * curves / total + BACKGROUND / area
    return np.asarray(-np.sum(light * np.log(probability), axis=1) / np.maximum(light.sum(axis=1), tiny))
