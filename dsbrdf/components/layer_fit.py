"""Fit structures of layers to values by the Levenberg-Marquardt method, and weigh the structures by their evidence.

The cost of a structure with the unknowns x is

    E(x) = n log(C(x) + c**2) + sum_i nu_i log(1 + d_i**2 / nu_i),

where C is the weighted squared error as a fraction of the weighted squared values, n the number of independent samples,
and c the model error, which few layers fall below. The d_i are independent deviations of x from its prior mean, with
Student's t priors of nu_i degrees of freedom. The cost is minimised first with a fixed noise of 20 % in place of the
logarithm: otherwise the prior dominates while C is large, and the fit loses narrow highlights. The evidence of a
structure is Laplace's approximation,

    E + log det A - log det A_prior + price,

where A is the matrix of the normal equations at the minimum. Each structure is fitted from several starts. Structures
whose cost stays far behind the best are dropped early. The weight of a structure is proportional to ``exp(-evidence /
4)``.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpotrf as potrf
from scipy.linalg.lapack import dpotrs as potrs
from scipy.optimize import nnls

from dsbrdf.arrays import Array
from dsbrdf.components.layer_data import N_SAMPLES, LayerData
from dsbrdf.components.layers import ALPHA_INDEX, LayeredModel, Linearized, SpecularLayer
from dsbrdf.components.structures import STRUCTURES, LayerStructure

_EVIDENCE_SCALE = 4.0
"""An increase of the evidence by this amount lowers a structure's weight by the factor e."""
_FIXED_NOISE = 0.2
_MAX_FIXED_NOISE_STEPS = 20
_MIN_FIXED_NOISE_GAIN = 0.5  # The first stage, with a fixed noise, ends if a step lowers the cost by less.
_MAX_STALLED_STEPS = 2
_COST_TOLERANCE = 0.05  # A step that lowers the cost by less counts as stalled; two such steps end the fit.
_MAX_UNKNOWN_CHANGE = 1.2  # If a step would change an unknown by more, the change is clipped.
_FIRST_DAMPING = 1e-2
_MAX_DAMPING_TRIES = 8


@dataclass(frozen=True, eq=False)
class FittedStructure:
    """A structure with the most probable values of its unknowns, and their uncertainty."""

    structure: LayerStructure
    unknowns: Array
    error: float  # relative error of the layers: square root of `LayerData.squared_error`
    evidence: float
    normal_equations: Array  # matrix of the normal equations, whose inverse gives the uncertainty of the unknowns

    @property
    def model(self) -> LayeredModel:
        """The layers with the most probable unknowns."""
        return self.structure.model(self.unknowns)

    def draw(self, generator: np.random.Generator, count: int, spread: float = 1.0) -> list[LayeredModel]:
        """Draw layers from the Gaussian that the normal equations define, within the bounds of the unknowns.

        `spread` multiplies the standard deviations. Every draw has a mirror image about the fitted unknowns, so that
        few draws give an unbiased mean.
        """
        values, vectors = np.linalg.eigh(self.normal_equations)
        # The symmetric root of the matrix is used, because the signs of eigenvectors depend on the library.
        root = (vectors * spread / np.sqrt(np.maximum(values, 1e-9))) @ vectors.T
        half = generator.standard_normal((-(-count // 2), values.size)) @ root
        drawn = self.unknowns + np.concatenate([half, -half])[:count]
        return [self.structure.model(unknowns) for unknowns in np.clip(drawn, *self.structure.bounds)]


class _Place(NamedTuple):
    """Layers with some values of the unknowns, and the parts of their cost."""

    layers: list[Linearized]
    total: Array  # values of all layers together, (3, N) [1/sr]
    error: float  # relative weighted squared error, see `LayerData.squared_error`
    penalty: float  # cost of the deviation of the unknowns from their prior


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
    _here: _Place = field(init=False)

    def __post_init__(self) -> None:
        self.unknowns = np.clip(self.unknowns, *self.structure.bounds)
        self._here = self._place(self.unknowns)

    @property
    def prospect(self) -> float:
        """Estimate of the evidence from the cost so far and a penalty for each unknown, to compare structures."""
        return self._cost(self._here, is_first=False) + self.structure.price + self.structure.mean.size

    @property
    def model(self) -> LayeredModel:
        """The layers of the current unknowns."""
        return self.structure.model(self.unknowns)

    def run(self, steps: int) -> None:
        """Take a number of steps, or fewer if the fit converges before."""
        for _ in range(steps):
            if self.is_first and (self._steps >= _MAX_FIXED_NOISE_STEPS or self._here.error < _FIXED_NOISE**2):
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
        cost = self._cost(self._here, is_first=False) + self.structure.price
        evidence = cost + float(np.linalg.slogdet(matrix)[1]) - self.structure.log_determinant
        return FittedStructure(self.structure, self.unknowns, float(np.sqrt(self._here.error)), evidence, matrix)

    def _step(self) -> None:
        """Take one step that lowers the cost; if there is none, end the first stage or the fit."""
        here = self._cost(self._here, is_first=self.is_first)
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
            place = self._place(tried)
            there = self._cost(place, is_first=self.is_first)
            if there < here:
                break
            self.damping *= 5.0
        else:
            self.done, self.is_first, self.damping = not self.is_first, False, _FIRST_DAMPING
            return
        self._stalled = self._stalled + 1 if here - there < _COST_TOLERANCE * self.data.n_samples / N_SAMPLES else 0
        self.unknowns, self._here, self.damping = tried, place, max(self.damping / 4.0, 1e-5)
        self.done = not self.is_first and self._stalled >= _MAX_STALLED_STEPS
        if self.is_first and here - there < _MIN_FIXED_NOISE_GAIN:
            self._free_noise()

    def _place(self, unknowns: Array) -> _Place:
        """Evaluate the layers with some unknowns, and the parts of the cost."""
        parts = zip(self.structure.layers, self.structure.slices, strict=True)
        layers = [prior.kind.linearize(self.data.points, unknowns[part]) for prior, part in parts]
        total = layers[0].values
        for layer in layers[1:]:
            total = total + layer.values
        whitened = self.structure.root @ (unknowns - self.structure.mean)
        penalty = float(self.structure.freedom @ np.log1p(whitened**2 / self.structure.freedom))
        return _Place(layers, total, self.data.squared_error(total), penalty)

    def _cost(self, place: _Place, *, is_first: bool) -> float:
        error = place.error
        scaled = error / _FIXED_NOISE**2 if is_first else float(np.log(error + self.data.model_error**2))
        return self.data.n_samples * scaled + place.penalty

    def _linearized(self) -> tuple[Array, Array]:
        """Return half of the Gauss-Newton matrix and half of the gradient of the squared error."""
        size = self.unknowns.size
        matrix, gradient = np.zeros((size, size)), np.zeros(size)
        layers, total = self._here.layers, self._here.total
        derivatives = [layer.relative() for layer in layers]
        # The rows are the derivatives of the values in the unknowns, then the residual.
        columns = np.empty((self.structure.of_channel[0].size + 1, total.shape[1]))
        for channel, places in enumerate(self.structure.of_channel):
            root = self.data.root_weight[channel]
            end = 0
            for layer, relative in zip(layers, derivatives, strict=True):
                np.multiply(layer.own[channel], root, out=columns[end])
                end += 1
                for other in layer.others:
                    np.multiply(_of_channel(other, channel, 2), root, out=columns[end])
                    end += 1
                start, end = end, end + relative.shape[-2]
                np.multiply(_of_channel(relative, channel, 3), layer.values[channel] * root, out=columns[start:end])
            np.subtract(total[channel] * root, self.data.weighted[channel], out=columns[end])
            products = columns[:-1] @ columns.T
            if self.data.sums is not None:
                sums = columns @ self.data.sums[channel].T
                products += sums[:-1] @ sums.T
            matrix[places[:, np.newaxis], places] += products[:, :-1]
            gradient[places] += products[:, -1]
        return matrix, gradient

    def _system(self, *, is_first: bool) -> tuple[Array, Array]:
        """Return half of the approximate Hessian and half of the gradient of the cost."""
        structure, (matrix, gradient) = self.structure, self._linearized()
        scale = self.data.n_samples / (_FIXED_NOISE**2 if is_first else self._here.error + self.data.model_error**2)
        off = self.unknowns - structure.mean
        whitened = structure.root @ off
        prior = structure.root.T @ (structure.root / (1.0 + whitened**2 / structure.freedom)[:, np.newaxis])
        return scale * matrix + prior, scale * gradient + prior @ off


def _of_channel(values: Array, channel: int, dimensions: int) -> Array:
    """Return values in one channel; an array with one dimension less is equal in all channels."""
    return values if values.ndim < dimensions else values[channel]


_TRIAL_STEPS = (5,)
_QUICK_TRIAL_STEPS = (1, 1, 3)  # After each stage of a quick trial, the worse half of the starts is dropped.
_TURN_TRIAL_STEPS = 3  # These trials start from the end of a trial without turning colours.
_MAX_UNTURNED_COST_LEAD = 150.0  # Without turning colours, the cost may exceed the lowest cost by at most this.
_QUICK_TRIAL_STRIDE = 2  # Trials of a complete material use every second pair of directions.
_MAX_FIRST_STEPS = 10
_MAX_STEPS = 60
_MAX_REFINING_STEPS = 20
_MAX_TRIAL_COST_LEAD = 40.0  # After the trials, a structure whose cost is higher than the best by more is dropped.
_MAX_COST_LEAD = 30.0  # After the first steps, a structure whose cost is higher than the best by more is dropped.
_MIN_CHANNEL_START = 0.05  # The colour of a layer starts with at least this fraction of its brightest channel.


def fit_structures(
    data: LayerData, structures: Sequence[LayerStructure] = STRUCTURES, *, quick: bool = False
) -> list[FittedStructure]:
    """Fit structures to data and sort the fits, the best first; structures far behind are dropped after a trial.

    If `quick`, trials use half of the data, and the worse half of the starts is dropped after each step. Fits of
    scattered samples need the full trials, because few steps do not yet identify the best start.
    """
    unit = data.n_samples / N_SAMPLES
    found: list[FittedStructure] = []
    best = np.inf
    for trial in _trials(data, structures, quick=quick):
        if trial.prospect > best + _MAX_TRIAL_COST_LEAD * unit:
            break
        descent = replace(trial, data=data, done=False)
        descent.run(_MAX_FIRST_STEPS)
        if descent.prospect > best + _MAX_COST_LEAD * unit:
            continue
        descent.run(_MAX_STEPS)
        if not trial.structure.only_in_ranges:
            best = min(best, descent.prospect)
        found.append(descent.fitted())
    return sorted(found, key=lambda fitted: fitted.evidence)


def refined(data: LayerData, structure: LayerStructure, unknowns: Array) -> FittedStructure:
    """Fit one structure, starting from unknowns (U,) near the optimum."""
    descent = Descent(data, structure, unknowns, is_first=False)
    descent.run(_MAX_REFINING_STEPS)
    return descent.fitted()


def structure_weights(found: Sequence[FittedStructure]) -> Array:
    """Return the weights of fitted structures, which sum to 1 and follow from the evidence.

    A structure that is only in ranges has at most the weight of the best other structure.
    """
    usual = min(fitted.evidence for fitted in found if not fitted.structure.only_in_ranges)
    evidence = np.maximum([fitted.evidence for fitted in found], usual)
    weights = np.exp((evidence.min() - evidence) / _EVIDENCE_SCALE)
    return np.asarray(weights / weights.sum())


def _trials(data: LayerData, structures: Sequence[LayerStructure], *, quick: bool) -> list[Descent]:
    """Take a few steps of the fit of every structure; return the fits so far, the most promising first."""
    if quick:
        data = data.thinned(_QUICK_TRIAL_STRIDE)
    unit = data.n_samples / N_SAMPLES
    trials: dict[str, Descent] = {}
    for structure in structures:
        parent = trials.get(structure.parent or "")
        if parent is not None and structure.turns:
            best = min(trial.prospect for trial in trials.values())
            if parent.prospect < best + _MAX_UNTURNED_COST_LEAD * unit:
                trials[structure.name] = Descent(data, structure, structure.turned(parent.unknowns), is_first=False)
                trials[structure.name].run(_TURN_TRIAL_STEPS)
        elif started := structure if parent is None else structure.started_from(parent.model):
            trials[structure.name] = _best_trial(data, started, _QUICK_TRIAL_STEPS if quick else _TRIAL_STEPS)
    return sorted(trials.values(), key=lambda trial: trial.prospect)


def _best_trial(data: LayerData, structure: LayerStructure, stages: Sequence[int]) -> Descent:
    """Return the best of the fits from all starts of a structure.

    `stages` are numbers of steps; only the better half of the starts enters the next stage.
    """
    trials = [Descent(data, structure, _start(data, structure, widths)) for widths in structure.starts]
    for steps in stages:
        for trial in trials:
            trial.run(steps)
        trials = sorted(trials, key=lambda trial: trial.prospect)[: -(-len(trials) // 2)]
    return trials[0]


def _start(data: LayerData, structure: LayerStructure, widths: tuple[float, ...]) -> Array:
    """Return start unknowns: the half widths [degrees], the best colours for them, and the prior's mean for the rest.

    The colours of the layers, and F90 of a specular layer, are found by linear least squares.
    """
    unknowns = structure.mean.copy()
    shapes, remaining = [], list(widths)
    for prior, part in zip(structure.layers, structure.slices, strict=True):
        own = unknowns[part]
        is_surface = issubclass(prior.kind, SpecularLayer)
        if is_surface and remaining:
            own[ALPHA_INDEX] = np.log(np.tan(np.radians(remaining.pop(0))) / np.sqrt(np.sqrt(2.0) - 1.0))
        white = np.concatenate([np.zeros(3), own[3:]])
        if is_surface:
            white[3] = 0.0
        layer = prior.kind.linearize(data.points, white)
        shapes.append(layer.own[0])
        if layer.others:
            shapes.append(_of_channel(layer.others[0], 0, 2))
    columns = np.stack(shapes)
    found = [nnls((columns * root).T, goal)[0] for root, goal in zip(data.root_weight, data.weighted, strict=True)]
    heights = iter(np.array(found).T)
    for prior, part in zip(structure.layers, structure.slices, strict=True):
        own, color = unknowns[part], next(heights)
        least = 0.1 * np.exp(prior.mean[0]) if issubclass(prior.kind, SpecularLayer) else 0.005
        own[:3] = np.log(np.maximum(color, _MIN_CHANNEL_START * max(float(color.max()), least)))
        if issubclass(prior.kind, SpecularLayer):
            own[3] = np.log(np.clip(next(heights).mean(), 0.02, 1.2))
    return unknowns
