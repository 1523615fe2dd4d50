"""Compute the directional albedo by quadrature over half vectors.

The directional albedo rho of a BRDF f is

    rho(omega_out) = integral f(omega_in, omega_out) cos(theta_in) d omega_in,
    d omega_in = 4 cos(theta_diff) d omega_half.

The half vector has the polar angle theta_half and an azimuth, which is 0 towards omega_out. A specular spike is narrow
only in theta_half, so the nodes of the quadrature are dense near theta_half = 0. The integral over the azimuth ends
where omega_in reaches the horizon; this azimuth has a closed form.

The values of the paper's model have a kink wherever theta_diff is the angle of a slice. The integrals over theta_half
and over the azimuth are divided at these kinks, so that the integrand is smooth in every part. The azimuth is divided
where theta_diff passes a slice. The polar angle theta_half is divided where the range of theta_diff over all azimuths
begins or ceases to contain a slice. Models with splines have no kinks.
"""

from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np

from dsbrdf.arrays import Array, Evaluate, Indices
from dsbrdf.data.geometry import CENTER_CUTOFF

_NO_KNOTS = np.zeros(0)
_gauss = cache(np.polynomial.legendre.leggauss)

_N_PANEL_NODES = 8  # Number of Gauss-Legendre nodes in each panel, an interval of the quadrature.
# The ends of narrow panels in theta_half [rad] resolve a lobe of 0.01 degrees and the step of `delta` at 1 degree.
_FINE_PANEL_ENDS = CENTER_CUTOFF * np.concatenate([np.geomspace(1e-3, 1.0, 9), [1.7, 2.8, 4.5]])
_PANEL_WIDTH = np.radians(4.0)  # Width of the intervals at larger theta_half, where the integrand is smooth [rad].
_AZIMUTH_ENDS = np.array([0.0, 0.2, 0.5, 1.0])
"""Ends of the intervals in the azimuth, as fractions of the range in which omega_in is above the horizon.

Intervals are short near azimuth 0, because theta_diff varies fastest with the azimuth there.
"""


def directional_albedo(evaluate: Evaluate, theta_out: Array, knots: Array = _NO_KNOTS) -> Array:
    """Return the directional albedo (..., 3) of a reciprocal isotropic BRDF at angles theta_out (...) [rad].

    `evaluate` may have kinks where theta_diff is one of the `knots` (D,) [rad]. The relative error is below 1e-5 for
    lobes about the normal that are wider than 0.01 degrees, and below 5e-4 for ring lobes wider than 2 degrees.
    """
    angles = theta_out.ravel().tolist()
    rules = (half_vector_rule(angle, knots) if knots.size else _smooth_rule(angle) for angle in angles)
    rows = [rule.weight @ evaluate(rule.theta_half, rule.theta_diff, rule.phi_diff) for rule in rules]
    return np.array(rows).reshape(*theta_out.shape, 3)


class HalfVectorRule(NamedTuple):
    """The nodes (n,) of a quadrature over omega_in; angles are in radians."""

    theta_half: Array
    theta_diff: Array
    phi_diff: Array
    azimuth: Array  # azimuth from omega_out to the half vector, 0 to pi
    cos_in: Array  # cosine of omega_in to the normal, at least 0
    weight: Array  # The sum of weight * f approximates the integral of f cos(theta_in) d omega_in [sr].


def half_vector_rule(
    theta_out: float, knots: Array = _NO_KNOTS, *, n_panel_nodes: int = _N_PANEL_NODES
) -> HalfVectorRule:
    """Return a quadrature over all omega_in for one omega_out; `knots` as in `directional_albedo`.

    With 4 instead of 8 nodes in each panel, the quadrature has a quarter of the nodes in all, and the relative error of
    an albedo is mostly below 1e-3.
    """
    gauss = _gauss(n_panel_nodes)
    theta_half, weight = _half_angle_rule(theta_out, knots, gauss)
    row, phi, phi_weight = _azimuth_rule(theta_half, theta_out, knots, gauss)
    theta_half, weight = theta_half[row, None], weight[row, None]
    cos_diff = np.cos(theta_out) * np.cos(theta_half) + np.sin(theta_out) * np.sin(theta_half) * np.cos(phi)
    cos_in = np.maximum(2.0 * cos_diff * np.cos(theta_half) - np.cos(theta_out), 0.0)
    # The factor 2 counts azimuths from pi to 2 pi, where values are equal by symmetry.
    measure = 2.0 * weight * phi_weight * np.sin(theta_half) * 4.0 * cos_diff * cos_in
    theta_diff = np.arccos(np.clip(cos_diff, 0.0, 1.0))
    # Solve cos_out = cos(theta_half) cos(theta_diff) + sin(theta_half) sin(theta_diff) cos(phi_diff) for phi_diff.
    swing = np.sin(theta_half) * np.sin(theta_diff)
    cos_phi = (np.cos(theta_out) - np.cos(theta_half) * cos_diff) / np.where(swing > 0.0, swing, np.inf)
    phi_diff = np.arccos(np.clip(cos_phi, -1.0, 1.0))
    parts = np.broadcast_arrays(theta_half, theta_diff, phi_diff, phi, cos_in, measure)
    return HalfVectorRule(*(part.ravel() for part in parts))


@lru_cache(maxsize=8)
def _smooth_rule(theta_out: float) -> HalfVectorRule:
    return half_vector_rule(theta_out)


def _half_angle_rule(theta_out: float, knots: Array, gauss: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return composite Gauss-Legendre nodes and weights in theta_half.

    Beyond one theta_half, omega_in is below the horizon at some azimuths; beyond another theta_half, at all azimuths.
    Intervals end at these two angles, and where the range of theta_diff over all azimuths begins or ceases to contain a
    knot. Near such ends the integral over the azimuth behaves like a square root of the distance; the substitution
    s*s*(3 - 2 s) makes the integrand smooth there.
    """
    shrinks, ends = 0.5 * (np.pi / 2 - theta_out), 0.5 * (np.pi / 2 + theta_out)
    even = np.arange(_FINE_PANEL_ENDS[-1], ends, _PANEL_WIDTH)
    # Over all azimuths, theta_diff has the range from |theta_half - theta_out| to theta_half + theta_out.
    kinks = np.concatenate([np.abs(theta_out - knots), theta_out + knots])
    breaks = np.unique(np.concatenate([[0.0], _FINE_PANEL_ENDS, even, kinks, [shrinks, ends]]))
    breaks = breaks[breaks <= ends]
    s = 0.5 * (1.0 + gauss[0])
    place, slope = s * s * (3.0 - 2.0 * s), 3.0 * s * (1.0 - s)
    length = np.diff(breaks)[:, None]
    return (breaks[:-1, None] + length * place).ravel(), (length * slope * gauss[1]).ravel()


def _azimuth_rule(
    theta_half: Array, theta_out: float, knots: Array, gauss: tuple[Array, Array]
) -> tuple[Indices, Array, Array]:
    """Return a composite Gauss-Legendre rule in the azimuth for each theta_half, divided at the knots.

    Returns the index of theta_half for each interval of the azimuth, and azimuths and weights (intervals, nodes).
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
    return row, start + 0.5 * length * (1.0 + gauss[0]), 0.5 * length * gauss[1]


def last_azimuth(theta_half: Array, theta_out: float) -> Array:
    """Return the largest azimuth of the half vector, from omega_out, at which omega_in is above the horizon."""
    down = np.cos(theta_out) * np.cos(2.0 * theta_half)
    across = np.sin(theta_out) * np.sin(2.0 * theta_half)
    ratio = np.where(across > np.abs(down), down / np.where(across > 0, across, 1.0), np.sign(down))
    return np.arccos(np.clip(-ratio, -1.0, 1.0))
