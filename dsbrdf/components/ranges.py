"""Estimate the uncertainty of the components by the spread of their parameters over probable layers.

Layers are drawn from every structure that explains the values, in proportion to its weight. Within a structure, they
are drawn from the Gaussian that the normal equations of its fit define.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.components.layer_fit import EVIDENCE_SCALE, FittedStructure, structure_weights
from dsbrdf.components.layers import SpecularLayer
from dsbrdf.components.shares import LABELS, NORMAL, WeightedLayers
from dsbrdf.model.reflectance import ReflectanceModel

PROBABILITY = 0.9
"""A parameter lies in its range with this probability."""
_POSTERIOR_FACTOR = float(np.sqrt(2.0 / EVIDENCE_SCALE))
"""Standard deviation of the posterior, as a fraction of that of the draws, which `EVIDENCE_SCALE` widens."""
_MIN_DRAWS = 4  # Every structure is drawn at least this number of times.
_N_SHARED_DRAWS = 40  # These further draws are divided among the structures by their weights.

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
        Directional albedo at normal incidence, and the albedo over its largest channel, for each channel.
    """

    light_share: Range
    albedo: RgbRange
    color: RgbRange


class SurfaceSpread(NamedTuple):
    """Hold the standard deviations of the logarithms of a component's roughness and F0 (3,)."""

    alpha: float
    f0: Array


class DrawnLayers(NamedTuple):
    """Hold D draws of a model's layers, their weights (D,), and the albedos (D, 3, 3) of `LABELS` by channel."""

    layers: Sequence[WeightedLayers]
    weight: Array
    albedos: Array

    @classmethod
    def of(cls, model: ReflectanceModel, found: Sequence[FittedStructure]) -> "DrawnLayers":
        """Draw layers from structures fitted to a model, the best first."""
        generator = np.random.default_rng(7)
        values = model.evaluate_unmasked(*NORMAL.angles).T
        drawn = []
        for one, weight in zip(found, structure_weights(found), strict=True):
            count = _MIN_DRAWS + int(_N_SHARED_DRAWS * weight)
            own = (one.model, *one.draw(generator, count))
            is_diffuse, each = one.structure.is_diffuse, float(weight) / len(own)
            drawn += [WeightedLayers(one.structure.name, each, layers, is_diffuse) for layers in own]
        albedos = np.array([one.split(values, NORMAL.points) @ NORMAL.weight for one in drawn])
        return cls(drawn, np.array([one.weight for one in drawn]), albedos)

    def ranges(self, label: str) -> ComponentRanges:
        """Return the ranges of the component with a label."""
        albedo = self.albedos[:, LABELS.index(label)]
        there = albedo.sum(axis=1) > 0.0
        color = albedo[there] / albedo[there].max(axis=1, keepdims=True)
        return ComponentRanges(
            self.light_range(label), _channels(albedo, self.weight), _channels(color, self.weight[there])
        )

    def light_range(self, label: str) -> Range:
        """Return the range of a component's fraction of the light at normal incidence."""
        share = self.albedos[:, LABELS.index(label)].sum(axis=1) / self.albedos.sum(axis=(1, 2))
        return _range(share, self.weight)

    def surface_spread(self, label: str) -> SurfaceSpread:
        """Return the spread of the brightest surface's roughness and of all surfaces' summed F0."""
        own = [
            [layer for layer, found in zip(one.model.layers, one.labels, strict=True) if found == label]
            for one in self.layers
        ]
        surfaces = [[layer for layer in layers if isinstance(layer, SpecularLayer)] for layers in own]
        there = [number for number, some in enumerate(surfaces) if some]
        if not there:
            return SurfaceSpread(0.0, np.zeros(3))
        f0 = np.array([np.sum([layer.f0 for layer in surfaces[number]], axis=0) for number in there])
        alpha = np.array([max(surfaces[number], key=lambda layer: sum(layer.f0)).alpha for number in there])
        spread = _POSTERIOR_FACTOR * _deviation(np.log(np.column_stack([alpha, f0])), self.weight[there])
        return SurfaceSpread(float(spread[0]), spread[1:])


def _deviation(values: Array, weight: Array) -> Array:
    """Return the weighted standard deviation of values (n, m) over n."""
    mean = np.average(values, axis=0, weights=weight)
    return np.asarray(np.sqrt(np.average((values - mean) ** 2, axis=0, weights=weight)))


def _channels(values: Array, weight: Array) -> RgbRange:
    red, green, blue = (_range(channel, weight) for channel in values.T)
    return red, green, blue


def _range(values: Array, weight: Array) -> Range:
    """Return the central range of weighted values (n,) that holds `PROBABILITY` of the weight."""
    order = np.argsort(values)
    cumulative = np.cumsum(weight[order])
    middle = (cumulative - 0.5 * weight[order]) / cumulative[-1]
    low, high = np.interp([0.5 * (1.0 - PROBABILITY), 0.5 * (1.0 + PROBABILITY)], middle, values[order]).tolist()
    return low, high
