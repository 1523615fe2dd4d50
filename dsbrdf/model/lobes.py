"""The lobe of the model in the form that fitting and evaluation share: height 1, with derivatives.

A lobe of either family is a decreasing function of the distance of ``theta'`` from its center, divided by its largest
value, so that its amplitude is its height in 1/sr:

    hemi_epd    s = expm1(kappa cos(theta' - center)**gamma) / expm1(kappa)        (Nishino 2009, eq. 3)
    student     s = (1 + gamma tan(theta' - center)**2)**-kappa                    (Student's t over slopes)

``center = 0`` is the paper's lobe about the normal; ``center > 0`` peaks on a ring; ``center < 0`` is a cusp, largest
at the normal: the flank of a lobe, moved there by its tangent, which reaches the horizon together with theta':

    tan(theta' - center) = tan(theta') + tan(-center),    center < 0.

``theta'`` is theta_half stretched along and across the plane of incidence by one number, the elongation e:

    tan(theta')**2 = tan(theta_half)**2 (cos(phi_diff)**2 c**-e + sin(phi_diff)**2 c**e),
    c**4 = cos(theta_diff)**4 + g**4 (1 - cos(theta_diff)**4).

c is the cosine of theta_diff, held above g = `GRAZING_COSINE` (to 75 degrees it differs by less than 0.3 %): with the
cosine itself the stretch would be infinite at the horizon, and in the last degrees steeper than any measurement tells.

``e = 0`` is the paper's lobe, round about the half vector.  Turning phi_diff by half a turn, which swaps the two
directions, leaves theta' as it is: every lobe is reciprocal.

All arrays broadcast; the first axis is as a rule the lobe.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FAMILIES = ("hemi_epd", "student")
"""Known lobes."""
GRAZING_COSINE = 0.08
"""The cosine that stretches lobes at theta_diff = 90 degrees, that of 85.4 degrees."""
LARGEST_CENTER = 1.57
"""A center is so far from the normal at most [rad]: at pi/2, the horizon, rounding decides the tangent's sign."""
_STEEPEST_TANGENT = 1e12
_LARGEST_TANGENT = float(np.tan(LARGEST_CENTER))
_LOWEST_LOG = -200.0  # squares of exponentials below need subnormal numbers, which take a hundred times as long


class Stretch(NamedTuple):
    """Squared tangents of theta' and their derivative in the elongation."""

    squared_tangent: Array
    by_elongation: Array


@dataclass(frozen=True, eq=False)
class LobeDerivatives:
    """A lobe of height 1 and its derivatives, arrays of one shape.

    Attributes
    ----------
    value : ndarray
    by_log_kappa, by_log_gamma : ndarray
    by_center : ndarray
        Per radian; 0 where no center was given.
    by_squared_tangent : ndarray
        Derivative in tan(theta')**2.
    """

    value: Array
    by_log_kappa: Array
    by_log_gamma: Array
    by_center: Array
    by_squared_tangent: Array


def log_cosine(theta_diff: Array) -> Array:
    """Logarithm of the cosine c that stretches lobes, from 0 at normal incidence to that of `GRAZING_COSINE`."""
    fourth = GRAZING_COSINE**4
    return np.asarray(0.25 * np.log(fourth + (1.0 - fourth) * np.cos(theta_diff) ** 4))


def half_width(kappa: Array, gamma: Array, family: str) -> Array:
    """Angle from the center at which a lobe has half its height [rad]."""
    return width_of_reach(fall_to_half(kappa, family) / gamma, family)


def gamma_of_half_width(width: Array, kappa: Array, family: str) -> Array:
    """Gamma of a lobe that has half its height at an angle from the center [rad]."""
    return fall_to_half(kappa, family) / reach_of_width(width, family)


def fall_to_half(kappa: Array, family: str) -> Array:
    """Gamma times the reach at which a lobe has half its height."""
    if family == "student":
        return np.expm1(np.log(2.0) / kappa)
    return np.log(kappa / np.log1p(0.5 * np.expm1(kappa)))


def slope_of_fall(kappa: Array, family: str) -> Array:
    """Derivative of the logarithm of `fall_to_half` in log kappa."""
    if family == "student":
        power = np.log(2.0) / kappa
        return -power / -np.expm1(-power)
    half = 0.5 * np.expm1(kappa)
    return (1.0 - kappa * (half + 0.5) / ((1.0 + half) * np.log1p(half))) / fall_to_half(kappa, family)


def reach_of_width(width: Array, family: str) -> Array:
    """-log(cos(width)) for "hemi_epd", tan(width)**2 for "student": what gamma is multiplied by."""
    squared = np.tan(width) ** 2
    return np.asarray(squared if family == "student" else 0.5 * np.log1p(squared))


def width_of_reach(reach: Array, family: str) -> Array:
    """Inverse of `reach_of_width` [rad]."""
    squared = reach if family == "student" else np.expm1(np.minimum(2.0 * reach, -_LOWEST_LOG))
    return np.asarray(np.arctan(np.sqrt(squared)))


def stretch(squared_tangent: Array, cos2_phi: Array, log_cos_diff: Array, elongation: Array) -> Stretch:
    """Stretch theta_half along and across the plane of incidence.

    Parameters
    ----------
    squared_tangent : ndarray
        ``tan(theta_half)**2``.
    cos2_phi : ndarray
        ``cos(phi_diff)**2``.
    log_cos_diff : ndarray
        As `log_cosine` gives it.
    elongation : ndarray
    """
    along = cos2_phi * np.exp(-elongation * log_cos_diff)
    across = (1.0 - cos2_phi) * np.exp(elongation * log_cos_diff)
    return Stretch(squared_tangent * (along + across), squared_tangent * log_cos_diff * (across - along))


def lobe_values(squared_tangent: Array, kappa: Array, gamma: Array, center: Array | None, family: str) -> Array:
    """Values of lobes of height 1.

    Parameters
    ----------
    squared_tangent : ndarray
        ``tan(theta')**2``.
    kappa, gamma : ndarray
        Positive.
    center : ndarray or None
        Angle of the ring [rad]; None for lobes about the normal.
    family : str
        One of `FAMILIES`.
    """
    if family == "student":
        at = squared_tangent if center is None else _tangent(squared_tangent, center) ** 2
        top = 0.0 if center is None else np.log1p(gamma * np.tan(np.minimum(center, 0.0)) ** 2)
        return np.exp(np.maximum(-kappa * (np.log1p(gamma * at) - top), _LOWEST_LOG))
    log_cos = _log_cos(squared_tangent, center)
    if center is None:
        return np.expm1(kappa * _power(gamma * log_cos)) / np.expm1(kappa)
    log_cos_top = -0.5 * np.log1p(np.tan(np.minimum(center, 0.0)) ** 2)
    top = kappa * _power(gamma * log_cos_top)
    return np.expm1(top * _power(gamma * (log_cos - log_cos_top))) / np.expm1(top)


def lobe_derivatives(
    squared_tangent: Array, kappa: Array, gamma: Array, center: Array | None, family: str
) -> LobeDerivatives:
    """Values and derivatives of lobes of height 1.

    Parameters are those of `lobe_values`.
    """
    tangent = None if center is None else _tangent(squared_tangent, center)
    negative = np.zeros(()) if center is None else np.minimum(center, 0.0)
    if family == "student":
        found = _student_derivatives(squared_tangent, kappa, gamma, tangent, negative)
    else:
        log_cos = _log_cos(squared_tangent, center)
        found = _hemi_epd_derivatives(squared_tangent, log_cos, kappa, gamma, tangent, negative)
    value, by_log_kappa, by_log_gamma, by_offset, by_top = found
    if center is None or tangent is None:
        return LobeDerivatives(value, by_log_kappa, by_log_gamma, np.zeros(()), by_offset)
    by_offset = np.where(tangent < _LARGEST_TANGENT, by_offset, 0.0)
    root = np.sqrt(squared_tangent)
    is_cusp, at_offset = center < 0.0, 1.0 + tangent**2
    per_root = np.where(is_cusp, at_offset, 1.0 + squared_tangent)
    by_squared_tangent = 0.5 * by_offset / (np.where(root > 0.0, root, np.inf) * per_root)
    by_center = np.where(is_cusp, by_top - by_offset * (1.0 + np.tan(negative) ** 2) / at_offset, -by_offset)
    return LobeDerivatives(value, by_log_kappa, by_log_gamma, by_center, by_squared_tangent)


def _hemi_epd_derivatives(
    squared_tangent: Array, log_cos: Array, kappa: Array, gamma: Array, tangent: Array | None, negative: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Value, and derivatives in log kappa, log gamma, the offset (else tan(theta')**2) and the negative center.

    The offset is theta' - center; its tangent and the logarithm of its cosine are given.
    """
    log_cos_top = -0.5 * np.log1p(np.tan(negative) ** 2)
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
    by_top = (by_log_top - by_log_ratio) * gamma * -np.tan(negative)
    by_offset = -0.5 * slope / (1.0 + squared_tangent) if tangent is None else -slope * tangent
    return value, by_log_top, by_log_gamma, by_offset, by_top


def _student_derivatives(
    squared_tangent: Array, kappa: Array, gamma: Array, tangent: Array | None, negative: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """As `_hemi_epd_derivatives`."""
    square = squared_tangent if tangent is None else tangent**2
    tangent_top = np.tan(negative)
    at, top = gamma * square, gamma * tangent_top**2
    fall = np.maximum(-kappa * (np.log1p(at) - np.log1p(top)), _LOWEST_LOG)
    value = np.exp(fall)
    by_log_gamma = -value * kappa * (at / (1.0 + at) - top / (1.0 + top))
    by_square = -value * kappa * gamma / (1.0 + at)
    by_top = value * kappa * gamma / (1.0 + top) * 2.0 * tangent_top * (1.0 + tangent_top**2)
    by_offset = by_square if tangent is None else by_square * 2.0 * tangent * (1.0 + square)
    return value, value * fall, by_log_gamma, by_offset, by_top


def _tangent(squared_tangent: Array, center: Array, largest: float = _LARGEST_TANGENT) -> Array:
    """tan(theta' - center), as the module defines it."""
    root, tan_center = np.sqrt(squared_tangent), np.tan(center)
    tangent = (root - tan_center) / (1.0 + root * np.maximum(tan_center, 0.0))
    return np.clip(tangent, -largest, largest)


def _log_cos(squared_tangent: Array, center: Array | None) -> Array:
    """Logarithm of cos(theta' - center), exact where it is small."""
    at = squared_tangent if center is None else _tangent(squared_tangent, center, _STEEPEST_TANGENT) ** 2
    return -0.5 * np.log1p(at)


def _power(log_power: Array) -> Array:
    return np.exp(np.maximum(log_power, _LOWEST_LOG))
