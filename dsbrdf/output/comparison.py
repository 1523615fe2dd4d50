"""Compare models and functions with one measurement, by the metrics of a fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal, TypeAlias

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.components.ggx import fit_ggx
from dsbrdf.data.geometry import DEFAULT_HORIZON_CUTOFF, half_difference
from dsbrdf.data.measurement import Measurement
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.metrics import ALBEDO_ANGLES, Metrics, sample_errors, sample_metrics
from dsbrdf.model.reflectance import FunctionModel, RenderableModel
from dsbrdf.result import FitResult

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
