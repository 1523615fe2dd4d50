"""Divide a model into specular spike, specular lobe and diffuse part, and describe each component by parameters.

The lobes of an accurate model overlap, so no lobe is a component by itself. Instead, several structures of physical
layers are fitted to the model's values and weighted by their evidence (`dsbrdf.components.layer_fit`). Each structure
divides the model's values among the components (`dsbrdf.components.shares`). A component is the weighted mean over the
structures: components sum to the model, and no component is negative. A component that reflects too little light is
left out.

Afterwards, layers are fitted to the values of each component (`dsbrdf.components.description`), and the parameters of
these layers describe the component.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Protocol

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.components.component import MIN_COMPONENT_LIGHT, MIN_LIGHT_OF_UNLIKELY_COMPONENT, Decomposition
from dsbrdf.components.description import Description, describe
from dsbrdf.components.layer_data import grid_values, material_data
from dsbrdf.components.layer_fit import fit_structures
from dsbrdf.components.layers import RetroLayer
from dsbrdf.components.points import LightRule, light_rules
from dsbrdf.components.shares import LABELS, SPIKE_HALF_WIDTH, DrawnLayers, WeightedLayers
from dsbrdf.components.structures import RARE_STRUCTURES, STRUCTURES
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.reflectance import ReflectanceModel
from dsbrdf.process_settings import one_blas_thread

_LIKELY_WEIGHT = 0.5
"""A component is likely if the weights of the structures with this component have a larger sum."""

_MIN_WIDTH_RATIO = 1.7  # Two highlights with a smaller ratio of half widths are one component.


class Fitted(Protocol):
    """Declare what `decompose` reads of the result of `dsbrdf.fit`."""

    @property
    def model(self) -> DSBRDF: ...  # noqa: D102
    @property
    def is_clipped(self) -> bool: ...  # noqa: D102


def decompose(model: DSBRDF | Fitted) -> Decomposition:
    """Separate a model into specular spike, specular lobe and diffuse part.

    Parameters
    ----------
    model : DSBRDF or FitResult
        Any model: fitted, loaded, or fitted by the paper's method. With the result of a fit to a clipped highlight, the
        components have no widths, alpha and F0.

    Returns
    -------
    Decomposition
        Components that sum to the model; results of the last 32 models are cached.

    Raises
    ------
    InvalidArgumentError
        If `model` is not a model.
    """
    fitted = getattr(model, "model", model)
    if not isinstance(fitted, ReflectanceModel):
        kind = type(model).__name__
        raise InvalidArgumentError(f"only a model can be decomposed, such as the result of dsbrdf.fit, not a {kind}")
    parts = _decompose(fitted)
    if not getattr(model, "is_clipped", False):
        return parts
    return replace(parts, descriptions=tuple(one.without_highlight() for one in parts.descriptions))


@lru_cache(maxsize=32)
@one_blas_thread
def _decompose(model: DSBRDF) -> Decomposition:
    on_grid = grid_values(model.evaluate_unmasked)
    data = material_data(on_grid)
    if data is None:
        return Decomposition(model, (), (), (), (), (0.0, 0.0), ())
    found = fit_structures(data, (*STRUCTURES, *RARE_STRUCTURES), quick=True)
    at_rules = [model.evaluate_unmasked(*rule.angles).T for rule in light_rules()]
    drawn = DrawnLayers.of(at_rules[0], found)
    reflected = [_reflected(*pair, drawn.fitted) for pair in zip(at_rules, light_rules(), strict=True)]
    light = np.max([one.sum(axis=1) / max(float(one.sum()), 1e-300) for one in reflected], axis=0)
    shares = dict(zip(LABELS, light.tolist(), strict=True))
    labels = tuple(label for label in LABELS if _is_there(label, shares[label], drawn.fitted))
    # If no component reflects enough light, the last layer of the best structure gives the label of a single component.
    split = _described(model, drawn, labels or (drawn.fitted[0].labels[-1],), on_grid, reflected)
    if _are_one_highlight(split.descriptions[: -1 if LABELS[2] in split.labels else None]):
        split = _described(model, drawn, split.labels[1:], on_grid, reflected)
    return _labelled_by_width(split)


def _described(
    model: DSBRDF, drawn: DrawnLayers, labels: tuple[str, ...], on_grid: Array, reflected: Sequence[Array]
) -> Decomposition:
    """Divide a model among components with labels, and describe each component."""
    diffuse_range, structures = drawn.light_range(LABELS[2:]), tuple(drawn.fitted)
    split = Decomposition(model, structures, labels, (), (), diffuse_range, drawn.alternatives)
    ranges = tuple(drawn.ranges(split.received(label)) for label in labels)
    descriptions = (
        describe(
            own,
            drawn.surface_spread(split.received(label), own_ranges),
            is_diffuse=label == LABELS[2],
            has_retro=any(RetroLayer in one.kinds_of(label) for one in drawn.fitted),
            has_ground=LABELS[2] not in labels,
        )
        for label, own, own_ranges in zip(labels, split.own_values(on_grid, reflected), ranges, strict=True)
    )
    return replace(split, ranges=ranges, descriptions=tuple(descriptions))


def _are_one_highlight(highlights: Sequence[Description]) -> bool:
    """Tell whether two highlights are one: the lobe is hardly wider than the spike, or both are spikes or lobes."""
    widths = [one.surface_half_width for one in highlights if one.surface_half_width is not None]
    if len(widths) < 2:
        return False
    spike, lobe = widths
    return lobe < _MIN_WIDTH_RATIO * spike or (spike < SPIKE_HALF_WIDTH) == (lobe < SPIKE_HALF_WIDTH)


def _labelled_by_width(split: Decomposition) -> Decomposition:
    """Return a decomposition in which the label of a single highlight follows the half width of the highlight."""
    labels = [label for label in split.labels if label != LABELS[2]]
    width = split.descriptions[0].surface_half_width
    if len(labels) != 1 or width is None:
        return split
    return replace(split, labels=(LABELS[0 if width < SPIKE_HALF_WIDTH else 1], *split.labels[1:]))


def _is_there(label: str, share: float, structures: Sequence[WeightedLayers]) -> bool:
    """Tell whether a component reflects enough light to be kept; an unlikely component must reflect more light."""
    probability = sum(structure.weight for structure in structures if label in structure.labels)
    least = MIN_COMPONENT_LIGHT if probability > _LIKELY_WEIGHT else MIN_LIGHT_OF_UNLIKELY_COMPONENT
    return probability > 0.0 and share > least


def _reflected(values: Array, rule: LightRule, structures: Sequence[WeightedLayers]) -> Array:
    """Return the albedo (labels, channels) that each label has of values (3, n) at the nodes of a quadrature."""
    parts = np.sum([one.weight * one.split(values, rule.points) for one in structures], axis=0)
    return np.asarray(parts @ rule.weight)
