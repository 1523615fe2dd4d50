"""Fit layers of surfaces to scattered samples, to predict how a material reflects outside of a plane of incidence.

Layers (`dsbrdf.components.layer_fit`), fitted in one plane of incidence, predict how the surface reflects in all other
planes. A structure says which layers there are. Highlights of measured materials are longer across the plane of
incidence than highlights of microfacets, by a stretch: with stretch 0, a highlight is round in half vectors; with
stretch 1, a highlight is round in angles about the mirror direction. A stretch replaces the squared tangent of
theta_half by

    tan(theta_half)**2 (cos(phi_diff)**2 + cos(theta_diff)**(2 stretch) sin(phi_diff)**2).

The samples determine the stretch; if all samples lie in one plane, the stretches keep their prior probabilities.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.components.layer_data import LAYER_POWER, PLAIN_ERROR_WEIGHT, LayerData
from dsbrdf.components.layer_fit import FittedStructure, fit_structures, structure_weights
from dsbrdf.components.layers import LayeredModel
from dsbrdf.components.points import Points
from dsbrdf.components.structures import STRUCTURES, LayerStructure
from dsbrdf.data.geometry import half_difference
from dsbrdf.samples.scattered_samples import ScatteredSamples

# This fraction of the median is added to values before their logarithm, so that noise of dark values weighs little.
_DARK_FRACTION = 0.02
# A highlight whose peak has no samples is not narrower than this half width, which instruments resolve.
_APERTURE = np.radians(0.3)
_MIN_HALF_WIDTH = 1e-4
_NEGLIGIBLE_WEIGHT = 1e-3
# Prior probability of each stretch of highlights across the plane of incidence.
_STRETCHES = {0.0: 0.6, 0.5: 0.3, 1.0: 0.1}
_LOWEST_COSINE_DIFF = 0.17  # The stretch of a highlight stays constant where the cosine of theta_diff is smaller.
_N_DRAWS = 32
# The evidence is overconfident, so that structures and layers are drawn by this power of their probability.
_DRAWN_POWER = 0.5
_MODEL_ERROR = 0.02  # Samples have noise, so they have a larger error than the values of a fitted model.

Candidate = tuple[LayerStructure, float]
"""A structure of layers, and the stretch of its highlights across the plane of incidence."""
CANDIDATES = tuple((structure, stretch) for stretch in _STRETCHES for structure in STRUCTURES)


def dark_level(samples: ScatteredSamples) -> float:
    """Return the level that is added to values before logarithms and weights are computed [1/sr]."""
    return float(_DARK_FRACTION * np.median(samples.values.mean(axis=1)) + 1e-9 * samples.values.max())


@dataclass(frozen=True, eq=False)
class SampleLayers:
    """Structures of layers fitted to samples, whose value is the weighted geometric mean over all structures."""

    found: tuple[FittedStructure, ...]
    stretches: tuple[float, ...]
    weights: Array  # probability of each structure, with the sum 1
    dark: float

    @classmethod
    def fit(cls, samples: ScatteredSamples, candidates: Sequence[Candidate] = CANDIDATES) -> "SampleLayers":
        """Fit candidate structures, drop structures of negligible probability, and sort by falling probability."""
        nearest = float(half_difference(samples.omega_in, samples.omega_out)[0].min())
        narrowest = max(min(nearest, _APERTURE), nearest / 4.0, _MIN_HALF_WIDTH)
        found = list[tuple[FittedStructure, float]]()
        for stretch in dict.fromkeys(stretch for _, stretch in candidates):
            structures = [structure.of_samples(narrowest) for structure, given in candidates if given == stretch]
            found += [(one, stretch) for one in fit_structures(_layer_data(samples, stretch), structures)]
        weights = structure_weights([one for one, _ in found]) * [_STRETCHES[stretch] for _, stretch in found]
        weights = weights / weights.sum()
        kept = [at for at in np.argsort(-weights, kind="stable") if weights[at] > _NEGLIGIBLE_WEIGHT]
        fits, stretches = zip(*(found[at] for at in kept), strict=True)
        return cls(fits, stretches, weights[kept] / weights[kept].sum(), dark_level(samples))

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """Return the structures of layers, each with the stretch of its highlights."""
        return tuple((one.structure, stretch) for one, stretch in zip(self.found, self.stretches, strict=True))

    def evaluate_unmasked(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return the values (n, 3) [1/sr] that the layers have at angles (n,)."""
        return np.maximum(np.exp(self._mean_log((theta_half, theta_diff, phi_diff))) - self.dark, 0.0)

    def caution(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return the amount (n, 3) to subtract from the logarithm of values far from all samples.

        If the logarithm of the true value is normally distributed with mean m and standard deviation s, the value
        exp(m - 1.5 s**2) minimises the expected relative error. So a highlight without samples becomes too faint rather
        than too bright. If s is below 1, less than 1.5 s**2 is subtracted, because samples in the tails of the
        highlight then determine the mean.
        """
        angles = theta_half, theta_diff, phi_diff
        drawn = self.drawn_logs(*angles)
        variance = drawn.var(axis=0)
        below = np.maximum(self._mean_log(angles) - drawn.min(axis=0), 0.0)
        return np.minimum(1.5 * variance**2 / (variance + 1.0), below)

    def spread(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return the standard deviation (n,) of the logarithm of the values over the drawn layers."""
        return np.asarray(np.sqrt(np.mean(np.var(self.drawn_logs(theta_half, theta_diff, phi_diff), axis=0), axis=1)))

    def drawn_logs(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return the logarithm of values plus the dark level, (draws, n, 3), for layers drawn by their probability."""
        return self._logs(self._drawn, (theta_half, theta_diff, phi_diff))

    @cached_property
    def _drawn(self) -> list[tuple[LayeredModel, float]]:
        generator = np.random.default_rng(0)
        weights = self.weights**_DRAWN_POWER
        counts = generator.multinomial(_N_DRAWS, weights / weights.sum()).tolist()
        drawn = zip(self.found, self.stretches, counts, strict=True)
        spread = _DRAWN_POWER**-0.5
        return [(model, stretch) for one, stretch, count in drawn for model in one.draw(generator, count, spread)]

    def _mean_log(self, angles: tuple[Array, Array, Array]) -> Array:
        models = [(one.model, stretch) for one, stretch in zip(self.found, self.stretches, strict=True)]
        return np.tensordot(self.weights, self._logs(models, angles), axes=1)

    def _logs(self, models: Sequence[tuple[LayeredModel, float]], angles: tuple[Array, Array, Array]) -> Array:
        points = {stretch: _points(*angles, stretch) for stretch in {stretch for _, stretch in models}}
        values = [model.layer_values(points[stretch]).sum(axis=0).T for model, stretch in models]
        return np.log(np.array(values) + self.dark)


def _points(theta_half: Array, theta_diff: Array, phi_diff: Array, stretch: float) -> Points:
    """Return the points of angles, with theta_half rescaled to widen highlights out of the plane of incidence."""
    points = Points.at(theta_half, theta_diff, phi_diff)
    if stretch == 0.0:
        return points
    narrowed = np.maximum(np.cos(theta_diff), _LOWEST_COSINE_DIFF) ** (2.0 * stretch)
    squared = points.squared_tangent * (np.cos(phi_diff) ** 2 + narrowed * np.sin(phi_diff) ** 2)
    return points._replace(squared_tangent=squared)


def _layer_data(samples: ScatteredSamples, stretch: float) -> LayerData:
    """Return samples with weights for a fit of layers.

    Squared errors are divided by f**1.4, where f is the value of the sample; a small part of the weight is for
    absolute errors.
    """
    level, square = samples.values.mean(axis=1), np.sum(samples.values**2, axis=1)
    relative = samples.weight / (level + dark_level(samples)) ** LAYER_POWER
    plain = PLAIN_ERROR_WEIGHT * samples.weight / np.sum(samples.weight * square)
    weight = relative / np.sum(relative * square) + plain
    points = _points(*half_difference(samples.omega_in, samples.omega_out), stretch)
    return LayerData.of(points, samples.values.T, np.broadcast_to(weight, (3, weight.size)), _MODEL_ERROR)
