"""Compute the squared error of a mixture of lobes over all rows of theta_diff, and its derivatives.

The unknowns are the control values of every lobe's log amplitude in each channel, log kappa, log gamma and elongation,
and of the center of ring lobes. Between knots, the parameters are the B-splines of `dsbrdf.model.splines`, which are
linear in the unknowns x: ``parameters(row) = sum_d B[row, d] x[d]``. With the analytic derivatives J of a row's values
in the row's parameters, the weights W and the residual r of the row,

    normal equations  A = sum_row (B B^T) x (J^T W J) + smoothing,     gradient  g = sum_row B x (J^T W r).

An amplitude affects only one channel, and a shape affects all three channels. Therefore the matrix of a row is computed
from one small product of lobes and derivatives for each channel.

A weak prior determines unknowns that no data determine: the cost of each squared second difference of control values is
`SMOOTHING` times the weighted sum of the squared data. Shapes have the strongest prior, because shapes of a faint lobe
would oscillate between knots.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.fitting.fit_data import Block, FitData
from dsbrdf.fitting.least_squares import Precision
from dsbrdf.fitting.mixture import Structure
from dsbrdf.model.lobes import LobeSlopes, lobe_curves, log_cosine
from dsbrdf.model.splines import roughness

MIN_INTERLEAVED_DERIVATIVES = 40
"""From this number of derivatives on, products take half the time if a row of memory has the columns of one sample."""
SMOOTHING = (1e-8, 2e-7, 1e-7)
"""Weights of squared second differences of log amplitudes, shapes and elongations, relative to the squared data."""


class MixtureProblem:
    """Compute the cost of a mixture on data with the prior `SMOOTHING`, and the derivatives of the cost.

    `prior` has the costs of squared log kappa and of squared elongations, relative to the squared data.
    """

    def __init__(
        self,
        data: FitData,
        structure: Structure,
        smoothing: tuple[float, float, float] = SMOOTHING,
        prior: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.data, self.structure = data, structure
        self.bases = structure.bases(data.theta_diff)
        precision: Any = self.precision
        self._pairs = {}
        for i, j in ((0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)):
            pair = np.einsum("rd,re->der", self.bases[i], self.bases[j]).reshape(-1, len(data.theta_diff))
            self._pairs[i, j] = pair.astype(precision)
        self._log_cos = log_cosine(data.theta_diff)[:, None, None]
        pulled = zip(self.bases, smoothing, strict=True)
        self._pulls = [data.signal * weight * roughness(basis.shape[1]) for basis, weight in pulled]
        k = structure.n_lobes
        # Each unknown has a cost, `prior` times the squared data for log kappa and elongations, otherwise 0.
        self._prior = np.zeros(structure.n_unknowns)
        _, shape, elongation = structure.split(self._prior)
        shape[:, :k], elongation[...] = (data.signal * weight for weight in prior)
        # Entries of the normal matrix for amplitudes of two different channels stay 0; `linearize` writes all others.
        self._matrix = np.zeros((structure.n_unknowns, structure.n_unknowns), precision)
        self._lobe_of = np.concatenate([np.tile(np.arange(k), 3), np.flatnonzero(structure.rings), np.arange(k)])

    @property
    def precision(self) -> Precision:
        """Precision of the data, in which `minimize` solves the normal equations."""
        return self.data.mean.dtype

    def limit(self, unknowns: Array) -> Array:
        """Clip unknowns to the bounds of the structure, see `Structure.limit`."""
        return self.structure.limit(unknowns)

    def values(self, unknowns: Array) -> Array:
        """Return the values of the mixture at the data [1/sr], (channels, rows, columns, bins)."""
        parameters = self.structure.row_parameters(self.bases, unknowns)
        along, across = self.data.squared_tangents
        values = np.empty((len(parameters[0]), 3, along.shape[2]), along.dtype)
        for rows in self.data.slices:
            curves = self._lobes(parameters, rows, along[rows], across[rows])[0]
            np.matmul(parameters[0][rows].astype(along.dtype), curves, out=values[rows])
        return values.transpose(1, 0, 2).reshape(3, *self.data.cos2_phi.shape)

    def curves(self, unknowns: Array) -> Array:
        """Return values of the lobes, all with height 1, at the data, (rows, lobes, columns * bins)."""
        parameters = self.structure.row_parameters(self.bases, unknowns)
        return self._lobes(parameters, slice(None), *self.data.squared_tangents)[0]

    def evaluate(self, unknowns: Array) -> "Evaluation":
        """Return the cost, and the intermediate arrays from which `linearize` computes the cost's derivatives."""
        parameters = self.structure.row_parameters(self.bases, unknowns)
        smoothed = zip(self._pulls, self.structure.split(unknowns), strict=True)
        # Half the gradient of the smoothing term of the cost.
        pull, parts = np.concatenate([(matrix @ part).ravel() for matrix, part in smoothed]), []
        pull += self._prior * unknowns
        cost = float(unknowns @ pull)
        for block in self.data.blocks:
            curves, kinds = self._lobes(parameters, block.rows, block.along, block.across)
            residual = parameters[0][block.rows].astype(curves.dtype) @ curves
            residual -= block.mean
            cost += float(np.vdot(residual, residual * block.weight))
            parts.append((block, curves, kinds, residual))
        return Evaluation(unknowns, cost, parameters[0], parts, pull)

    def linearize(self, at: "Evaluation") -> tuple[Array, Array]:
        """Return the lower triangle of the Gauss-Newton matrix, and half the gradient of the cost.

        The next call overwrites the matrix, whose memory is reused.
        """
        k, count = self.structure.n_lobes, self._lobe_of.size
        products, *buffers = self._buffers
        for block, curves, kinds, residual in at.parts:
            # The columns are the derivatives of the values in the parameters of the lobes, then the residual.
            rows, _, samples = curves.shape
            shapes = (rows, count, samples), (rows, count, samples), (rows, count + 1, samples)
            derivatives, weighted, columns = (
                buffer[: math.prod(shape)].reshape(shape) for buffer, shape in zip(buffers, shapes, strict=True)
            )
            is_interleaved = count >= MIN_INTERLEAVED_DERIVATIVES
            columns = columns.reshape(rows, samples, -1) if is_interleaved else columns.transpose(0, 2, 1)
            derivatives[:, :k] = curves
            for place, values in (column for kind in kinds for column in self._slopes(block, kind)):
                derivatives[:, place] = values
            columns[..., :count] = derivatives.transpose(0, 2, 1)
            for channel in range(3):
                columns[..., count] = residual[:, channel]
                np.multiply(derivatives, block.weight[:, channel, None], out=weighted)
                np.matmul(weighted, columns, out=products[block.rows, channel])
        matrix, gradient = self._assemble(products, at.amplitude[:, :, self._lobe_of])
        self.structure.chain(at.unknowns, matrix, gradient)
        for part, pull in zip(self.structure.parts, self._pulls, strict=True):
            square = matrix[part, part].reshape(len(pull), -1, len(pull), (part.stop - part.start) // len(pull))
            np.einsum("dpep->dep", square)[...] += pull[:, :, None]
        np.einsum("nn->n", matrix)[...] += self._prior
        return matrix, gradient + at.pull

    @cached_property
    def _buffers(self) -> tuple[Array, Array, Array, Array]:
        """Arrays that `linearize` reuses, so that they stay in a processor's cache.

        The first array is for the products of M derivatives with each other and with the residual (rows, 3, M, M + 1).
        The other arrays are for a block: its derivatives, these times the weights, and derivatives and residual.
        """
        count, dtype = self._lobe_of.size, self.data.mean.dtype
        size = max(block.along.size for block in self.data.blocks)
        products = np.empty((len(self.data.theta_diff), 3, count, count + 1), dtype)
        derivatives, weighted, columns = (np.empty(size * width, dtype) for width in (count, count, count + 1))
        return products, derivatives, weighted, columns

    def _assemble(self, products: Array, scale: Array) -> tuple[Array, Array]:
        """Return the matrix and the gradient in the control values, from products in the parameters of each row.

        The products (rows, 3, M, M + 1) of M derivatives with each other and with the residual are overwritten. The
        derivatives are of lobes with height 1, and `scale` (rows, 3, M) has the amplitudes of these lobes.
        """
        k, (first, *_), bases = self.structure.n_lobes, self.structure.parts, self.bases
        q, matrix = 2 * k + self.structure.n_rings, self._matrix
        by_row = products[..., -1] * scale
        by_amplitude, by_shared = by_row[:, :, :k].reshape(len(by_row), -1), by_row[:, :, k:].sum(axis=1)
        parts = zip(bases, (by_amplitude, by_shared[:, :q], by_shared[:, q:]), strict=True)
        gradient = np.concatenate([(basis.T @ part).ravel() for basis, part in parts])
        precision: Any = self.precision
        scale = scale.astype(precision)  # The products have no more digits, and the matrix only directs the steps.
        own = self._spread(0, 0, products[:, :, :k, :k] * scale[:, :, :k, None] * scale[:, :, None, :k])
        into = matrix[first, first].reshape(len(own), 3, k, len(own), 3, k)
        for channel in range(3):
            into[:, channel, :, :, channel] = own[:, :, channel].transpose(0, 2, 1, 3)
        below = products[:, :, k:]
        below *= scale[:, :, k:, None]
        mixed = np.empty((len(below), below.shape[2], 3 * k), precision)
        by_channel = mixed.reshape(*mixed.shape[:2], 3, k).transpose(0, 2, 1, 3)
        np.multiply(below[..., :k], scale[:, :, None, :k], out=by_channel)
        shared = below[:, 0, :, k:-1] * scale[:, 0, None, k:]
        for channel in (1, 2):
            shared += below[:, channel, :, k:-1] * scale[:, channel, None, k:]
        for i, j, block in (
            (1, 0, mixed[:, :q]),
            (2, 0, mixed[:, q:]),
            (1, 1, shared[:, :q, :q]),
            (2, 1, shared[:, q:, :q]),
            (2, 2, shared[:, q:, q:]),
        ):
            spread = self._spread(i, j, block).transpose(0, 2, 1, 3)
            matrix[self.structure.parts[i], self.structure.parts[j]].reshape(spread.shape)[...] = spread
        return matrix, gradient

    def _spread(self, i: int, j: int, blocks: Array) -> Array:
        """Sum the product of two spline bases and a block (rows, ...) over the rows.

        The result has one axis for the control values of each basis, then the other axes of the block.
        """
        spread = self._pairs[i, j] @ blocks.reshape(len(blocks), -1)
        return spread.reshape(self.bases[i].shape[1], self.bases[j].shape[1], *blocks.shape[1:])

    def _lobes(
        self, parameters: tuple[Array, Array, Array], rows: slice, along: Array, across: Array
    ) -> tuple[Array, list["_Kind"]]:
        """Return lobes of height 1 in some rows, (rows, lobes, samples), and intermediate arrays for derivatives."""
        shape, elongation = parameters[1][rows], parameters[2][rows]
        k, centered = self.structure.n_lobes, self.structure.n_lobes - self.structure.n_rings
        logs = elongation[..., None] * self._log_cos[rows], shape[:, :k, None], shape[:, k : 2 * k, None]
        ratio, kappa, gamma = (np.exp(part).astype(along.dtype) for part in logs)
        centers, curves, kinds = shape[:, 2 * k :, None].astype(along.dtype), [], []
        for part, center in ((slice(0, centered), None), (slice(centered, k), centers)):
            if part.stop > part.start:
                near, far = along / ratio[:, part], across * ratio[:, part]
                values, slopes = lobe_curves(near + far, kappa[:, part], gamma[:, part], center, self.structure.family)
                curves.append(values)
                kinds.append(_Kind(part, slopes, near, far))
        return curves[0] if len(curves) == 1 else np.concatenate(curves, axis=1), kinds

    def _slopes(self, block: Block, kind: "_Kind") -> list[tuple[slice, Array]]:
        """Return derivatives of lobes with respect to the parameters that all channels share, with their columns."""
        k, slopes = self.structure.n_lobes, kind.slopes()
        start, stop, end = kind.part.start, kind.part.stop, 3 * k + self.structure.n_rings
        by_elongation = kind.far - kind.near
        by_elongation *= self._log_cos[block.rows].astype(by_elongation.dtype)
        by_elongation *= slopes.by_squared_tangent
        columns = [
            (slice(k + start, k + stop), slopes.by_log_kappa),
            (slice(2 * k + start, 2 * k + stop), slopes.by_log_gamma),
            (slice(end + start, end + stop), by_elongation),
        ]
        return columns + [(slice(3 * k, end), slopes.by_center)] * bool(slopes.by_center.ndim)


@dataclass(frozen=True, eq=False)
class _Kind:
    """Intermediate arrays of either the lobes about the normal, or the ring lobes."""

    part: slice  # indices of the lobes of this kind among all lobes of the mixture
    slopes: Callable[[], LobeSlopes]
    near: Array  # part of tan(theta')**2 along the plane of incidence, see `dsbrdf.model.lobes`
    far: Array  # part of tan(theta')**2 across the plane of incidence


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The cost of a mixture on its data, with intermediate arrays for the derivatives of the cost."""

    unknowns: Array
    cost: float  # weighted squared error plus the costs of the smoothing and of the prior
    amplitude: Array  # amplitudes of the lobes, (rows, 3, lobes)
    # Lobes of height 1 (rows, lobes, samples), their kinds, and the residual (rows, 3, samples) of each block.
    parts: list[tuple[Block, Array, list[_Kind], Array]]
    pull: Array  # half the gradient of the smoothing's part of the cost
