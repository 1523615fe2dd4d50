"""Divide the values of a model among its components by structures of layers, and estimate the uncertainty.

The uncertainty is the spread of the components' parameters over probable layers. Some light may count as specular or as
diffuse, such as the light of fibres, and half of the draws count it on the other side. Layers are drawn from every
structure that explains the model's values, in proportion to the weight of the structure. Within a structure, layers are
drawn from the Gaussian that the normal equations of the structure's fit define, with a width that grows with the
roughness of the widest highlight.

The draws do not cover the difference between the model and the layers, although this light may belong to any component.
At a pair of directions where a component reflects the fraction p of the light of all layers, 4 p (1 - p) of the
difference counts as doubtful: the whole difference if p is one half, and nothing if p is 0 or 1. The doubtful light
widens the ranges of the component, as an independent error.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.components.layer_fit import FittedStructure, structure_weights
from dsbrdf.components.layer_priors import MAX_ALPHA
from dsbrdf.components.layers import GRAZING_ANGLE, DiffuseLayer, Layer, LayeredModel, SheenLayer, SpecularLayer
from dsbrdf.components.points import NORMAL, Points

LABELS = ("specular_spike", "specular_lobe", "diffuse")
"""Labels of the components, from narrow to wide."""
SPIKE_HALF_WIDTH = float(np.radians(3.0))
"""A highlight with a smaller half width is a spike, otherwise a lobe [rad of theta_half]."""
HALO_TAN2 = float(np.tan(np.radians(30.0))) ** 2
"""At smaller tan(theta_half)**2, values above the sum of all layers are mostly assigned to the highlight."""
EXCESS_HALO_TAN2 = HALO_TAN2 / 4.0
"""At smaller tan(theta_half)**2, values below the sum of all layers are mostly subtracted from the highlight."""
_MIN_MISSED = 0.01
"""Layers count as wrong by at least this fraction of the values, because no equation of a layer is exact."""
_DIFFERENCE_POWER = 3
"""Power p in the part f**p of the missed light that layers with the fraction f of all light of the layers receive."""
MIN_LIGHT = 1e-18
"""This value is added to values and to layers, to avoid a division by zero [1/sr]."""


@dataclass(frozen=True, eq=False)
class WeightedLayers:
    """Divide the values of a model among components by a structure of layers fitted to the model.

    Attributes
    ----------
    name : str
        The structure in words.
    weight : float
        Probability of the structure.
    model : LayeredModel
        The fitted layers.
    is_diffuse : tuple of bool
        Whether the light of each layer counts as diffuse.
    """

    name: str
    weight: float
    model: LayeredModel
    is_diffuse: tuple[bool, ...]

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Label of the component that each layer belongs to."""
        return tuple(map(_label, self.model.layers, self.is_diffuse))

    def split(self, values: Array, points: Points) -> Array:
        """Divide values (3, N) of a model at points among the components, (labels, channels, N)."""
        layers = self.model.layer_values(points)
        place = np.array([LABELS.index(label) for label in self.labels])
        narrow, wide, diffuse = (layers[place == label].sum(axis=0) for label in range(3))
        if not (place < 2).any():
            # Even if all layers are diffuse, values far above the layers near the mirror direction are a highlight.
            ground = np.minimum(values, diffuse * (2.0 + (points.squared_tangent / HALO_TAN2) ** 2))
            return np.stack([np.zeros_like(values), values - ground, ground])
        specular = narrow + wide
        missed = values.sum(axis=0) - (specular + diffuse).sum(axis=0)
        halo = np.where(missed > 0.0, HALO_TAN2, EXCESS_HALO_TAN2)
        # A smooth step over the halo of a highlight: 0 at the mirror direction, 1 far outside of the halo.
        outside = 1.0 - 1.0 / (1.0 + (points.squared_tangent / halo) ** 2)
        ground = _divided(values, diffuse, specular, _DIFFERENCE_POWER, _DIFFERENCE_POWER, outside)
        rest = values - ground
        if not (place == 0).any():
            return np.stack([np.zeros_like(rest), rest, ground])
        # The square keeps the lobe smooth below a bright spike; both have their share of a colour that layers miss.
        lobe = _divided(rest, wide, narrow, 2, 0, 1.0)
        return np.stack([rest - lobe, lobe, ground])

    def doubtful(self, values: Array, points: Points, labels: Sequence[str]) -> Array:
        """Return the part of the values that the layers miss and that may belong to layers with labels, (3, N)."""
        layers = self.model.layer_values(points)
        total = layers.sum(axis=0) + MIN_LIGHT
        fraction = layers[[label in labels for label in self.labels]].sum(axis=0) / total
        missed = np.maximum(np.abs(values - total), _MIN_MISSED * values)
        return np.asarray(missed * 4.0 * fraction * (1.0 - fraction))

    def kinds_of(self, label: str) -> set[type[Layer]]:
        """Return the kinds of the layers of a component."""
        layers = zip(self.model.layers, self.labels, strict=True)
        return {type(layer) for layer, found in layers if found == label}

    def light_of(self, kind: type[Layer]) -> float:
        """Return the fraction of all reflected light at normal incidence that layers of one kind reflect."""
        own = [isinstance(layer, kind) for layer in self.model.layers]
        return float(self._light[own].sum() / self._light.sum())

    @cached_property
    def _light(self) -> Array:
        """Albedo of each layer at normal incidence, summed over the channels, shape (layers,)."""
        return np.asarray(np.sum(self.model.layer_values(NORMAL.points) @ NORMAL.weight, axis=1))


def _divided(values: Array, own: Array, other: Array, power: int, color_power: int, weight: Array | float) -> Array:
    """Return the part of values (3, N) that belongs to layers with the values `own` instead of layers with `other`.

    The brightness, the sum over the channels, is divided first: the difference to the layers counts by `weight`. The
    colours follow the layers, so that the colour of a difference does not become the colour of a faint part.
    """
    bright, of_own, of_other = (one.sum(axis=0) + MIN_LIGHT for one in (values, own, other))
    part = np.minimum(bright, _with_missed(bright, of_own, of_other, power, weight))
    own, other = own * (part / of_own), other * ((bright - part) / of_other)
    return np.minimum(values, _with_missed(values, own, other + MIN_LIGHT, color_power, 1.0))


def _with_missed(values: Array, own: Array, other: Array, power: int, weight: Array | float) -> Array:
    """Add to layers with the values `own` what all layers miss, times a power of their fraction of all layers."""
    fraction = own / (own + other)
    return np.asarray(own * (1.0 - weight * fraction**power) + values * weight * fraction ** (power + 1))


def _label(layer: Layer, is_diffuse: bool) -> str:
    if is_diffuse:
        return LABELS[2]
    return LABELS[0 if isinstance(layer, SpecularLayer) and layer.half_width < SPIKE_HALF_WIDTH else 1]


PROBABILITY = 0.9
"""Probability with which a parameter lies in its range."""
RANGE_HALF_WIDTH_SIGMAS = 1.645
"""Within this number of standard deviations are 90 % of a Gaussian."""
_MIN_WEIGHT = 0.01  # A structure of layers with a smaller weight is dropped.
_MIN_DRAWS = 4  # The layers of every structure are drawn at least this number of times.
_N_SHARED_DRAWS = 30  # This number of further draws is divided among structures by weight.
# With the next two numbers, ranges contain the truth of more than 90 % of known materials.
_MIN_SPREAD = 0.2  # Layers with a narrow highlight spread by this fraction of what independent samples give.
_ALPHA_OF_UNIT_SPREAD = 0.3  # Layers of this roughness spread as independent samples do.
_MIN_METAL_REFLECTANCE = 0.2  # A highlight that reflects less, as the mean of all channels, is not from a metal.
_MAX_TAIL_ALBEDO = 0.2  # A ground that reflects a larger fraction of the highlight's reflectance is not a tail.
_MAX_TAIL_COLOR_RATIO = 1.1  # In the channels of a tail, this fraction is equal up to this factor.

Range: TypeAlias = tuple[float, float]
RgbRange: TypeAlias = tuple[Range, Range, Range]


@dataclass(frozen=True)
class ComponentRanges:
    """Ranges (low, high) of a component's light and colour.

    Attributes
    ----------
    light_share : tuple of float
        Fraction of the light that the material reflects at normal incidence.
    albedo, color : tuple of tuple of float
        Directional albedo at normal incidence, and this albedo divided by its largest channel.
    """

    light_share: Range
    albedo: RgbRange
    color: RgbRange


class SurfaceSpread(NamedTuple):
    """Standard deviations of the logarithms of a component's roughness, and of F0 and F70 in each channel."""

    alpha: float
    f0: Array
    f70: Array


class DrawnLayers(NamedTuple):
    """D draws of a model's layers, and the light of each component in `LABELS` at normal incidence.

    Attributes
    ----------
    layers : sequence of WeightedLayers
        The draws.
    weight : Array
        Weights of the draws (D,).
    albedos : Array
        Albedo of each component by channel, (D, 3, 3).
    fitted : sequence of WeightedLayers
        The fitted layers of each structure, around which the layers are drawn.
    values : Array
        Values of the model at the nodes of `NORMAL`, (3, n) [1/sr].
    """

    layers: Sequence[WeightedLayers]
    weight: Array
    albedos: Array
    fitted: Sequence[WeightedLayers]
    values: Array

    @classmethod
    def of(cls, values: Array, found: Sequence[FittedStructure]) -> "DrawnLayers":
        """Draw layers from fitted structures, the best structure first; improbable ones are left out.

        `values` (3, n) are the ones of the model at the nodes of `NORMAL`.
        """
        generator = np.random.default_rng(7)
        found = [one for one in found if not _misses_highlight(one, values)] or found
        usual = _probable([one for one in found if not one.structure.only_in_ranges])
        fitted = [WeightedLayers(one.structure.name, p, one.model, one.structure.is_diffuse) for one, p in usual]
        drawn = []
        for one, weight in _probable(found):
            own = (one.model, *one.draw(generator, _MIN_DRAWS + int(_N_SHARED_DRAWS * weight), _spread(one)))
            sides = (one.structure.name, one.structure.is_diffuse), _other_sides(one)
            drawn += [
                WeightedLayers(name, weight / len(own), layers, is_diffuse)
                for layers, (name, is_diffuse) in zip(own, itertools.cycle(sides))
            ]
        albedos = np.array([one.split(values, NORMAL.points) @ NORMAL.weight for one in drawn])
        return cls(drawn, np.array([one.weight for one in drawn]), albedos, fitted, values)

    @property
    def alternatives(self) -> tuple[str, ...]:
        """Names of structures that are drawn without taking part in the split."""
        fitted = {one.name for one in self.fitted}
        return tuple(dict.fromkeys(one.name for one in self.layers if one.name not in fitted))

    def ranges(self, labels: Sequence[str]) -> ComponentRanges:
        """Return the ranges of the component to which layers with some labels belong."""
        albedo, doubtful = self._albedo(labels), self._doubtful(labels)
        there = albedo.sum(axis=1) > 0.0
        color = albedo[there] / albedo[there].max(axis=1, keepdims=True)
        of_light = self._light_range(albedo, doubtful)
        of_color = _channels(color, self.weight[there], np.zeros(3))
        return ComponentRanges(of_light, _channels(albedo, self.weight, doubtful), of_color)

    def light_range(self, labels: Sequence[str]) -> Range:
        """Return the range of the fraction of the light at normal incidence that layers with some labels reflect."""
        return self._light_range(self._albedo(labels), self._doubtful(labels))

    def _light_range(self, albedo: Array, doubtful: Array) -> Range:
        every = self.albedos.sum(axis=(1, 2))
        low, high = _range(albedo.sum(axis=1) / every, self.weight, float(doubtful.sum() / every[0]))
        return low, min(high, 1.0)

    def _albedo(self, labels: Sequence[str]) -> Array:
        """Return the albedo of layers with some labels in each draw, (D, 3)."""
        return self.albedos[:, [LABELS.index(label) for label in labels]].sum(axis=1)

    def _doubtful(self, labels: Sequence[str]) -> Array:
        """Return the doubtful light of layers with some labels by channel, (3,)."""
        each = [one.weight * one.doubtful(self.values, NORMAL.points, labels) for one in self.fitted]
        return np.asarray(np.sum(each, axis=0) @ NORMAL.weight)

    def surface_spread(self, labels: Sequence[str], ranges: ComponentRanges) -> SurfaceSpread:
        """Return the standard deviations of the logarithms of roughness, F0 and F70 over all draws.

        `ranges` belong to the component. The roughness is the one of the brightest surface; F0 and F70 are summed over
        all surfaces, and the uncertainty of the component's light adds to theirs.
        """
        own = [
            [layer for layer, found in zip(one.model.layers, one.labels, strict=True) if found in labels]
            for one in self.layers
        ]
        surfaces = [[layer for layer in layers if isinstance(layer, SpecularLayer)] for layers in own]
        there = [number for number, some in enumerate(surfaces) if some]
        if not there:
            return SurfaceSpread(0.0, np.zeros(3), np.zeros(3))
        drawn = [surfaces[number] for number in there]
        f0 = np.array([np.sum([layer.f0 for layer in layers], axis=0) for layers in drawn])
        f70 = np.array([np.sum([layer.reflectance_at(GRAZING_ANGLE) for layer in layers], axis=0) for layers in drawn])
        alpha = np.array([max(layers, key=lambda layer: sum(layer.f0)).alpha for layers in drawn])
        logs, weight = np.log(np.column_stack([alpha, f0, f70])), self.weight[there]
        variance = np.average((logs - np.average(logs, axis=0, weights=weight)) ** 2, axis=0, weights=weight)
        spread = np.sqrt(variance)
        light = np.maximum(np.average(self._albedo(labels), axis=0, weights=self.weight), 1e-300)
        most = np.maximum(np.array(ranges.albedo)[:, 1], light)
        doubt = np.log(most / light) / RANGE_HALF_WIDTH_SIGMAS
        return SurfaceSpread(float(spread[0]), np.hypot(spread[1:4], doubt), np.hypot(spread[4:], doubt))


def _probable(found: Sequence[FittedStructure]) -> list[tuple[FittedStructure, float]]:
    """Return fitted structures with their weights, without those of small weight."""
    kept = [one for one, weight in zip(found, structure_weights(found), strict=True) if weight >= _MIN_WEIGHT]
    return list(zip(kept, structure_weights(kept).tolist(), strict=True))


def _other_sides(found: FittedStructure) -> tuple[str, tuple[bool, ...]]:
    """Return another name of a structure, and another answer to whether the light of each layer is diffuse.

    The tail of a metal's highlight has the colour of the metal, so a dim ground of this colour may be such a tail.
    """
    structure, layers = found.structure, found.model.layers
    highlight = sum((one.reflectance for one in layers if isinstance(one, SpecularLayer)), np.zeros(3))
    ground = next((np.array(one.albedo) for one in layers if isinstance(one, DiffuseLayer)), highlight)
    ratio = ground / np.maximum(highlight, 1e-300)
    is_metal = highlight.mean() > _MIN_METAL_REFLECTANCE
    if is_metal and ratio.max() < min(_MAX_TAIL_ALBEDO, _MAX_TAIL_COLOR_RATIO * ratio.min()):
        return "metal with a long tail", (False,) * len(layers)
    return structure.name, structure.other_sides or structure.is_diffuse


def _spread(found: FittedStructure) -> float:
    """Return the factor between the spread of draws and the spread that a structure's normal equations give.

    Errors of layers are alike over the width of a highlight, so a rougher surface has fewer independent samples. Sheen
    is at least as wide as the roughest surface.
    """
    layers = [one for one in found.model.layers if not isinstance(one, DiffuseLayer)]
    widest = max((MAX_ALPHA if isinstance(one, SheenLayer) else one.alpha for one in layers), default=0.0)
    return float(np.hypot(_MIN_SPREAD, widest / _ALPHA_OF_UNIT_SPREAD))


def _misses_highlight(found: FittedStructure, values: Array) -> bool:
    """Tell whether no layer is a surface although most of the values at the nodes of `NORMAL` are a highlight."""
    if not (all(found.structure.is_diffuse) or all(found.structure.other_sides or (False,))):
        return False
    split = WeightedLayers(found.structure.name, 1.0, found.model, found.structure.is_diffuse)
    spike, lobe, diffuse = (split.split(values, NORMAL.points) @ NORMAL.weight).sum(axis=1)
    return bool(spike + lobe > diffuse)


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
