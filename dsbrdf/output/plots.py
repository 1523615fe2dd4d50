"""Draw measurements, models, components and fits, a fit beside its samples or measurement, and several materials."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, TypeAlias

from dsbrdf.components.component import Component, Decomposition
from dsbrdf.components.decomposition import decompose
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import profiles
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.report import FitResult
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.reflectance import ReflectanceModel
from dsbrdf.output.figures import materials_figure, overview_figure, profiles_figure
from dsbrdf.output.parameter_figures import components_figure
from dsbrdf.output.sample_figures import samples_figure
from dsbrdf.samples.scattered_samples import ScatteredSamples

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dsbrdf.data.synthetic import Reflectance

Shown: TypeAlias = Measurement | ReflectanceModel | Decomposition | FitResult


def plot(shown: Shown | Mapping[str, Shown], measured: Measurement | ScatteredSamples | None = None) -> Figure:
    """Draw a measurement, a model, components or a fit, or compare several materials; needs matplotlib.

    Parameters
    ----------
    shown : Measurement, DSBRDF, Component, Decomposition, FitResult or another model, or a mapping of names to these
        A measurement is drawn as profiles, which are means over phi_diff, with interpolated curves; a model, its
        components or one of them as values at theta_half = 0 and directional albedo. Of a mapping, and of layers and
        blends, profiles and lit spheres are drawn, with a colour for each name.
    measured : Measurement or ScatteredSamples, optional
        Data to compare with a model or a fit. For a measurement, the figure has the profiles, the fit and its
        components; for samples, it has the samples, the fit and the residual.

    Raises
    ------
    InvalidArgumentError
        If an object has another type, or `measured` is given and `shown` is neither a model nor a fit.
    """
    if isinstance(shown, Mapping):
        return materials_figure({name: _reflectance(one) for name, one in shown.items()})
    options = shown.report.options if isinstance(shown, FitResult) else FitOptions()
    model = shown.model if isinstance(shown, FitResult) else shown
    if measured is not None:
        if not isinstance(measured, Measurement | ScatteredSamples):
            raise InvalidArgumentError('to compare materials, name them: plot({"first": ..., "second": ...})')
        if not isinstance(model, DSBRDF):
            raise InvalidArgumentError("only a model or a fit can be drawn together with a measurement")
        return plot_fit(model, measured, options)
    match model:
        case Measurement():
            return profiles_figure(profiles(model), model.interpolated, curves="interpolated")
        case Component():
            return components_figure([model], "")
        case DSBRDF() | Decomposition():
            return components_figure(decompose(model) if isinstance(model, DSBRDF) else model, "")
    return materials_figure({type(model).__name__: _reflectance(model)})


def _reflectance(shown: Shown) -> Reflectance:
    """Return an object whose values can be evaluated at all angles."""
    match shown:
        case Measurement():
            return shown.interpolated
        case FitResult() | Decomposition():
            return shown.model
        case ReflectanceModel():
            return shown
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
