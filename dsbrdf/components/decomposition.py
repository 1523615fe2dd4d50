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

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.components.component import MIN_COMPONENT_LIGHT, MIN_LIGHT_OF_UNLIKELY_COMPONENT, Decomposition
from dsbrdf.components.description import describe
from dsbrdf.components.layer_data import grid_values, material_data
from dsbrdf.components.layer_fit import fit_structures, structure_weights
from dsbrdf.components.layers import RetroLayer
from dsbrdf.components.shares import LABELS, DrawnLayers, LightRule, WeightedLayers, light_rules
from dsbrdf.components.structures import RARE_STRUCTURES, STRUCTURES
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.reflectance import ReflectanceModel
from dsbrdf.process_settings import one_blas_thread

if TYPE_CHECKING:
    from dsbrdf.fitting.report import FitResult

_MIN_WEIGHT = 0.01  # A structure of layers with a smaller weight is dropped.
_LIKELY_WEIGHT = 0.5
"""A component is likely if the weights of the structures with this component have a larger sum."""


def decompose(model: DSBRDF | FitResult) -> Decomposition:
    """Separate a model into specular spike, specular lobe and diffuse part.

    Parameters
    ----------
    model : DSBRDF or FitResult
        Any model: fitted, loaded, or fitted by the paper's method.

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
    return _decompose(fitted)


@lru_cache(maxsize=32)
@one_blas_thread
def _decompose(model: DSBRDF) -> Decomposition:
    data = material_data(grid_values(model))
    if data is None:
        return Decomposition(model, (), (), (), (), (0.0, 0.0))
    found = fit_structures(data, (*STRUCTURES, *RARE_STRUCTURES), quick=True)
    kept = [one for one, weight in zip(found, structure_weights(found), strict=True) if weight >= _MIN_WEIGHT]
    structures = tuple(
        WeightedLayers(one.structure.name, float(weight), one.model, one.structure.is_diffuse)
        for one, weight in zip(kept, structure_weights(kept), strict=True)
    )
    reflected = [_reflected(model, structures, rule) for rule in light_rules()]
    light = np.max([one.sum(axis=1) / max(float(one.sum()), 1e-300) for one in reflected], axis=0)
    shares = dict(zip(LABELS, light.tolist(), strict=True))
    labels = tuple(label for label in LABELS if _is_there(label, shares[label], structures))
    # If no component reflects enough light, the last layer of the best structure gives the label of a single component.
    labels = labels or (structures[0].labels[-1],)
    drawn = DrawnLayers.of(model, kept)
    split = Decomposition(model, structures, labels, tuple(map(drawn.ranges, labels)), (), drawn.light_range(LABELS[2]))
    descriptions = tuple(
        describe(
            own,
            drawn.surface_spread(label),
            is_diffuse=label == LABELS[2],
            has_retro=any(RetroLayer in one.kinds_of(label) for one in structures),
            has_ground=LABELS[2] not in labels,
        )
        for label, own in zip(labels, split.own_values(reflected), strict=True)
    )
    return replace(split, descriptions=descriptions)


def _is_there(label: str, share: float, structures: tuple[WeightedLayers, ...]) -> bool:
    """Tell whether a component reflects enough light to be kept; an unlikely component must reflect more light."""
    probability = sum(structure.weight for structure in structures if label in structure.labels)
    least = MIN_COMPONENT_LIGHT if probability > _LIKELY_WEIGHT else MIN_LIGHT_OF_UNLIKELY_COMPONENT
    return probability > 0.0 and share > least


def _reflected(model: DSBRDF, structures: tuple[WeightedLayers, ...], rule: LightRule) -> Array:
    """Return the directional albedo of each label at the angle of a quadrature, (labels, channels)."""
    values = model.evaluate_unmasked(*rule.angles).T
    parts = np.sum([one.weight * one.split(values, rule.points) for one in structures], axis=0)
    return np.asarray(parts @ rule.weight)
