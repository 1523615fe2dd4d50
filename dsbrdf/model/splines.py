"""How the parameters of the model run over theta_diff.

A parameter is a clamped cubic B-spline of its control values: between knots it stays within the range of the control
values around it, so that a positive one stays positive and nothing overshoots.  Knots B make B + 2 control values; a
single knot makes a constant.  `linear` interpolation, the paper's, has its values at the knots.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

Array = NDArray[np.float64]

DEGREE = 3


def n_control_values(n_knots: int) -> int:
    """Number of control values of a spline with this many knots."""
    return 1 if n_knots == 1 else n_knots + DEGREE - 1


def knot_vector(knots: Array) -> Array:
    """Knots with both ends repeated, as a clamped spline has them, shape (B + 6,)."""
    return np.concatenate([np.repeat(knots[0], DEGREE), knots, np.repeat(knots[-1], DEGREE)])


def spline_basis(knots: Array, theta_diff: Array) -> Array:
    """Weights of the control values in the spline's value at each theta_diff.

    Parameters
    ----------
    knots : ndarray, shape (B,)
        Increasing [rad].
    theta_diff : ndarray, shape (R,)
        Held at the first and the last knot beyond them [rad].

    Returns
    -------
    ndarray, shape (R, D)
        Non-negative; each row adds up to 1.
    """
    if knots.size == 1:
        return np.ones((theta_diff.size, 1))
    held = np.clip(theta_diff, knots[0], knots[-1])
    return np.asarray(BSpline.design_matrix(held, knot_vector(knots), DEGREE).toarray())


def pieces_of_spline(knots: Array, values: Array, breaks: Array) -> Array:
    """Coefficients of a spline on pieces that begin at the breaks.

    Parameters
    ----------
    knots : ndarray, shape (B,)
    values : ndarray, shape (D, R)
        Control values of R splines.
    breaks : ndarray, shape (P,)
        Increasing, all knots among them; the last one ends the last piece.

    Returns
    -------
    ndarray, shape (4, P - 1, R)
        Coefficients of (theta_diff - break)**3 to **0; constant beyond the spline's own knots.
    """
    starts = breaks[:-1]
    if knots.size == 1:
        return _constant(values, starts.size)
    spline = BSpline(knot_vector(knots), values, DEGREE)
    inside = (starts >= knots[0]) & (starts < knots[-1])
    held = np.clip(starts, knots[0], knots[-1])
    terms = [spline(held, order) * inside[:, None] / factor for order, factor in ((3, 6.0), (2, 2.0), (1, 1.0))]
    terms.append(spline(held))
    return np.stack(terms)


def pieces_of_line(knots: Array, values: Array, breaks: Array) -> Array:
    """`pieces_of_spline` for linear interpolation of values (B, R) at the knots."""
    starts = breaks[:-1]
    if knots.size == 1:
        return _constant(values, starts.size)
    piece = np.clip(np.searchsorted(knots, starts, side="right") - 1, 0, knots.size - 2)
    slope = np.diff(values, axis=0) / np.diff(knots)[:, None]
    inside = ((starts >= knots[0]) & (starts < knots[-1]))[:, None]
    held = np.clip(starts, knots[0], knots[-1])
    level = values[piece] + slope[piece] * (held - knots[piece])[:, None]
    return np.stack([np.zeros_like(level), np.zeros_like(level), slope[piece] * inside, level])


def roughness(n_values: int) -> Array:
    """Quadratic form of the squared second differences of control values, shape (D, D)."""
    second = np.diff(np.eye(n_values), 2, axis=0) if n_values > 2 else np.zeros((0, n_values))
    return np.asarray(second.T @ second)


def _constant(values: Array, n_pieces: int) -> Array:
    level = np.repeat(values[:1], n_pieces, axis=0)
    return np.stack([np.zeros_like(level)] * 3 + [level])
