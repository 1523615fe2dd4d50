"""Fit two GGX highlights over a Lambertian ground, the model that most renderers have, to compare other models with it.

Each highlight is a specular layer (see `dsbrdf.components.layers`) with the tail exponent 2, height-correlated masking,
and the Fresnel term of glass between F0 in each channel and F90.
"""

from dataclasses import replace

import numpy as np

from dsbrdf.arrays import Evaluate
from dsbrdf.components.layer_data import renderer_data
from dsbrdf.components.layer_fit import fit_structures
from dsbrdf.components.layer_priors import OWN_PRIORS, LayerPrior
from dsbrdf.components.layers import DiffuseLayer, LayeredModel, SpecularLayer
from dsbrdf.components.points import light_rules
from dsbrdf.components.structures import LayerStructure


def _fixed(prior: LayerPrior, unknowns: dict[int, float]) -> LayerPrior:
    """Return a prior in which some unknowns, by their index, have a fixed value."""
    arrays = {name: getattr(prior, name).copy() for name in ("mean", "lower", "upper")}
    for index, value in unknowns.items():
        for array in arrays.values():
            array[index] = value
    return replace(prior, **arrays)


# Unknowns of a surface after its colour and F90: q1, q2, log alpha, log tau, masking and under_coat.
_HIGHLIGHT = _fixed(OWN_PRIORS[SpecularLayer], {4: 0.0, 5: 0.0, 7: float(np.log(2.0)), 8: 0.0, 9: 0.0})
_LAMBERT = _fixed(OWN_PRIORS[DiffuseLayer], dict.fromkeys(range(3, 9), 0.0))
_STARTS_DEG = ((0.15, 12.0), (1.0, 6.0), (1.0, 16.0), (4.0, 16.0), (8.0, 30.0))
_STRUCTURE = LayerStructure("two GGX highlights", (_HIGHLIGHT, _HIGHLIGHT, _LAMBERT), starts=_STARTS_DEG)
N_NUMBERS = 13
"""Number of free parameters: F0 in three channels, F90 and alpha of each highlight, and the colour of the ground."""


def fit_ggx(evaluate: Evaluate) -> LayeredModel:
    """Fit two GGX highlights and a Lambertian ground to the values of a material, weighted by their visibility."""
    data = renderer_data(evaluate, light_rules()[:2])
    return LayeredModel(()) if data is None else fit_structures(data, [_STRUCTURE])[0].model
