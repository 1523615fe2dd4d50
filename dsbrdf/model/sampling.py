"""Draw directions roughly in proportion to the reflected light, and compute their exact density.

A direction omega_in is drawn in one of two ways: with a density proportional to the cosine of its angle to the normal,
or by mirroring omega_out at a facet of a rough surface. The facet is drawn from the facets that are visible from
omega_out (Heitz 2018). The rough surface has the GGX distribution of normals (Walter 2007), with different roughness
along and across the plane of incidence. Visible facets reflect most light upwards even at grazing angles, so that
few directions are drawn below the horizon.

Let L be the length of T = omega_in + omega_out. In a frame whose first axis is the projection of omega_out on the
surface, the density of a mirrored omega_in per solid angle is

    L**4 / (2 pi a b (T_z**2 + (T_x/a)**2 + (T_y/b)**2)**2 (o_z + sqrt(o_z**2 + (a o_x)**2))),

where a and b are the roughnesses along and across the plane of incidence, and o is omega_out. This density equals the
density of visible normals h divided by 4 h . omega_out, in a form that is defined at the horizon too.

For each theta_out, omega_in is drawn from a mixture of such densities, with roughnesses from `_CANDIDATE_ROUGHNESSES`,
and of the cosine density. The variance of the weights f cos(theta_in) / pdf of the samples is, up to a constant,

    integral (f cos(theta_in))**2 / pdf d omega_in.

A mixture begins with the cosine density; the density that lowers this integral most is added repeatedly. After each
addition, the fraction w_m of every density p_m is improved by the iteration
w_m <- w_m sqrt(integral (f cos)**2 p_m / pdf**2). The fixed point of the iteration has the minimum variance, because
the integral is convex in the fractions. The cosine density has at least the fraction `MIN_COSINE_FRACTION`, which
bounds the weights of the samples.

The mixtures are tabulated at the angles theta_out in `ANGLES`. Both `sample` and `pdf` use the mixture of the nearest
angle, so that their densities agree to rounding.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from dsbrdf.arrays import Array, Evaluate, Indices
from dsbrdf.data.geometry import spherical
from dsbrdf.model.albedo import half_vector_rule

Vector = Sequence[Any] | Array
"""Three components of directions."""

ANGLES = np.radians(np.arange(0.0, 90.5, 1.5))
"""Angles theta_out to the normal at which the mixture is tabulated [rad]."""
MIN_COSINE_FRACTION = 0.1
"""Minimum fraction of the cosine density in a mixture: no weight exceeds ``pi f / MIN_COSINE_FRACTION``."""
MAX_MIXTURE_ANGLE = np.radians(89.5)
"""Larger angles use the mixture of this angle [rad], because at 90 degrees all nodes are below the horizon."""
MIXTURE_PARTS = 6
"""Number of densities of a mixture besides the cosine density."""
LOG_STRETCHES = np.array([-1.0, 0.0, 1.0])
"""Logarithms of candidate ratios of the roughness along the plane of incidence to the roughness across it."""
_CANDIDATE_ROUGHNESSES = np.stack(
    [np.geomspace(1e-3, 1.0, 14)[:, None] * np.exp(sign * LOG_STRETCHES) for sign in (0.5, -0.5)], axis=-1
).reshape(-1, 2)
START_FRACTION = 0.03
"""Fraction with which a density is added to a mixture, before all fractions are improved."""
FRACTION_ITERATIONS = 20
"""Number of iterations that improve the fractions of a mixture after a density is added."""


class Samples(NamedTuple):
    """Directions drawn by `dsbrdf.DSBRDF.sample`; below the horizon (z < 0), pdf and weight are 0."""

    omega_in: Array  # drawn directions, unit vectors (..., 3)
    pdf: Array  # density per solid angle [1/sr], (...)
    weight: Array  # f cos(theta_in) / pdf, whose mean is the directional albedo, (..., 3)


@dataclass(frozen=True, eq=False)
class DirectionSampler:
    """Draw directions from the mixture of densities that each angle in `ANGLES` has; see `direction_sampler`."""

    along: Array  # roughness along the plane of incidence, (angles, densities)
    across: Array  # roughness across the plane of incidence, (angles, densities)
    cumulative: Array  # cumulative sums of a mixture's fractions, (angles, densities + 1); the cosine density is last

    def sample(self, omega_out: Array, rng: np.random.Generator) -> Array:
        """Draw a direction omega_in for each omega_out, both of shape (n, 3)."""
        row = _row(omega_out)
        chosen = np.sum(self.cumulative[row] <= rng.random(row.size)[:, None], axis=1)
        uniform = rng.random((2, row.size))
        cosine = chosen >= self.along.shape[1]
        turn = np.array([np.cos(2.0 * np.pi * uniform[1]), np.sin(2.0 * np.pi * uniform[1])])
        omega_in = np.empty_like(omega_out)
        omega_in[cosine] = np.stack([*np.sqrt(uniform[0]) * turn, np.sqrt(1.0 - uniform[0])], axis=-1)[cosine]
        row, chosen, uniform, turn = row[~cosine], chosen[~cosine], uniform[0, ~cosine], turn[:, ~cosine]
        along, across = self.along[row, chosen], self.across[row, chosen]
        omega_in[~cosine] = np.stack(mirrored(omega_out[~cosine].T, along, across, uniform, turn), axis=-1)
        return omega_in

    def pdf(self, omega_in: Array, omega_out: Array) -> Array:
        """Return the density [1/sr] of directions omega_in (n, 3) for omega_out (n, 3); it is 0 below the horizon."""
        result = np.zeros(len(omega_in))
        above = np.flatnonzero((omega_in[:, 2] > 0.0) & (omega_out[:, 2] > 0.0))
        first, second = omega_in[above], omega_out[above]
        row = _row(second)
        share = np.diff(self.cumulative, axis=1, prepend=0.0)[row].T
        density, seen = share[-1] * first[:, 2] / np.pi, in_plane_of_incidence(first.T, second.T)
        for part in range(self.along.shape[1]):
            density += share[part] * mirrored_density(seen, self.along[row, part], self.across[row, part])
        result[above] = density
        return result


def direction_sampler(evaluate: Evaluate) -> DirectionSampler:
    """Build the mixture of densities for every angle in `ANGLES`, from the values of a model."""
    along, across = np.ones((2, ANGLES.size, MIXTURE_PARTS))
    share = np.zeros((ANGLES.size, MIXTURE_PARTS + 1))
    for row, theta_out in enumerate(ANGLES):
        parts, found = _mixture(min(float(theta_out), MAX_MIXTURE_ANGLE), evaluate)
        along[row, : len(parts)], across[row, : len(parts)] = _CANDIDATE_ROUGHNESSES[parts].T
        share[row, : len(parts)], share[row, -1] = found[:-1], found[-1]
    cumulative = np.cumsum(share, axis=1)
    return DirectionSampler(along, across, cumulative / cumulative[:, -1:])


def _mixture(theta_out: float, evaluate: Evaluate) -> tuple[list[int], Array]:
    """Return the mixture for one angle: indices of its densities, then all fractions, the cosine density's last."""
    rule = half_vector_rule(theta_out)
    used = rule.cos_in > 0.0
    theta_half, azimuth, cos_in = rule.theta_half[used], rule.azimuth[used], rule.cos_in[used]
    half, omega_out = spherical(theta_half, azimuth), spherical([theta_out], 0.0)
    omega_in = 2.0 * (half @ omega_out[0])[:, None] * half - omega_out
    densities = np.empty((len(_CANDIDATE_ROUGHNESSES) + 1, cos_in.size))
    seen = in_plane_of_incidence(omega_in.T, omega_out.T)
    for density, (along, across) in zip(densities[:-1], _CANDIDATE_ROUGHNESSES, strict=True):
        density[:] = mirrored_density(seen, along, across)
    densities[-1] = cos_in / np.pi
    reflected = evaluate(theta_half, rule.theta_diff[used], rule.phi_diff[used]).mean(axis=1) * cos_in
    squared = reflected**2 * rule.weight[used] / cos_in
    parts, share = [len(_CANDIDATE_ROUGHNESSES)], np.ones(1)
    for _ in range(MIXTURE_PARTS):
        rest = (1.0 - START_FRACTION) * (share @ densities[parts])
        # A loop is faster than one operation on all densities, which do not fit in the cache.
        variance = np.array([squared @ (1.0 / (rest + START_FRACTION * density)) for density in densities])
        variance[parts] = np.inf
        parts.insert(0, int(np.argmin(variance)))
        share = np.append(START_FRACTION, (1.0 - START_FRACTION) * share)
        share = _improved(share, densities[parts], squared)
    return parts[:-1], share


def _improved(share: Array, densities: Array, squared: Array) -> Array:
    """Improve the fractions of the densities (densities, nodes) in a mixture.

    `squared` (nodes,) is the squared integrand times the weights of the quadrature.
    """
    for _ in range(FRACTION_ITERATIONS):
        share = share * np.sqrt(densities @ (squared / (share @ densities) ** 2))
        share = share / max(share.sum(), 1e-300)
        share[:-1] *= min(1.0, (1.0 - MIN_COSINE_FRACTION) / max(share[:-1].sum(), 1e-300))
        share[-1] = 1.0 - share[:-1].sum()
    return share


def in_plane_of_incidence(omega_in: Vector, omega_out: Vector, xp: Any = np) -> tuple[Any, ...]:
    """Return the six terms by which the density of a mirrored direction depends on both directions.

    In the formula of the module's docstring, the terms are T_x, T_y, T_z**2, L**2, o_z and o_x. Shaders and renderers
    run this function, `mirrored_density` and `mirrored` on numbers of their own, with `xp` for NumPy.
    """
    total = [first + second for first, second in zip(omega_in, omega_out, strict=True)]
    x, y, radius = _heading(omega_out, xp)
    toward, aside = total[0] * x + total[1] * y, total[1] * x - total[0] * y
    return toward, aside, total[2] ** 2, _dot(total, total), omega_out[2], radius


def mirrored_density(seen: tuple[Any, ...], along: Any, across: Any, xp: Any = np) -> Any:
    """Return the density per solid angle of mirrored directions, by the formula of the module's docstring."""
    toward, aside, squared_up, squared_length, height, radius = seen
    slopes = squared_up + (toward / along) ** 2 + (aside / across) ** 2
    visible = height + xp.sqrt(height**2 + (along * radius) ** 2)
    return (squared_length / slopes) ** 2 / (2.0 * math.pi * along * across * visible)


def mirrored(omega_out: Vector, along: Any, across: Any, uniform: Any, turn: Vector, xp: Any = np) -> list[Any]:
    """Mirror directions at normals of a rough surface that are drawn from those visible from the directions.

    The method is from Dupuy and Benyoub (2023). After the surface is stretched to roughness 1, a normal is the half
    vector of omega_out and of a point drawn uniformly from a spherical cap: the height of the point is uniform, and
    `turn` is the cosine and sine of a uniform azimuth.
    """
    x, y, radius = _heading(omega_out, xp)
    length = xp.sqrt((along * radius) ** 2 + omega_out[2] ** 2)
    seen_x, seen_z = along * radius / length, omega_out[2] / length
    z = (1.0 - uniform) * (1.0 + seen_z) - seen_z
    ring = xp.sqrt(xp.maximum(1.0 - z * z, 0.0))
    toward, aside = along * (ring * turn[0] + seen_x), across * ring * turn[1]
    normal = toward * x - aside * y, toward * y + aside * x, z + seen_z
    scale = 2.0 * _dot(normal, omega_out) / _dot(normal, normal)
    return [scale * one - other for one, other in zip(normal, omega_out, strict=True)]


def _dot(first: Vector, second: Vector) -> Any:
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]


def _heading(omega: Vector, xp: Any) -> tuple[Any, Any, Any]:
    """Return cosine and sine of the azimuth, and sine of the angle to the normal, whose azimuth is taken as 0."""
    radius2 = xp.maximum(omega[0] ** 2 + omega[1] ** 2, 1e-30)  # The root of 0 would have no derivative.
    radius, has_azimuth = xp.sqrt(radius2), radius2 > 1e-30
    return xp.where(has_azimuth, omega[0] / radius, 1.0), xp.where(has_azimuth, omega[1] / radius, 0.0), radius


def _row(omega_out: Array) -> Indices:
    """Return the index in `ANGLES` of the angle nearest to each direction."""
    theta = np.arctan2(np.hypot(omega_out[:, 0], omega_out[:, 1]), omega_out[:, 2])
    return np.clip(np.rint(theta / ANGLES[1]), 0, ANGLES.size - 1).astype(np.intp)
