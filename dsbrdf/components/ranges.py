"""How uncertain the components are: the spread of their figures over probable layers.

Layers are drawn from every structure that explains the values, by its weight, and within a structure from the normal
equations of its fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.components.layer_fit import FittedStructure, structure_weights
from dsbrdf.components.layers import SpecularLayer
from dsbrdf.components.shares import LABELS, NORMAL, WeightedLayers
from dsbrdf.model.dsbrdf import DSBRDF

PROBABILITY = 0.9
"""With which a figure lies in its range."""
_DRAWS = 24  # from each structure


@dataclass(frozen=True)
class ComponentRanges:
    """Ranges (low, high) of a component's figures; None for those that it does not have.

    Attributes
    ----------
    light_share, half_width, alpha : tuple of float
        Of the share of all light at normal incidence, the half width [rad] and the roughness of the brightest layer.
    albedo, color, f0 : tuple of tuple of float
        For each channel: of the directional albedo at normal incidence, of the albedo over its largest channel, and of
        the reflectance of the component's surfaces at normal incidence.
    """

    light_share: tuple[float, float]
    albedo: tuple[tuple[float, float], ...]
    color: tuple[tuple[float, float], ...]
    half_width: tuple[float, float] | None = None
    alpha: tuple[float, float] | None = None
    f0: tuple[tuple[float, float], ...] | None = None


def component_ranges(
    model: DSBRDF, found: Sequence[FittedStructure], labels: Sequence[str]
) -> tuple[ComponentRanges, ...]:
    """Ranges of the components with these labels, from structures fitted to a model, the best first."""
    generator = np.random.default_rng(7)
    values = model.evaluate_unmasked(NORMAL.angle, NORMAL.angle, np.zeros(NORMAL.angle.size)).T
    drawn = [
        WeightedLayers(one.structure.name, float(weight), layers, one.structure.is_diffuse)
        for one, weight in zip(found, structure_weights(found), strict=True)
        for layers in (one.model, *one.draw(generator, _DRAWS))
    ]
    albedos = np.array([one.split(values, NORMAL.points) @ NORMAL.weight for one in drawn])  # (draws, labels, channels)
    weight = np.array([one.weight for one in drawn])
    shares = albedos.sum(axis=2) / albedos.sum(axis=(1, 2))[:, np.newaxis]
    return tuple(_of_component(label, drawn, weight, albedos, shares) for label in labels)


def _of_component(
    label: str, drawn: Sequence[WeightedLayers], weight: Array, albedos: Array, shares: Array
) -> ComponentRanges:
    place = LABELS.index(label)
    albedo, share = albedos[:, place], shares[:, place]
    there = share > 0.0
    color = albedo[there] / albedo[there].max(axis=1, keepdims=True)
    common = _range(share, weight), _channels(albedo, weight), _channels(color, weight[there])
    layers = [one.brightest(label) if label in one.labels and label != "diffuse" else None for one in drawn]
    specular = [(one, layer) for one, layer in zip(drawn, layers, strict=True) if isinstance(layer, SpecularLayer)]
    if not specular:
        return ComponentRanges(*common)
    own = np.array([one.weight for one, _ in specular])
    return ComponentRanges(
        *common,
        half_width=_range(np.array([layer.half_width for _, layer in specular]), own),
        alpha=_range(np.array([layer.alpha for _, layer in specular]), own),
        f0=_channels(np.array([one.reflectance(label) for one, _ in specular]), own),
    )


def _channels(values: Array, weight: Array) -> tuple[tuple[float, float], ...]:
    return tuple(_range(channel, weight) for channel in values.T)


def _range(values: Array, weight: Array) -> tuple[float, float]:
    """The middle range of values (n,) with weights (n,) that has the stated probability."""
    order = np.argsort(values)
    cumulative = np.cumsum(weight[order])
    middle = (cumulative - 0.5 * weight[order]) / cumulative[-1]
    low, high = np.interp([0.5 * (1.0 - PROBABILITY), 0.5 * (1.0 + PROBABILITY)], middle, values[order]).tolist()
    return low, high
