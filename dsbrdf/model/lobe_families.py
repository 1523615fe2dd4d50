"""Define the families of lobes, as functions of the offset, the distance of theta' from the center.

`FAMILIES` lists the families. `dsbrdf.model.lobes` has their formulas, and the code that they have in common.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dsbrdf.arrays import Array

Family = Literal["hemi_epd", "student"]
"""Names of the families of lobes."""
MAX_CENTER = 1.57
"""Maximum distance of a center from the normal [rad]; closer to pi/2, the sign of its tangent is uncertain."""
_MIN_LOG = -200.0  # Smaller exponents are clipped: squares of their exponentials are slow subnormal numbers.
_MIN_SINGLE_LOG = -35.0  # In single precision, squares of smaller exponentials are subnormal.

Slopes = Callable[[], tuple[Array, Array, Array, Array]]
"""Returns derivatives in log kappa, log gamma, the squared tangent of the offset, and this square at the top."""


@dataclass(frozen=True)
class LobeFamily:
    """Define a family of lobes by positive kappa and gamma; gamma multiplies the reach, a function of the offset."""

    fall_to_half: Callable[[Array], Array]  # kappa -> gamma times the reach at half height
    slope_of_fall: Callable[[Array], Array]  # kappa -> derivative of log(fall_to_half) in log kappa
    reach: Callable[[Array], Array]  # squared tangent of the offset -> reach
    squared_tangent: Callable[[Array], Array]  # inverse of `reach`
    # (reach, tangent of the offset) -> derivative of the offset in log reach
    slope_of_width: Callable[[Array, Array], Array]
    largest_tangent: float  # Larger tangents of the offset are clipped.
    # Returns lobes of height 1 and a function for their derivatives. The arguments are the squared tangent of the
    # offset, kappa, gamma and, for cusps, the squared tangent at their top, the normal.
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
        slope_of_width=lambda _, tangent: 0.5 * tangent / (1.0 + tangent**2),  # The reach is tangent**2.
        largest_tangent=float(np.tan(MAX_CENTER)),
        curve=_student_curve,
    ),
}
"""Families by name; a new family also needs a name in `Family`, and formulas in the exports."""
