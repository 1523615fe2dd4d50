"""How the parameters of the model run over theta_diff.

Between knots the logarithms of kappa and gamma, and the ring angle, follow a natural cubic spline, which is kept near
the range of its values at the knots: where no data hold it, in a gap, it would go anywhere.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from dsbrdf.data.grid import THETA_DIFF

Array = NDArray[np.float64]

OVERSHOOT = float(np.log(2.0))
"""How far a spline may leave the range of its knots, in log kappa and log gamma."""
CENTER_OVERSHOOT = float(np.radians(1.0))
"""The same for the angle of a ring lobe [rad]."""


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
