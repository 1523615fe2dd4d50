r"""How many lobes a measurement needs: Williams' step-down test, and the Bayesian information criterion.

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

from dsbrdf.errors import InvalidArgumentError

MAX_DOSES = 20
"""Most doses for which the quadrature below is accurate; far more than a mixture of lobes can use."""

# The trapezium rule converges faster than any power on an entire integrand with Gaussian decay: at this step
# its error is below 1e-9 for MAX_DOSES and at rounding level for 7.
_CONTROL = np.linspace(-9.0, 9.0, 91)
_CONTROL_WEIGHT = np.exp(-0.5 * _CONTROL**2) * (0.2 / math.sqrt(2.0 * math.pi))
_LEGENDRE_NODES, _LEGENDRE_WEIGHTS = np.polynomial.legendre.leggauss(80)
_NEGLIGIBLE = 1e-18  # probability cut off at either end of the distribution of s
_FAR = 18.0  # 1 - H, averaged over the control, is below 1e-30 there
_KNOWN_VARIANCE = 1e7  # degrees of freedom that change critical values by less than 1e-6 against infinity


@dataclass(frozen=True)
class WilliamsRow:
    """What the test says about one number of lobes; plain numbers, so that it can be stored as JSON.

    Attributes
    ----------
    n_lobes : int
        Number of lobes K.
    mean : float
        Mean of the statistic over the blocks.
    isotonic_mean : float
        Mean after pooling adjacent violators among the doses; the control keeps its own mean.
    t : float or None
        Williams' statistic; None for the control, and where the residual variance is zero.
    critical_value : float or None
        What `t` is compared with; None for the control, and without degrees of freedom.
    significant : bool
        Whether the step-down procedure finds K worse than the control: False from the first K that is not.
    """

    n_lobes: int
    mean: float
    isotonic_mean: float
    t: float | None
    critical_value: float | None
    significant: bool


@dataclass(frozen=True)
class WilliamsResult:
    """Outcome of `williams_test`.

    Attributes
    ----------
    n_lobes : int
        Smallest number of lobes that is not significantly worse than the largest one.
    alpha : float
        Significance level, one-sided.
    variance : float
        Residual mean square of the two-way layout; 0.0 where it is rounding error or cannot be estimated.
    degrees_of_freedom : int
        ``(groups - 1) (blocks - 1)``; 0 with one group or one block.
    table : tuple of WilliamsRow
        One row per number of lobes, 1, 2, ..., K_max; the last one is the control.
    """

    n_lobes: int
    alpha: float
    variance: float
    degrees_of_freedom: int
    table: tuple[WilliamsRow, ...]


def williams_critical_value(n_doses: int, degrees_of_freedom: float, alpha: float = 0.01) -> float:
    """One-sided critical value of Williams' test with equal group sizes (Williams 1971).

    Computed, not tabulated: see the module's derivation. With one dose it is Student's t.

    Parameters
    ----------
    n_doses : int
        Number of doses beside the control, 1 to `MAX_DOSES`.
    degrees_of_freedom : float
        Degrees of freedom of the variance estimate, at least 1; ``math.inf`` for a known variance.
    alpha : float
        Significance level, ``1e-6 <= alpha < 0.5``.

    Returns
    -------
    float
        What the statistic of the largest dose exceeds with probability `alpha` if no dose has an effect.

    Raises
    ------
    InvalidArgumentError
        If an argument is out of its range.
    """
    if n_doses not in range(1, MAX_DOSES + 1):
        raise InvalidArgumentError(f"n_doses is {n_doses}, it must be an integer from 1 to {MAX_DOSES}")
    if not degrees_of_freedom >= 1:  # also catches NaN
        raise InvalidArgumentError(f"degrees_of_freedom is {degrees_of_freedom}, it must be at least 1")
    _check_alpha(alpha)
    return _critical_value(int(n_doses), float(degrees_of_freedom), float(alpha))


def isotonic_means(means: ArrayLike) -> NDArray[np.float64]:
    """Non-decreasing sequence closest to `means` in least squares, by pooling adjacent violators.

    Parameters
    ----------
    means : array_like, shape (n,)
        Means of groups of equal size, in the order in which they are expected to grow; ``n >= 1``.

    Returns
    -------
    ndarray, shape (n,)
        The isotonic means ``M_i`` of Williams 1971.

    Raises
    ------
    InvalidArgumentError
        If `means` is empty, not one-dimensional or not finite.
    """
    values = np.asarray(means, dtype=np.float64)
    if values.ndim != 1 or values.size == 0:
        raise InvalidArgumentError(f"means has the shape {values.shape}, it must be (n,) with n at least 1")
    if not np.isfinite(values).all():
        raise InvalidArgumentError("means holds NaN or infinity; every mean must be finite")
    return np.asarray(isotonic_regression(values).x, dtype=np.float64)


def williams_test(statistic: ArrayLike, alpha: float = 0.01) -> WilliamsResult:
    """Smallest number of lobes that is not significantly worse than the largest (Nishino 2009, section 5).

    Parameters
    ----------
    statistic : array_like, shape (n_lobes_max, n_blocks)
        Row ``K - 1`` holds the expected negative log probability of the K-lobe fit in each (slice, channel)
        block; smaller is better. The last row is the control.
    alpha : float
        Significance level of the one-sided test, ``1e-6 <= alpha < 0.5``.

    Returns
    -------
    WilliamsResult
        The choice, and a row for every number of lobes.

    Raises
    ------
    InvalidArgumentError
        If `statistic` is not a two-dimensional, non-empty, finite array, or an argument is out of its range.

    Notes
    -----
    Adding a constant to a block changes nothing. Three degenerate cases have no Student-like statistic:

    - one row: nothing to compare, the answer is 1;
    - zero residual variance (up to rounding): the means count as exact, and a K whose isotonic mean is above
      the control's by more than rounding error is significantly worse;
    - one block: the residual vanishes identically, and the same rule holds, so that lobes are dropped only
      where that costs nothing.
    """
    values = _check_statistic(statistic)
    _check_alpha(alpha)
    n_groups, n_blocks = values.shape
    degrees_of_freedom = (n_groups - 1) * (n_blocks - 1)
    rounding = 8.0 * float(np.finfo(np.float64).eps) * float(np.abs(values).max())
    # Differences from the block means are all that the test depends on; they keep their digits better.
    centred = (values - values.mean(axis=0))[::-1]  # from here on row i is dose i, the control comes first
    means = centred.mean(axis=1)
    variance = float(np.sum((centred - means[:, np.newaxis]) ** 2)) / max(degrees_of_freedom, 1)
    if variance <= rounding**2:
        variance = 0.0
    isotonic = np.concatenate([means[:1], isotonic_means(means[1:])]) if n_groups > 1 else means
    steps = _step_down(isotonic - means[0], 2.0 * variance / n_blocks, degrees_of_freedom, alpha, rounding)
    grand_mean = float(values.mean())
    table = tuple(
        WilliamsRow(n_groups - dose, grand_mean + float(means[dose]), grand_mean + float(isotonic[dose]), *steps[dose])
        for dose in reversed(range(n_groups))
    )
    n_lobes = next(row.n_lobes for row in table if not row.significant)
    return WilliamsResult(n_lobes, float(alpha), variance, degrees_of_freedom, table)


def bic(squared_error: ArrayLike, n_samples: ArrayLike, n_parameters: ArrayLike) -> NDArray[np.float64]:
    """Bayesian information criterion of a least-squares fit with Gaussian errors of unknown variance.

    ``n log(squared_error / n) + p log(n)``, up to a constant of the data alone; smaller is better.

    Parameters
    ----------
    squared_error : array_like
        Sum of squared residuals, >= 0. An exact fit (0) has the criterion ``-inf``.
    n_samples : array_like
        Number n of samples in that sum, > 0; broadcast against the others.
    n_parameters : array_like
        Number p of fitted parameters, >= 0.

    Returns
    -------
    ndarray
        Of the broadcast shape, ``()`` for scalars.

    Raises
    ------
    InvalidArgumentError
        If an argument is not finite or out of its range.
    """
    error, n, p = (np.asarray(a, dtype=np.float64) for a in (squared_error, n_samples, n_parameters))
    if not (np.isfinite(error) & (error >= 0)).all():
        raise InvalidArgumentError("squared_error must be finite and not negative")
    if not (np.isfinite(n) & (n > 0)).all():
        raise InvalidArgumentError("n_samples must be finite and positive")
    if not (np.isfinite(p) & (p >= 0)).all():
        raise InvalidArgumentError("n_parameters must be finite and not negative")
    with np.errstate(divide="ignore"):  # log(0) = -inf is the documented answer
        return np.asarray(n * np.log(error / n) + p * np.log(n))


def _check_alpha(alpha: float) -> None:
    if not 1e-6 <= alpha < 0.5:  # also catches NaN
        raise InvalidArgumentError(f"alpha is {alpha}, it must be at least 1e-6 and less than 0.5")


def _check_statistic(statistic: ArrayLike) -> NDArray[np.float64]:
    values = np.asarray(statistic, dtype=np.float64)
    if values.ndim != 2 or values.size == 0:
        raise InvalidArgumentError(
            f"statistic has the shape {values.shape}, it must be (n_lobes_max, n_blocks) with both at least 1"
        )
    if len(values) > MAX_DOSES + 1:
        raise InvalidArgumentError(f"statistic has {len(values)} rows, it may have {MAX_DOSES + 1} at most")
    if not np.isfinite(values).all():
        raise InvalidArgumentError(
            "statistic holds NaN or infinity; every block must have a finite value for every number of lobes"
        )
    return values


def _step_down(
    difference: NDArray[np.float64],
    squared_error: float,
    degrees_of_freedom: int,
    alpha: float,
    rounding: float,
) -> list[tuple[float | None, float | None, bool]]:
    """``(t, critical value, significant)`` of every dose, the control (dose 0) included.

    `difference` holds ``M_i - X_0``, and `squared_error` the estimated variance of such a difference.
    """
    steps: list[tuple[float | None, float | None, bool]] = []
    going_down = True
    for dose in range(len(difference) - 1, 0, -1):
        critical = _critical_value(dose, float(degrees_of_freedom), alpha) if degrees_of_freedom else None
        if critical is None or squared_error == 0.0:
            t, exceeds = None, bool(difference[dose] > rounding)
        else:
            t = float(difference[dose]) / math.sqrt(squared_error)
            exceeds = t > critical
        going_down = going_down and exceeds
        steps.append((t, critical, going_down))
    steps.append((None, None, False))
    return steps[::-1]


@lru_cache(maxsize=256)
def _critical_value(n_doses: int, degrees_of_freedom: float, alpha: float) -> float:
    # The largest dose alone is Student's t, a lower bound; no trailing mean has a larger variance, so that
    # Bonferroni's inequality gives an upper bound. Both are widened for rounding.
    finite = min(degrees_of_freedom, _KNOWN_VARIANCE)
    lower = -float(stdtrit(finite, alpha)) * 0.999 - 1e-3
    upper = -float(stdtrit(finite, alpha / n_doses)) * 1.001 + 1e-3
    log_alpha = math.log(alpha)

    def excess(t: float) -> float:
        return math.log(_exceedance(t, n_doses, degrees_of_freedom)) - log_alpha

    return float(brentq(excess, lower, upper, xtol=1e-9, rtol=1e-12))


def _exceedance(t: float, n_doses: int, degrees_of_freedom: float) -> float:
    """Probability that the statistic of the largest dose exceeds `t` under the null."""
    if degrees_of_freedom >= _KNOWN_VARIANCE:
        return float(_exceedance_known_variance(np.array([math.sqrt(2.0) * t]), n_doses)[0])
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
    return float(weight @ _exceedance_known_variance(math.sqrt(2.0) * t * s, n_doses))


def _exceedance_known_variance(c: NDArray[np.float64], n_doses: int) -> NDArray[np.float64]:
    """Mean of ``1 - H_k(x + c)`` over a standard normal x, for c of shape (n,)."""
    return _leaves_half_line(c[:, np.newaxis] + _CONTROL, n_doses) @ _CONTROL_WEIGHT


def _leaves_half_line(c: NDArray[np.float64], n_steps: int) -> NDArray[np.float64]:
    """``1 - H_k(c)`` by Spitzer's identity, written for the complements so that small tails keep digits."""
    single = [ndtr(-math.sqrt(j) * c) for j in range(1, n_steps + 1)]  # 1 - Phi(c sqrt(j))
    leaves = [np.zeros_like(c)]
    for k in range(1, n_steps + 1):
        terms = (single[j - 1] + leaves[k - j] * (1.0 - single[j - 1]) for j in range(1, k + 1))
        leaves.append(sum(terms, np.zeros_like(c)) / k)
    return leaves[n_steps]
