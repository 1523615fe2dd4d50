"""Where the parameters of the global fit have their knots, and how they run between them.

Knots belong where the data are and where they matter: real materials put nearly all of their squared signal
into the last degrees before the horizon cutoff, and change fastest there.  The knots share out the integral of
a density proportional to the cube root of the squared signal of each theta_diff row, so that they adapt to the
measurement, to its cutoff and to missing regions.  Each stands on a row of the grid.

Between knots the logarithms of kappa and gamma, and the ring angle, follow a natural cubic spline, which is kept near
the range of its values at the knots: where no data hold it, in a gap, it would go anywhere.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from dsbrdf.measurement import THETA_DIFF

Array = NDArray[np.float64]

OVERSHOOT = float(np.log(2.0))
"""How far a spline may leave the range of its knots, in log kappa and log gamma."""
CENTER_OVERSHOOT = float(np.radians(1.0))
"""The same for the angle of a ring lobe [rad]."""
_DENSITY_POWER = 1.0 / 3.0
_DENSITY_FLOOR = 1e-4  # of the whole signal: rows with less still need their share of knots
_DENSITY_WINDOW = 7  # rows averaged, so that noise in single rows places no knots


def place_knots(mean: Array, weight: Array, count: int) -> NDArray[np.intp]:
    """Rows of the theta_diff axis to put knots on.

    Parameters
    ----------
    mean, weight : ndarray, shape (3, 90, N)
        Profiles [1/sr] and weights, 0 for what is not used.
    count : int
        Number of knots asked for.

    Returns
    -------
    ndarray of int, shape (<= count,)
        Increasing; the first and the last row with data are among them.  Fewer than asked for where they would fall
        on the same row.
    """
    rows = np.flatnonzero(weight.sum(axis=(0, 2)) > 0)
    signal = np.einsum("crn,crn->r", weight[:, rows], mean[:, rows] ** 2)
    share = np.log(signal / max(signal.sum(), np.finfo(float).tiny) + _DENSITY_FLOOR)
    half = _DENSITY_WINDOW // 2
    smooth = np.convolve(np.pad(share, half, mode="edge"), np.ones(_DENSITY_WINDOW) / _DENSITY_WINDOW, "valid")
    density = np.exp(_DENSITY_POWER * smooth)
    steps = 0.5 * (density[1:] + density[:-1])  # by rows with data: a gap without data takes no knots
    cumulative = np.concatenate([[0.0], np.cumsum(steps)])
    places = np.interp(np.linspace(0.0, cumulative[-1], count), cumulative, np.arange(rows.size))
    return rows[np.unique(np.round(places).astype(np.intp))]


def spline_basis(knots: Array, theta_diff: Array) -> Array:
    """Weights of the knots' values in the spline's value at each theta_diff.

    Parameters
    ----------
    knots : ndarray, shape (D,)
    theta_diff : ndarray, shape (R,)
        Held at the first and the last knot beyond them.

    Returns
    -------
    ndarray, shape (R, D)
    """
    return parameter_spline(knots, np.eye(knots.size))(np.clip(theta_diff, knots[0], knots[-1]))


def parameter_spline(knots: Array, values: Array) -> CubicSpline:
    """Natural cubic spline through values of shape (D, ...); a straight line for two knots.

    A single knot is a constant.
    """
    if knots.size == 1:
        return CubicSpline(knots[0] + np.array([0.0, 1.0]), np.repeat(values, 2, axis=0), bc_type="natural")
    return CubicSpline(knots, values, bc_type="natural")


def roughness(knots: Array) -> Array:
    """Quadratic form of the squared second differences over the knots, shape (D, D), free of their spacing's scale."""
    count = knots.size
    second = np.zeros((max(count - 2, 0), count))
    for i in range(count - 2):
        before, after = knots[i + 1] - knots[i], knots[i + 2] - knots[i + 1]
        half_span = 0.25 * (before + after)
        second[i, i : i + 3] = half_span * np.array([1.0 / before, -1.0 / before - 1.0 / after, 1.0 / after])
    return second.T @ second


def knot_angles(rows: NDArray[np.intp]) -> Array:
    """Angles theta_diff of the rows [rad]."""
    return THETA_DIFF[rows]
