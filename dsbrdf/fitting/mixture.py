"""Describe the lobes of a mixture, and the layout and the bounds of the mixture's unknowns in one array.

Instead of gamma and center, the unknowns of a lobe are its log reach and its offset:

    log reach = log fall_to_half(kappa) - log gamma,
    center = offset where positive, else limit * expm1(offset / limit).

The reach determines the half width of a lobe, and a positive offset is the angle from the normal to the peak of a ring.
Therefore kappa can change without a change of the half width, and each bound concerns one unknown. A negative offset
makes a cusp, whose center cannot fall below -limit. The limit is the half width of the lobe, but at most
`MAX_CUSP_OFFSET`, so that a cusp is about as steep as the lobe.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np

from dsbrdf.arrays import Array, Mask
from dsbrdf.data.geometry import THETA_HALF
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.lobes import FAMILIES, MAX_CENTER, fall_to_half, reach_of_width, width_of_reach
from dsbrdf.model.splines import n_control_values, spline_basis

LOG_AMPLITUDE_BOUNDS = (-25.0, 18.5)
"""Bounds of log amplitudes, from practically 0 to the maximum value of a measurement [log 1/sr]."""
KAPPA_BOUNDS = (1e-2, 10.0)
REACH_BOUNDS = (4e-6, 70.0)
"""Bounds of `reach_of_width`, from a half width of 1/6 degree, about the narrowest on a grid, to a flat lobe."""
OFFSET_BOUNDS = (-1.0, MAX_CENTER)
"""Bounds of the offset that determines a lobe's center, from a cusp to a ring at the horizon [rad]."""
ELONGATION_BOUNDS = (-2.0, 10.0)
MAX_CUSP_OFFSET = 0.25
"""Centers of cusps cannot be below the negative of this angle [rad]."""
MAX_OFFSET_LIMITS = 2.5
"""Offsets of cusps beyond this multiple of the center's limit are clipped: the center would hardly change there."""


@dataclass(frozen=True, eq=False)
class Structure:
    """Define the lobes of a mixture, the knots [rad] of their parameters, and the layout of the unknowns."""

    rings: tuple[bool, ...]  # whether each lobe has a center other than 0; these lobes come last
    knots: tuple[Array, Array, Array]  # knots in theta_diff of amplitudes, shapes and elongations [rad]
    family: str  # name of a family of lobes, see `dsbrdf.model.lobes`
    # Angles that have data [rad]; their spacing bounds the widths, because narrower lobes would fit gaps in the data.
    theta_half: Array = field(default_factory=lambda: THETA_HALF)

    @property
    def n_lobes(self) -> int:
        """Number K of lobes."""
        return len(self.rings)

    @property
    def n_rings(self) -> int:
        """Number of lobes that have a center other than 0."""
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
        """Slices of the unknowns that are amplitudes, shapes and elongations."""
        first, second, third = (rows * columns for rows, columns in self.blocks)
        return slice(0, first), slice(first, first + second), slice(first + second, first + second + third)

    def split(self, unknowns: Array) -> tuple[Array, Array, Array]:
        """Return views on the unknowns: amplitudes, shapes and elongations, one row for each control value.

        The columns of the amplitudes are log amplitudes (3 K), channel by channel. The columns of the shapes are log
        kappa (K), log reach (K) and the offsets of ring lobes. Elongations have K columns.
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
        """Lower and upper bounds of the unknowns; `limit` narrows these bounds for some ring lobes."""
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
        """Clip unknowns to the bounds, and widen lobes that are narrower than the spacing of the data.

        The offset of a cusp is clipped where a lower offset would hardly change the cusp.
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
        """Return control values of log kappa (K), log gamma (K) and the centers of ring lobes, in columns."""
        shape, k = self.split(unknowns)[1].copy(), self.n_lobes
        offset = shape[:, 2 * k :]
        if offset.min(initial=0.0) < 0.0:
            limit = self._cusp_limit(shape[:, 2 * k - self.n_rings : 2 * k])
            offset[...] = np.maximum(offset, 0.0) + limit * np.expm1(np.minimum(offset, 0.0) / limit)
        shape[:, k : 2 * k] = np.log(fall_to_half(np.exp(shape[:, :k]), self.family)) - shape[:, k : 2 * k]
        return shape

    def bases(self, theta_diff: Array) -> tuple[Array, Array, Array]:
        """Return the weights of the control values of amplitudes, shapes and elongations at angles theta_diff."""
        amplitude, shape, elongation = (_basis(knots.tobytes(), theta_diff.tobytes()) for knots in self.knots)
        return amplitude, shape, elongation

    def row_parameters(self, bases: tuple[Array, Array, Array], unknowns: Array) -> tuple[Array, Array, Array]:
        """Return amplitudes (rows, 3, K), `lobe_shapes` and elongations (rows, K) at the angles of `bases`."""
        amplitude, _, elongation = self.split(unknowns)
        logs = (bases[0] @ amplitude).reshape(-1, 3, self.n_lobes)
        return np.exp(logs), bases[1] @ self.lobe_shapes(unknowns), bases[2] @ elongation

    def join(self, amplitude: Array, lobe_shapes: Array, elongation: Array) -> Array:
        """Return the unknowns that have some control values; this is the inverse of `split` and `lobe_shapes`."""
        shape, k = lobe_shapes.copy(), self.n_lobes
        shape[:, k : 2 * k] = np.log(fall_to_half(np.exp(shape[:, :k]), self.family)) - shape[:, k : 2 * k]
        limit = self._cusp_limit(shape[:, 2 * k - self.n_rings : 2 * k])
        center = shape[:, 2 * k :]
        negative = np.maximum(np.minimum(center, 0.0) / limit, np.expm1(-MAX_OFFSET_LIMITS))
        shape[:, 2 * k :] = np.maximum(center, 0.0) + limit * np.log1p(negative)
        return np.concatenate([amplitude.ravel(), shape.ravel(), elongation.ravel()])

    def chain(self, unknowns: Array, matrix: Array, gradient: Array) -> None:
        """Convert derivatives in the control values of `lobe_shapes` into derivatives in the unknowns, in place.

        Only the lower triangle of the Gauss-Newton matrix is used.
        """
        shape, k, part = self.split(unknowns)[1], self.n_lobes, self.parts[1]
        # At a constant half width, gamma depends on kappa.
        by_kappa = FAMILIES[self.family].slope_of_fall(np.exp(shape[:, :k]))[..., None]
        rows = matrix[part, : part.stop].reshape(*shape.shape, -1)
        reach, offset = self._of_rings(unknowns)
        has_cusps = offset.min(initial=0.0) < 0.0
        if has_cusps:
            limit = self._cusp_limit(reach)
            slope = FAMILIES[self.family].slope_of_width(np.exp(reach), np.tan(limit)) * (limit < MAX_CUSP_OFFSET)
            saturation = np.minimum(offset, 0.0) / limit
            # The center of a cusp depends on the offset and on the half width.
            by_offset = np.exp(saturation)[..., None]
            by_reach = (slope * (np.expm1(saturation) - saturation * np.exp(saturation)))[..., None]

        def apply(derivatives: Array) -> None:
            by_gamma = derivatives[:, k : 2 * k]
            derivatives[:, :k] += by_kappa * by_gamma
            np.negative(by_gamma, out=by_gamma)
            if has_cusps:
                by_center = derivatives[:, 2 * k :]
                by_gamma[:, k - self.n_rings :] += by_reach * by_center
                by_center *= by_offset

        apply(gradient[part].reshape(*shape.shape, 1))
        apply(rows)
        below = matrix[part.start :, part]
        columns = below.T.copy().reshape(*shape.shape, -1)  # A copy is faster than strides over whole rows.
        apply(columns)
        below[...] = columns.reshape(shape.size, -1).T

    def _of_rings(self, unknowns: Array) -> tuple[Array, Array]:
        """Return views on log reach and offset of the ring lobes, (control values, ring lobes)."""
        shape, k = self.split(unknowns)[1], self.n_lobes
        return shape[:, 2 * k - self.n_rings : 2 * k], shape[:, 2 * k :]

    def _cusp_limit(self, log_reach: Array) -> Array:
        """Return the limit of a cusp's center, which cannot be below the negative of this angle [rad]."""
        return np.minimum(width_of_reach(np.exp(log_reach), self.family), MAX_CUSP_OFFSET)

    def _narrowest(self, offset: Array) -> Array:
        """Return the log reach of a lobe whose half width is the spacing of the data at the center of the lobe."""
        if self.theta_half.size < 2:
            return np.full(offset.shape, -np.inf)
        spacing = np.interp(np.maximum(offset, 0.0), *self._spacing)
        return np.asarray(np.log(reach_of_width(np.minimum(spacing, 1.0), self.family)))

    @cached_property
    def _spacing(self) -> tuple[Array, Array]:
        """Angles midway between neighbouring angles theta_half with data, and the spacings there [rad]."""
        return 0.5 * (self.theta_half[1:] + self.theta_half[:-1]), np.diff(self.theta_half)


@dataclass(frozen=True, eq=False)
class Mixture:
    """The structure of a mixture of lobes, and the values of its unknowns."""

    structure: Structure
    unknowns: Array

    def lobes(self) -> tuple[Array, Array, Array]:
        """Return the control values of K lobes, the last axis of each array.

        The arrays are the log amplitude (D, 3, K), the shape
        (S, 3, K) and the elongation (E, K). A shape holds log kappa, log reach and offset of the module's equations;
        lobes about the normal have the offset 0.
        """
        k = self.structure.n_lobes
        amplitude, shape, elongation = self.structure.split(self.unknowns)
        offset = np.zeros((len(shape), k))
        offset[:, list(self.structure.rings)] = shape[:, 2 * k :]
        shapes = np.stack([shape[:, :k], shape[:, k : 2 * k], offset], axis=1)
        return amplitude.reshape(-1, 3, k), shapes, elongation


def join_lobes(knots: Structure, is_ring: Mask, lobes: Iterable[Array]) -> Mixture:
    """Make a mixture of lobes in the form of `Mixture.lobes`, on the knots of a structure, with ring lobes last."""
    order = np.argsort(is_ring, kind="stable")
    amplitude, shapes, elongation = (part[..., order] for part in lobes)
    shape = np.concatenate([shapes[:, 0], shapes[:, 1], shapes[:, 2, is_ring[order]]], axis=1)
    structure = replace(knots, rings=tuple(is_ring[order].tolist()))
    return Mixture(structure, np.concatenate([amplitude.ravel(), shape.ravel(), elongation.ravel()]))


def mixture_model(mixture: Mixture) -> DSBRDF:
    """Return the model of a mixture, with the lobes in the order of the mixture."""
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
    """Move a mixture to new knots; the mixture does not change if the new knots include the old knots."""
    old = mixture.structure
    amplitude, _, elongation = old.split(mixture.unknowns)
    parts = (amplitude, old.lobe_shapes(mixture.unknowns), elongation)
    return Mixture(new, new.join(*map(_change, parts, old.knots, new.knots)))


def _change(control_values: Array, old_knots: Array, new_knots: Array) -> Array:
    angles = np.linspace(new_knots[0], new_knots[-1], 8 * n_control_values(new_knots.size))
    values = spline_basis(old_knots, angles) @ control_values
    return np.asarray(np.linalg.lstsq(spline_basis(new_knots, angles), values, rcond=None)[0])
