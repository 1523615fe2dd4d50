"""Compare models and functions with one measurement, by the metrics of a fit, and with two fitted GGX highlights.

Two GGX highlights over a Lambertian ground are the model that most renderers have. Each highlight is a specular layer
(see `dsbrdf.components.layers`) with the tail exponent 2, height-correlated masking, and the Fresnel term of glass
between F0 in each channel and F90.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Literal, TypeAlias

import numpy as np

from dsbrdf.arrays import Array, Evaluate
from dsbrdf.components.layer_data import renderer_data
from dsbrdf.components.layer_fit import fit_structures
from dsbrdf.components.layer_priors import OWN_PRIORS, LayerPrior
from dsbrdf.components.layers import DiffuseLayer, LayeredModel, SpecularLayer
from dsbrdf.components.points import light_rules
from dsbrdf.components.structures import LayerStructure
from dsbrdf.data.geometry import DEFAULT_HORIZON_CUTOFF, half_difference
from dsbrdf.data.measurement import Measurement
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.metrics import ALBEDO_ANGLES, Metrics, sample_errors, sample_metrics
from dsbrdf.model.reflectance import FunctionModel, RenderableModel
from dsbrdf.result import FitResult


def _fixed(prior: LayerPrior, unknowns: dict[int, float]) -> LayerPrior:
    """Return a prior in which some unknowns, by their index, have a fixed value."""
    arrays = {name: getattr(prior, name).copy() for name in ("mean", "lower", "upper")}
    for index, value in unknowns.items():
        for array in arrays.values():
            array[index] = value
    return replace(prior, **arrays)


# Unknowns of a surface after its colour and F90: m, q1, q2, log alpha, log tau, masking, under_coat and refraction.
_HIGHLIGHT = _fixed(
    OWN_PRIORS[SpecularLayer], {4: 0.0, 5: 0.0, 6: 0.0, 8: float(np.log(2.0)), 9: 0.0, 10: 0.0, 11: 0.0}
)
_LAMBERT = _fixed(OWN_PRIORS[DiffuseLayer], dict.fromkeys(range(3, 9), 0.0))
_STARTS_DEG = ((0.15, 12.0), (1.0, 6.0), (1.0, 16.0), (4.0, 16.0), (8.0, 30.0))
_STRUCTURE = LayerStructure("two GGX highlights", (_HIGHLIGHT, _HIGHLIGHT, _LAMBERT), starts=_STARTS_DEG)
N_NUMBERS = 13
"""Number of free parameters: F0 in three channels, F90 and alpha of each highlight, and the colour of the ground."""


def fit_ggx(evaluate: Evaluate) -> LayeredModel:
    """Fit two GGX highlights and a Lambertian ground to the values of a material, weighted by their visibility."""
    data = renderer_data(evaluate, light_rules()[:2])
    return LayeredModel(()) if data is None else fit_structures(data, [_STRUCTURE])[0].model


Compared: TypeAlias = RenderableModel | FitResult | Measurement | Callable[[Array, Array], Any] | Literal["ggx"]


def compare(measurement: Measurement, others: Mapping[str, Compared]) -> dict[str, Metrics]:
    """Return the errors of models, fits or functions relative to a measurement.

    Parameters
    ----------
    measurement : Measurement
    others : mapping of names to models, fits, measurements, functions or ``"ggx"``
        A function takes omega_in and omega_out, unit vectors (n, 3) above the horizon, and returns values (n, 3)
        [1/sr], see `dsbrdf.FunctionModel`. ``"ggx"`` stands for two GGX highlights over a Lambertian ground, which are
        fitted to the measurement.

    Returns
    -------
    dict of Metrics
        The metrics of each by its name; directions up to 80 degrees from the normal count.

    Raises
    ------
    InvalidArgumentError
        If something is not one of these, a function returns another shape, or the measurement has zeros only.
    """
    return {name: _metrics(as_model(other, measurement), measurement) for name, other in others.items()}


def as_model(compared: Compared, measurement: Measurement) -> RenderableModel:
    """Return what is compared as a model; ``"ggx"`` is fitted to the measurement."""
    if isinstance(compared, FitResult):
        return compared.model
    if isinstance(compared, RenderableModel):
        return compared
    if isinstance(compared, Measurement):
        evaluate = compared.interpolated.evaluate
        return FunctionModel(lambda first, second: evaluate(*half_difference(first, second)))
    if compared == "ggx":
        return fit_ggx(measurement.interpolated.evaluate)
    if callable(compared):
        return FunctionModel(compared)
    raise InvalidArgumentError(
        f'a model, a fit, a measurement, a function or "ggx" can be compared, not an object of type '
        f"{type(compared).__name__}"
    )


def _metrics(model: RenderableModel, measurement: Measurement) -> Metrics:
    sums = sample_errors(model, measurement, DEFAULT_HORIZON_CUTOFF)
    return sample_metrics(model, measurement, sums, np.asarray(model.albedo(ALBEDO_ANGLES)))
