"""Define the families of lobes, functions of the offset: the distance of theta' from the center.

A family is an entry of `FAMILIES`; `dsbrdf.model.lobes` has the formulas and all code common to the families.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dsbrdf.arrays import Array

Family = Literal["hemi_epd", "student"]
"""Names of the families."""
MAX_CENTER = 1.57
"""Maximum distance of a center from the normal [rad]; nearer to pi/2, rounding decides the tangent's sign."""
_MIN_LOG = -200.0  # Squares of smaller exponentials are slow subnormal numbers.
_MIN_SINGLE_LOG = -35.0  # This is the limit in single precision.

Slopes = Callable[[], tuple[Array, Array, Array, Array]]
"""Returns derivatives in log kappa, log gamma, the offset's squared tangent, and this square at the maximum."""


@dataclass(frozen=True)
class LobeFamily:
    """Define a family of lobes; kappa and gamma are positive, and angles are in radians."""

    fall_to_half: Callable[[Array], Array]  # gamma times the reach at half height, as a function of kappa
    slope_of_fall: Callable[[Array], Array]  # derivative of the logarithm of `fall_to_half` in log kappa
    reach: Callable[[Array], Array]  # the factor of gamma at an offset with a squared tangent
    squared_tangent: Callable[[Array], Array]  # inverse of `reach`
    slope_of_width: Callable[
        [Array, Array], Array
    ]  # derivative of the offset in log reach, from the reach and the tangent
    largest_tangent: float  # A lobe is constant beyond this tangent of the offset.
    # The curve returns lobes of height 1 and a function for their derivatives. Its arguments are the offset's squared
    # tangent, kappa, gamma and, for lobes with their maximum at the normal but not at offset 0, this square there.
    curve: Callable[[Array, Array, Array, Array | None], tuple[Array, Slopes]]


def _power(log_power: Array) -> Array:
    return np.exp(np.maximum(log_power, _MIN_LOG if log_power.dtype == np.float64 else _MIN_SINGLE_LOG))


def _hemi_epd_fall(kappa: Array) -> Array:
    return np.log(kappa / np.log1p(0.5 * np.expm1(kappa)))


def _hemi_epd_slope(kappa: Array) -> Array:
    half = 0.5 * np.expm1(kappa)
    return (1.0 - kappa * (half + 0.5) / ((1.0 + half) * np.log1p(half))) / _hemi_epd_fall(kappa)


def _hemi_epd_curve(square: Array, kappa: Array, gamma: Array, top: Array | None) -> tuple[Array, Slopes]:
    per_log, plus_one = -0.5 * gamma, 1.0 + square
    fall, largest = per_log * np.log1p(square), kappa
    if top is not None:
        fall_to_top = per_log * np.log1p(top)
        fall -= fall_to_top
        largest = kappa * _power(fall_to_top)
    exponent, scale = _power(fall), 1.0 / np.expm1(largest)
    exponent *= largest
    grown = np.expm1(exponent)
    value = grown * scale

    def slopes() -> tuple[Array, Array, Array, Array]:
        by_fall = exponent * scale
        by_fall *= grown + 1.0
        per_value = largest * (scale + 1.0)
        by_log_kappa = value * -per_value
        by_log_kappa += by_fall
        by_log_gamma, by_square = by_fall * fall, by_fall * (per_log / plus_one)
        if top is None:
            return by_log_kappa, by_log_gamma, by_square, np.zeros(())
        by_log_gamma += by_log_kappa * fall_to_top
        return by_log_kappa, by_log_gamma, by_square, value * (-per_value * per_log / (1.0 + top))

    return value, slopes


def _student_slope(kappa: Array) -> Array:
    power = np.log(2.0) / kappa
    return -power / -np.expm1(-power)


def _student_curve(square: Array, kappa: Array, gamma: Array, top: Array | None) -> tuple[Array, Slopes]:
    scaled, scaled_top = gamma * square, gamma * (0.0 if top is None else top)
    plus_one = 1.0 + scaled
    fall = kappa * (np.log1p(scaled_top) - np.log1p(scaled))
    value = _power(fall)

    def slopes() -> tuple[Array, Array, Array, Array]:
        per_log, falls_at_top = kappa * value, 1.0 / (1.0 + scaled_top)
        by_log_gamma = per_log * (scaled_top * falls_at_top - scaled / plus_one)
        return value * fall, by_log_gamma, -gamma * per_log / plus_one, per_log * (gamma * falls_at_top)

    return value, slopes


FAMILIES = {
    "hemi_epd": LobeFamily(
        fall_to_half=_hemi_epd_fall,
        slope_of_fall=_hemi_epd_slope,
        reach=lambda squared_tangent: 0.5 * np.log1p(squared_tangent),
        squared_tangent=lambda reach: np.expm1(np.minimum(2.0 * reach, -_MIN_LOG)),
        slope_of_width=lambda reach, tangent: reach / tangent,
        largest_tangent=1e12,
        curve=_hemi_epd_curve,
    ),
    "student": LobeFamily(
        fall_to_half=lambda kappa: np.expm1(np.log(2.0) / kappa),
        slope_of_fall=_student_slope,
        reach=lambda squared_tangent: squared_tangent,
        squared_tangent=lambda reach: reach,
        slope_of_width=lambda _, tangent: 0.5 * tangent / (1.0 + tangent**2),  # The reach is tangent**2.
        largest_tangent=float(np.tan(MAX_CENTER)),
        curve=_student_curve,
    ),
}
"""Families by name; a new family also needs a name in `Family`, and formulas in the GLSL and Mitsuba exports."""
