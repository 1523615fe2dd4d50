"""Evaluate a model, quickly at a single point and without large arrays at a million points.

Between two knots every parameter of a lobe is a cubic polynomial in theta_diff, whose coefficients are computed once
for a model. For a few points, the coefficients of each point are looked up, and consecutive lobes of one kind (with or
without a center) are evaluated together. Many points are divided into blocks, and the points of a block are sorted by
the interval between knots that contains theta_diff, because within an interval each coefficient is a single number. The
lobes are then evaluated in turn, so that intermediate arrays stay in the processor's cache. Both ways do equal
operations on every point.
"""

import itertools
from collections.abc import Iterator

import numpy as np

from dsbrdf.arrays import Array, Indices, Mask
from dsbrdf.model.lobes import lobe_values, log_cosine
from dsbrdf.model.splines import pieces_of

_MAX_LOOKED_UP_POINTS = 512
"""For more points, sorting by interval between knots is faster than looking up coefficients."""
_MAX_POINTS_OF_RUNS = 2048
"""For more points, single lobes are faster than runs of lobes of one kind, whose arrays would not fit in the cache."""
_SORTED_POINTS = 65536
"""Many points are evaluated in blocks of this size, so that the arrays of a block stay in the cache."""
_MAX_TANGENT = 1e15  # tan(theta_half) is clipped to this value, because the tangent of pi/2 is infinite.


class Evaluator:
    """Evaluate the lobes of a model; safe to use from several threads.

    The three `groups` of parameters are amplitude; kappa, gamma and center; and elongation. Each group has its knots
    and the control values (control values, parameters). The order of the parameters is amplitude (channel, lobe), then
    kappa, gamma and center (shape, lobe), then elongation (lobe). If `spline`, the control values of amplitude, kappa
    and gamma are logarithms; otherwise the control values of amplitude are log1p(amplitude). All three channels have
    one shape, or each channel has its own; `is_ring` is the mask (lobes,) of the lobes with a center other than 0.
    """

    def __init__(self, *groups: tuple[Array, Array], n_shapes: int, is_ring: Mask, family: str, spline: bool) -> None:
        breaks = np.unique(np.concatenate([knots for knots, _ in groups]))
        if breaks.size == 1:
            breaks = breaks[0] + np.array([0.0, 1.0])
        rows = np.concatenate([pieces_of(*group, breaks, spline=spline) for group in groups], axis=2)
        # The terms (4, R, P) are the coefficients of ``(theta_diff - break)**3`` to ``**0`` for R parameters.
        self._breaks, self._terms = breaks, np.ascontiguousarray(rows.transpose(0, 2, 1))
        self._n_lobes = n_lobes = is_ring.size
        self._n_shapes, self._family, self._spline, self._is_ring = n_shapes, family, spline, is_ring
        starts = [lobe for lobe in range(n_lobes) if lobe == 0 or is_ring[lobe] != is_ring[lobe - 1]]
        self._runs = [slice(start, stop) for start, stop in itertools.pairwise([*starts, n_lobes])]
        self._single_lobes = [slice(lobe, lobe + 1) for lobe in range(n_lobes)]
        self._round = not groups[2][1].any()
        kc = n_lobes * n_shapes
        ends = np.cumsum([0, 3 * n_lobes, kc, kc, kc, n_lobes]).tolist()
        self._parts = [slice(start, stop) for start, stop in itertools.pairwise(ends)]
        self._n_logarithms = ends[3 if spline else 1]

    def parameters(self, theta_diff: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return the parameters of all lobes at n angles.

        The arrays are amplitude (n, 3, lobes), kappa, gamma and center (n, shapes, lobes) and elongation (n, lobes).
        """
        rows = self._looked_up(theta_diff)
        amplitude, kappa, gamma, center, elongation = (rows[part].T for part in self._parts)
        n, k = theta_diff.size, self._n_lobes
        kappa, gamma, center = (part.reshape(n, self._n_shapes, k) for part in (kappa, gamma, center))
        return amplitude.reshape(n, 3, k), kappa, gamma, center, elongation

    def values(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return the sum of the lobes, shape (n, 3), at angles (n,)."""
        if self._n_lobes == 0:
            return np.zeros((theta_half.size, 3))
        tangent = np.minimum(np.tan(theta_half), _MAX_TANGENT)
        squared = np.square(tangent, out=tangent)
        if theta_half.size <= _MAX_LOOKED_UP_POINTS:
            return self._sum(self._looked_up(theta_diff), squared, theta_diff, phi_diff)
        result = np.empty((theta_half.size, 3))
        for start in range(0, theta_half.size, _SORTED_POINTS):
            block = slice(start, start + _SORTED_POINTS)
            self._fill(result[block], squared[block], theta_diff[block], phi_diff[block])
        return result

    def grid(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Iterator[Array]:
        """Yield for each theta_diff the values (3, H, P) at all pairs of theta_half (H,) and phi_diff (P,).

        All points at one theta_diff have the same parameters. If no lobe has an elongation, values do not depend on
        phi_diff and are computed for one phi_diff. The values have the precision of phi_diff: in single precision, a
        grid takes a third of the time.
        """
        shape = (3, theta_half.size, phi_diff.size)
        phi_diff = phi_diff[:1] if self._round else phi_diff
        *parameters, elongation = self.parameters(theta_diff)
        amplitude, kappa, gamma, center = (part.astype(phi_diff.dtype) for part in parameters)
        factors = _stretch(elongation[:, :, None], theta_diff[:, None, None], phi_diff).astype(phi_diff.dtype)
        squared = np.square(np.minimum(np.tan(theta_half), _MAX_TANGENT)).astype(phi_diff.dtype)[:, None]
        values = np.empty((self._n_shapes, self._n_lobes, theta_half.size * phi_diff.size), phi_diff.dtype)
        for row in range(theta_diff.size):
            at = (squared * factors[row, :, None]).reshape(values.shape[1:])
            for lobes, channel in itertools.product(self._runs, range(self._n_shapes)):
                ring = center[row, channel, lobes, None] if self._is_ring[lobes.start] else None
                values[channel, lobes] = lobe_values(
                    at[lobes], kappa[row, channel, lobes, None], gamma[row, channel, lobes, None], ring, self._family
                )
            # One product serves both kinds of models: all channels have one shape, or each channel has its own.
            total = amplitude[row].reshape(self._n_shapes, 3 // self._n_shapes, self._n_lobes) @ values
            yield np.broadcast_to(total.reshape(3, theta_half.size, phi_diff.size), shape)

    def _fill(self, result: Array, squared: Array, theta_diff: Array, phi_diff: Array) -> None:
        """Write the values of a block of points into `result`, one interval between knots after another."""
        piece, step = self._place(theta_diff)
        order = np.argsort(piece.astype(np.uint8 if self._breaks.size < 256 else np.uint16), kind="stable")
        start = 0
        for index, count in enumerate(np.bincount(piece).tolist()):
            chosen = order[start : start + count]
            start += count
            if count:
                steps, angles = step[chosen], theta_diff[chosen]
                # For a distant light and viewer, all theta_diff are equal: parameters at one of them are enough.
                if (angles == angles[0]).all():
                    steps, angles = steps[:1], angles[:1]
                rows = self._rows(self._terms[:, :, index : index + 1], steps)
                result[chosen] = self._sum(rows, squared[chosen], angles, phi_diff[chosen])

    def _place(self, theta_diff: Array) -> tuple[Indices, Array]:
        """Return for each angle the index of its interval between knots, and the distance from the interval's start."""
        breaks = self._breaks
        held = np.minimum(np.maximum(theta_diff, breaks[0]), breaks[-1])
        piece = breaks[1:-1].searchsorted(held, side="right")
        return piece, held - breaks[piece]

    def _looked_up(self, theta_diff: Array) -> Array:
        """Return the parameters (rows, n) of the lobes at n angles, with coefficients looked up for each angle."""
        piece, step = self._place(theta_diff)
        return self._rows(self._terms.take(piece, axis=2), step)

    def _rows(self, terms: Array, step: Array) -> Array:
        """Evaluate cubic polynomials with coefficients (4, rows, n or 1), and convert logarithms to parameters."""
        rows = terms[0] * step
        for term in terms[1:3]:
            rows += term
            rows *= step
        rows += terms[3]
        logarithms = rows[: self._n_logarithms]
        (np.exp if self._spline else np.expm1)(logarithms, out=logarithms)
        return rows

    def _sum(self, rows: Array, squared: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return the sum of the lobes (n, 3), from parameters (rows, n or 1) and tan(theta_half)**2 (n,)."""
        amplitude, kappa, gamma, center, elongation = map(rows.__getitem__, self._parts)
        k, n_shapes = self._n_lobes, self._n_shapes
        if self._round:
            stretched = np.broadcast_to(squared, (k, squared.size))
        else:
            stretched = squared * _stretch(elongation, theta_diff, phi_diff)
        amplitude, total = amplitude.reshape(3, k, -1), np.zeros((3, squared.size))
        kappa, gamma, center = [part.reshape(n_shapes, k, -1) for part in (kappa, gamma, center)]
        for lobes in self._runs if squared.size <= _MAX_POINTS_OF_RUNS else self._single_lobes:
            ring = center[:, lobes] if self._is_ring[lobes.start] else None
            values = lobe_values(stretched[lobes], kappa[:, lobes], gamma[:, lobes], ring, self._family)
            total += (amplitude[:, lobes] * values).sum(axis=1)
        return np.ascontiguousarray(total.T)


def _stretch(elongation: Array, theta_diff: Array, phi_diff: Array) -> Array:
    """Return the factor by which an elongation stretches tan(theta_half)**2, see `dsbrdf.model.lobes`."""
    cos2 = np.square(np.cos(phi_diff))
    ratio = np.exp(elongation * log_cosine(theta_diff))
    return cos2 / ratio + (1.0 - cos2) * ratio
