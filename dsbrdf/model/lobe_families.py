"""Define the families of lobes, as functions of the angle between theta' and the center of a lobe.

`FAMILIES` has the families of lobes by name. `dsbrdf.model.lobes` has the formulas of the families, and the code that
all families have in common.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dsbrdf.arrays import Array

Family = Literal["hemi_epd", "student"]
"""Names of the families of lobes."""
MAX_CENTER = 1.57
"""Maximum angle between a lobe's center and the normal [rad]; at pi/2, rounding may change the tangent's sign."""
_MIN_LOG = -200.0  # Smaller exponents are clipped: squared exponentials could be subnormal numbers, which are slow.
_MIN_SINGLE_LOG = -35.0  # Smaller exponents are clipped in single precision, where exp(-87) is already subnormal.

Slopes = Callable[[], tuple[Array, Array, Array, Array]]
"""Function that returns the derivatives of lobes in log kappa, in log gamma and in two squared tangents.

The tangents are those of the angle to the center, and of this angle at the maximum of a cusp.
"""


@dataclass(frozen=True)
class LobeFamily:
    """Define a family of lobes with positive kappa and gamma.

    In the formula of a lobe, gamma multiplies a function of the angle to the center of the lobe, called `reach`.
    """

    # Takes kappa, and returns the product of gamma and `reach` at which a lobe has half its height.
    fall_to_half: Callable[[Array], Array]
    # Takes kappa, and returns the derivative of log(fall_to_half) in log kappa.
    slope_of_fall: Callable[[Array], Array]
    # Takes the squared tangent of the angle to the center; returns the function of this angle that gamma multiplies.
    reach: Callable[[Array], Array]
    # Takes a value of `reach`, and returns the squared tangent of the angle to the center.
    squared_tangent: Callable[[Array], Array]
    # Takes `reach` and the tangent of the angle to the center; returns the derivative of the angle by log(reach).
    slope_of_width: Callable[[Array, Array], Array]
    # Larger tangents of the angle to the center are clipped, because the tangent of 90 degrees is infinite.
    largest_tangent: float
    # Takes the squared tangent of the angle to the center, kappa, gamma and, for cusps, this square at the maximum.
    # Returns lobes of height 1, and a function that returns the derivatives of the lobes.
    curve: Callable[[Array, Array, Array, Array | None], tuple[Array, Slopes]]


def _power(log_power: Array) -> Array:
    return np.exp(np.maximum(log_power, _MIN_LOG if log_power.dtype == np.float64 else _MIN_SINGLE_LOG))


def _hemi_epd_fall(kappa: Array) -> Array:
    return np.log(kappa / np.log1p(0.5 * np.expm1(kappa)))


def _hemi_epd_slope(kappa: Array) -> Array:
    half = 0.5 * np.expm1(kappa)
    return (1.0 - kappa * (half + 0.5) / ((1.0 + half) * np.log1p(half))) / _hemi_epd_fall(kappa)


def _hemi_epd_curve(square: Array, kappa: Array, gamma: Array, top: Array | None) -> tuple[Array, Slopes]:
    per_log = -0.5 * gamma
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
        by_log_gamma, by_square = by_fall * fall, by_fall * (per_log / (1.0 + square))
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
        slope_of_width=lambda _, tangent: 0.5 * tangent / (1.0 + tangent**2),  # The unused `reach` is tangent**2.
        largest_tangent=float(np.tan(MAX_CENTER)),
        curve=_student_curve,
    ),
}
"""Families of lobes by name; a new family also needs a name in `Family`, and formulas in the exports."""
