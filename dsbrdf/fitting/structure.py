"""Describe the lobes of a mixture, the layout of its unknowns in one array, and their bounds.

Instead of gamma and center, the unknowns are log reach and offset:

    log reach = log fall_to_half(kappa) - log gamma,
    center = offset where positive, else limit * expm1(offset / limit).

The reach determines the half width, and the offset is the distance of the peak from the normal. Therefore kappa can
change without a change of the half width, and each bound concerns one unknown. A negative center makes a cusp. Its
limit is the half width, at most `MAX_CUSP_OFFSET`, so that a cusp is about as steep as the lobe.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np

from dsbrdf.arrays import Array, Mask
from dsbrdf.data.grid import THETA_HALF
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.lobe_families import FAMILIES, MAX_CENTER
from dsbrdf.model.lobes import fall_to_half, reach_of_width, width_of_reach
from dsbrdf.model.splines import n_control_values, spline_basis

LOG_AMPLITUDE_BOUNDS = (-25.0, 18.5)
"""Logarithms of amplitudes from practically 0 to the maximum value of a measurement [log 1/sr]."""
KAPPA_BOUNDS = (1e-2, 10.0)
REACH_BOUNDS = (4e-6, 70.0)
"""Reach from 1/6 degree, about the narrowest peak that the grid resolves, to a flat lobe."""
OFFSET_BOUNDS = (-1.0, MAX_CENTER)
"""Offsets from a cusp to a ring at the horizon [rad]."""
ELONGATION_BOUNDS = (-2.0, 10.0)
MAX_CUSP_OFFSET = 0.25
"""Maximum distance of a center below 0 [rad]."""
MAX_OFFSET_LIMITS = 2.5
"""Beyond this multiple of a cusp's limit, the offset changes the center by less than 1/12 of the limit."""


@dataclass(frozen=True, eq=False)
class Structure:
    """Define the lobes of a mixture, the knots [rad] of their parameters, and the layout of the unknowns."""

    rings: tuple[bool, ...]  # whether a lobe has a center; ring lobes come last
    knots: tuple[Array, Array, Array]  # knots of amplitudes, shapes and elongations
    family: str  # one of `dsbrdf.model.lobe_families.FAMILIES`
    theta_half: Array = field(
        default_factory=lambda: THETA_HALF
    )  # angles with data; lobes narrower than their spacing would fit gaps

    @property
    def n_lobes(self) -> int:
        """Number K of lobes."""
        return len(self.rings)

    @property
    def n_rings(self) -> int:
        """Number of lobes that have a center."""
        return sum(self.rings)

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns of the mixture."""
        return sum(rows * columns for rows, columns in self.blocks)

    @cached_property
    def blocks(self) -> list[tuple[int, int]]:
        """Numbers of control values, and of parameters per control value, for amplitudes, shapes and elongations."""
        columns = 3 * self.n_lobes, 2 * self.n_lobes + self.n_rings, self.n_lobes
        return [(n_control_values(knots.size), count) for knots, count in zip(self.knots, columns, strict=True)]

    @cached_property
    def parts(self) -> tuple[slice, slice, slice]:
        """Slices of the amplitudes, shapes and elongations in the unknowns."""
        first, second, third = (rows * columns for rows, columns in self.blocks)
        return slice(0, first), slice(first, first + second), slice(first + second, first + second + third)

    def split(self, unknowns: Array) -> tuple[Array, Array, Array]:
        """Return views on the unknowns: amplitude (D, 3 K), shape (S, 2 K + rings) and elongation (E, K).

        Amplitudes are logarithms, channel by channel; shapes are log kappa, log reach, and offsets of ring lobes.
        """
        blocks = zip(self.parts, self.blocks, strict=True)
        amplitude, shape, elongation = (unknowns[part].reshape(block) for part, block in blocks)
        return amplitude, shape, elongation

    def is_kappa(self) -> Mask:
        """Mask of the unknowns that are logarithms of kappa, shape (n_unknowns,)."""
        mask = np.zeros(self.n_unknowns)
        self.split(mask)[1][:, : self.n_lobes] = 1.0
        return mask > 0.0

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Bounds of the unknowns, shape (n_unknowns,) each; ring lobes may have narrower ones, see `limit`."""
        sides, k = [], self.n_lobes
        for side in (0, 1):
            bound = np.empty(self.n_unknowns)
            amplitude, shape, elongation = self.split(bound)
            amplitude[...] = LOG_AMPLITUDE_BOUNDS[side]
            shape[:, :k] = np.log(KAPPA_BOUNDS[side])
            shape[:, k : 2 * k] = np.log(REACH_BOUNDS[side])
            shape[:, 2 * k :], elongation[...] = OFFSET_BOUNDS[side], ELONGATION_BOUNDS[side]
            sides.append(bound)
        about_normal = self.split(sides[0])[1][:, k : 2 * k - self.n_rings]
        np.maximum(about_normal, self._narrowest(np.zeros(1)), out=about_normal)
        return sides[0], sides[1]

    def limit(self, unknowns: Array) -> Array:
        """Clip unknowns to the bounds, and widen lobes narrower than the data's spacing.

        A negative offset is clipped where a lower offset would hardly change the cusp.
        """
        low, high = self.bounds
        limited = np.maximum(np.minimum(unknowns, high), low)
        if self.n_rings:
            reach, offset = self._of_rings(limited)
            if offset.min() < 0.0:
                np.maximum(offset, -MAX_OFFSET_LIMITS * self._cusp_limit(reach), out=offset)
            np.maximum(reach, self._narrowest(offset), out=reach)
        return limited

    def lobe_shapes(self, unknowns: Array) -> Array:
        """Return control values (S, 2 K + rings) of log kappa, log gamma and, for ring lobes, center."""
        shape, k = self.split(unknowns)[1].copy(), self.n_lobes
        offset = shape[:, 2 * k :]
        if offset.min(initial=0.0) < 0.0:
            limit = self._cusp_limit(shape[:, 2 * k - self.n_rings : 2 * k])
            offset[...] = np.maximum(offset, 0.0) + limit * np.expm1(np.minimum(offset, 0.0) / limit)
        shape[:, k : 2 * k] = np.log(fall_to_half(np.exp(shape[:, :k]), self.family)) - shape[:, k : 2 * k]
        return shape

    def bases(self, theta_diff: Array) -> tuple[Array, Array, Array]:
        """Return weights of the control values of amplitudes, shapes and elongations at angles (R,)."""
        amplitude, shape, elongation = (_basis(knots.tobytes(), theta_diff.tobytes()) for knots in self.knots)
        return amplitude, shape, elongation

    def row_parameters(self, bases: tuple[Array, Array, Array], unknowns: Array) -> tuple[Array, Array, Array]:
        """Return amplitude (R, 3, K), shape (R, 2 K + rings) and elongation (R, K) at the angles of `bases`."""
        amplitude, _, elongation = self.split(unknowns)
        logs = (bases[0] @ amplitude).reshape(-1, 3, self.n_lobes)
        return np.exp(logs), bases[1] @ self.lobe_shapes(unknowns), bases[2] @ elongation

    def join(self, amplitude: Array, lobe_shapes: Array, elongation: Array) -> Array:
        """Return the unknowns of control values, the inverse of `split` and `lobe_shapes`."""
        shape, k = lobe_shapes.copy(), self.n_lobes
        shape[:, k : 2 * k] = np.log(fall_to_half(np.exp(shape[:, :k]), self.family)) - shape[:, k : 2 * k]
        limit = self._cusp_limit(shape[:, 2 * k - self.n_rings : 2 * k])
        center = shape[:, 2 * k :]
        negative = np.maximum(np.minimum(center, 0.0) / limit, np.expm1(-MAX_OFFSET_LIMITS))
        shape[:, 2 * k :] = np.maximum(center, 0.0) + limit * np.log1p(negative)
        return np.concatenate([amplitude.ravel(), shape.ravel(), elongation.ravel()])

    def chain(self, unknowns: Array, matrix: Array, gradient: Array) -> None:
        """Turn derivatives in control values of `lobe_shapes` into derivatives in the unknowns, in place.

        Only the lower triangle of the matrix is used.
        """
        shape, k, part = self.split(unknowns)[1], self.n_lobes, self.parts[1]
        by_kappa = FAMILIES[self.family].slope_of_fall(np.exp(shape[:, :k]))[..., None]  # log gamma in log kappa
        rows = matrix[part, : part.stop].reshape(*shape.shape, -1)
        columns = matrix[part.start :, part].reshape(-1, *shape.shape).transpose(1, 2, 0)
        reach, offset = self._of_rings(unknowns)
        has_cusps = offset.min(initial=0.0) < 0.0
        if has_cusps:
            limit = self._cusp_limit(reach)
            slope = FAMILIES[self.family].slope_of_width(np.exp(reach), np.tan(limit)) * (limit < MAX_CUSP_OFFSET)
            saturation = np.minimum(offset, 0.0) / limit
            by_offset = np.exp(saturation)[..., None]  # center in offset, then in log reach
            by_reach = (slope * (np.expm1(saturation) - saturation * np.exp(saturation)))[..., None]
        for derivatives in (gradient[part].reshape(*shape.shape, 1), rows, columns):
            by_gamma = derivatives[:, k : 2 * k]
            derivatives[:, :k] += by_kappa * by_gamma
            np.negative(by_gamma, out=by_gamma)
            if has_cusps:
                by_center = derivatives[:, 2 * k :]
                by_gamma[:, k - self.n_rings :] += by_reach * by_center
                by_center *= by_offset

    def _of_rings(self, unknowns: Array) -> tuple[Array, Array]:
        """Return views (S, rings) on log reach and offset of the ring lobes."""
        shape, k = self.split(unknowns)[1], self.n_lobes
        return shape[:, 2 * k - self.n_rings : 2 * k], shape[:, 2 * k :]

    def _cusp_limit(self, log_reach: Array) -> Array:
        """Return the maximum distance of a center below 0 [rad]."""
        return np.minimum(width_of_reach(np.exp(log_reach), self.family), MAX_CUSP_OFFSET)

    def _narrowest(self, offset: Array) -> Array:
        """Return the log reach of a lobe as narrow as the data's spacing at its center."""
        if self.theta_half.size < 2:
            return np.full(offset.shape, -np.inf)
        spacing = np.interp(np.maximum(offset, 0.0), *self._spacing)
        return np.asarray(np.log(reach_of_width(np.minimum(spacing, 1.0), self.family)))

    @cached_property
    def _spacing(self) -> tuple[Array, Array]:
        """Angles midway between neighbouring angles with data, and their spacing [rad]."""
        return 0.5 * (self.theta_half[1:] + self.theta_half[:-1]), np.diff(self.theta_half)


@dataclass(frozen=True, eq=False)
class Mixture:
    """Hold a structure and its unknowns."""

    structure: Structure
    unknowns: Array

    def lobes(self) -> tuple[Array, Array, Array]:
        """Return the control values of K lobes, the last axis of each array.

        The arrays are the log amplitude (D, 3, K), the shape (S, 3, K) and the elongation (E, K). A shape holds log
        kappa, log reach and the offset of the module's equations; lobes about the normal have offset 0.
        """
        k = self.structure.n_lobes
        amplitude, shape, elongation = self.structure.split(self.unknowns)
        offset = np.zeros((len(shape), k))
        offset[:, list(self.structure.rings)] = shape[:, 2 * k :]
        shapes = np.stack([shape[:, :k], shape[:, k : 2 * k], offset], axis=1)
        return amplitude.reshape(-1, 3, k), shapes, elongation


def join_lobes(knots: Structure, is_ring: Mask, lobes: Iterable[Array]) -> Mixture:
    """Make a mixture of lobes as from `Mixture.lobes`, rings last, on the knots of a structure."""
    order = np.argsort(is_ring, kind="stable")
    amplitude, shapes, elongation = (part[..., order] for part in lobes)
    shape = np.concatenate([shapes[:, 0], shapes[:, 1], shapes[:, 2, is_ring[order]]], axis=1)
    structure = replace(knots, rings=tuple(is_ring[order].tolist()))
    return Mixture(structure, np.concatenate([amplitude.ravel(), shape.ravel(), elongation.ravel()]))


def mixture_model(mixture: Mixture) -> DSBRDF:
    """Return the model of a mixture, with its lobes in the same order."""
    structure = mixture.structure
    amplitude, _, elongation = structure.split(mixture.unknowns)
    shape, k = structure.lobe_shapes(mixture.unknowns), structure.n_lobes
    center = np.zeros((len(shape), k))
    center[:, list(structure.rings)] = shape[:, 2 * k :]
    amplitude_knots, shape_knots, elongation_knots = structure.knots
    return DSBRDF(
        theta_diff=amplitude_knots,
        amplitude=np.exp(amplitude).reshape(-1, 3, k).transpose(1, 0, 2),
        kappa=np.exp(shape[np.newaxis, :, :k]),
        gamma=np.exp(shape[np.newaxis, :, k : 2 * k]),
        center=center[np.newaxis],
        elongation=elongation,
        shape_theta_diff=shape_knots,
        elongation_theta_diff=elongation_knots,
        interpolation="spline",
        lobe=structure.family,
    )


@lru_cache(maxsize=64)
def _basis(knots: bytes, theta_diff: bytes) -> Array:
    basis = spline_basis(np.frombuffer(knots), np.frombuffer(theta_diff))
    basis.flags.writeable = False
    return basis


def change_knots(mixture: Mixture, new: Structure) -> Mixture:
    """Move a mixture to new knots, exactly if they include the old knots."""
    old = mixture.structure
    amplitude, _, elongation = old.split(mixture.unknowns)
    parts = (amplitude, old.lobe_shapes(mixture.unknowns), elongation)
    return Mixture(new, new.join(*map(_change, parts, old.knots, new.knots)))


def _change(control_values: Array, old_knots: Array, new_knots: Array) -> Array:
    angles = np.linspace(new_knots[0], new_knots[-1], 8 * n_control_values(new_knots.size))
    values = spline_basis(old_knots, angles) @ control_values
    return np.asarray(np.linalg.lstsq(spline_basis(new_knots, angles), values, rcond=None)[0])
