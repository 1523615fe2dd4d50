"""Divide the values of a model among its components, by the layers of a structure that was fitted to the model."""

from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.components.layers import Layer, LayeredModel, SpecularLayer
from dsbrdf.components.points import Points
from dsbrdf.model.albedo import half_vector_rule

LABELS = ("specular_spike", "specular_lobe", "diffuse")
"""Labels of the components, from narrow to wide."""
SPIKE_HALF_WIDTH = float(np.radians(3.0))
"""A highlight with a smaller half width is a spike, otherwise a lobe [rad of theta_half]."""
HALO = float(np.tan(np.radians(30.0))) ** 2
"""At smaller tan(theta_half)**2, values above the sum of all layers are mostly assigned to the highlight."""
EXCESS_HALO = HALO / 4.0
"""At smaller tan(theta_half)**2, values below the sum of all layers are mostly subtracted from the highlight."""
SPIKE_HALO = HALO / 25.0
"""At smaller tan(theta_half)**2, differences between a highlight and its layers are mostly assigned to the spike."""
_DIFFERENCE_POWER = 3
"""Power p in the part f**p of the missed light that layers with the fraction f of all light of the layers receive."""
_N_PANEL_NODES = 4  # With this number of nodes in each panel of a quadrature, its relative error is mostly below 1e-3.
_MIN_LAYER_LIGHT = 1e-300  # This value is added to the sum of the layers, to avoid a division by zero [1/sr].
_MAX_VALUE_RATIO = 1e100  # Larger ratios of model to layers are clipped, so that squared ratios do not overflow.


class LightRule(NamedTuple):
    """Hold the nodes (n,) and weights of a quadrature of the directional albedo at one angle.

    Attributes
    ----------
    angles : tuple of Array
        theta_half, theta_diff and phi_diff (n,) [rad].
    points : Points
        The nodes in the form that layers evaluate.
    weight : Array
        Weights (n,) [sr].
    """

    angles: tuple[Array, Array, Array]
    points: Points
    weight: Array


def _normal_rule() -> LightRule:
    """Return the quadrature at normal incidence, where theta_half = theta_diff and values do not depend on azimuth."""
    rule = half_vector_rule(0.0)
    angle, place = np.unique(rule.theta_half, return_inverse=True)
    weight = np.asarray(np.bincount(place, rule.weight), dtype=np.float64)
    angles = angle, angle, np.zeros(angle.size)
    return LightRule(angles, Points.at(*angles), weight)


def _light_rule(theta_out: float) -> LightRule:
    rule = half_vector_rule(theta_out, n_panel_nodes=_N_PANEL_NODES)
    angles = rule.theta_half, rule.theta_diff, rule.phi_diff
    return LightRule(angles, Points.at(*angles), rule.weight)


NORMAL = _normal_rule()


@cache
def light_rules() -> tuple[LightRule, LightRule, LightRule]:
    """Return the quadratures of the directional albedo at 0, 45 and 70 degrees to the normal."""
    return NORMAL, _light_rule(float(np.radians(45.0))), _light_rule(float(np.radians(70.0)))


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
        specular = narrow + wide + _MIN_LAYER_LIGHT
        total = specular + diffuse
        missed = _ratio(values, total) - 1.0
        outside = _outside(points, np.where(missed > 0.0, HALO, EXCESS_HALO))
        # Even if all layers are diffuse, values far above the layers near the mirror direction are a highlight.
        most = (
            1.0 + missed * outside * (diffuse / total) ** _DIFFERENCE_POWER
            if (place < 2).any()
            else 2.0 + (points.squared_tangent / HALO) ** 2
        )
        ground = np.minimum(values, diffuse * most)
        rest = values - ground
        if not (place == 0).any():
            return np.stack([np.zeros_like(rest), rest, ground])
        missed = (_ratio(rest, specular) - 1.0) * _outside(points, SPIKE_HALO)
        lobe = np.minimum(rest, wide * (1.0 + missed * (wide / specular) ** _DIFFERENCE_POWER))
        return np.stack([rest - lobe, lobe, ground])

    def doubtful(self, values: Array, points: Points) -> Array:
        """Return the part of the values that the layers miss and that may belong to each component, (labels, 3, N)."""
        layers = self.model.layer_values(points)
        place = np.array([LABELS.index(label) for label in self.labels])
        total = layers.sum(axis=0) + _MIN_LAYER_LIGHT
        fraction = np.array([layers[place == number].sum(axis=0) / total for number in range(len(LABELS))])
        return np.asarray(np.abs(values - total) * 4.0 * fraction * (1.0 - fraction))

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


def _outside(points: Points, halo: Array | float) -> Array:
    """Return a smooth step over the halo of a highlight: 0 at the mirror direction, 1 far outside of the halo."""
    return np.asarray(1.0 - 1.0 / (1.0 + (points.squared_tangent / halo) ** 2))


def _ratio(values: Array, total: Array) -> Array:
    """Return the ratio of values to the sum of layers, clipped where the sum is almost 0."""
    with np.errstate(over="ignore"):
        return np.minimum(values / total, _MAX_VALUE_RATIO)


def _label(layer: Layer, is_diffuse: bool) -> str:
    if is_diffuse:
        return LABELS[2]
    return LABELS[0 if isinstance(layer, SpecularLayer) and layer.half_width < SPIKE_HALF_WIDTH else 1]
