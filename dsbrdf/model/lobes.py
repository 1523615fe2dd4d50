"""Evaluate lobes of height 1 and their derivatives, for fits and for the model.

In both families, a lobe is a decreasing function of the angle between ``theta'`` and the center of the lobe. The
function is divided by its largest value, so that the amplitude of a lobe is its height in 1/sr:

    hemi_epd    s = expm1(kappa cos(theta' - center)**gamma) / expm1(kappa)        (Nishino 2009, eq. 3)
    student     s = (1 + gamma tan(theta' - center)**2)**-kappa                    (Student's t over slopes)

A lobe with ``center = 0`` is the paper's lobe, whose maximum is at the normal. A lobe with ``center > 0`` has its
maximum on a ring about the normal. A lobe with ``center < 0`` is a cusp: only the flank of the lobe remains, and its
maximum is at the normal. For a cusp, the angle to the center is defined by tangents, so that this angle reaches 90
degrees together with theta':

    tan(theta' - center) = tan(theta') + tan(-center),    center < 0.

``theta'`` is theta_half stretched along and across the plane of incidence by one number, the elongation e:

    tan(theta')**2 = tan(theta_half)**2 (cos(phi_diff)**2 c**-e + sin(phi_diff)**2 c**e),
    c**4 = cos(theta_diff)**4 + g**4 (1 - cos(theta_diff)**4).

Here c is nearly cos(theta_diff), but at least g = `GRAZING_COSINE`; up to 75 degrees, c differs from the cosine by less
than 0.3 %. With the cosine in place of c, the stretch would be infinite at the horizon.

A lobe with ``e = 0`` is round: its values do not depend on phi_diff, like the values of the paper's lobes. Swapping the
two directions adds pi to phi_diff, which does not change theta': every lobe is reciprocal.

The arrays in all functions of this module broadcast; usually the first axis is the lobe.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

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
        by_log_gamma, by_square = by_fall * fall, per_log / (1.0 + square)
        by_square *= by_fall
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


GRAZING_COSINE = 0.08
"""Minimum of c, the cosine of theta_diff by which lobes are stretched; it is cos(85.4 degrees)."""


class LobeSlopes(NamedTuple):
    """Derivatives of lobes of height 1."""

    by_log_kappa: Array
    by_log_gamma: Array
    by_center: Array  # derivative in the center [1/rad]; 0 for a lobe about the normal
    by_squared_tangent: Array  # derivative in tan(theta')**2


def log_cosine(theta_diff: Array) -> Array:
    """Return the logarithm of c, the bounded cosine of theta_diff by which lobes are stretched."""
    fourth = GRAZING_COSINE**4
    return np.asarray(0.25 * np.log(fourth + (1.0 - fourth) * np.cos(theta_diff) ** 4))


def half_width(kappa: Array, gamma: Array, family: str) -> Array:
    """Return the angle from the center at which a lobe has half its height [rad]."""
    return width_of_reach(fall_to_half(kappa, family) / gamma, family)


def gamma_of_half_width(width: Array, kappa: Array, family: str) -> Array:
    """Return the gamma with which a lobe of a given kappa has a given half width [rad]."""
    return fall_to_half(kappa, family) / reach_of_width(width, family)


def fall_to_half(kappa: Array, family: str) -> Array:
    """Return the product of gamma and `reach_of_width` at which a lobe with `kappa` has half its height."""
    return FAMILIES[family].fall_to_half(kappa)


def reach_of_width(width: Array, family: str) -> Array:
    """Return the function that gamma multiplies in the formula of a lobe, at an angle from the center [rad]."""
    return np.asarray(FAMILIES[family].reach(np.tan(width) ** 2))


def width_of_reach(reach: Array, family: str) -> Array:
    """Return the angle from the center [rad] at a value of `reach_of_width`; this is the inverse function."""
    return np.asarray(np.arctan(np.sqrt(FAMILIES[family].squared_tangent(reach))))


def lobe_values(squared_tangent: Array, kappa: Array, gamma: Array, center: Array | None, family: str) -> Array:
    """Return values of lobes of height 1 in a family of `dsbrdf.model.lobes.FAMILIES`.

    The arguments are ``tan(theta')**2``, positive kappa and gamma, and the center [rad], or None for 0.
    """
    return lobe_curves(squared_tangent, kappa, gamma, center, family)[0]


def lobe_curves(
    squared_tangent: Array, kappa: Array, gamma: Array, center: Array | None, family: str
) -> tuple[Array, Callable[[], LobeSlopes]]:
    """Return `lobe_values`, and a function that returns the derivatives of the lobes from intermediate results."""
    known = FAMILIES[family]
    if center is None:
        values, slopes = known.curve(squared_tangent, kappa, gamma, None)

        def about_normal() -> LobeSlopes:
            by_log_kappa, by_log_gamma, by_square, _ = slopes()
            return LobeSlopes(by_log_kappa, by_log_gamma, np.zeros(()), by_square)

        return values, about_normal
    root, tangent = np.sqrt(squared_tangent), np.tan(center)
    of_ring, of_cusp = np.maximum(tangent, 0.0), np.minimum(tangent, 0.0)
    below, offset = 1.0 + root * of_ring, np.asarray(root - tangent)
    offset /= below
    np.minimum(offset, known.largest_tangent, out=offset)
    values, slopes = known.curve(offset * offset, kappa, gamma, of_cusp * of_cusp)

    def about_center() -> LobeSlopes:
        by_log_kappa, by_log_gamma, by_square, by_top = slopes()
        half_by_offset = offset * by_square
        half_by_offset[offset >= known.largest_tangent] = 0.0
        half_by_offset /= below * below
        # At theta' = 0, the derivative in tan(theta')**2 is infinite, so the tangent that divides it is bounded.
        least = np.sqrt(np.finfo(root.dtype).tiny)
        by_squared_tangent = half_by_offset * (1.0 + of_ring**2) / np.maximum(root, least)
        half_by_offset *= 1.0 + squared_tangent * np.sign(of_ring)
        by_center = of_cusp * by_top
        by_center -= half_by_offset
        by_center *= 2.0 + 2.0 * tangent**2
        return LobeSlopes(by_log_kappa, by_log_gamma, by_center, by_squared_tangent)

    return values, about_center
