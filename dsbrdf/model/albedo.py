"""Directional albedo by quadrature over half vectors.

    rho(omega_out) = integral f(omega_in, omega_out) cos(theta_in) d omega_in,
    d omega_in = 4 cos(theta_diff) d omega_half.

In half vectors even a specular spike is smooth on a scale that is known beforehand: its width in theta_half.
The nodes in theta_half are graded towards 0 for it. In the azimuth the domain of integration ends where omega_in
reaches the horizon, which is known in closed form.

The paper's model has a kink at each of its slices. The azimuth is cut where theta_diff passes such a knot, again in
closed form, and theta_half where the first or the last azimuth does; between the cuts all is smooth. A spline is
smooth enough without.
"""

from typing import NamedTuple

import numpy as np

from dsbrdf.arrays import Array, Evaluate, Indices
from dsbrdf.data.grid import CENTER_CUTOFF

_SMOOTH = np.zeros(0)

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
# Panel ends that resolve a spike a hundredth of a degree wide, and the edge of the delta term.
_FINE = CENTER_CUTOFF * np.concatenate([np.geomspace(1e-3, 1.0, 9), [1.7, 2.8, 4.5]])
_WIDTH = np.radians(4.0)  # of the other panels
# Panel ends in the part of the circle where omega_in is above the horizon; theta_diff turns fastest near azimuth 0, and
# an elongated lobe has its ridge a quarter turn from the plane of incidence.
_AZIMUTH_ENDS = np.array([0.0, 0.2, 0.5, 1.0])


def directional_albedo(evaluate: Evaluate, theta_out: Array, knots: Array = _SMOOTH) -> Array:
    """Directional albedo (..., 3) of a reciprocal isotropic BRDF at angles theta_out (...) to the normal [rad].

    `evaluate` need not be smooth where theta_diff is one of the `knots` (D,) [rad]. The relative error is below 1e-5
    for lobes about the normal wider than a hundredth of a degree, and below 5e-4 for ring lobes wider than two.
    """
    rules = (half_vector_rule(float(angle), knots) for angle in theta_out.ravel())
    rows = [rule.weight @ evaluate(rule.theta_half, rule.theta_diff, rule.phi_diff) for rule in rules]
    return np.array(rows).reshape(*theta_out.shape, 3)


class HalfVectorRule(NamedTuple):
    """Nodes for integrals over omega_in, each of shape (n,); angles in radians."""

    theta_half: Array
    theta_diff: Array
    phi_diff: Array
    azimuth: Array  # of the half vector, from omega_out: half the circle stands for all of it
    cos_in: Array  # zero or positive
    weight: Array  # of the integral of f cos(theta_in) d omega_in [sr]


def half_vector_rule(theta_out: float, knots: Array = _SMOOTH) -> HalfVectorRule:
    """Nodes in half vectors for integrals over the hemisphere of omega_in; knots as for `directional_albedo`."""
    theta_half, weight = _half_angle_rule(theta_out, knots)
    row, phi, phi_weight = _azimuth_rule(theta_half, theta_out, knots)
    theta_half, weight = theta_half[row, None], weight[row, None]
    cos_diff = np.cos(theta_out) * np.cos(theta_half) + np.sin(theta_out) * np.sin(theta_half) * np.cos(phi)
    cos_in = np.maximum(2.0 * cos_diff * np.cos(theta_half) - np.cos(theta_out), 0.0)
    # The azimuth runs over half the circle: the other half is its mirror image.
    measure = 2.0 * weight * phi_weight * np.sin(theta_half) * 4.0 * cos_diff * cos_in
    theta_diff = np.arccos(np.clip(cos_diff, 0.0, 1.0))
    # cos_out = cos(theta_half) cos(theta_diff) + sin(theta_half) sin(theta_diff) cos(phi_diff)
    swing = np.sin(theta_half) * np.sin(theta_diff)
    cos_phi = (np.cos(theta_out) - np.cos(theta_half) * cos_diff) / np.where(swing > 0.0, swing, np.inf)
    phi_diff = np.arccos(np.clip(cos_phi, -1.0, 1.0))
    parts = np.broadcast_arrays(theta_half, theta_diff, phi_diff, phi, cos_in, measure)
    return HalfVectorRule(*(part.ravel() for part in parts))


def _half_angle_rule(theta_out: float, knots: Array) -> tuple[Array, Array]:
    """Composite Gauss-Legendre nodes and weights in theta_half.

    The panels end where the azimuth range starts to shrink, where it is empty, and where a knot enters or leaves it.
    There it behaves like a square root, so the nodes of a panel are placed by s*s*(3 - 2 s), which flattens both ends.
    """
    shrinks, ends = 0.5 * (np.pi / 2 - theta_out), 0.5 * (np.pi / 2 + theta_out)
    even = np.arange(_FINE[-1], ends, _WIDTH)
    # A knot enters at theta_diff = |theta_half - theta_out|, opposite the normal it leaves at their sum.
    kinks = np.concatenate([np.abs(theta_out - knots), theta_out + knots])
    breaks = np.unique(np.concatenate([[0.0], _FINE, even, kinks, [shrinks, ends]]))
    breaks = breaks[breaks <= ends]
    s = 0.5 * (1.0 + _NODES)
    place, slope = s * s * (3.0 - 2.0 * s), 3.0 * s * (1.0 - s)
    length = np.diff(breaks)[:, None]
    return (breaks[:-1, None] + length * place).ravel(), (length * slope * _WEIGHTS).ravel()


def _azimuth_rule(theta_half: Array, theta_out: float, knots: Array) -> tuple[Indices, Array, Array]:
    """Composite Gauss-Legendre rule in the azimuth of each theta_half, cut at the knots.

    Returns the index of the theta_half to which each panel belongs, and azimuths and weights, each (panels, nodes).
    """
    last = last_azimuth(theta_half, theta_out)[:, None]
    across = np.sin(theta_out) * np.sin(theta_half)[:, None]
    along = np.cos(theta_out) * np.cos(theta_half)[:, None]
    cos_phi = (np.cos(knots) - along) / np.where(across > 0, across, 1.0)
    crossing = np.minimum(np.arccos(np.clip(cos_phi, -1.0, 1.0)), last)
    ends = np.sort(np.concatenate([last * _AZIMUTH_ENDS, crossing], axis=1), axis=1)
    length = np.diff(ends, axis=1)
    row, panel = np.nonzero(length > 1e-12)
    start, length = ends[row, panel, None], length[row, panel, None]
    return row, start + 0.5 * length * (1.0 + _NODES), 0.5 * length * _WEIGHTS


def last_azimuth(theta_half: Array, theta_out: float) -> Array:
    """Largest azimuth of the half vector from omega_out at which omega_in is above the horizon."""
    down = np.cos(theta_out) * np.cos(2.0 * theta_half)
    across = np.sin(theta_out) * np.sin(2.0 * theta_half)
    ratio = np.where(across > np.abs(down), down / np.where(across > 0, across, 1.0), np.sign(down))
    return np.arccos(np.clip(-ratio, -1.0, 1.0))
