"""Fit the unknowns of one structure of layers to values by the Levenberg-Marquardt method.

The cost of a structure with the unknowns x is

    E(x) = n log(C(x) + c**2) + sum_i nu_i log(1 + d_i**2 / nu_i),

where C is the weighted squared error as a fraction of the weighted squared values, n the number of independent samples,
and c the model error, the lowest error of any layers. The d_i are independent deviations of x from its prior mean, with
Student's t priors of nu_i degrees of freedom. The cost is minimised first with a fixed noise of 20 % in place of the
logarithm: otherwise the prior dominates while C is large, and the fit loses narrow highlights. The evidence of a
structure is Laplace's approximation,

    E + log det A - log det A_prior + price,

where A is the matrix of the normal equations at the minimum.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg.lapack import dpotrf as potrf
from scipy.linalg.lapack import dpotrs as potrs

from dsbrdf.arrays import Array
from dsbrdf.components.layers import LayeredModel, Linearized
from dsbrdf.components.points import Points
from dsbrdf.components.structures import LayerStructure

EVIDENCE_SCALE = 4.0
"""An increase of the evidence by this amount lowers a structure's weight by the factor e."""
N_SAMPLES = 50.0
"""The values of a whole material count as this many independent samples."""
MODEL_ERROR = 0.02
"""Relative error that even the best layers of a material have; it is c in the cost of a structure."""
_FIXED_NOISE = 0.2
_MAX_FIXED_NOISE_STEPS = 20
_MIN_FIXED_NOISE_GAIN = 0.5  # The first stage, with a fixed noise, ends if a step lowers the cost by less.
_MAX_STALLED_STEPS = 2
_COST_TOLERANCE = 0.02  # A step that lowers the cost by less counts as stalled; two such steps end the fit.
_MAX_UNKNOWN_CHANGE = 1.2  # If a step would change an unknown by more, the change is clipped.
_FIRST_DAMPING = 1e-2
_MAX_DAMPING_TRIES = 8


@dataclass(frozen=True, eq=False)
class LayerData:
    """Hold RGB values at points and the weights of their errors; weights times squared values sum to 1.

    Attributes
    ----------
    points : Points
        N pairs of directions.
    root_weight, weighted : Array
        Square roots of the weights, and the values times these roots, (3, N).
    n_samples : float
        Number of independent samples that the values count as.
    model_error : float
        Relative error that even the best layers have.
    sums : Array or None
        Weights of B sums over the weighted residuals, (3, B, N); the squared sums are added to the error.
    """

    points: Points
    root_weight: Array
    weighted: Array
    n_samples: float = N_SAMPLES
    model_error: float = MODEL_ERROR
    sums: Array | None = None

    @classmethod
    def of(cls, points: Points, values: Array, weight: Array) -> "LayerData":
        """Make data of values (3, N) and their weights (3, N); at least one value must be positive."""
        root = np.sqrt(weight / np.sum(weight * values**2))
        return cls(points, root, values * root)

    def thinned(self, step: int) -> "LayerData":
        """Return the data at every pair of directions with an index divisible by `step`, for a rough fit."""
        root, weighted = self.root_weight[:, ::step], self.weighted[:, ::step]
        scale = 1.0 / max(float(np.linalg.norm(weighted)), 1e-300)
        return replace(
            self,
            points=Points(*(quantity[..., ::step] for quantity in self.points)),
            root_weight=scale * root,
            weighted=scale * weighted,
            sums=None if self.sums is None else step / scale * self.sums[:, :, ::step],
        )

    def squared_error(self, values: Array) -> float:
        """Return the weighted squared error of layers with the values (3, N), relative to the data."""
        residual = values * self.root_weight - self.weighted
        error = float(np.sum(residual**2))
        return error if self.sums is None else error + float(np.sum((self.sums @ residual[..., np.newaxis]) ** 2))


@dataclass(frozen=True, eq=False)
class FittedStructure:
    """Hold a structure with the most probable values of its unknowns, and their uncertainty."""

    structure: LayerStructure
    unknowns: Array
    error: float  # relative error of the layers: square root of `LayerData.squared_error`
    evidence: float
    normal_equations: Array  # matrix of the normal equations, whose inverse gives the uncertainty of the unknowns

    @property
    def model(self) -> LayeredModel:
        """The layers with the most probable unknowns."""
        return self.structure.model(self.unknowns)

    def draw(self, generator: np.random.Generator, count: int) -> list[LayeredModel]:
        """Draw layers from the Gaussian that the normal equations define, within the bounds of the unknowns.

        Every draw has a mirror image about the fitted unknowns, so that few draws give an unbiased mean.
        """
        values, vectors = np.linalg.eigh(self.normal_equations)
        # The symmetric root of the matrix is used, because the signs of eigenvectors depend on the library.
        root = (vectors * np.sqrt(0.5 * EVIDENCE_SCALE / np.maximum(values, 1e-9))) @ vectors.T
        half = generator.standard_normal((-(-count // 2), values.size)) @ root
        drawn = self.unknowns + np.concatenate([half, -half])[:count]
        return [self.structure.model(unknowns) for unknowns in np.clip(drawn, *self.structure.bounds)]


@dataclass(eq=False)
class Descent:
    """Minimise the cost of one structure by Levenberg-Marquardt; a descent can be stopped and continued."""

    data: LayerData
    structure: LayerStructure
    unknowns: Array
    is_first: bool = True  # whether the fit is in the first stage, which uses `_FIXED_NOISE`
    done: bool = False
    damping: float = _FIRST_DAMPING
    _steps: int = 0
    _stalled: int = 0
    _error: float = field(init=False)  # relative weighted squared error, see `LayerData.squared_error`
    _matrix: Array = field(init=False)  # half the Gauss-Newton matrix of the squared error
    _gradient: Array = field(init=False)  # half the gradient of the squared error

    def __post_init__(self) -> None:
        self.unknowns = np.clip(self.unknowns, *self.structure.bounds)
        self._linearize(self._layers(self.unknowns))

    @property
    def prospect(self) -> float:
        """Estimate of the evidence from the cost so far and a penalty for each unknown, to compare structures."""
        cost = self._cost(self._error, is_first=False) + self._penalty(self.unknowns)
        return cost + self.structure.price + self.structure.mean.size

    @property
    def model(self) -> LayeredModel:
        """The layers of the current unknowns."""
        return self.structure.model(self.unknowns)

    def run(self, steps: int) -> None:
        """Take a number of steps, or fewer if the fit converges before."""
        for _ in range(steps):
            if self.is_first and (self._steps >= _MAX_FIXED_NOISE_STEPS or self._error < _FIXED_NOISE**2):
                self._free_noise()
            if self.done:
                return
            self._steps += 1
            self._step()

    def _free_noise(self) -> None:
        """End the first stage of the fit, in which the noise is fixed."""
        self.is_first, self.damping = False, max(self.damping, 1e-3)

    def fitted(self) -> FittedStructure:
        """Return the fitted structure with the current unknowns."""
        matrix, _ = self._system(is_first=False)
        cost = self._cost(self._error, is_first=False) + self._penalty(self.unknowns) + self.structure.price
        evidence = cost + float(np.linalg.slogdet(matrix)[1]) - self.structure.log_determinant
        return FittedStructure(self.structure, self.unknowns, float(np.sqrt(self._error)), evidence, matrix)

    def _step(self) -> None:
        """Take one step that lowers the cost; if there is none, end the first stage or the fit."""
        here = self._cost(self._error, is_first=self.is_first) + self._penalty(self.unknowns)
        matrix, gradient = self._system(is_first=self.is_first)
        lower, upper = self.structure.bounds
        held = (self.unknowns <= lower + 1e-9) & (gradient > 0.0) | (self.unknowns >= upper - 1e-9) & (gradient < 0.0)
        free = np.flatnonzero(~held)
        if not free.size:
            self.done = True
            return
        reduced = matrix[free[:, np.newaxis], free]
        diagonal = reduced.diagonal()
        for _ in range(_MAX_DAMPING_TRIES):
            damped = reduced.copy()
            damped.flat[:: free.size + 1] += self.damping * diagonal
            move = potrs(potrf(damped, lower=1)[0], gradient[free], lower=1)[0]
            tried = self.unknowns.copy()
            tried[free] -= np.minimum(np.maximum(move, -_MAX_UNKNOWN_CHANGE), _MAX_UNKNOWN_CHANGE)
            tried = np.minimum(np.maximum(tried, lower), upper)
            layers = self._layers(tried)
            there = self._cost(self._squared_error(layers), is_first=self.is_first) + self._penalty(tried)
            if there < here:
                break
            self.damping *= 5.0
        else:
            self.done, self.is_first, self.damping = not self.is_first, False, _FIRST_DAMPING
            return
        self._stalled = self._stalled + 1 if here - there < _COST_TOLERANCE * self.data.n_samples / N_SAMPLES else 0
        self.unknowns, self.damping = tried, max(self.damping / 4.0, 1e-5)
        self.done = not self.is_first and self._stalled >= _MAX_STALLED_STEPS
        if self.is_first and here - there < _MIN_FIXED_NOISE_GAIN:
            self._free_noise()
        self._linearize(layers)

    def _layers(self, unknowns: Array) -> list[Linearized]:
        parts = zip(self.structure.layers, self.structure.slices, strict=True)
        return [prior.kind.linearize(self.data.points, unknowns[part]) for prior, part in parts]

    def _squared_error(self, layers: list[Linearized]) -> float:
        return self.data.squared_error(_sum_of(layers))

    def _cost(self, error: float, *, is_first: bool) -> float:
        scaled = error / _FIXED_NOISE**2 if is_first else float(np.log(error + self.data.model_error**2))
        return self.data.n_samples * scaled

    def _linearize(self, layers: list[Linearized]) -> None:
        """Compute the squared error of the layers, and its normal equations, channel by channel."""
        size = self.unknowns.size
        self._error, self._matrix, self._gradient = 0.0, np.zeros((size, size)), np.zeros(size)
        total, derivatives = _sum_of(layers), [layer.relative() for layer in layers]
        # The rows are the derivatives of the values in the unknowns, then the residual.
        columns = np.empty((self.structure.of_channel[0].size + 1, total.shape[1]))
        for channel, places in enumerate(self.structure.of_channel):
            root = self.data.root_weight[channel]
            end = 0
            for layer, relative in zip(layers, derivatives, strict=True):
                np.multiply(layer.own[channel], root, out=columns[end])
                end += 1
                if layer.grazing is not None:
                    np.multiply(layer.grazing, root, out=columns[end])
                    end += 1
                start, end = end, end + len(relative)
                np.multiply(relative, layer.values[channel] * root, out=columns[start:end])
            np.subtract(total[channel] * root, self.data.weighted[channel], out=columns[end])
            products = columns[:-1] @ columns.T
            self._error += float(columns[-1] @ columns[-1])
            if self.data.sums is not None:
                sums = columns @ self.data.sums[channel].T
                products += sums[:-1] @ sums.T
                self._error += float(sums[-1] @ sums[-1])
            self._matrix[places[:, np.newaxis], places] += products[:, :-1]
            self._gradient[places] += products[:, -1]

    def _system(self, *, is_first: bool) -> tuple[Array, Array]:
        """Return half of the approximate Hessian and half of the gradient of the cost."""
        structure = self.structure
        scale = self.data.n_samples / (_FIXED_NOISE**2 if is_first else self._error + self.data.model_error**2)
        off = self.unknowns - structure.mean
        whitened = structure.root @ off
        prior = structure.root.T @ (structure.root / (1.0 + whitened**2 / structure.freedom)[:, np.newaxis])
        return scale * self._matrix + prior, scale * self._gradient + prior @ off

    def _penalty(self, unknowns: Array) -> float:
        whitened = self.structure.root @ (unknowns - self.structure.mean)
        return float(self.structure.freedom @ np.log1p(whitened**2 / self.structure.freedom))


def _sum_of(layers: Sequence[Linearized]) -> Array:
    """Return the sum of the values (3, N) of layers."""
    total = layers[0].values
    for layer in layers[1:]:
        total = total + layer.values
    return total
