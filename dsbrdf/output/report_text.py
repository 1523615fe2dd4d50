"""The result of a fit as text and as JSON: metrics, lobes and components.

The JSON has the same form as in the HTTP service.  Angles are in degrees, because this is for display and for HTTP; the
rest of the library uses radians.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dsbrdf.data.grid import CHANNELS
from dsbrdf.fitting.metrics import Metrics, RelativeErrors
from dsbrdf.fitting.report import FitReport, FitResult
from dsbrdf.model.decomposition import Component, decompose, lobe_widths
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.serialize import to_json

SHOWN_THETA_DIFF = (0.0, 30.0, 60.0, 75.0)
"""theta_diff of the parameters that are printed [degrees]."""


def metrics_line(metrics: Metrics) -> str:
    """Return one line with the metrics that have a value."""
    return ", ".join(f"{name} {value:.4g}" for name, value in asdict(metrics).items() if value is not None)


def components_table(components: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return a table with a line for each component: lobes, half width, albedo and margin."""
    lines = [f"{'component':<16}{'lobes':<9}{'half width':>10}   {'albedo red, green, blue':<24}{'margin':>8}"]
    for component in components:
        lobes = ", ".join(str(lobe) for lobe in component["lobes"]) or "none"
        width = "" if component["half_width_deg"] is None else f"{component['half_width_deg']:.2f}°"
        albedo = "  ".join(f"{round(value, 4) + 0.0:.4f}" for value in component["albedo"])  # never -0.0000
        margin = "" if component["margin"] is None else f"{component['margin']:.2f}"
        lines.append(f"{component['label']:<16}{lobes:<9}{width:>10}   {albedo:<24}{margin:>8}".rstrip())
    return lines


def parameters_table(
    model: DSBRDF, *, channel: str = "red", theta_diff_deg: Sequence[float] = SHOWN_THETA_DIFF
) -> list[str]:
    """Return a table of the parameters of one channel, with center and elongation where they are not 0."""
    parameters = model.parameters_at(np.radians(theta_diff_deg))
    column = CHANNELS.index(channel)
    shape_column = column if model.kappa.shape[0] == 3 else 0
    head = "".join(f"{angle:>10.0f}°" for angle in theta_diff_deg)
    lines = [f"{f'{channel} channel, theta_diff':<34}{head}"]
    for lobe, width in enumerate(np.degrees(lobe_widths(model))):
        rows = [("amplitude", parameters["amplitude"][:, column, lobe])]
        rows += [(name, parameters[name][:, shape_column, lobe]) for name in ("kappa", "gamma")]
        if model.is_ring[lobe]:
            rows.append(("center", np.degrees(parameters["center"][:, shape_column, lobe])))
        if model.elongation[:, lobe].any():
            rows.append(("elongation", parameters["elongation"][:, lobe]))
        lead = f"{'ring lobe' if model.is_ring[lobe] else 'lobe'} {lobe}, {width:.2f}°"
        for name, values in rows:
            cells = "".join(f"{value:>10.4g}{'°' if name == 'center' else ' '}" for value in values)
            lines.append(f"{lead:<22}{name:<12}{cells}".rstrip())
            lead = ""
    return lines


def lobes_phrase(model: DSBRDF) -> str:
    """Return the numbers of lobes and ring lobes in words, such as ``3 lobes + 1 ring lobe``."""
    rings = int(np.count_nonzero(model.is_ring))
    centered = model.n_lobes - rings
    words = f"{centered} {'lobe' if centered == 1 else 'lobes'}"
    return words if rings == 0 else f"{words} + {rings} {'ring lobe' if rings == 1 else 'ring lobes'}"


def growth_table(report: FitReport) -> list[str]:
    """Return a table of the lobes that were tried, one after the other; empty if the fit did not search for them.

    The error is the weighted squared error on samples that no lobe was fitted to, as a share of their squared signal.
    """
    lines = [f"{'lobes tried':<14}{'ring lobes':>10}{'error held out':>18}"] if report.growth else []
    for step in report.growth:
        verdict = "kept" if step.pays else "does not pay"
        lines.append(f"{step.n_lobes:<14}{step.ring_lobes:>10}{step.error:>18.3g}   {verdict}")
    return lines


def selection_table(report: FitReport) -> list[str]:
    """Return a table of the numbers of lobes that Williams' test compared; empty if the number was not chosen so."""
    lines = [f"{'lobes':<14}{'E_p':>10}{'squared error':>16}{'t':>10}{'critical':>10}"] if report.selection else []
    for step in report.selection:
        t, critical = ("" if value is None else f"{value:.3f}" for value in (step.t, step.critical_value))
        verdict = "   worse" if step.significant else ""
        cells = f"{step.n_lobes:<14}{step.e_p:>10.4f}{step.squared_error:>16.4g}{t:>10}{critical:>10}"
        lines.append(f"{cells}{verdict}".rstrip())
    return lines


def bands_table(report: FitReport) -> list[str]:
    """Return a table of the errors of each channel and of each band of theta_diff with data."""
    rows: list[tuple[str, RelativeErrors]] = [(f"{row.channel} channel", row) for row in report.by_channel]
    for band in report.by_theta_diff:
        low, high = np.degrees(band.theta_diff)
        rows.append((f"theta_diff {low:.0f}° to {high:.0f}°", band))
    lines = [f"{'error':<24}{'relative_rms':>14}{'floor':>10}{'excess':>10}"] if rows else []
    for name, errors in rows:
        excess = "" if errors.excess is None else f"{errors.excess:.3f}"
        lines.append(f"{name:<24}{errors.relative_rms:>14.4f}{errors.floor:>10.4f}{excess:>10}".rstrip())
    return lines


def model_text(model: DSBRDF, *, channel: str = "red") -> list[str]:
    """Return the components of a model and the parameters of one channel."""
    return [*components_table(component_documents(model)), "", *parameters_table(model, channel=channel)]


def result_text(file: Path, result: FitResult) -> list[str]:
    """Return the report of one fit: metrics, warnings, components, parameters, lobes tried, errors."""
    warnings = [f"warning: {sentence}" for sentence in result.report.warnings]
    lines = [headline(file, result), *warnings, "", *model_text(result.model)]
    for table in (growth_table(result.report), selection_table(result.report), bands_table(result.report)):
        lines += ["", *table] if table else []
    return [*lines, ""]


def headline(file: Path, result: FitResult) -> str:
    """Return one line with the file, the number of lobes, the metrics and the time."""
    seconds = sum(result.report.timings.values())
    return f"{file.stem}: {lobes_phrase(result.model)}; {metrics_line(result.report.metrics)}; {seconds:.2f} s"


def result_document(model: DSBRDF, report: FitReport | None) -> dict[str, Any]:
    """Return the stored form of a model and its report, with metrics, warnings, lobes and components beside it."""
    about = {
        "metrics": None if report is None else asdict(report.metrics),
        "warnings": [] if report is None else list(report.warnings),
        "lobes": lobes_document(model),
        "components": component_documents(model),
    }
    stored: dict[str, Any] = json.loads(to_json(model, report))
    return about | stored


def component_documents(model: DSBRDF) -> list[dict[str, Any]]:
    """Return the components of a model, from narrow to wide, as they are written to JSON."""
    return [component_document(component) for component in decompose(model)]


def lobes_document(model: DSBRDF) -> dict[str, Any]:
    """Return the parameters as they are written to JSON: those of `DSBRDF`, with angles in degrees."""
    arrays: dict[str, Any] = {
        "theta_diff_deg": _degrees(model.theta_diff),
        "amplitude": model.amplitude.tolist(),
        "shape_theta_diff_deg": _degrees(model.shape_theta_diff),
        "kappa": model.kappa.tolist(),
        "gamma": model.gamma.tolist(),
        "center_deg": _degrees(model.center),
        "elongation_theta_diff_deg": _degrees(model.elongation_theta_diff),
        "elongation": model.elongation.tolist(),
        "delta": model.delta.tolist(),
    }
    return arrays | {"interpolation": model.interpolation, "lobe": model.lobe}


def component_document(component: Component) -> dict[str, Any]:
    """Return one component as JSON content."""
    width = component.half_width
    return {
        "label": component.label,
        "lobes": list(component.lobes),
        "parameters": lobes_document(component.model),
        "albedo": component.albedo.tolist(),
        "half_width_deg": None if width is None else float(np.degrees(width)),
        "margin": component.margin,
    }


def _degrees(angles: NDArray[np.float64]) -> Any:
    """Return angles in degrees, rounded so that 5 degrees are written as 5."""
    return np.round(np.degrees(angles), 10).tolist()
