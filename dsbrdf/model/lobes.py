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
from typing import NamedTuple

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.model.lobe_families import FAMILIES

GRAZING_COSINE = 0.08
"""Minimum of c, the cosine of theta_diff by which lobes are stretched; it is cos(85.4 degrees)."""


class LobeSlopes(NamedTuple):
    """Hold derivatives of lobes of height 1."""

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
    """Return values of lobes of height 1 in a family of `dsbrdf.model.lobe_families.FAMILIES`.

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
        by_offset = 2.0 * offset * by_square * (offset < known.largest_tangent)
        by_offset /= below * below
        # At theta' = 0, the derivative in tan(theta')**2 is infinite, so the tangent that divides it is bounded.
        least = np.sqrt(np.finfo(root.dtype).tiny)
        by_squared_tangent = by_offset * (0.5 + 0.5 * of_ring**2) / np.maximum(root, least)
        by_tangent = 2.0 * of_cusp * by_top - by_offset * (1.0 + squared_tangent * (tangent > 0.0))
        return LobeSlopes(by_log_kappa, by_log_gamma, (1.0 + tangent**2) * by_tangent, by_squared_tangent)

    return values, about_center
