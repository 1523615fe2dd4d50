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

``e = 0`` is the paper's lobe, round about the half vector. Turning phi_diff by half a turn, which swaps the two
directions, leaves theta' as it is: every lobe is reciprocal.

All arrays broadcast; the first axis is as a rule the lobe.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.model.lobe_families import FAMILIES, LARGEST_TANGENT, tangent_of_offset

GRAZING_COSINE = 0.08
"""The cosine that stretches lobes at theta_diff = 90 degrees, that of 85.4 degrees."""


class Stretch(NamedTuple):
    """Squared tangents of theta' and their derivative in the elongation."""

    squared_tangent: Array
    by_elongation: Array


@dataclass(frozen=True, eq=False)
class LobeDerivatives:
    """A lobe of height 1 and its derivatives, arrays of one shape."""

    value: Array
    by_log_kappa: Array
    by_log_gamma: Array
    by_center: Array  # per radian; 0 where no center was given
    by_squared_tangent: Array  # in tan(theta')**2


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
    return FAMILIES[family].fall_to_half(kappa)


def reach_of_width(width: Array, family: str) -> Array:
    """What gamma is multiplied by at an angle from the center [rad]; each family has its own."""
    return np.asarray(FAMILIES[family].reach(np.tan(width) ** 2))


def width_of_reach(reach: Array, family: str) -> Array:
    """Inverse of `reach_of_width` [rad]."""
    return np.asarray(np.arctan(np.sqrt(FAMILIES[family].squared_tangent(reach))))


def stretch(squared_tangent: Array, cos2_phi: Array, log_cos_diff: Array, elongation: Array) -> Stretch:
    """Stretch theta_half along and across the plane of incidence.

    The arguments are ``tan(theta_half)**2``, ``cos(phi_diff)**2``, what `log_cosine` gives, and the elongation.
    """
    along = cos2_phi * np.exp(-elongation * log_cos_diff)
    across = (1.0 - cos2_phi) * np.exp(elongation * log_cos_diff)
    return Stretch(squared_tangent * (along + across), squared_tangent * log_cos_diff * (across - along))


def lobe_values(squared_tangent: Array, kappa: Array, gamma: Array, center: Array | None, family: str) -> Array:
    """Values of lobes of height 1, of one of `dsbrdf.model.lobe_families.FAMILIES`.

    The arguments are ``tan(theta')**2``, kappa and gamma, both positive, and the center [rad], None about the normal.
    """
    return FAMILIES[family].values(squared_tangent, kappa, gamma, center)


def lobe_derivatives(
    squared_tangent: Array, kappa: Array, gamma: Array, center: Array | None, family: str
) -> LobeDerivatives:
    """Values and derivatives of lobes of height 1, of the arguments of `lobe_values`."""
    tangent = None if center is None else tangent_of_offset(squared_tangent, center)
    tangent_top = np.zeros(()) if center is None else np.tan(np.minimum(center, 0.0))
    found = FAMILIES[family].derivatives(squared_tangent, kappa, gamma, center, tangent, tangent_top)
    value, by_log_kappa, by_log_gamma, by_offset, by_top = found
    if center is None or tangent is None:
        return LobeDerivatives(value, by_log_kappa, by_log_gamma, np.zeros(()), by_offset)
    by_offset = np.where(tangent < LARGEST_TANGENT, by_offset, 0.0)
    root = np.sqrt(squared_tangent)
    is_cusp, at_offset = center < 0.0, 1.0 + tangent**2
    per_root = np.where(is_cusp, at_offset, 1.0 + squared_tangent)
    by_squared_tangent = 0.5 * by_offset / (np.where(root > 0.0, root, np.inf) * per_root)
    by_center = np.where(is_cusp, by_top - by_offset * (1.0 + tangent_top**2) / at_offset, -by_offset)
    return LobeDerivatives(value, by_log_kappa, by_log_gamma, by_center, by_squared_tangent)
