"""Compute the directional albedo by quadrature over half vectors.

    rho(omega_out) = integral f(omega_in, omega_out) cos(theta_in) d omega_in,
    d omega_in = 4 cos(theta_diff) d omega_half.

In half vectors even a specular spike is smooth on the scale of its width in theta_half, so the nodes in theta_half are
graded towards 0. In the azimuth, the domain of integration ends at an angle in closed form, where omega_in reaches the
horizon.

The paper's model has a kink at each of its slices. The azimuth is cut in closed form where theta_diff passes a slice,
and theta_half is cut where a slice enters or leaves the range of azimuths; the integrand is smooth between the cuts.
A spline needs no cuts.
"""

from typing import NamedTuple

import numpy as np

from dsbrdf.arrays import Array, Evaluate, Indices
from dsbrdf.data.grid import CENTER_CUTOFF

_NO_KNOTS = np.zeros(0)

_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(8)
# These panel ends resolve a spike with a width of 0.01 degrees, and the edge of the delta term.
_FINE_PANEL_ENDS = CENTER_CUTOFF * np.concatenate([np.geomspace(1e-3, 1.0, 9), [1.7, 2.8, 4.5]])
_PANEL_WIDTH = np.radians(4.0)  # width of the other panels
# Ends of panels, as fractions of the azimuths with omega_in above the horizon. Panels are short near azimuth 0, where
# theta_diff changes fastest, and an elongated lobe has its ridge a quarter turn from the plane of incidence.
_AZIMUTH_ENDS = np.array([0.0, 0.2, 0.5, 1.0])


def directional_albedo(evaluate: Evaluate, theta_out: Array, knots: Array = _NO_KNOTS) -> Array:
    """Return the directional albedo (..., 3) of a reciprocal isotropic BRDF at angles theta_out (...) [rad].

    `evaluate` need not be smooth where theta_diff is one of the `knots` (D,) [rad]. The relative error is below 1e-5
    for lobes about the normal wider than a hundredth of a degree, and below 5e-4 for ring lobes wider than two.
    """
    rules = (half_vector_rule(float(angle), knots) for angle in theta_out.ravel())
    rows = [rule.weight @ evaluate(rule.theta_half, rule.theta_diff, rule.phi_diff) for rule in rules]
    return np.array(rows).reshape(*theta_out.shape, 3)


class HalfVectorRule(NamedTuple):
    """Hold nodes (n,) for integrals over omega_in, with angles in radians."""

    theta_half: Array
    theta_diff: Array
    phi_diff: Array
    azimuth: Array  # azimuth from omega_out to the half vector, over half of the circle
    cos_in: Array  # not negative
    weight: Array  # weight in the integral of f cos(theta_in) d omega_in [sr]


def half_vector_rule(theta_out: float, knots: Array = _NO_KNOTS) -> HalfVectorRule:
    """Return nodes for integrals over the hemisphere of omega_in; knots as for `directional_albedo`."""
    theta_half, weight = _half_angle_rule(theta_out, knots)
    row, phi, phi_weight = _azimuth_rule(theta_half, theta_out, knots)
    theta_half, weight = theta_half[row, None], weight[row, None]
    cos_diff = np.cos(theta_out) * np.cos(theta_half) + np.sin(theta_out) * np.sin(theta_half) * np.cos(phi)
    cos_in = np.maximum(2.0 * cos_diff * np.cos(theta_half) - np.cos(theta_out), 0.0)
    # The azimuth runs over half of the circle; the other half is its mirror image.
    measure = 2.0 * weight * phi_weight * np.sin(theta_half) * 4.0 * cos_diff * cos_in
    theta_diff = np.arccos(np.clip(cos_diff, 0.0, 1.0))
    # Solve cos_out = cos(theta_half) cos(theta_diff) + sin(theta_half) sin(theta_diff) cos(phi_diff) for phi_diff.
    swing = np.sin(theta_half) * np.sin(theta_diff)
    cos_phi = (np.cos(theta_out) - np.cos(theta_half) * cos_diff) / np.where(swing > 0.0, swing, np.inf)
    phi_diff = np.arccos(np.clip(cos_phi, -1.0, 1.0))
    parts = np.broadcast_arrays(theta_half, theta_diff, phi_diff, phi, cos_in, measure)
    return HalfVectorRule(*(part.ravel() for part in parts))


def _half_angle_rule(theta_out: float, knots: Array) -> tuple[Array, Array]:
    """Return composite Gauss-Legendre nodes and weights in theta_half.

    The panels end where the azimuth range starts to shrink, where it is empty, and where a knot enters or leaves it.
    There it behaves like a square root, so the nodes of a panel are placed by s*s*(3 - 2 s), which flattens both ends.
    """
    shrinks, ends = 0.5 * (np.pi / 2 - theta_out), 0.5 * (np.pi / 2 + theta_out)
    even = np.arange(_FINE_PANEL_ENDS[-1], ends, _PANEL_WIDTH)
    # A knot enters at theta_diff = |theta_half - theta_out|, and leaves at theta_diff = theta_half + theta_out.
    kinks = np.concatenate([np.abs(theta_out - knots), theta_out + knots])
    breaks = np.unique(np.concatenate([[0.0], _FINE_PANEL_ENDS, even, kinks, [shrinks, ends]]))
    breaks = breaks[breaks <= ends]
    s = 0.5 * (1.0 + _GAUSS_NODES)
    place, slope = s * s * (3.0 - 2.0 * s), 3.0 * s * (1.0 - s)
    length = np.diff(breaks)[:, None]
    return (breaks[:-1, None] + length * place).ravel(), (length * slope * _GAUSS_WEIGHTS).ravel()


def _azimuth_rule(theta_half: Array, theta_out: float, knots: Array) -> tuple[Indices, Array, Array]:
    """Return a composite Gauss-Legendre rule in the azimuth of each theta_half, cut at the knots.

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
    return row, start + 0.5 * length * (1.0 + _GAUSS_NODES), 0.5 * length * _GAUSS_WEIGHTS


def last_azimuth(theta_half: Array, theta_out: float) -> Array:
    """Return the largest azimuth of the half vector from omega_out with omega_in above the horizon."""
    down = np.cos(theta_out) * np.cos(2.0 * theta_half)
    across = np.sin(theta_out) * np.sin(2.0 * theta_half)
    ratio = np.where(across > np.abs(down), down / np.where(across > 0, across, 1.0), np.sign(down))
    return np.arccos(np.clip(-ratio, -1.0, 1.0))
