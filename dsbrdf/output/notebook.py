"""How objects show themselves in a notebook: a lit sphere beside a few lines, and figures.

Wings to the left call this module, and no other of this wing, from the methods `_repr_html_` and `plot`.
"""

from __future__ import annotations

from base64 import b64encode
from dataclasses import asdict
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import profiles
from dsbrdf.data.scattered_samples import ScatteredSamples
from dsbrdf.fitting.decomposition import decompose
from dsbrdf.model.image_metrics import displayed, exposure
from dsbrdf.model.render import render_sphere, sphere_normals
from dsbrdf.output.figures import overview_figure, profiles_figure
from dsbrdf.output.parameter_figures import components_figure, parameters_figure
from dsbrdf.output.report_text import lobes_phrase
from dsbrdf.output.sample_figures import samples_figure
from dsbrdf.output.sphere_panels import cut_out, encode_png

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from dsbrdf.fitting.decomposition import Component
    from dsbrdf.fitting.options import FitOptions
    from dsbrdf.fitting.report import FitReport, FitResult
    from dsbrdf.model.dsbrdf import DSBRDF
    from dsbrdf.model.layers import LayeredModel

_THUMBNAIL = 96  # pixels


def plot_model(model: DSBRDF) -> Figure:
    """Draw the height and the directional albedo of the components."""
    return parameters_figure(model)


def plot_measurement(measurement: Measurement) -> Figure:
    """Draw a measurement's means over phi_diff, and what is interpolated between them."""
    return profiles_figure(profiles(measurement), measurement.interpolated, curves="interpolated")


def plot_component(component: Component) -> Figure:
    """Draw the height and the directional albedo of one component."""
    return components_figure([component], "")


def plot_result(result: FitResult, measured: Measurement | ScatteredSamples | None) -> Figure:
    """Draw what was measured and the fit; without it, the components' parameters."""
    return plot_model(result.model) if measured is None else plot_fit(result.model, measured, result.report.options)


def plot_fit(
    model: DSBRDF, measured: Measurement | ScatteredSamples, options: FitOptions, *, model_lobes: bool = False
) -> Figure:
    """Draw profiles, the fit with these options and its components, or lobes; or samples, the fit and the residual."""
    if isinstance(measured, ScatteredSamples):
        fitted = measured.with_options(options)
        return samples_figure(fitted, model)
    data = profiles(measured, horizon_cutoff=options.horizon_cutoff, robust=options.robust)
    return overview_figure(data, model, model_lobes=model_lobes)


def measurement_html(measurement: Measurement) -> str:
    """Return a lit sphere of a measurement beside its name and the share of nodes with a value."""
    share = np.count_nonzero(measurement.valid) / measurement.valid.size
    rows = {"measurement": measurement.name, "nodes with a value": f"{share:.1%}", "sha256": measurement.sha256[:12]}
    return _card(measurement, _table(rows))


def model_html(model: DSBRDF) -> str:
    """Return a lit sphere of a model beside the light, albedo and half width of its components."""
    return _card(model, _model_table(model))


def component_html(component: Component) -> str:
    """Return a lit sphere of a component beside its light, albedo and half width, and the structure it is from."""
    rows = {component.label.replace("_", " "): _component_phrase(component), "structure": component.structure}
    return _card(component, _table(rows))


def layers_html(model: LayeredModel) -> str:
    """Return a lit sphere of a layered model beside the parameters of its layers."""
    rows = {"layered model": f"{len(model.layers)} layers, {model.n_numbers} numbers"}
    for number, layer in enumerate(model.layers, 1):
        parameters = (f"{name} {_rounded(value)}" for name, value in asdict(layer).items())
        rows[f"{number}: {type(layer).__name__.removesuffix('Layer').lower()}"] = ", ".join(parameters)
    return _card(model, _table(rows))


def _rounded(value: float | Sequence[float]) -> str:
    return f"{value:.3g}" if isinstance(value, float) else f"({', '.join(f'{one:.3g}' for one in value)})"


def result_html(result: FitResult) -> str:
    """Return a lit sphere of the model beside its components, the metrics and the warnings."""
    return _card(result.model, _model_table(result.model), report_html(result.report))


def report_html(report: FitReport) -> str:
    """Return the metrics that have a value and the warnings."""
    metrics = {name: f"{value:.4g}" for name, value in asdict(report.metrics).items() if value is not None}
    sentences = "".join(f"<li>{escape(sentence)}</li>" for sentence in report.warnings)
    return _table(metrics) + (f"<ul>{sentences}</ul>" if sentences else "")


def _model_table(model: DSBRDF) -> str:
    rows = {"model": f"{lobes_phrase(model)}, {model.n_numbers} numbers"}
    for component in decompose(model):
        rows[component.label.replace("_", " ")] = _component_phrase(component)
    return _table(rows)


def _component_phrase(component: Component) -> str:
    albedo = ", ".join(f"{value:.4f}" for value in component.albedo)
    width = "" if component.half_width is None else f", half width {np.degrees(component.half_width):.1f}°"
    return f"{component.light_share:.0%} of the light, albedo {albedo}{width}"


def _card(source: DSBRDF | LayeredModel | Component | Measurement, *parts: str) -> str:
    """Return a sphere, with nothing drawn around it, and parts to its right."""
    sphere, mask = render_sphere(source, size=_THUMBNAIL), sphere_normals(_THUMBNAIL)[1]
    shown = encode_png(cut_out(displayed(sphere, exposure(sphere, mask))))
    image = f'<img alt="lit sphere" width="{_THUMBNAIL}" src="data:image/png;base64,{b64encode(shown).decode()}">'
    beside = "".join(f"<div>{part}</div>" for part in (image, *parts))
    return f'<div style="display: flex; flex-wrap: wrap; gap: 1em; align-items: flex-start">{beside}</div>'


def _table(rows: dict[str, str]) -> str:
    cells = (f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows.items())
    return f"<table>{''.join(cells)}</table>" if rows else ""
