"""Interpolate the parameters of the model over theta_diff.

A parameter is a clamped cubic B-spline of its control values. Between two knots the spline stays within the range of
the four control values that determine it there: a positive parameter stays positive and does not overshoot. A spline
with B knots has B + 2 control values; a single knot makes a constant. The paper interpolates linearly between values at
knots.
"""

import numpy as np

from dsbrdf.arrays import Array

DEGREE = 3
SECOND_DIFFERENCE_WEIGHT = 3e-2
"""Weight of squared second differences of control values, relative to squared errors, where splines are fitted."""


def n_control_values(n_knots: int) -> int:
    """Return the number of control values of a spline with `n_knots` knots."""
    return 1 if n_knots == 1 else n_knots + DEGREE - 1


def knot_vector(knots: Array) -> Array:
    """Return the knots (B + 6,) of a clamped cubic spline, with the first and the last of B knots four times."""
    return np.concatenate([np.repeat(knots[0], DEGREE), knots, np.repeat(knots[-1], DEGREE)])


def spline_basis(knots: Array, theta_diff: Array) -> Array:
    """Return the weight of every control value at each theta_diff, (angles, control values), for knots (B,) [rad].

    Weights are not negative, and the weights at an angle sum to 1; theta_diff is clipped to the first and the last
    knot.
    """
    if knots.size == 1:
        return np.ones((theta_diff.size, 1))
    return _basis(knot_vector(knots), DEGREE, np.clip(theta_diff, knots[0], knots[-1]))


def pieces_of(knots: Array, values: Array, breaks: Array, *, spline: bool) -> Array:
    """Return R curves as cubic polynomials in theta_diff (4, P - 1, R), between each of P breaks and the next.

    The first axis has the coefficients of (theta_diff - break)**3 to **0 for the break at which a polynomial begins.
    The curves are splines with control values (D, R) on knots (B,), or linear between values (B, R) at the knots. All
    knots must be among the breaks. Beyond its own knots a curve is constant.
    """
    starts = breaks[:-1]
    if knots.size == 1:
        level = np.repeat(values[:1], starts.size, axis=0)
        return np.stack([np.zeros_like(level)] * 3 + [level])
    inside = ((starts >= knots[0]) & (starts < knots[-1]))[:, None]
    held = np.clip(starts, knots[0], knots[-1])
    if not spline:
        piece = np.clip(np.searchsorted(knots, starts, side="right") - 1, 0, knots.size - 2)
        slope = (np.diff(values, axis=0) / np.diff(knots)[:, None])[piece]
        level = values[piece] + slope * (held - knots[piece])[:, None]
        return np.stack([np.zeros_like(level), np.zeros_like(level), slope * inside, level])
    all_knots, terms, factor = knot_vector(knots), [_basis(knot_vector(knots), DEGREE, held) @ values], 1.0
    for order in range(1, DEGREE + 1):
        # The derivative of a spline is a spline of one degree less, without the first and the last of its knots.
        degree = DEGREE - order
        all_knots = all_knots[1:-1]
        spans = all_knots[degree + 1 :] - all_knots[: -degree - 1]
        values = (degree + 1) * np.diff(values, axis=0) / spans[:, None]
        factor *= order
        terms.append(_basis(all_knots, degree, held) @ values * inside / factor)
    return np.stack(terms[::-1])


def roughness(n_values: int) -> Array:
    """Return the matrix (D, D) of the quadratic form that sums squared second differences of D control values."""
    second = np.diff(np.eye(n_values), 2, axis=0)
    return np.asarray(second.T @ second)


def smooth_control_values(basis: Array, values: Array) -> Array:
    """Return control values (D, n) of n smooth splines that fit values (rows, n).

    `basis` (rows, D) is the `spline_basis` at the angles of the rows.
    """
    ridge = SECOND_DIFFERENCE_WEIGHT * roughness(basis.shape[1]) + 1e-9 * np.eye(basis.shape[1])
    return np.asarray(np.linalg.solve(basis.T @ basis + ridge, basis.T @ values))


def _basis(all_knots: Array, degree: int, at: Array) -> Array:
    """Return values (R, D) of D B-splines at angles (R,) within the knots, by the recursion of Cox and de Boor."""
    n_values = all_knots.size - degree - 1
    piece = np.clip(all_knots.searchsorted(at, side="right") - 1, degree, n_values - 1)
    local = np.ones((at.size, 1))
    for order in range(1, degree + 1):
        index = piece[:, None] + np.arange(1, order + 1)
        share = local / (all_knots[index] - all_knots[index - order])
        rising, falling = (at[:, None] - all_knots[index - order]) * share, (all_knots[index] - at[:, None]) * share
        local = np.zeros((at.size, order + 1))
        local[:, :-1] = falling
        local[:, 1:] += rising
    basis = np.zeros((at.size, n_values))
    np.put_along_axis(basis, piece[:, None] + np.arange(-degree, 1), local, axis=1)
    return basis
