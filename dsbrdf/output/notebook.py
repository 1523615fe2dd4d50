"""Show objects of the library in notebooks, as a lit sphere beside a short table."""

from __future__ import annotations

from base64 import b64encode
from dataclasses import asdict
from html import escape

import numpy as np

from dsbrdf.components.component import Component
from dsbrdf.components.decomposition import decompose
from dsbrdf.components.layers import LayeredModel
from dsbrdf.data.measurement import Measurement
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.report_text import lobes_phrase
from dsbrdf.output.sphere_panels import cut_out, encode_png
from dsbrdf.rendering.sphere import displayed, exposure, render_sphere, sphere_normals
from dsbrdf.result import FitReport, FitResult

_THUMBNAIL_SIZE_PX = 96


def html(shown: Measurement | DSBRDF | Component | LayeredModel | FitResult | FitReport) -> str:
    """Return an object as HTML: a lit sphere beside a table, or the metrics and warnings of a report."""
    if isinstance(shown, FitReport):
        return _report_html(shown)
    source, report = (shown.model, [_report_html(shown.report)]) if isinstance(shown, FitResult) else (shown, [])
    return _card(source, _table(_rows(source)), *report)


def _rows(source: Measurement | DSBRDF | Component | LayeredModel) -> dict[str, str]:
    """Return the table that describes an object: a text for each name of a property."""
    if isinstance(source, DSBRDF):
        rows = {"model": f"{lobes_phrase(source)}, {source.n_numbers} numbers"}
        return rows | {part.label.replace("_", " "): _component_phrase(part) for part in decompose(source)}
    if isinstance(source, Component):
        return {source.label.replace("_", " "): _component_phrase(source), "structure": source.structure}
    if isinstance(source, Measurement):
        valid = f"{np.count_nonzero(source.valid) / source.valid.size:.1%}"
        return {"measurement": source.name, "nodes with a value": valid, "sha256": source.sha256[:12]}
    rows = {"layered model": f"{len(source.layers)} layers, {source.n_numbers} numbers"}
    for number, layer in enumerate(source.layers, 1):
        kind = type(layer).__name__.removesuffix("Layer").lower()
        numbers = {name: ", ".join(f"{one:.3g}" for one in np.atleast_1d(value)) for name, value in vars(layer).items()}
        parameters = (f"{name} ({text})" if "," in text else f"{name} {text}" for name, text in numbers.items())
        rows[f"{number}: {kind}"] = ", ".join(parameters)
    return rows


def _component_phrase(component: Component) -> str:
    albedo = ", ".join(f"{value:.4f}" for value in component.albedo)
    width = "" if component.half_width is None else f", half width {np.degrees(component.half_width):.1f}°"
    return f"{component.light_share:.0%} of the light, albedo {albedo}{width}"


def _report_html(report: FitReport) -> str:
    """Return a report as HTML: the metrics that are not None, and the warnings."""
    metrics = {name: f"{value:.4g}" for name, value in asdict(report.metrics).items() if value is not None}
    sentences = "".join(f"<li>{escape(sentence)}</li>" for sentence in report.warnings)
    return _table(metrics) + (f"<ul>{sentences}</ul>" if sentences else "")


def _card(source: DSBRDF | LayeredModel | Component | Measurement, *parts: str) -> str:
    """Return HTML of a lit sphere on a transparent background, with parts to the right of the sphere."""
    sphere, mask = render_sphere(source, size=_THUMBNAIL_SIZE_PX), sphere_normals(_THUMBNAIL_SIZE_PX)[1]
    shown = encode_png(cut_out(displayed(sphere, exposure(sphere, mask))))
    image = (
        f'<img alt="lit sphere" width="{_THUMBNAIL_SIZE_PX}" src="data:image/png;base64,{b64encode(shown).decode()}">'
    )
    beside = "".join(f"<div>{part}</div>" for part in (image, *parts))
    return f'<div style="display: flex; flex-wrap: wrap; gap: 1em; align-items: flex-start">{beside}</div>'


def _table(rows: dict[str, str]) -> str:
    cells = (f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows.items())
    return f"<table>{''.join(cells)}</table>" if rows else ""
