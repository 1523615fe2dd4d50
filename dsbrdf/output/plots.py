"""Draw measurements, models, components and fits, and a fit beside its samples or measurement."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dsbrdf.components.decomposition import Component
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import profiles
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.report import FitResult
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.figures import overview_figure, profiles_figure
from dsbrdf.output.parameter_figures import components_figure, parameters_figure
from dsbrdf.output.sample_figures import samples_figure
from dsbrdf.samples.scattered_samples import ScatteredSamples

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot(
    shown: Measurement | DSBRDF | Component | FitResult, measured: Measurement | ScatteredSamples | None = None
) -> Figure:
    """Draw a measurement, a model, a component or a fit; needs matplotlib.

    Parameters
    ----------
    shown : Measurement, DSBRDF, Component or FitResult
        A measurement is drawn as profiles, which are means over phi_diff, with interpolated curves; a model or a
        component as its values at theta_half = 0 and its directional albedo.
    measured : Measurement or ScatteredSamples, optional
        Data to compare with a model or a fit. For a measurement, the figure has the profiles, the fit and its
        components; for samples, it has the samples, the fit and the residual.

    Raises
    ------
    InvalidArgumentError
        If `shown` has another type, or is a measurement or component although `measured` is given.
    """
    options = shown.report.options if isinstance(shown, FitResult) else FitOptions()
    model = shown.model if isinstance(shown, FitResult) else shown
    if isinstance(model, DSBRDF):
        return parameters_figure(model) if measured is None else plot_fit(model, measured, options)
    if measured is not None:
        raise InvalidArgumentError("only a model or a fit can be drawn together with a measurement")
    if isinstance(model, Component):
        return components_figure([model], "")
    if isinstance(model, Measurement):
        return profiles_figure(profiles(model), model.interpolated, curves="interpolated")
    raise InvalidArgumentError(
        f"a measurement, model, component or fit can be drawn, not an object of type {type(shown).__name__}"
    )


def plot_fit(
    model: DSBRDF, measured: Measurement | ScatteredSamples, options: FitOptions, *, model_lobes: bool = False
) -> Figure:
    """Draw a fit against its data: profiles with components or lobes, or samples with the residual."""
    if isinstance(measured, ScatteredSamples):
        return samples_figure(measured, model)
    data = profiles(measured, horizon_cutoff=options.horizon_cutoff, robust=options.robust)
    return overview_figure(data, model, model_lobes=model_lobes)
