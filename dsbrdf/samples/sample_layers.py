"""Layers that explain scattered samples, and how far they may be from the material between the samples.

Layers by evidence (`dsbrdf.components.layer_fit`) are fitted to the samples; they know how a surface that is seen in
one plane reflects in all others. Highlights of measured materials are longer across the plane of incidence than those
of microfacets, to different degrees: between a highlight that is round in half vectors (stretch 0) and one that is
round in angles about the mirror direction (stretch 1), whose squared tangent of theta_half is

    tan(theta_half)**2 (cos(phi_diff)**2 + cos(theta_diff)**(2 stretch) sin(phi_diff)**2).

The samples decide; where they lie in one plane, the stretches keep their prior probabilities.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.components.layer_data import LAYER_POWER, PLAIN_ERROR_WEIGHT
from dsbrdf.components.layer_fit import FittedStructure, LayerData, fit_structures, structure_weights
from dsbrdf.components.layers import LayeredModel
from dsbrdf.components.points import Points
from dsbrdf.components.structures import STRUCTURES, LayerStructure
from dsbrdf.data.geometry import half_difference
from dsbrdf.samples.scattered_samples import ScatteredSamples

# Errors of values below this fraction of the median of the channels' mean count alike.
_DARK_FRACTION = 0.02
# A highlight in which no sample lies has at least the half width that instruments resolve, or a quarter of theta_half
# of the nearest sample: a narrower one is seen by its tails alone, which tell nothing of its peak. The second is the
# smallest half width of any highlight.
_APERTURE = np.radians(0.3)
_MIN_HALF_WIDTH = 1e-4
_NEGLIGIBLE_WEIGHT = 1e-3
# Prior probabilities of stretches.
_STRETCHES = {0.0: 0.6, 0.5: 0.3, 1.0: 0.1}
_LOWEST_COSINE_DIFF = 0.17  # A highlight nearer to grazing angles has no further stretch.
_N_DRAWS = 32
# Structures are drawn with this power of their weights, as evidence is surer than it should be.
_DRAWN_POWER = 0.5

Candidate = tuple[LayerStructure, float]
"""A structure of layers and its stretch."""
UNSTRETCHED = tuple((structure, 0.0) for structure in STRUCTURES)
CANDIDATES = tuple((structure, stretch) for stretch in _STRETCHES for structure in STRUCTURES)


def dark_level(samples: ScatteredSamples) -> float:
    """Return the value below which errors count alike [1/sr]."""
    return float(_DARK_FRACTION * np.median(samples.values.mean(axis=1)) + 1e-9 * samples.values.max())


@dataclass(frozen=True, eq=False)
class SampleLayers:
    """Structures of layers fitted to samples, whose values are the weighted geometric mean."""

    found: tuple[FittedStructure, ...]
    stretches: tuple[float, ...]
    weights: Array  # (S,)
    dark: float

    @classmethod
    def fit(cls, samples: ScatteredSamples, candidates: Sequence[Candidate] = UNSTRETCHED) -> "SampleLayers":
        """Fit candidates; those that hardly count are dropped, and the most probable one comes first."""
        nearest = float(half_difference(samples.omega_in, samples.omega_out)[0].min())
        narrowest = max(min(nearest, _APERTURE), nearest / 4.0, _MIN_HALF_WIDTH)
        found = list[tuple[FittedStructure, float]]()
        for stretch in dict.fromkeys(stretch for _, stretch in candidates):
            structures = [structure.no_narrower(narrowest) for structure, given in candidates if given == stretch]
            fitted = fit_structures(_layer_data(samples, stretch), structures)
            found += [(one, stretch) for one in fitted]
        weights = structure_weights([one for one, _ in found]) * [_STRETCHES[stretch] for _, stretch in found]
        weights = weights / weights.sum()
        kept = [at for at in np.argsort(-weights, kind="stable") if weights[at] > _NEGLIGIBLE_WEIGHT]
        fits, stretches = zip(*(found[at] for at in kept), strict=True)
        return cls(fits, stretches, weights[kept] / weights[kept].sum(), dark_level(samples))

    @property
    def evidence(self) -> float:
        """Return the evidence of the structure that explains the samples best; less is better."""
        return self.found[0].evidence

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """Return the structures and their stretches."""
        return tuple((one.structure, stretch) for one, stretch in zip(self.found, self.stretches, strict=True))

    def evaluate_unmasked(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return values (n, 3) at angles (n,) [1/sr]."""
        return np.maximum(np.exp(self._mean_log((theta_half, theta_diff, phi_diff))) - self.dark, 0.0)

    def caution(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return by how much the logarithm of the values should be less where no sample is (n, 3).

        If the logarithm of the true value is normal with a mean m and a deviation s, exp(m - 1.5 s**2) has the least
        expected relative error: a highlight that no sample saw is rather too faint than a needle that nobody measured.
        Where s is below 1, less of it: there the mean is what layers know of a highlight from its tails.
        """
        angles = theta_half, theta_diff, phi_diff
        drawn = self.drawn_logs(*angles)
        variance = drawn.var(axis=0)
        below = np.maximum(self._mean_log(angles) - drawn.min(axis=0), 0.0)
        return np.minimum(1.5 * variance**2 / (variance + 1.0), below)

    def spread(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return the standard deviation of the logarithm of the values, over layers that are as probable (n,)."""
        return np.asarray(np.sqrt(np.mean(np.var(self.drawn_logs(theta_half, theta_diff, phi_diff), axis=0), axis=1)))

    def drawn_logs(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return logarithms of the values, the dark level added, of layers that are as probable (draws, n, 3)."""
        return self._logs(self._drawn, (theta_half, theta_diff, phi_diff))

    @cached_property
    def _drawn(self) -> list[tuple[LayeredModel, float]]:
        generator = np.random.default_rng(0)
        weights = self.weights**_DRAWN_POWER
        counts = generator.multinomial(_N_DRAWS, weights / weights.sum()).tolist()
        drawn = zip(self.found, self.stretches, counts, strict=True)
        return [(model, stretch) for one, stretch, count in drawn for model in one.draw(generator, count)]

    def _mean_log(self, angles: tuple[Array, Array, Array]) -> Array:
        models = [(one.model, stretch) for one, stretch in zip(self.found, self.stretches, strict=True)]
        return np.tensordot(self.weights, self._logs(models, angles), axes=1)

    def _logs(self, models: Sequence[tuple[LayeredModel, float]], angles: tuple[Array, Array, Array]) -> Array:
        points = {stretch: _points(*angles, stretch) for stretch in {stretch for _, stretch in models}}
        values = [model.layer_values(points[stretch]).sum(axis=0).T for model, stretch in models]
        return np.log(np.array(values) + self.dark)


def _points(theta_half: Array, theta_diff: Array, phi_diff: Array, stretch: float) -> Points:
    """Return points of angles at which highlights are longer across the plane of incidence."""
    points = Points.at(theta_half, theta_diff, phi_diff)
    if stretch == 0.0:
        return points
    narrowed = np.maximum(np.cos(theta_diff), _LOWEST_COSINE_DIFF) ** (2.0 * stretch)
    squared = points.squared_tangent * (np.cos(phi_diff) ** 2 + narrowed * np.sin(phi_diff) ** 2)
    return points._replace(squared_tangent=squared, log_squared_secant=np.log1p(squared))


def _layer_data(samples: ScatteredSamples, stretch: float) -> LayerData:
    """Return samples, weighted so that layers are fitted to errors relative to f**1.4, and a fraction of plain ones."""
    level, square = samples.values.mean(axis=1), np.sum(samples.values**2, axis=1)
    relative = samples.weight / (level + dark_level(samples)) ** LAYER_POWER
    plain = PLAIN_ERROR_WEIGHT * samples.weight / np.sum(samples.weight * square)
    weight = relative / np.sum(relative * square) + plain
    points = _points(*half_difference(samples.omega_in, samples.omega_out), stretch)
    return LayerData.of(points, samples.values.T, np.broadcast_to(weight, (3, weight.size)))
