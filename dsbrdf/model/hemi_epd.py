"""The hemispherical exponential power distribution (hemi-EPD), the lobe of the paper, as Algorithm 1 needs it.

The lobe of scale ``kappa > 0`` and shape ``gamma >= 0`` is, without its normalisation
(Nishino 2009, eqs. 3 and 5),

    l(theta) = exp(kappa * cos(theta)**gamma) - 1.

``gamma = 0`` is a constant (a Lambertian lobe), ``gamma -> infinity`` a mirror.  The other fits and evaluation take the
lobe divided by its height, with derivatives, from `dsbrdf.model.lobes`.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def lobe(theta: ArrayLike, kappa: ArrayLike, gamma: ArrayLike) -> Array:
    """Value of the unnormalised lobe (Nishino 2009, eq. 3 without C).

    Parameters
    ----------
    theta : array_like
        Angle theta_half from the normal, 0 to pi/2 [rad].
    kappa, gamma : array_like
        Scale, > 0, and shape, >= 0.

    Returns
    -------
    ndarray
        ``exp(kappa cos(theta)**gamma) - 1``, the arguments broadcast together.
    """
    kappa, gamma = np.asarray(kappa, float), np.asarray(gamma, float)
    return np.expm1(kappa * _power(_log_cos(np.asarray(theta, float)), gamma))


def half_width(kappa: ArrayLike, gamma: ArrayLike) -> Array:
    """Angle at which the lobe has half its peak value [rad]; pi/2 where it never falls that low.

    Solves ``exp(kappa cos(theta)**gamma) - 1 = (exp(kappa) - 1) / 2``.
    """
    kappa, gamma = np.asarray(kappa, float), np.asarray(gamma, float)
    # log1p(expm1(kappa) / 2) without overflow for a large kappa.
    log_ratio = np.log((kappa + np.log1p(np.exp(-kappa)) - np.log(2.0)) / kappa)
    log_ratio = np.where(kappa < 1e-3, np.log(0.5) + np.log1p(kappa / 4.0), log_ratio)
    with np.errstate(divide="ignore"):
        log_cos = log_ratio / gamma
    # arccos(exp(x)) through the sine, which keeps narrow lobes exact.
    return np.arctan2(np.sqrt(-np.expm1(2.0 * log_cos)), np.exp(log_cos))


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
