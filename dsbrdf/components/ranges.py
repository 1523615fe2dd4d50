"""Estimate the uncertainty of the components by the spread of their parameters over probable layers.

Layers are drawn from every structure that explains the model's values, in proportion to the weight of the structure.
Within a structure, layers are drawn from the Gaussian that the normal equations of the structure's fit define.

The draws do not cover the difference between the model and the layers, although this light may belong to any component.
At a pair of directions where a component reflects the fraction p of the light of all layers, 4 p (1 - p) of the
difference counts as doubtful: the whole difference if p is one half, and nothing if p is 0 or 1. The doubtful light
widens the ranges of the component, as an independent error.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.components.layer_descent import EVIDENCE_SCALE, FittedStructure
from dsbrdf.components.layer_fit import structure_weights
from dsbrdf.components.layers import GRAZING_ANGLE, SpecularLayer
from dsbrdf.components.shares import LABELS, NORMAL, WeightedLayers
from dsbrdf.model.reflectance import ReflectanceModel

PROBABILITY = 0.9
"""Probability with which a parameter lies in its range."""
_POSTERIOR_FACTOR = float(np.sqrt(2.0 / EVIDENCE_SCALE))
"""Ratio of the posterior's standard deviation to the standard deviation of draws, which `EVIDENCE_SCALE` widens."""
_MIN_DRAWS = 4  # The layers of every structure are drawn at least this number of times.
_N_SHARED_DRAWS = 40  # This number of further draws is divided among structures by weight.

Range: TypeAlias = tuple[float, float]
RgbRange: TypeAlias = tuple[Range, Range, Range]


@dataclass(frozen=True)
class ComponentRanges:
    """Hold the ranges (low, high) of a component's light and colour.

    Attributes
    ----------
    light_share : tuple of float
        Fraction of all light at normal incidence.
    albedo, color : tuple of tuple of float
        Directional albedo at normal incidence, and this albedo divided by its largest channel.
    """

    light_share: Range
    albedo: RgbRange
    color: RgbRange


class SurfaceSpread(NamedTuple):
    """Hold standard deviations of the logarithms of a component's roughness, and of F0 and F70 in each channel."""

    alpha: float
    f0: Array
    f70: Array


class DrawnLayers(NamedTuple):
    """Hold D draws of a model's layers, and the light of each component in `LABELS` at normal incidence.

    Attributes
    ----------
    layers : sequence of WeightedLayers
        The draws.
    weight : Array
        Weights of the draws (D,).
    albedos : Array
        Albedo of each component by channel, (D, 3, 3).
    doubtful : Array
        Doubtful light of each component by channel, (3, 3).
    """

    layers: Sequence[WeightedLayers]
    weight: Array
    albedos: Array
    doubtful: Array

    @classmethod
    def of(cls, model: ReflectanceModel, found: Sequence[FittedStructure]) -> "DrawnLayers":
        """Draw layers from structures fitted to a model; the best structure is the first."""
        generator = np.random.default_rng(7)
        values = model.evaluate_unmasked(*NORMAL.angles).T
        drawn, doubtful = [], np.zeros((len(LABELS), 3))
        for one, weight in zip(found, structure_weights(found), strict=True):
            count = _MIN_DRAWS + int(_N_SHARED_DRAWS * weight)
            own = (one.model, *one.draw(generator, count))
            is_diffuse, each = one.structure.is_diffuse, float(weight) / len(own)
            drawn += [WeightedLayers(one.structure.name, each, layers, is_diffuse) for layers in own]
            doubtful += weight * (drawn[-len(own)].doubtful(values, NORMAL.points) @ NORMAL.weight)
        albedos = np.array([one.split(values, NORMAL.points) @ NORMAL.weight for one in drawn])
        return cls(drawn, np.array([one.weight for one in drawn]), albedos, doubtful)

    def ranges(self, label: str) -> ComponentRanges:
        """Return the ranges of the component with a label."""
        number = LABELS.index(label)
        albedo = self.albedos[:, number]
        there = albedo.sum(axis=1) > 0.0
        color = albedo[there] / albedo[there].max(axis=1, keepdims=True)
        of_albedo = _channels(albedo, self.weight, self.doubtful[number])
        return ComponentRanges(self.light_range(label), of_albedo, _channels(color, self.weight[there], np.zeros(3)))

    def light_range(self, label: str) -> Range:
        """Return the range of a component's fraction of the light at normal incidence."""
        number, every = LABELS.index(label), self.albedos.sum(axis=(1, 2))
        low, high = _range(
            self.albedos[:, number].sum(axis=1) / every, self.weight, self.doubtful[number].sum() / every[0]
        )
        return low, min(high, 1.0)

    def surface_spread(self, label: str) -> SurfaceSpread:
        """Return the standard deviations, over all draws, of the logarithms of roughness, F0 and F70.

        The roughness is the one of the brightest surface; F0 and F70 are summed over all surfaces.
        """
        own = [
            [layer for layer, found in zip(one.model.layers, one.labels, strict=True) if found == label]
            for one in self.layers
        ]
        surfaces = [[layer for layer in layers if isinstance(layer, SpecularLayer)] for layers in own]
        there = [number for number, some in enumerate(surfaces) if some]
        if not there:
            return SurfaceSpread(0.0, np.zeros(3), np.zeros(3))
        f0 = np.array([np.sum([layer.f0 for layer in surfaces[number]], axis=0) for number in there])
        f70 = np.array(
            [np.sum([layer.reflectance_at(GRAZING_ANGLE) for layer in surfaces[number]], axis=0) for number in there]
        )
        alpha = np.array([max(surfaces[number], key=lambda layer: sum(layer.f0)).alpha for number in there])
        spread = _POSTERIOR_FACTOR * _deviation(np.log(np.column_stack([alpha, f0, f70])), self.weight[there])
        return SurfaceSpread(float(spread[0]), spread[1:4], spread[4:])


def _deviation(values: Array, weight: Array) -> Array:
    """Return the weighted standard deviation of values (n, m) over n."""
    mean = np.average(values, axis=0, weights=weight)
    return np.asarray(np.sqrt(np.average((values - mean) ** 2, axis=0, weights=weight)))


def _channels(values: Array, weight: Array, doubtful: Array) -> RgbRange:
    red, green, blue = (_range(channel, weight, doubt) for channel, doubt in zip(values.T, doubtful, strict=True))
    return red, green, blue


def _range(values: Array, weight: Array, doubt: float) -> Range:
    """Return the central range of positive values (n,) that contains the fraction `PROBABILITY` of their weight.

    `doubt` is an independent error of the values, which widens the range to both sides of the mean.
    """
    order = np.argsort(values)
    cumulative = np.cumsum(weight[order])
    middle = (cumulative - 0.5 * weight[order]) / cumulative[-1]
    low, high = np.interp([0.5 * (1.0 - PROBABILITY), 0.5 * (1.0 + PROBABILITY)], middle, values[order]).tolist()
    mean = float(np.average(values, weights=weight))
    low, high = mean - np.hypot(max(mean - low, 0.0), doubt), mean + np.hypot(max(high - mean, 0.0), doubt)
    return max(float(low), 0.0), float(high)
