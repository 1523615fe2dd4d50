"""The families of lobes: how a lobe falls with its offset, the distance of theta' from its center.

A family is an entry of `FAMILIES`; `dsbrdf.model.lobes` has the formulas, and what they have in common.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dsbrdf.arrays import Array

Family = Literal["hemi_epd", "student"]
"""Names of the families."""
LARGEST_CENTER = 1.57
"""A center is so far from the normal at most [rad]: at pi/2, the horizon, rounding decides the tangent's sign."""
LARGEST_TANGENT = float(np.tan(LARGEST_CENTER))
_STEEPEST_TANGENT = 1e12
_LOWEST_LOG = -200.0  # squares of exponentials below need subnormal numbers, which take a hundred times as long


def tangent_of_offset(squared_tangent: Array, center: Array, largest: float = LARGEST_TANGENT) -> Array:
    """tan(theta' - center), as `dsbrdf.model.lobes` defines it."""
    root, tan_center = np.sqrt(squared_tangent), np.tan(center)
    tangent = (root - tan_center) / (1.0 + root * np.maximum(tan_center, 0.0))
    return np.clip(tangent, -largest, largest)


def _log_cos(squared_tangent: Array, center: Array | None) -> Array:
    """Logarithm of cos(theta' - center), exact where it is small."""
    at = squared_tangent if center is None else tangent_of_offset(squared_tangent, center, _STEEPEST_TANGENT) ** 2
    return -0.5 * np.log1p(at)


def _power(log_power: Array) -> Array:
    return np.exp(np.maximum(log_power, _LOWEST_LOG))


@dataclass(frozen=True)
class LobeFamily:
    """What defines a family; kappa and gamma are positive, angles in radians."""

    fall_to_half: Callable[[Array], Array]  # gamma times the reach at half the height, of kappa
    slope_of_fall: Callable[[Array], Array]  # derivative of the logarithm of `fall_to_half` in log kappa
    reach: Callable[[Array], Array]  # what gamma is multiplied by at an offset with a squared tangent
    squared_tangent: Callable[[Array], Array]  # inverse of `reach`
    slope_of_width: Callable[[Array, Array], Array]  # of the offset in log reach, of a reach and the tangent there
    # Lobes of height 1, of tan(theta')**2, kappa, gamma and the center, if there is one.
    values: Callable[[Array, Array, Array, Array | None], Array]
    # Value and derivatives in log kappa, log gamma, the offset (else tan(theta')**2) and the negative part of the
    # center; of the arguments of `values` and the tangents of the offset, if there is a center, and of that part.
    derivatives: Callable[[Array, Array, Array, Array | None, Array | None, Array], tuple[Array, ...]]


def _hemi_epd_fall(kappa: Array) -> Array:
    return np.log(kappa / np.log1p(0.5 * np.expm1(kappa)))


def _hemi_epd_slope(kappa: Array) -> Array:
    half = 0.5 * np.expm1(kappa)
    return (1.0 - kappa * (half + 0.5) / ((1.0 + half) * np.log1p(half))) / _hemi_epd_fall(kappa)


def _hemi_epd_values(squared_tangent: Array, kappa: Array, gamma: Array, center: Array | None) -> Array:
    log_cos = _log_cos(squared_tangent, center)
    if center is None:
        return np.expm1(kappa * _power(gamma * log_cos)) / np.expm1(kappa)
    log_cos_top = -0.5 * np.log1p(np.tan(np.minimum(center, 0.0)) ** 2)
    top = kappa * _power(gamma * log_cos_top)
    return np.expm1(top * _power(gamma * (log_cos - log_cos_top))) / np.expm1(top)


def _hemi_epd_derivatives(
    squared_tangent: Array, kappa: Array, gamma: Array, center: Array | None, tangent: Array | None, tangent_top: Array
) -> tuple[Array, ...]:
    log_cos = _log_cos(squared_tangent, center)
    log_cos_top = -0.5 * np.log1p(tangent_top**2)
    top = kappa * _power(gamma * log_cos_top)
    ratio = _power(gamma * (log_cos - log_cos_top))
    scale = 1.0 / np.expm1(top)
    exponent = top * ratio
    value = np.expm1(exponent) * scale
    by_log_ratio = exponent * np.exp(exponent) * scale
    by_log_top = by_log_ratio - value * (top * np.exp(top) * scale)
    by_log_gamma = by_log_ratio * gamma * (log_cos - log_cos_top) + by_log_top * gamma * log_cos_top
    slope = by_log_ratio * gamma
    # d log cos / d negative = -tan(negative), and the ratio is taken to the top.
    by_top = (by_log_top - by_log_ratio) * gamma * -tangent_top
    by_offset = -0.5 * slope / (1.0 + squared_tangent) if tangent is None else -slope * tangent
    return value, by_log_top, by_log_gamma, by_offset, by_top


def _student_slope(kappa: Array) -> Array:
    power = np.log(2.0) / kappa
    return -power / -np.expm1(-power)


def _student_values(squared_tangent: Array, kappa: Array, gamma: Array, center: Array | None) -> Array:
    at = squared_tangent if center is None else tangent_of_offset(squared_tangent, center) ** 2
    top = 0.0 if center is None else np.log1p(gamma * np.tan(np.minimum(center, 0.0)) ** 2)
    return np.exp(np.maximum(-kappa * (np.log1p(gamma * at) - top), _LOWEST_LOG))


def _student_derivatives(
    squared_tangent: Array, kappa: Array, gamma: Array, _: Array | None, tangent: Array | None, tangent_top: Array
) -> tuple[Array, ...]:
    square = squared_tangent if tangent is None else tangent**2
    at, top = gamma * square, gamma * tangent_top**2
    fall = np.maximum(-kappa * (np.log1p(at) - np.log1p(top)), _LOWEST_LOG)
    value = np.exp(fall)
    by_log_gamma = -value * kappa * (at / (1.0 + at) - top / (1.0 + top))
    by_square = -value * kappa * gamma / (1.0 + at)
    by_top = value * kappa * gamma / (1.0 + top) * 2.0 * tangent_top * (1.0 + tangent_top**2)
    by_offset = by_square if tangent is None else by_square * 2.0 * tangent * (1.0 + square)
    return value, value * fall, by_log_gamma, by_offset, by_top


FAMILIES = {
    "hemi_epd": LobeFamily(
        fall_to_half=_hemi_epd_fall,
        slope_of_fall=_hemi_epd_slope,
        reach=lambda squared_tangent: 0.5 * np.log1p(squared_tangent),
        squared_tangent=lambda reach: np.expm1(np.minimum(2.0 * reach, -_LOWEST_LOG)),
        slope_of_width=lambda reach, tangent: reach / tangent,
        values=_hemi_epd_values,
        derivatives=_hemi_epd_derivatives,
    ),
    "student": LobeFamily(
        fall_to_half=lambda kappa: np.expm1(np.log(2.0) / kappa),
        slope_of_fall=_student_slope,
        reach=lambda squared_tangent: squared_tangent,
        squared_tangent=lambda reach: reach,
        slope_of_width=lambda _, tangent: 0.5 * tangent / (1.0 + tangent**2),  # the reach is the tangent's square
        values=_student_values,
        derivatives=_student_derivatives,
    ),
}
"""Known lobes, by name. A new one also needs a name in `Family` and its formula in the exports to GLSL and Mitsuba."""
