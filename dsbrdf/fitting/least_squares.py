"""Least squares over all rows of the folded profiles.

Unknowns are the control values of every lobe's log amplitude in each channel, of its log kappa, log gamma and, for ring
lobes, center, and of its elongation; between knots they follow the B-splines of `dsbrdf.model.splines`, which are
linear in the unknowns: ``parameters(row) = sum_d B[row, d] x[d]``. With the analytic derivatives J of a row's values
with respect to the row's parameters,

    normal equations  A = sum_row (B B^T) x (J^T W J) + smoothing,     gradient  g = sum_row B x (J^T W r).

An amplitude concerns its own channel only and a shape all three: J^T W J of a row comes from one small product of lobes
and derivatives for each channel. The method is Levenberg-Marquardt with the damping update of Nielsen (1999,
IMM-REP-1999-05) and bounds: an unknown that stands at a bound and is pushed outwards is held.

A weak pull decides what the data leave open: `SMOOTHING` times the squared signal for each squared second difference of
control values. Shapes get the strongest: where a lobe is faint they would run from bound to bound between two knots.
What is known of the lobes beforehand can be added as a `Prior`.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.linalg.lapack import dpotrf as potrf
from scipy.linalg.lapack import dpotrs as potrs

from dsbrdf.arrays import Array, Indices, Mask
from dsbrdf.data.grid import THETA_DIFF, THETA_HALF
from dsbrdf.data.reduction import FoldedProfiles
from dsbrdf.fitting.structure import Structure
from dsbrdf.model.lobes import Stretch, lobe_derivatives, lobe_values, log_cosine, stretch
from dsbrdf.model.splines import roughness

SMOOTHING = (1e-7, 3e-6, 1e-6)
"""Pull on second differences of log amplitudes, shapes and elongations, as a share of the squared signal."""
_LARGEST_STEP = 1.5  # in logarithms, radians and elongation
_FIRST_DAMPING, _LARGEST_DAMPING = 1e-2, 1e8
_LIMIT_PASSES = 5
_SMALLEST_CHANGE = 1e-9
_STALLED_STEPS = 2  # iterations in a row that lower the cost by less than the tolerance


@dataclass(frozen=True, eq=False)
class FitData:
    """Values at points in R rows of equal theta_diff, N angles theta_half and P of phi_diff, and what they count."""

    mean: Array  # (3, R, N, P)
    weight: Array  # (3, R, N, P)
    cos2_phi: Array  # (R, N, P)
    theta_diff: Array  # (R,) [rad]
    theta_half: Array  # the same for all rows (N,) or each row's own (R, N) [rad]

    @classmethod
    def select(cls, folded: FoldedProfiles, weight: Array, rows: Indices, columns: Indices) -> "FitData":
        """Take rows of theta_diff and columns of theta_half of folded profiles, with all of their bins."""
        chosen = np.ix_(np.arange(3), rows, columns)
        cos2_phi = np.ascontiguousarray(folded.cos2_phi[np.ix_(rows, columns)])
        return cls(folded.mean[chosen], weight[chosen], cos2_phi, THETA_DIFF[rows], THETA_HALF[columns])

    @classmethod
    def from_samples(cls, values: Array, weight: Array, row: Indices, theta_half: Array, phi_diff: Array) -> "FitData":
        """Put samples (n, 3) into rows of whole degrees of theta_diff; shorter ones end with samples of no weight."""
        rows, index, counts = np.unique(row, return_inverse=True, return_counts=True)
        order = np.argsort(index, kind="stable")
        place = index[order], np.arange(row.size) - np.repeat(np.cumsum(counts) - counts, counts)
        shape = (rows.size, counts.max())
        mean, counted, cos2_phi = (np.zeros(s) for s in ((3, *shape, 1), (3, *shape, 1), (*shape, 1)))
        data = cls(mean, counted, cos2_phi, THETA_DIFF[rows], np.zeros(shape))
        data.mean[:, *place, 0], data.weight[:, *place, 0] = values[order].T, weight[order].T
        data.cos2_phi[*place, 0], data.theta_half[place] = np.cos(phi_diff[order]) ** 2, theta_half[order]
        return data

    def take_bins(self, bins: Sequence[int]) -> "FitData":
        """Keep some bins of phi_diff only."""
        chosen = list(bins)
        return replace(
            self, mean=self.mean[..., chosen], weight=self.weight[..., chosen], cos2_phi=self.cos2_phi[..., chosen]
        )

    @property
    def signal(self) -> float:
        """Weighted sum of squares."""
        return float(np.sum(self.weight * self.mean**2))


@dataclass(frozen=True, eq=False)
class Prior:
    """What the U unknowns probably are: the cost of a deviation d is ``d @ matrix @ d``, as a share of the signal."""

    matrix: Array  # symmetric, not negative, (U, U)
    target: Array  # (U,), equal for all control values of a parameter: the smoothing does not pull against it


class MixtureProblem:
    """The cost of a mixture on data, and its derivatives; `SMOOTHING` and a `Prior` pull at the unknowns."""

    def __init__(
        self,
        data: FitData,
        structure: Structure,
        smoothing: tuple[float, float, float] = SMOOTHING,
        prior: Prior | None = None,
    ) -> None:
        self.data, self.structure = data, structure
        self.bases = structure.bases(data.theta_diff)
        self._squared = np.tan(data.theta_half)[..., None] ** 2
        self._log_cos = log_cosine(data.theta_diff)[:, None, None]
        self._signal = data.signal
        blocks = [
            pull * np.kron(roughness(basis.shape[1]), np.eye(columns))
            for basis, pull, (_, columns) in zip(self.bases, smoothing, structure.blocks, strict=True)
        ]
        self._pull = self._signal * (block_diag(*blocks) + (0.0 if prior is None else prior.matrix))
        self._target = np.zeros(structure.n_unknowns) if prior is None else prior.target

    def values(self, unknowns: Array) -> Array:
        """Values of the mixture, shape (3, R, N, P) [1/sr]."""
        amplitude, _, _ = self.structure.row_parameters(self.bases, unknowns)
        return np.einsum("crk,krnp->crnp", amplitude, self.curves(unknowns), optimize=True)

    def curves(self, unknowns: Array) -> Array:
        """Values of the lobes at height 1, shape (K, R, N, P)."""
        _, shape, elongation = self.structure.row_parameters(self.bases, unknowns)
        family = self.structure.family
        return np.concatenate(
            [
                lobe_values(at.squared_tangent, kappa, gamma, center, family)
                for at, kappa, gamma, center in self._kinds(shape, elongation)
            ]
        )

    def evaluate(self, unknowns: Array) -> "Evaluation":
        """Cost, and what its derivatives are put together from."""
        amplitude, shape, elongation = self.structure.row_parameters(self.bases, unknowns)
        curves = self._derivatives(shape, elongation)
        curves = np.ascontiguousarray(curves.reshape(*curves.shape[:2], -1).transpose(1, 0, 2))
        values = amplitude.transpose(1, 0, 2) @ curves[:, : self.structure.n_lobes]
        residual = values.transpose(1, 0, 2) - self.data.mean.reshape(3, len(values), -1)
        cost = np.einsum("crn,crn,crn->", self.data.weight.reshape(residual.shape), residual, residual)
        off = unknowns - self._target
        return Evaluation(unknowns, float(cost + off @ self._pull @ off), amplitude, curves, residual)

    def linearize(self, at: "Evaluation") -> tuple[Array, Array]:
        """Gauss-Newton matrix (U, U) and half the gradient (U,) of the cost."""
        k, n_rows = self.structure.n_lobes, self.data.theta_diff.size
        rings = np.flatnonzero(self.structure.rings)
        lobe_of = np.concatenate([np.arange(k), np.arange(k), rings, np.arange(k)])
        within, across = np.zeros((n_rows, 3, k, 3, k)), np.zeros((n_rows, 3, k, lobe_of.size))
        shared = np.zeros((n_rows, lobe_of.size, lobe_of.size))
        by_amplitude, by_shared = np.zeros((n_rows, 3, k)), np.zeros((n_rows, lobe_of.size))
        for channel in range(3):
            height, scale = at.amplitude[channel], at.amplitude[channel][:, lobe_of]
            weighted = at.curves * self.data.weight[channel].reshape(n_rows, 1, -1)
            product = weighted @ at.curves.transpose(0, 2, 1)
            slope = (weighted @ at.residual[channel][..., None])[..., 0]
            within[:, channel, :, channel] = product[:, :k, :k] * height[:, :, None] * height[:, None, :]
            across[:, channel] = product[:, :k, k:] * height[:, :, None] * scale[:, None, :]
            shared += product[:, k:, k:] * scale[:, :, None] * scale[:, None, :]
            by_amplitude[:, channel] = slope[:, :k] * height
            by_shared += slope[:, k:] * scale
        own, mixed = within.reshape(n_rows, 3 * k, 3 * k), across.reshape(n_rows, 3 * k, -1)
        upper, lower = ((own, mixed), (mixed.transpose(0, 2, 1), shared))
        rows = np.concatenate([np.concatenate(upper, axis=2), np.concatenate(lower, axis=2)], axis=1)
        gradient_rows = np.concatenate([by_amplitude.reshape(n_rows, -1), by_shared], axis=1)
        matrix, gradient = self._assemble(rows, gradient_rows)
        self.structure.chain(at.unknowns, matrix, gradient)
        return matrix + self._pull, gradient + self._pull @ (at.unknowns - self._target)

    def _assemble(self, rows: Array, gradient_rows: Array) -> tuple[Array, Array]:
        """Normal equations of the unknowns from those of each row's parameters."""
        k = self.structure.n_lobes
        ends = np.cumsum([0, 3 * k, 2 * k + self.structure.n_rings, k])
        parts = [slice(start, stop) for start, stop in itertools.pairwise(ends)]
        blocks: list[list[Array]] = [[np.empty(0)] * 3 for _ in range(3)]
        for i, first in enumerate(self.bases):
            for j in range(i, 3):
                block = _spread(first, self.bases[j], rows[:, parts[i], parts[j]])
                blocks[i][j], blocks[j][i] = block, block.T
        gradient = [(basis.T @ gradient_rows[:, part]).ravel() for basis, part in zip(self.bases, parts, strict=True)]
        return np.block(blocks), np.concatenate(gradient)

    def _kinds(self, shape: Array, elongation: Array) -> Iterator[tuple[Stretch, Array, Array, Array | None]]:
        """Stretch, kappa, gamma and center of the lobes about the normal, then of the ring lobes, (lobes, R, 1, 1)."""
        k, centered = self.structure.n_lobes, self.structure.n_lobes - self.structure.n_rings
        by_lobe = shape.T[..., None, None]
        stretches = elongation.T[..., None, None]
        for part, center in ((slice(0, centered), None), (slice(centered, k), by_lobe[2 * k :])):
            if part.stop > part.start:
                stretched = stretch(self._squared, self.data.cos2_phi, self._log_cos, stretches[part])
                yield stretched, np.exp(by_lobe[:k][part]), np.exp(by_lobe[k : 2 * k][part]), center

    def _derivatives(self, shape: Array, elongation: Array) -> Array:
        """Values, then derivatives in log kappa, log gamma, center and elongation, each of all lobes that have it."""
        values, by_log_kappa, by_log_gamma, by_center, by_elongation = ([] for _ in range(5))
        for at, kappa, gamma, center in self._kinds(shape, elongation):
            found = lobe_derivatives(at.squared_tangent, kappa, gamma, center, self.structure.family)
            values.append(found.value)
            by_log_kappa.append(found.by_log_kappa)
            by_log_gamma.append(found.by_log_gamma)
            by_elongation.append(found.by_squared_tangent * at.by_elongation)
            if center is not None:
                by_center.append(found.by_center)
        return np.concatenate(values + by_log_kappa + by_log_gamma + by_center + by_elongation)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A mixture on its data."""

    unknowns: Array  # (U,)
    cost: float  # weighted squared error plus the pull towards smooth parameters
    amplitude: Array  # (3, R, K)
    curves: Array  # lobes of height 1, then derivatives in the Q parameters that channels share, (R, K + Q, N * P)
    residual: Array  # mixture less data, (3, R, N * P)


@dataclass(frozen=True, eq=False)
class Solution:
    """Outcome of `minimize`."""

    unknowns: Array
    cost: float
    converged: bool  # whether the cost stopped falling within the iterations allowed
    iterations: int


def minimize(
    problem: MixtureProblem,
    start: Array,
    *,
    tolerance: float,
    iterations: int,
    fixed: Mask | None = None,
    on_iteration: Callable[[int], None] | None = None,
) -> Solution:
    """Levenberg-Marquardt within the bounds of the structure, from the unknowns `start`.

    An iteration stalls that lowers the cost by less than the share `tolerance`; at most so many steps are tried, and
    `on_iteration` is called with the number of each. The unknowns that are `fixed` keep the value they start from.
    """
    at = problem.evaluate(problem.structure.limit(start))
    matrix, gradient = problem.linearize(at)
    damping, growth, stalled = _FIRST_DAMPING, 2.0, 0
    for number in range(1, iterations + 1):
        if on_iteration is not None:
            on_iteration(number)
        step = _step(problem.structure, at.unknowns, matrix, gradient, damping, fixed)
        predicted = -float(2.0 * gradient @ step + step @ matrix @ step)
        proposed = problem.evaluate(at.unknowns + step) if predicted > 0.0 else at
        gain = (at.cost - proposed.cost) / predicted if predicted > 0.0 else -1.0
        if gain > 0.0:
            stalled = stalled + 1 if at.cost - proposed.cost < tolerance * at.cost else 0
            at, damping, growth = proposed, damping * max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3), 2.0
            if stalled >= _STALLED_STEPS:
                return Solution(at.unknowns, at.cost, True, number)
            matrix, gradient = problem.linearize(at)
        else:
            damping, growth = damping * growth, growth * 2.0
            if damping > _LARGEST_DAMPING:
                return Solution(at.unknowns, at.cost, True, number)
    return Solution(at.unknowns, at.cost, False, iterations)


def _step(
    structure: Structure,
    unknowns: Array,
    matrix: Array,
    gradient: Array,
    damping: float,
    fixed: Mask | None,
) -> Array:
    """Damped Gauss-Newton step within the limits of the structure.

    Unknowns that a limit stops short are given the step that is left to them, and the others are solved for anew, as
    under a constraint, with the same factor: else these would answer to steps that are not made.
    """
    # First those that stand at a limit and are pushed outwards.
    pushed = structure.limit(unknowns - _SMALLEST_CHANGE * np.sign(gradient))
    free = np.abs(pushed - unknowns) > 0.5 * _SMALLEST_CHANGE
    if fixed is not None:
        free &= ~fixed
    index = np.flatnonzero(free)
    step = np.zeros_like(gradient)
    if not index.size:
        return step
    scale = np.diag(matrix)
    damped = matrix[np.ix_(index, index)]
    damped[np.diag_indices(index.size)] += damping * (scale[index] + 1e-12 * scale.max())
    factor, failed = potrf(damped, overwrite_a=True)
    if failed:  # singular to rounding: no step, so that the damping grows
        return step
    solved = unlimited = potrs(factor, -gradient[index])[0]
    stopped = np.zeros(index.size, bool)
    for _ in range(_LIMIT_PASSES):
        wanted = np.zeros_like(gradient)
        wanted[index] = np.clip(solved, -_LARGEST_STEP, _LARGEST_STEP)
        step = structure.limit(unknowns + wanted) - unknowns
        newly = ~stopped & (np.abs(step[index] - solved) > _SMALLEST_CHANGE)
        if not newly.any():
            break
        stopped |= newly
        places = np.flatnonzero(stopped)
        response = potrs(factor, np.eye(index.size)[:, places])[0]
        held = step[index][places]
        solved = unlimited + response @ np.linalg.solve(response[places], held - unlimited[places])
        solved[places] = held  # to the last bit: an unknown at its bound stays there
    return step


def _spread(first: Array, second: Array, rows: Array) -> Array:
    """Sum over rows of (first x second) x block, shape (D P, E Q) for blocks (R, P, Q)."""
    outer = np.einsum("rd,re->rde", first, second).reshape(len(first), -1)
    d, e, (_, p, q) = first.shape[1], second.shape[1], rows.shape
    spread = (outer.T @ rows.reshape(len(rows), -1)).reshape(d, e, p, q)
    return spread.transpose(0, 2, 1, 3).reshape(d * p, e * q)
