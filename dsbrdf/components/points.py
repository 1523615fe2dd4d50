"""Compute the quantities at pairs of directions from which all layers of `dsbrdf.components.layers` are evaluated.

Some pairs are the nodes of quadratures of the directional albedo.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.model.albedo import half_vector_rule

COAT_INDEX = 1.5
"""Refractive index of the clear coat above a layer."""
COAT_F0 = 0.04
"""Reflectance at normal incidence of the clear coat above a layer."""
MIN_COSINE = 0.02
"""Smaller cosines to the normal are clipped, because masking is steep near the horizon, where nothing is measured."""
MAX_TAN2 = 1e4
"""Larger values of tan(theta_half)**2 are clipped, because the tangent of 90 degrees is infinite."""
MIN_RISE = 1e-3
"""Smaller values of 1 - cos(theta_diff) are clipped for sheen, which uses their logarithm."""
MIN_SINE = 3e-2
"""Smaller values of sin(theta_half) are clipped for sheen, which uses the logarithm of sin(theta_half)."""
_N_PANEL_NODES = 3  # With this number of nodes in each panel of a quadrature, its relative error is mostly below 2e-3.


class Points(NamedTuple):
    """The quantities that layers need at N pairs of directions, as arrays (N,) or stacks of such arrays."""

    squared_tangent: Array  # tan(theta_half)**2
    cosines: Array  # cosines of omega_in and of omega_out to the normal, (2, N)
    squared_sines: Array  # 1 - cosines**2, (2, N)
    fresnel: Array  # reflectance of glass at theta_diff, from 0 (normal) to 1 (grazing)
    passed: Array  # logarithm of the fraction of light that passes a clear coat both ways
    rise: Array  # u = 1 - cos(theta_diff), and u**2
    to_schlick: Array  # u**5, the rise by Schlick's law, minus the rise of glass
    ground: Array  # the six terms of a diffuse layer, see `dsbrdf.components.layers`
    fibres: Array  # logarithms of 1 - cos(theta_diff) and of sin(theta_half), for sheen
    below_coat: (
        Array  # logarithms of the factors of tan(theta_half)**2 and of values below a coat that refracts, (2, N)
    )
    squared_retro: Array  # tan(theta_half)**2 after omega_in is turned by 180 degrees about the normal

    @classmethod
    def at(cls, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Points:
        """Compute the quantities that layers need at angles (N,) [rad]."""
        cos_half, sin_half, cos_diff = np.cos(theta_half), np.sin(theta_half), np.cos(theta_diff)
        level, swing = cos_diff * cos_half, np.sin(theta_diff) * sin_half * np.cos(phi_diff)
        cos_in, cos_out = cosines = np.maximum(np.stack([level - swing, level + swing]), MIN_COSINE)
        below = np.sqrt(COAT_INDEX**2 - 1.0 + cosines**2)
        squared_tangent = np.minimum((sin_half / np.maximum(cos_half, 1e-9)) ** 2, MAX_TAN2)
        rise = 1.0 - np.maximum(cos_diff, 0.0)
        to_in, to_out, fresnel = map(fresnel_rise, (cos_in, cos_out, 1.0 - rise))
        # This equals sin(theta_in) sin(theta_out) cos(phi_in - phi_out), from which the term of Oren and Nayar is made.
        along = 2.0 * cos_diff**2 - 1.0 - cos_in * cos_out
        passed = np.log((1.0 - to_in) * (1.0 - to_out))
        ground = (
            passed,
            cos_diff**2 * (to_in + to_out),
            fresnel,
            np.log(2.0 / (cos_in + cos_out)),
            sin_half**2,
            np.where(along > 0.0, along / np.maximum(cos_in, cos_out), along),
        )
        return cls(
            squared_tangent=squared_tangent,
            cosines=cosines,
            squared_sines=1.0 - cosines**2,
            fresnel=fresnel,
            passed=passed + 2.0 * np.log(1.0 - COAT_F0),
            rise=np.stack([rise, rise**2]),
            to_schlick=rise**5 - fresnel,
            ground=np.stack(ground),
            fibres=np.log(np.stack([np.maximum(rise, MIN_RISE), np.maximum(sin_half, MIN_SINE)])),
            below_coat=np.log(
                np.stack([(cosines.sum(axis=0) / below.sum(axis=0)) ** 2, np.prod(cosines / below, axis=0)])
            ),
            squared_retro=np.maximum(4.0 * np.sin(theta_diff) ** 2 - (cos_in - cos_out) ** 2, 0.0)
            / (cos_in + cos_out) ** 2,
        )


def grid_points(theta_half: Array, theta_diff: Array, phi_diff: Array) -> Iterator[Points]:
    """Yield for each theta_diff the points at all pairs of theta_half (H,) and phi_diff (P,), phi_diff fastest."""
    half, phi = (angle.ravel() for angle in np.meshgrid(theta_half, phi_diff, indexing="ij"))
    for angle in theta_diff:
        yield Points.at(half, np.full(half.size, angle), phi)


def fresnel_rise(cosine: Array) -> Array:
    """Return the reflectance of glass (index 1.5), scaled to 0 at normal incidence and to 1 at grazing incidence."""
    refracted = np.sqrt(1.25 + cosine**2)  # This is the cosine of the refracted direction times the refractive index.
    across = (refracted - cosine) / (refracted + cosine)
    ratio = (cosine * (refracted + cosine) - 1.0) / (cosine * (refracted - cosine) + 1.0)
    return np.asarray(np.maximum(0.5 * across**2 * (1.0 + ratio**2) - COAT_F0, 0.0) / (1.0 - COAT_F0))


class LightRule(NamedTuple):
    """The nodes (n,) and weights of a quadrature of the directional albedo at one angle.

    Attributes
    ----------
    angles : tuple of Array
        theta_half, theta_diff and phi_diff (n,) [rad].
    points : Points
        The nodes in the form that layers evaluate.
    weight : Array
        Weights (n,) [sr].
    """

    angles: tuple[Array, Array, Array]
    points: Points
    weight: Array


def _normal_rule() -> LightRule:
    """Return the quadrature at normal incidence, where theta_half = theta_diff and values do not depend on azimuth."""
    rule = half_vector_rule(0.0)
    angle, place = np.unique(rule.theta_half, return_inverse=True)
    weight = np.asarray(np.bincount(place, rule.weight), dtype=np.float64)
    angles = angle, angle, np.zeros(angle.size)
    return LightRule(angles, Points.at(*angles), weight)


def _light_rule(theta_out: float) -> LightRule:
    rule = half_vector_rule(theta_out, n_panel_nodes=_N_PANEL_NODES)
    angles = rule.theta_half, rule.theta_diff, rule.phi_diff
    return LightRule(angles, Points.at(*angles), rule.weight)


NORMAL = _normal_rule()


@cache
def light_rules() -> tuple[LightRule, LightRule, LightRule]:
    """Return the quadratures of the directional albedo at 0, 45 and 70 degrees to the normal."""
    return NORMAL, _light_rule(float(np.radians(45.0))), _light_rule(float(np.radians(70.0)))
