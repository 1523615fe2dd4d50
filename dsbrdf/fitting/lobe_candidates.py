"""Choose the lobes with which a fit starts, from many candidates and without nonlinear fits.

The method is orthogonal matching pursuit (Pati, Rezaiifar, Krishnaprasad 1993). The candidates are lobes of many
widths, centers and elongations. In each step, the candidate that explains most of the residual is added to the chosen
lobes. Then the amplitudes of all chosen lobes are solved anew for each row of theta_diff and each channel, under the
condition that no amplitude is negative (Bruckstein, Elad, Zibulevsky 2008).

Amplitudes of a mixture are smooth in theta_diff, and amplitudes of single rows are not. The squared error of smoothed
amplitudes can be a hundred times the signal, so `fit_amplitudes` fits the smooth amplitudes before other unknowns.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dsbrdf.arrays import Array, Mask
from dsbrdf.data.reduction import TINY
from dsbrdf.fitting.fit_data import FitData
from dsbrdf.fitting.least_squares import Precision, minimize
from dsbrdf.fitting.mixture import LOG_AMPLITUDE_BOUNDS, Mixture, Structure, join_lobes
from dsbrdf.fitting.mixture_problem import MixtureProblem
from dsbrdf.model.lobes import gamma_of_half_width, lobe_values, log_cosine, reach_of_width
from dsbrdf.model.splines import smooth_control_values

WIDTHS_DEG = (0.4, 0.8, 1.5, 2.5, 4.0, 6.0, 10.0, 16.0, 25.0, 40.0, 60.0)
RING_WIDTHS_DEG = (0.4, 0.8, 1.5, 3.0, 6.0, 10.0, 16.0, 25.0, 40.0)
RING_CENTERS_DEG = (1.0, 2.0, 4.0, 8.0, 15.0, 25.0, 40.0, 60.0, 85.0)
CUSP_WIDTHS_DEG = (0.7, 1.5, 3.0, 6.0, 9.0)
CUSP_CENTER_HALF_WIDTHS = -1.5
ELONGATIONS = (-1.0, 0.0, 1.0, 3.0)
START_KAPPA = 1.0
START_ELONGATION = 0.5
"""A fit starts at this fraction of a candidate's elongation, because fits correct too round lobes more easily."""
MIN_START_HEIGHT = 0.02
"""A lobe starts with at least this fraction of a typical amplitude, because fainter lobes have tiny derivatives."""
CHOICE_RIDGE = 1e-3
"""Fraction of the diagonal that is added to normal equations, which nearly equal lobes would make singular."""
EQUAL_GAIN = 1e-4
"""Candidates count as equally good if the squared errors that they explain differ by a smaller fraction."""
MIN_VISIBLE_VALUE = 0.02
"""A candidate of height 1 whose values are smaller at all data is chosen only if there is no other candidate."""
AMPLITUDE_SWEEPS = 30
AMPLITUDE_ITERATIONS = 40
AMPLITUDE_PRIOR = 3e-3
"""Cost of a squared change of a log amplitude by `fit_amplitudes`, relative to the squared data.

Without this cost, lobes that explain little at first would lose their amplitude, and with it all derivatives: no later
step could bring such lobes back.
"""
MIN_RELATIVE_SQUARE = 1e-20
"""The square of a lobe that no datum of a row shows counts as this fraction of the largest: it would be a divisor 0."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Candidates for lobes, all of height 1, and the weighted products of these lobes with the data."""

    width: Array  # half width of each candidate [rad]
    center: Array  # center of each candidate [rad]
    elongation: Array  # elongation of each candidate
    curves: Array  # values of the candidates at the data, (rows, candidates, samples)
    right: Array  # weighted products of the candidates with the data, (rows, 3, candidates)
    size: Array  # weighted sums of the candidates' squares, (rows, 3, candidates)

    @classmethod
    def at(cls, data: FitData, family: str) -> "Candidates":
        """Evaluate all candidates of a family of lobes at the data."""
        shapes = [(width, 0.0) for width in WIDTHS_DEG]
        shapes += [(width, CUSP_CENTER_HALF_WIDTHS * width) for width in CUSP_WIDTHS_DEG]
        # A ring narrower than the steps of the grid at its center would fall between the data, so none is a candidate.
        shapes += [(w, c) for c in RING_CENTERS_DEG for w in RING_WIDTHS_DEG if w >= max(0.12 * c, 0.3 * min(c, 5.0))]
        width, center = np.radians(shapes).T
        along, across = data.squared_tangents
        stretch = np.array(ELONGATIONS) * log_cosine(data.theta_diff)[:, None]
        ratio = np.exp(stretch)[:, :, None].astype(along.dtype)
        squared = along / ratio + across * ratio
        kappa = np.array(START_KAPPA)
        gamma = gamma_of_half_width(width, kappa, family).astype(along.dtype)
        kappa = kappa.astype(along.dtype)
        curves = np.empty((len(along), len(ELONGATIONS), len(shapes), along.shape[2]), along.dtype)
        for n in range(len(shapes)):
            at = None if center[n] == 0.0 else center[n]
            curves[:, :, n] = lobe_values(squared, kappa, gamma[n], at, family)
        count, (mean, weight) = len(ELONGATIONS), data.rows
        flat = curves.reshape(len(along), -1, along.shape[2])
        transposed = flat.transpose(0, 2, 1)
        products = ((weight * mean) @ transposed).astype(float), (weight @ np.square(transposed)).astype(float)
        elongation = np.repeat(ELONGATIONS, len(shapes))
        return cls(np.tile(width, count), np.tile(center, count), elongation, flat, *products)

    @property
    def is_ring(self) -> Mask:
        """Mask of the candidates with a center other than 0."""
        return self.center != 0.0

    @cached_property
    def is_visible(self) -> Mask:
        """Mask of the candidates with data near their peak; the height of any other candidate would be arbitrary."""
        return np.asarray(self.curves[0].max(axis=1) >= MIN_VISIBLE_VALUE)

    def mixed(self, data: FitData, curves: Array) -> Array:
        """Return the weighted products (rows, 3, lobes, candidates) of lobes (rows, lobes, samples) with candidates."""
        weighted = curves[:, None] * data.rows[1][:, :, None]
        return np.asarray((weighted @ self.curves.transpose(0, 2, 1)[:, None]).astype(float))

    def best(self, gram: Array, mixed: Array, amplitudes: Array, allowed: Mask) -> int:
        """Return the index of the allowed candidate that explains most of the residual of some lobes.

        `amplitudes` (rows, 3, lobes) are the amplitudes of the lobes. `gram` (rows, 3, lobes, lobes) are the products
        of the lobes with each other, and `mixed` (rows, 3, lobes, candidates) with the candidates. The amplitudes are
        adjusted to each candidate. The widest of equally good candidates is chosen.
        """
        count = gram.shape[-1]
        residual = self.right - np.einsum("rhkc,rhk->rhc", mixed, amplitudes)
        ridge = CHOICE_RIDGE * np.trace(gram, axis1=2, axis2=3)[..., None, None] / max(count, 1) + TINY
        adjusted = np.linalg.inv(gram + ridge * np.eye(count)) @ mixed
        unexplained = self.size - np.einsum("rhkc,rhkc->rhc", mixed, adjusted)
        gains = np.maximum(residual, 0.0) ** 2 / np.maximum(unexplained, CHOICE_RIDGE * self.size + TINY)
        allowed = allowed & self.is_visible if np.any(allowed & self.is_visible) else allowed
        gain = np.where(allowed, gains.sum(axis=(0, 1)), -1.0)
        equal = np.flatnonzero((gain >= (1.0 - EQUAL_GAIN) * gain.max()) & allowed)
        return int(equal[self.width[equal].argmax()])

    def start(self, data: FitData, empty: Structure, chosen: list[int], amplitudes: Array) -> Mixture:
        """Return a mixture of the chosen candidates, from which a fit can start.

        The amplitudes of the mixture are smooth in theta_diff and near `amplitudes` (rows, 3, lobes).
        """
        amplitude = _log_amplitudes(data, empty, amplitudes)
        logs = np.full(len(chosen), np.log(START_KAPPA)), np.log(reach_of_width(self.width[chosen], empty.family))
        shape = np.stack([*logs, np.where(self.is_ring[chosen], self.center[chosen], 0.0)])
        n_shapes, n_elongations = (rows for rows, _ in empty.blocks[1:])
        shapes = np.broadcast_to(shape, (n_shapes, *shape.shape))
        elongation = np.tile(START_ELONGATION * self.elongation[chosen], (n_elongations, 1))
        mixture = join_lobes(empty, self.is_ring[chosen], (amplitude, shapes, elongation))
        return replace(mixture, unknowns=mixture.structure.limit(mixture.unknowns))


def normal_equations(data: FitData, curves: Array) -> tuple[Array, Array]:
    """Return the weighted products of lobes with each other (rows, 3, lobes, lobes), and with the data.

    `curves` (rows, lobes, samples) are the values of the lobes. The products with the data are (rows, 3, lobes).
    """
    mean, weight = data.rows
    weighted = curves[:, None] * weight[:, :, None]
    gram, right = weighted @ curves.transpose(0, 2, 1)[:, None], weighted @ mean[..., None]
    return gram.astype(float), right[..., 0].astype(float)


def solved_amplitudes(gram: Array, right: Array, start: Array | None = None) -> Array:
    """Solve `normal_equations` for amplitudes (rows, 3, lobes), none of which is negative.

    Coordinate descent takes an exact step in one amplitude after the other. `start` has start values for the first
    lobes; the other lobes start from 0.
    """
    k, count = right.shape[-1], right[..., 0].size
    amplitudes = np.zeros((count, k))
    if start is not None:
        amplitudes[:, : start.shape[2]] = start.reshape(count, -1)
    rows = gram.reshape(count, k, k).transpose(1, 0, 2).copy()
    goals, squares = right.reshape(count, k).T.copy(), np.diagonal(gram, axis1=2, axis2=3).reshape(count, k).T
    squares = np.maximum(squares, MIN_RELATIVE_SQUARE * squares.max(axis=0, initial=0.0)) + TINY
    steps = list(zip(amplitudes.T, rows, goals, squares, strict=True))
    for _ in range(AMPLITUDE_SWEEPS):
        for amplitude, row, goal, square in steps:
            step = goal - np.einsum("nk,nk->n", row, amplitudes)
            step /= square
            step += amplitude
            np.maximum(step, 0.0, out=amplitude)
    return amplitudes.reshape(right.shape)


def fit_amplitudes(data: FitData, mixture: Mixture) -> Mixture:
    """Fit only the amplitudes of a mixture; with fixed shapes, that takes hardly any time."""
    structure, problem = mixture.structure, MixtureProblem(data, mixture.structure)
    products = normal_equations(data, problem.curves(mixture.unknowns))
    start = mixture.unknowns[structure.parts[0]]
    amplitudes = _AmplitudeProblem(problem.bases[0], *products, data.signal, start)
    unknowns = mixture.unknowns.copy()
    unknowns[structure.parts[0]] = minimize(amplitudes, start, iterations=AMPLITUDE_ITERATIONS).unknowns
    return Mixture(structure, unknowns)


@dataclass(frozen=True, eq=False)
class _AmplitudeProblem:
    """Compute the squared error of lobes with fixed shapes, and its derivatives in control values of log amplitudes."""

    basis: Array  # weights of the control values at the rows, (rows, control values)
    gram: Array  # products of the lobes with each other, (rows, 3, lobes, lobes)
    right: Array  # products of the lobes with the data, (rows, 3, lobes)
    signal: float  # weighted sum of the squared data
    start: Array  # log amplitudes from which changes have a cost, (control values * 3 * lobes,)

    @property
    def precision(self) -> Precision:
        return np.dtype(np.float64)

    def limit(self, unknowns: Array) -> Array:
        return np.clip(unknowns, *LOG_AMPLITUDE_BOUNDS)

    def evaluate(self, unknowns: Array) -> "_Amplitudes":
        amplitude = np.exp((self.basis @ unknowns.reshape(self.basis.shape[1], -1)).reshape(self.right.shape))
        product, change = np.einsum("rhkl,rhl->rhk", self.gram, amplitude), unknowns - self.start
        error = self.signal + float(np.sum(amplitude * (product - 2.0 * self.right)))
        cost = error + AMPLITUDE_PRIOR * self.signal * float(change @ change)
        return _Amplitudes(unknowns, cost, amplitude, product - self.right)

    def linearize(self, at: "_Amplitudes") -> tuple[Array, Array]:
        (_, count), k = self.basis.shape, at.amplitude.shape[2]
        blocks = self.gram * at.amplitude[..., :, None] * at.amplitude[..., None, :]
        matrix = np.zeros((count, 3, k, count, 3, k))
        for channel in range(3):
            matrix[:, channel, :, :, channel] = np.einsum(
                "rd,re,rkl->dkel", self.basis, self.basis, blocks[:, channel], optimize=True
            )
        matrix = matrix.reshape(self.start.size, -1) + AMPLITUDE_PRIOR * self.signal * np.eye(self.start.size)
        gradient = (self.basis.T @ (at.amplitude * at.residual).reshape(len(self.basis), -1)).ravel()
        return matrix, gradient + AMPLITUDE_PRIOR * self.signal * (at.unknowns - self.start)


@dataclass(frozen=True, eq=False)
class _Amplitudes:
    """The cost of some amplitudes, and intermediate arrays for the derivatives of the cost."""

    unknowns: Array
    cost: float
    amplitude: Array  # amplitudes of the lobes, (rows, 3, lobes)
    residual: Array  # products of the lobes with the mixture minus the data, (rows, 3, lobes)


def _log_amplitudes(data: FitData, structure: Structure, amplitudes: Array) -> Array:
    """Return control values of smooth log amplitudes that are near `amplitudes` (rows, 3, lobes)."""
    typical = np.sqrt(np.mean(amplitudes**2, axis=(0, 1)))
    typical = np.maximum(typical, MIN_START_HEIGHT * typical.max() + TINY)
    logs = np.log(np.maximum(amplitudes, MIN_START_HEIGHT * typical))
    values = smooth_control_values(structure.bases(data.theta_diff)[0], logs.reshape(len(logs), -1))
    return values.reshape(-1, *amplitudes.shape[1:])
