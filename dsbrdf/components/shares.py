"""Fractions of a model's values that belong to the layers of a structure, by the formula of the decomposition."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.components.layers import Layer, LayeredModel, RetroLayer, SpecularLayer
from dsbrdf.components.points import Points
from dsbrdf.model.albedo import half_vector_rule

LABELS = ("specular_spike", "specular_lobe", "diffuse")
"""Components, from narrow to wide."""
SPIKE_HALF_WIDTH = float(np.radians(3.0))
"""Border between the specular spike and the specular lobe [rad of theta_half]."""
HALO = float(np.tan(np.radians(30.0))) ** 2
"""tan(theta_half)**2 up to which most of what the layers miss is the highlight's."""
_TRANSITION = 3  # power of the diffuse part's share with which it takes what the layers miss
_TINY, _LARGEST_RATIO = 1e-300, 1e100


class NormalRule(NamedTuple):
    """Nodes (n,) for the directional albedo at normal incidence, where nothing depends on the azimuth [rad]."""

    angle: Array  # theta_half, which is theta_diff; phi_diff is 0
    weight: Array  # [sr]
    points: Points


def _normal_rule() -> NormalRule:
    rule = half_vector_rule(0.0)
    angle, place = np.unique(rule.theta_half, return_inverse=True)
    weight = np.asarray(np.bincount(place, rule.weight), dtype=np.float64)
    return NormalRule(angle, weight, Points.at(angle, angle, np.zeros(angle.size)))


NORMAL = _normal_rule()


@dataclass(frozen=True, eq=False)
class WeightedLayers:
    """A structure of layers, fitted to a model.

    Attributes
    ----------
    name : str
        The structure in words.
    weight : float
        How probable it is.
    model : LayeredModel
        Its layers.
    is_diffuse : tuple of bool
        Whether the light of each layer counts as diffuse.
    """

    name: str
    weight: float
    model: LayeredModel
    is_diffuse: tuple[bool, ...]

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """The component that each layer belongs to."""
        return tuple(map(_label, self.model.layers, self.is_diffuse))

    def split(self, values: Array, points: Points) -> Array:
        """Divide values (3, N) of a model at points among `LABELS`, shape (3, 3, N)."""
        layers = self.model.layer_values(points)
        place = np.array([LABELS.index(label) for label in self.labels])
        narrow, wide, diffuse = (layers[place == label].sum(axis=0) for label in range(3))
        specular = narrow + wide
        total = specular + diffuse + _TINY
        beyond, missed = (points.squared_tangent / HALO) ** 2, _ratio(values, total) - 1.0
        taken = (diffuse / total) ** _TRANSITION * np.where(missed > 0.0, beyond / (1.0 + beyond), 1.0)
        # A ground alone explains all values, but no highlight: what is much brighter near the mirror direction is one.
        most = 1.0 + missed * taken if (place < 2).any() else 2.0 + beyond
        ground = np.minimum(values, diffuse * most)
        rest = values - ground
        spike = rest * (narrow / (specular + _TINY))
        return np.stack([spike, rest - spike, ground])

    def brightest(self, label: str) -> Layer:
        """The layer of a component that reflects most at normal incidence."""
        own = [number for number, found in enumerate(self.labels) if found == label]
        return self.model.layers[max(own, key=lambda number: float(self._light[number]))]

    def reflectance(self, label: str) -> Array:
        """Reflectance at normal incidence of all surfaces of a component together, shape (3,)."""
        layers = zip(self.model.layers, self.labels, strict=True)
        own = [layer.reflectance for layer, found in layers if found == label and isinstance(layer, SpecularLayer)]
        return np.sum(own, axis=0) if own else np.zeros(3)

    def light_of(self, kind: type[Layer]) -> float:
        """Share of the light at normal incidence that layers of a kind reflect."""
        own = [isinstance(layer, kind) for layer in self.model.layers]
        return float(self._light[own].sum() / self._light.sum())

    @cached_property
    def _light(self) -> Array:
        """What each layer reflects at normal incidence, channels added, shape (layers,)."""
        return np.asarray(np.sum(self.model.layer_values(NORMAL.points) @ NORMAL.weight, axis=1))


def _ratio(values: Array, total: Array) -> Array:
    """Quotient of values and what layers have, bounded: where layers have nothing, or a model is absurdly bright."""
    with np.errstate(over="ignore"):
        return np.minimum(values / total, _LARGEST_RATIO)


def _label(layer: Layer, is_diffuse: bool) -> str:
    if is_diffuse or not isinstance(layer, (SpecularLayer, RetroLayer)):
        return LABELS[2]
    return LABELS[0 if isinstance(layer, SpecularLayer) and layer.half_width < SPIKE_HALF_WIDTH else 1]
