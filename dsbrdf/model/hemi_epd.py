"""The hemispherical exponential power distribution (hemi-EPD), the lobe of the model.

The lobe of scale ``kappa > 0`` and shape ``gamma >= 0`` is, without its normalisation
(Nishino 2009, eqs. 3 and 5),

    l(theta) = exp(kappa * cos(theta)**gamma) - 1.

``gamma = 0`` is a constant (a Lambertian lobe), ``gamma -> infinity`` a mirror.  A *ring lobe* is the
same function of ``theta - center``; ``center = 0`` is the paper's lobe.  Fitting and evaluation take the lobe
divided by its height, with derivatives, from `dsbrdf.model.lobes`.

Energy.  Integrating the exponential series term by term over the hemisphere gives

    1/C = 2 pi * sum_{n >= 1} kappa**n / (n! (n gamma + 1)),

which is real for every kappa > 0, unlike the paper's closed form with incomplete gamma functions, and has
positive terms only, so that nothing cancels.  Written with Poisson weights p_n = exp(-kappa) kappa**n / n!,

    1/C = 2 pi exp(kappa) * sum_{n >= 1} p_n / (n gamma + 1),

the terms stay in range for any kappa, and only those within a dozen standard deviations of n = kappa count.
The integral from the pole to theta has the same series with a factor 1 - cos(theta)**(n gamma + 1).
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaln

from dsbrdf.errors import InvalidArgumentError

Array = NDArray[np.float64]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
_RING_PANELS = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0, 14.0])


def lobe(theta: ArrayLike, kappa: ArrayLike, gamma: ArrayLike, center: ArrayLike = 0.0) -> Array:
    """Value of the unnormalised lobe (Nishino 2009, eq. 3 without C).

    Parameters
    ----------
    theta : array_like
        Angle theta_half from the normal, 0 to pi/2 [rad].
    kappa, gamma : array_like
        Scale, > 0, and shape, >= 0.
    center : array_like, optional
        Angle of the ring on which the lobe peaks, 0 to pi/2 [rad]; 0 is a lobe about the normal.

    Returns
    -------
    ndarray
        ``exp(kappa cos(theta - center)**gamma) - 1``, the arguments broadcast together.
    """
    kappa, gamma = _check_parameters(kappa, gamma)
    return np.expm1(kappa * _power(_log_cos(np.asarray(theta, float) - np.asarray(center, float)), gamma))


def energy(kappa: ArrayLike, gamma: ArrayLike, center: ArrayLike = 0.0) -> Array:
    """Energy 1/C of the lobe on the hemisphere: the integral of `lobe` over solid angle.

    Parameters
    ----------
    kappa, gamma : array_like
        Scale, > 0, and shape, 0 (Lambertian) to infinity (mirror: energy 0).
    center : array_like, optional
        Angle of the ring [rad].  A ring lobe has no such series; it is integrated numerically.

    Returns
    -------
    ndarray
        ``2 pi sum kappa**n / (n! (n gamma + 1))`` [sr times the lobe's unit]; infinite only where the value
        itself is above the largest double.
    """
    kappa, gamma = _check_parameters(kappa, gamma)
    kappa, gamma, center = np.broadcast_arrays(kappa, gamma, np.asarray(center, float))
    result = np.asarray(_series_energy(kappa, gamma))
    rings = center > 0
    if rings.any():
        result[rings] = _ring_energy(kappa[rings], gamma[rings], center[rings])
    return result


def _series_energy(kappa: Array, gamma: Array) -> Array:
    total = np.zeros(kappa.shape)
    for n, weight in _poisson_terms(kappa):
        total += weight / (n * gamma + 1.0)
    with np.errstate(over="ignore", divide="ignore"):
        return 2.0 * np.pi * np.exp(kappa + np.log(total))


def _ring_energy(kappa: Array, gamma: Array, center: Array) -> Array:
    """Gauss-Legendre on panels that scale with the half width of the lobe, for arrays of shape (n,)."""
    offset = half_width(kappa, gamma)[:, None] * _RING_PANELS
    ends = np.clip(center[:, None] + np.concatenate([-offset[:, ::-1], offset[:, 1:]], axis=1), 0.0, np.pi / 2)
    ends = np.concatenate([np.zeros((kappa.size, 1)), ends, np.full((kappa.size, 1), np.pi / 2)], axis=1)
    half_length = 0.5 * np.diff(ends, axis=1)
    theta = ends[:, :-1, None] + half_length[..., None] * (1.0 + _NODES)
    value = lobe(theta, *(a[:, None, None] for a in (kappa, gamma, center)))
    return np.asarray(2.0 * np.pi * np.einsum("npq,np,q->n", value * np.sin(theta), half_length, _WEIGHTS))


def cdf(theta: ArrayLike, kappa: ArrayLike, gamma: ArrayLike) -> Array:
    """Share of the lobe's energy within ``theta`` of the normal.

    Parameters
    ----------
    theta : array_like
        0 to pi/2 [rad].
    kappa, gamma : array_like
        Scale, > 0, and shape, 0 to infinity.

    Returns
    -------
    ndarray
        Values in [0, 1] with small relative error also where they are small.
    """
    kappa, gamma = _check_parameters(kappa, gamma)
    theta = np.asarray(theta, float)
    if not np.all((theta >= 0) & (theta <= np.pi / 2)):
        raise InvalidArgumentError("theta must lie between 0 and pi/2")
    log_cos = _log_cos(theta)
    # Numerator and denominator are both divided by max(gamma, 1): the mirror limit is then 1, not 0/0.
    by_gamma = 1.0 / np.maximum(gamma, 1.0)
    shape = np.minimum(gamma, 1.0)
    shape_of = np.broadcast_shapes(theta.shape, kappa.shape, gamma.shape)
    inside, total = np.zeros(shape_of), np.zeros(shape_of)
    with np.errstate(invalid="ignore"):
        for n, weight in _poisson_terms(kappa):
            term = weight / (n * shape + by_gamma)
            total += term
            inside += term * -np.expm1(np.where(theta > 0, (n * gamma + 1.0) * log_cos, 0.0))
    return inside / total


def half_width(kappa: ArrayLike, gamma: ArrayLike) -> Array:
    """Angle at which the lobe has half its peak value [rad]; pi/2 where it never falls that low.

    Solves ``exp(kappa cos(theta)**gamma) - 1 = (exp(kappa) - 1) / 2``.  A ring lobe has this half width to
    either side of its center.
    """
    kappa, gamma = _check_parameters(kappa, gamma)
    # log1p(expm1(kappa) / 2) without overflow for a large kappa.
    log_ratio = np.log((kappa + np.log1p(np.exp(-kappa)) - np.log(2.0)) / kappa)
    log_ratio = np.where(kappa < 1e-3, np.log(0.5) + np.log1p(kappa / 4.0), log_ratio)
    with np.errstate(divide="ignore"):
        log_cos = log_ratio / gamma
    # arccos(exp(x)) through the sine, which keeps narrow lobes exact.
    return np.arctan2(np.sqrt(-np.expm1(2.0 * log_cos)), np.exp(log_cos))


def _check_parameters(kappa: ArrayLike, gamma: ArrayLike) -> tuple[Array, Array]:
    kappa, gamma = np.asarray(kappa, float), np.asarray(gamma, float)
    if not np.all((kappa > 0) & (kappa < np.inf)):
        raise InvalidArgumentError("kappa must be positive and finite")
    if not np.all(gamma >= 0):
        raise InvalidArgumentError("gamma must be zero or positive")
    return kappa, gamma


def _log_cos(theta: Array) -> Array:
    """Logarithm of the cosine, exact for small angles too; -infinity from pi/2 on."""
    with np.errstate(divide="ignore"):
        return np.where(
            np.abs(theta) < np.pi / 4,
            0.5 * np.log1p(-(np.sin(theta) ** 2)),
            np.log(np.maximum(np.cos(theta), 0.0)),
        )


def _power(log_cos: Array, gamma: Array) -> Array:
    """Power cos**gamma from its logarithm, with 0**0 = 1 and 1**infinity = 1."""
    with np.errstate(invalid="ignore"):
        return np.where((gamma == 0) | (log_cos == 0), 1.0, np.exp(gamma * log_cos))


def _poisson_terms(kappa: Array) -> Iterator[tuple[Array, Array]]:
    """Yield n and exp(-kappa) kappa**n / n! for every n >= 1 that counts, by recurrence from the first."""
    spread = 12.0 * np.sqrt(kappa)
    n = np.maximum(1.0, np.floor(kappa - spread))
    weight = np.exp(n * np.log(kappa) - kappa - gammaln(n + 1.0))
    last = float(np.max(kappa + spread - n, initial=0.0)) + 30.0
    for _ in range(int(last)):
        yield n, weight
        n = n + 1.0
        weight = weight * kappa / n
