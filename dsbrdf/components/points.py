"""Pairs of directions as layers see them: what all layers of `dsbrdf.components.layers` need to know, found once."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from dsbrdf.arrays import Array

COAT_F0 = 0.04
"""Reflectance at normal incidence of the clear coat that light passes on its way to a layer below."""
LEAST_COSINE = 0.02  # masking and transmittance have steep ends at the horizon, where nobody measures
LARGEST_TANGENT = 1e4  # squared
LEAST_RISE, LEAST_SINE = 1e-3, 3e-2  # of sheen: the logarithm of nothing has no value


class Points(NamedTuple):
    """What the layers need to know of N pairs of directions: arrays (N,), or stacks of them (..., N)."""

    squared_tangent: Array  # of theta_half
    log_squared_secant: Array
    cos_in: Array
    cos_out: Array
    fresnel: Array  # s at theta_diff
    passed: Array  # log of the light that passes a clear coat both ways
    rise: Array  # u and u**2, (2, N)
    ground: Array  # X of the diffuse layer, (6, N)
    fibres: Array  # log u and log sin(theta_half), (2, N)
    squared_retro: Array  # squared tangent of the half vector's angle after omega_in is turned by 180 degrees

    @classmethod
    def at(cls, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Points:
        """Points of angles (N,) [rad]."""
        cos_half, sin_half, cos_diff = np.cos(theta_half), np.sin(theta_half), np.cos(theta_diff)
        level, swing = cos_diff * cos_half, np.sin(theta_diff) * sin_half * np.cos(phi_diff)
        cos_in, cos_out = np.maximum(level - swing, LEAST_COSINE), np.maximum(level + swing, LEAST_COSINE)
        squared_tangent = np.minimum((sin_half / np.maximum(cos_half, 1e-9)) ** 2, LARGEST_TANGENT)
        rise = 1.0 - np.maximum(cos_diff, 0.0)
        to_in, to_out, fresnel = map(fresnel_rise, (cos_in, cos_out, 1.0 - rise))
        # sin(theta_in) sin(theta_out) cos(phi_in - phi_out), over the larger cosine where it is positive
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
            fibres=np.log(np.stack([np.maximum(rise, LEAST_RISE), np.maximum(sin_half, LEAST_SINE)])),
            squared_retro=np.maximum(4.0 * np.sin(theta_diff) ** 2 - (cos_in - cos_out) ** 2, 0.0)
            / (cos_in + cos_out) ** 2,
        )


def grid_points(theta_half: Array, theta_diff: Array, phi_diff: Array) -> Iterator[Points]:
    """Points at each angle theta_half (H,), for all theta_diff (D,) and phi_diff (P,) in that order."""
    diff, phi = (angle.ravel() for angle in np.meshgrid(theta_diff, phi_diff, indexing="ij"))
    for angle in theta_half:
        yield Points.at(np.full(diff.size, angle), diff, phi)


def fresnel_rise(cosine: Array) -> Array:
    """How far the reflectance of glass (index 1.5) has risen from normal (0) to grazing incidence (1), shape (...)."""
    refracted = np.sqrt(1.25 + cosine**2)  # cosine in the glass, times its index
    across = (refracted - cosine) / (refracted + cosine)
    ratio = (cosine * (refracted + cosine) - 1.0) / (cosine * (refracted - cosine) + 1.0)
    return np.asarray(np.maximum(0.5 * across**2 * (1.0 + ratio**2) - COAT_F0, 0.0) / (1.0 - COAT_F0))
