"""Directional albedo by quadrature over half vectors.

    rho(omega_out) = integral f(omega_in, omega_out) cos(theta_in) d omega_in,
    d omega_in = 4 cos(theta_diff) d omega_half.

In half vectors even a specular spike is smooth on a scale that is known beforehand: its width in theta_half.
The nodes in theta_half are graded towards 0 for it.  In the azimuth the domain of integration ends where omega_in
reaches the horizon, which is known in closed form.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dsbrdf.profiles import CENTER_CUTOFF

Array = NDArray[np.float64]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)
_AZIMUTH_NODES, _AZIMUTH_WEIGHTS = np.polynomial.legendre.leggauss(24)
_FINE = CENTER_CUTOFF * np.geomspace(1e-3, 1.0, 9)  # panel ends that resolve a spike a hundredth of a degree wide
_COARSE = np.radians(3.0)  # no panel is wider: the narrowest ring lobes


def directional_albedo(evaluate: Callable[[Array, Array], Array], theta_out: Array) -> Array:
    """Directional albedo of a bivariate BRDF.

    Parameters
    ----------
    evaluate : callable
        ``evaluate(theta_half, theta_diff) -> (..., 3)`` [1/sr].
    theta_out : ndarray, shape (...)
        Angles to the normal [rad].

    Returns
    -------
    ndarray, shape (..., 3)
    """
    rows = [_albedo_at(evaluate, float(angle)) for angle in theta_out.ravel()]
    return np.array(rows).reshape(*theta_out.shape, 3)


def _albedo_at(evaluate: Callable[[Array, Array], Array], theta_out: float) -> Array:
    theta_half, weight = _half_angle_rule(theta_out)
    last = _last_azimuth(theta_half, theta_out)
    phi = 0.5 * last[:, None] * (1.0 + _AZIMUTH_NODES)
    cos_diff = np.cos(theta_out) * np.cos(theta_half)[:, None]
    cos_diff = cos_diff + np.sin(theta_out) * np.sin(theta_half)[:, None] * np.cos(phi)
    cos_in = 2.0 * cos_diff * np.cos(theta_half)[:, None] - np.cos(theta_out)
    # The azimuth runs over half the circle: the other half is its mirror image.
    measure = weight[:, None] * np.sin(theta_half)[:, None] * last[:, None] * _AZIMUTH_WEIGHTS
    measure = measure * 4.0 * cos_diff * np.maximum(cos_in, 0.0)
    theta_diff = np.arccos(np.clip(cos_diff, 0.0, 1.0))
    return np.asarray(np.einsum("np,npc->c", measure, evaluate(theta_half[:, None], theta_diff)))


def _half_angle_rule(theta_out: float) -> tuple[Array, Array]:
    """Composite Gauss-Legendre nodes and weights in theta_half.

    The panels end where the azimuth range starts to shrink and where it is empty.  There it behaves like a square
    root, so the nodes of a panel are placed by s*s*(3 - 2 s), which flattens both ends.
    """
    shrinks, ends = 0.5 * (np.pi / 2 - theta_out), 0.5 * (np.pi / 2 + theta_out)
    breaks = np.unique(np.concatenate([[0.0], _FINE, np.arange(CENTER_CUTOFF, ends, _COARSE), [shrinks, ends]]))
    breaks = breaks[breaks <= ends]
    s = 0.5 * (1.0 + _NODES)
    place, slope = s * s * (3.0 - 2.0 * s), 3.0 * s * (1.0 - s)
    length = np.diff(breaks)[:, None]
    return (breaks[:-1, None] + length * place).ravel(), (length * slope * _WEIGHTS).ravel()


def _last_azimuth(theta_half: Array, theta_out: float) -> Array:
    """Largest azimuth of the half vector from omega_out at which omega_in is above the horizon."""
    down = np.cos(theta_out) * np.cos(2.0 * theta_half)
    across = np.sin(theta_out) * np.sin(2.0 * theta_half)
    ratio = np.where(across > np.abs(down), down / np.where(across > 0, across, 1.0), np.sign(down))
    return np.arccos(np.clip(-ratio, -1.0, 1.0))
