r"""How many lobes a measurement needs: Williams' step-down test.

Nishino 2009, section 5, fits every number of lobes K up to a bound K_max and keeps the smallest K that is not
significantly worse than the bound by Williams' test. The statistic is the expected negative log probability
``E_p = -mean(log p)`` of each block, a (slice, channel) pair: *smaller is better*. Taking lobes away is the
treatment: K_max is the control (dose 0), and dose ``i = 1 ... k`` with ``k = K_max - 1`` is the fit with
``K_max - i`` lobes. A larger dose can only make E_p larger, so the alternative is one-sided and upwards.

Williams (1971, Biometrics 27:103-117; 1972, Biometrics 28:519-531), equal group sizes r:

    M_i = max_{u <= i} min_{v >= i} mean(X_u, ..., X_v)     isotonic means of the doses 1 ... k
    t_i = (M_i - X_0) / sqrt(2 s^2 / r)                     X_0: the control's own mean, not amalgamated

The largest dose is tested first, and dose i only if every larger one was significant; ``t_i`` is compared
with the critical value of *i* doses. The blocks make this a two-way layout: ``s^2`` is the residual mean
square after removing row and block effects, with ``(groups - 1) (blocks - 1)`` degrees of freedom, and r is
the number of blocks.

Critical values. Under the null let z_i be independent standard normal. The largest isotonic mean is the
maximum of the trailing means, so ``M_k <= c`` says that the random walk with the steps ``z_k - c``,
``z_(k-1) - c``, ... stays at or below 0 for k steps. Spitzer's identity (1956, Trans. AMS 82:323-339) gives
that probability exactly:

    H_0 = 1,    H_k(c) = (1/k) sum_{j=1..k} Phi(c sqrt(j)) H_{k-j}(c)

What is left is the mean of ``1 - H_k(x + sqrt(2) t s)`` over the control's normal x and over s with
``df s^2 ~ chi^2_df``.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq, isotonic_regression
from scipy.special import gammainccinv, gammaincinv, gammaln, ndtr, stdtrit

Array = NDArray[np.float64]

# The trapezium rule converges faster than any power on an entire integrand with Gaussian decay: at this step
# its error is at rounding level for up to 7 doses.
_CONTROL = np.linspace(-9.0, 9.0, 91)
_CONTROL_WEIGHT = np.exp(-0.5 * _CONTROL**2) * (0.2 / math.sqrt(2.0 * math.pi))
_LEGENDRE_NODES, _LEGENDRE_WEIGHTS = np.polynomial.legendre.leggauss(80)
_NEGLIGIBLE = 1e-18  # probability cut off at either end of the distribution of s
_FAR = 18.0  # 1 - H, averaged over the control, is below 1e-30 there


@dataclass(frozen=True)
class WilliamsRow:
    """What the test says about one number of lobes.

    Attributes
    ----------
    n_lobes : int
    mean : float
        Mean of the statistic over the blocks.
    t : float or None
        Williams' statistic; None for the control, and where the residual variance is zero.
    critical_value : float or None
        What `t` is compared with; None for the control, and without degrees of freedom.
    significant : bool
        Whether the step-down procedure finds K worse than the control: False from the first K that is not.
    """

    n_lobes: int
    mean: float
    t: float | None
    critical_value: float | None
    significant: bool


def williams_test(statistic: ArrayLike, alpha: float = 0.01) -> tuple[WilliamsRow, ...]:
    """Compare every number of lobes with the largest; the first that is not significant is the choice.

    Parameters
    ----------
    statistic : array_like, shape (n_lobes_max, n_blocks)
        Row ``K - 1`` holds the expected negative log probability of the K-lobe fit in each (slice, channel)
        block; smaller is better. The last row is the control.
    alpha : float
        Significance level of the one-sided test.

    Returns
    -------
    tuple of WilliamsRow
        One for each number of lobes, 1, 2, ...

    Notes
    -----
    Adding a constant to a block changes nothing. Two degenerate cases have no Student-like statistic:

    - zero residual variance (up to rounding): the means count as exact, and a K whose isotonic mean is above
      the control's by more than rounding error is significantly worse;
    - one block: the residual vanishes identically, and the same rule holds, so that lobes are dropped only
      where that costs nothing.
    """
    values = np.asarray(statistic, dtype=np.float64)
    n_groups, n_blocks = values.shape
    degrees_of_freedom = (n_groups - 1) * (n_blocks - 1)
    rounding = 8.0 * float(np.finfo(np.float64).eps) * float(np.abs(values).max())
    # Differences from the block means are all that the test depends on; they keep their digits better.
    centred = (values - values.mean(axis=0))[::-1]  # from here on row i is dose i, the control comes first
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
    """One-sided critical value of Williams' test with equal group sizes (Williams 1971).

    Computed, not tabulated: see the module's derivation. With one dose it is Student's t.

    Parameters
    ----------
    n_doses : int
        Number of doses beside the control.
    degrees_of_freedom : float
        Degrees of freedom of the variance estimate, at least 1.
    alpha : float
        Significance level, ``1e-6 <= alpha < 0.5``.

    Returns
    -------
    float
        What the statistic of the largest dose exceeds with probability `alpha` if no dose has an effect.
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
    first = math.sqrt(float(gammaincinv(half, _NEGLIGIBLE)) / half)
    last = math.sqrt(float(gammainccinv(half, _NEGLIGIBLE)) / half)
    if t > 0:  # with few degrees of freedom and a large t only small s count
        last = min(last, max(_FAR / (math.sqrt(2.0) * t), 2.0 * first))
    s = first + 0.5 * (last - first) * (1.0 + _LEGENDRE_NODES)
    log_density = (
        (degrees_of_freedom - 1.0) * np.log(s) - half * s**2 + half * math.log(half) - float(gammaln(half))
    ) + math.log(2.0)
    weight = 0.5 * (last - first) * _LEGENDRE_WEIGHTS * np.exp(log_density)
    shifted = (math.sqrt(2.0) * t * s)[:, np.newaxis] + _CONTROL
    return float(weight @ (_leaves_half_line(shifted, n_doses) @ _CONTROL_WEIGHT))


def _leaves_half_line(c: Array, n_steps: int) -> Array:
    """``1 - H_k(c)`` by Spitzer's identity, written for the complements so that small tails keep digits."""
    single = [ndtr(-math.sqrt(j) * c) for j in range(1, n_steps + 1)]  # 1 - Phi(c sqrt(j))
    leaves = [np.zeros_like(c)]
    for k in range(1, n_steps + 1):
        terms = (single[j - 1] + leaves[k - j] * (1.0 - single[j - 1]) for j in range(1, k + 1))
        leaves.append(sum(terms, np.zeros_like(c)) / k)
    return leaves[n_steps]
