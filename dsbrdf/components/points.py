"""Compute once the quantities at pairs of directions that all layers of `dsbrdf.components.layers` share."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from dsbrdf.arrays import Array

COAT_F0 = 0.04
"""Reflectance at normal incidence of the clear coat above a layer."""
MIN_COSINE = 0.02
"""Smaller cosines to the normal are clipped, because masking is steep near the horizon, where nothing is measured."""
MAX_TAN2 = 1e4
"""Larger values of tan(theta_half)**2 are clipped."""
MIN_RISE = 1e-3
"""Smaller values of 1 - cos(theta_diff) are clipped for sheen, which uses their logarithm."""
MIN_SINE = 3e-2
"""Smaller values of sin(theta_half) are clipped for sheen, which uses the logarithm of sin(theta_half)."""


class Points(NamedTuple):
    """Hold the quantities that layers use at N pairs of directions: arrays (N,) or stacks (..., N)."""

    squared_tangent: Array  # tan(theta_half)**2
    log_squared_secant: Array
    cos_in: Array
    cos_out: Array
    fresnel: Array  # reflectance of glass at theta_diff, from 0 (normal) to 1 (grazing)
    passed: Array  # logarithm of the fraction of light that passes a clear coat both ways
    rise: Array  # u = 1 - cos(theta_diff) and u**2, (2, N)
    ground: Array  # six terms of the diffuse layer, (6, N)
    fibres: Array  # logarithms of u and of sin(theta_half), (2, N)
    squared_retro: Array  # tan(theta_half)**2 after omega_in is turned by 180 degrees about the normal

    @classmethod
    def at(cls, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Points:
        """Compute the points of angles (N,) [rad]."""
        cos_half, sin_half, cos_diff = np.cos(theta_half), np.sin(theta_half), np.cos(theta_diff)
        level, swing = cos_diff * cos_half, np.sin(theta_diff) * sin_half * np.cos(phi_diff)
        cos_in, cos_out = np.maximum(level - swing, MIN_COSINE), np.maximum(level + swing, MIN_COSINE)
        squared_tangent = np.minimum((sin_half / np.maximum(cos_half, 1e-9)) ** 2, MAX_TAN2)
        rise = 1.0 - np.maximum(cos_diff, 0.0)
        to_in, to_out, fresnel = map(fresnel_rise, (cos_in, cos_out, 1.0 - rise))
        # This is sin(theta_in) sin(theta_out) cos(phi_in - phi_out), the term of Oren and Nayar before its division.
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
            log_squared_secant=np.log1p(squared_tangent),
            cos_in=cos_in,
            cos_out=cos_out,
            fresnel=fresnel,
            passed=passed + 2.0 * np.log(1.0 - COAT_F0),
            rise=np.stack([rise, rise**2]),
            ground=np.stack(ground),
            fibres=np.log(np.stack([np.maximum(rise, MIN_RISE), np.maximum(sin_half, MIN_SINE)])),
            squared_retro=np.maximum(4.0 * np.sin(theta_diff) ** 2 - (cos_in - cos_out) ** 2, 0.0)
            / (cos_in + cos_out) ** 2,
        )


def grid_points(theta_half: Array, theta_diff: Array, phi_diff: Array) -> Iterator[Points]:
    """Yield the points at each theta_half (H,), for all theta_diff (D,) and phi_diff (P,) in this order."""
    diff, phi = (angle.ravel() for angle in np.meshgrid(theta_diff, phi_diff, indexing="ij"))
    for angle in theta_half:
        yield Points.at(np.full(diff.size, angle), diff, phi)


def fresnel_rise(cosine: Array) -> Array:
    """Return the rise (...) of the reflectance of glass (index 1.5) from normal (0) to grazing incidence (1)."""
    refracted = np.sqrt(1.25 + cosine**2)  # This is the cosine of the refracted direction times the index.
    across = (refracted - cosine) / (refracted + cosine)
    ratio = (cosine * (refracted + cosine) - 1.0) / (cosine * (refracted - cosine) + 1.0)
    return np.asarray(np.maximum(0.5 * across**2 * (1.0 + ratio**2) - COAT_F0, 0.0) / (1.0 - COAT_F0))
