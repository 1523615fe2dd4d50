"""Write the result of a fit as text, JSON and CSV: metrics, components with their layers, and the model's lobes.

The JSON is the same as from the HTTP service. Angles in text, JSON and CSV are in degrees; the rest of the library uses
radians.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dsbrdf.arrays import Array
from dsbrdf.components.decomposition import decompose
from dsbrdf.components.layers import LayeredModel
from dsbrdf.data.geometry import CHANNELS
from dsbrdf.fitting.metrics import Metrics, RelativeErrors
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.lobes import half_width
from dsbrdf.output.documents import component_documents
from dsbrdf.output.serialize import to_json
from dsbrdf.result import FitReport, FitResult, verdict

_TEXT_WIDTH = 60  # maximum length of the lines of a report [characters]


def metrics_lines(metrics: Metrics, width: int = _TEXT_WIDTH) -> list[str]:
    """Return the metrics that are not None, in equal columns on lines of at most `width` characters."""
    known = {name: value for name, value in asdict(metrics).items() if value is not None}
    wide = max(map(len, known), default=0)
    cells = [f"{name:<{wide}} {value:<11.4g}" for name, value in known.items()]
    each = max((width + 2) // (wide + 12), 1)
    return ["".join(cells[start : start + each]).rstrip() for start in range(0, len(cells), each)]


def components_table(components: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a table with a line for each component: fraction of the light with range, half width and albedo."""
    if not components:
        return ["The model reflects no light, so it has no components."]
    lines = [f"{'component':<14}{'light':>5}{'90 % range':>11}{'width':>8}{'albedo r, g, b':>21}"]
    for component in components:
        (low, high), width = component["ranges"]["light_share"], component["half_width_deg"]
        cells = f"{component['light_share']:>5.0%}{f'{low:.0%}-{high:.0%}':>11}"
        cells += f"{'' if width is None else f'{width:.2f}°':>8}"
        lines.append(f"{component['label']:<14}{cells}" + "".join(f"{value:>7.4f}" for value in component["albedo"]))
    return lines


def component_surfaces_table(components: Sequence[Mapping[str, Any]], *, remarks: bool = True) -> list[str]:
    """Return the surfaces and optional remarks of each component."""
    lines: list[str] = []
    for component in components:
        lines.append(f"{component['label']} ({component['structure']})")
        for number, surface in enumerate(component["surfaces"], 1):
            lines += _surface_lines(number, surface)
        for remark in component["remarks"] if remarks else ():
            lines += wrap(remark, _TEXT_WIDTH, initial_indent="  ", subsequent_indent="  ")
    return lines


def _surface_lines(number: int, surface: Mapping[str, Any]) -> list[str]:
    """Return the parameters of one surface with their 90 % ranges; parameters that are None are left out."""
    rows = []
    if surface["alpha"] is not None:
        rows += [("alpha", surface["alpha"], surface["alpha_range"]), ("tail", surface["tail_exponent"], None)]
    for name in ("f0", "f70"):
        if surface[name] is not None:
            heads = [f"{name.upper()} {channel}" for channel in CHANNELS]
            rows += [*zip(heads, surface[name], surface[f"{name}_range"], strict=True)]
    texts = [
        f"{name:<10}{value:.3g}" if spread is None else f"{name:<10}{value:<9.3g}({spread[0]:.3g} to {spread[1]:.3g})"
        for name, value, spread in rows
    ]
    return [f"  {'' if place else f'surface {number}':<12}{text}" for place, text in enumerate(texts)]


def lobes_in_channel(model: DSBRDF, theta_diff: ArrayLike, channel: int) -> dict[str, Array]:
    """Return parameters and half widths (..., K) of the K lobes in one channel at theta_diff (...) [rad]."""
    found, shape = model.parameters_at(theta_diff), channel if model.kappa.shape[0] == 3 else 0
    at = {name: found[name][..., shape, :] for name in ("kappa", "gamma", "center")}
    at |= {"amplitude": found["amplitude"][..., channel, :], "elongation": found["elongation"]}
    return at | {"half_width": half_width(at["kappa"], at["gamma"], model.lobe)}


def lobes_phrase(model: DSBRDF) -> str:
    """Return the number of lobes in words, such as ``4 lobes (1 ring)``."""
    rings = int(np.count_nonzero(model.is_ring))
    words = f"{model.n_lobes} {'lobe' if model.n_lobes == 1 else 'lobes'}"
    return words if rings == 0 else f"{words} ({rings} {'ring' if rings == 1 else 'rings'})"


def search_table(report: FitReport) -> list[str]:
    """Return a table of the numbers of lobes that the fit tried, in the order of the trials; empty without a search.

    The error in the table is the weighted squared error at validation samples, divided by their squared values.
    """
    lines = [f"{'lobes tried':<14}{'rings':>10}{'error held out':>18}"] if report.search else []
    for step in report.search:
        verdict = "kept" if step.kept else "too few"
        lines.append(f"{step.n_lobes:<14}{step.ring_lobes:>10}{step.error:>18.3g}   {verdict}")
    return lines


def selection_table(report: FitReport) -> list[str]:
    """Return a table of the numbers of lobes that Williams' test compared; empty if there was no test."""
    lines = [f"{'lobes':<6}{'E_p':>9}{'squared error':>15}{'t':>9}{'critical':>10}"] if report.selection else []
    for step in report.selection:
        t, critical = ("" if value is None else f"{value:.3f}" for value in (step.t, step.critical_value))
        verdict = "   worse" if step.significant else ""
        cells = f"{step.n_lobes:<6}{step.e_p:>9.4f}{step.squared_error:>15.4g}{t:>9}{critical:>10}"
        lines.append(f"{cells}{verdict}".rstrip())
    return lines


def bands_table(report: FitReport) -> list[str]:
    """Return a table of the relative errors in each channel, and in each band of theta_diff that has data."""
    rows: list[tuple[str, RelativeErrors]] = [(f"{row.channel} channel", row) for row in report.by_channel]
    for band in report.by_theta_diff:
        low, high = np.degrees(band.theta_diff)
        rows.append((f"theta_diff {low:.0f}° to {high:.0f}°", band))
    lines = [f"{'error':<24}{'relative_rms':>14}{'floor':>10}{'excess':>10}"] if rows else []
    for name, errors in rows:
        excess = "" if errors.excess is None else f"{errors.excess:.3f}"
        lines.append(f"{name:<24}{errors.relative_rms:>14.4f}{errors.floor:>10.4f}{excess:>10}".rstrip())
    return lines


def samples_tables(report: FitReport) -> list[str]:
    """Return tables of validation errors and of directions to measure next, for a fit of scattered samples only."""
    lines = [f"{'samples left out':<32}{'samples':>9}{'relative_rms':>14}"] if report.left_out else []
    lines += [f"{row.where:<32}{row.n_samples:>9}{row.relative_rms:>14.4f}" for row in report.left_out]
    if report.measure_next:
        lines += ["", f"{'measure next':<14}{'theta_in':>10}{'theta_out':>11}{'phi':>7}"]
        pairs = report.measure_next
        lines += [f"{'':<14}{p.theta_in_deg:>9.0f}°{p.theta_out_deg:>10.0f}°{p.phi_deg:>6.0f}°" for p in pairs]
    return lines


def model_text(model: DSBRDF | FitResult, *, remarks: bool = True) -> list[str]:
    """Return the components of a model and their surfaces, optionally with remarks."""
    components = component_documents(model)
    return [*components_table(components), "", *component_surfaces_table(components, remarks=remarks)]


def result_text(file: Path, result: FitResult) -> list[str]:
    """Return the report of one fit: verdict, warnings, metrics, components and errors."""
    report = result.report
    lines = [headline(file, result), *(f"warning: {sentence}" for sentence in report.warnings), ""]
    lines += [*metrics_lines(report.metrics), ""]
    lines += model_text(result, remarks=False)  # The warnings of the report include the remarks.
    for table in (samples_tables, search_table, selection_table, bands_table):
        lines += ["", *found] if (found := table(report)) else []
    return [*lines, ""]


def headline(file: Path, result: FitResult) -> str:
    """Return one line with the file, the verdict on the fit, the number of lobes and the time."""
    metrics, seconds = result.report.metrics, sum(result.report.timings.values())
    close = "fitted" if metrics.relative_rms is None else f"error {_percent(metrics.relative_rms)} at the samples"
    close = verdict(metrics) or close
    if metrics.relative_rms_expected is not None:
        close += f", probably below {_percent(metrics.relative_rms_expected)} over all directions"
    return f"{file.stem}: {close}; {lobes_phrase(result.model)}; {seconds:.2f} s"


def _percent(error: float) -> str:
    return f"{100.0 * error:.2g}%" if error < 0.995 else f"{error:.0%}"


def result_document(model: DSBRDF, report: FitReport | None) -> dict[str, Any]:
    """Return a JSON document of metrics, warnings, findings and components, followed by the stored model and report."""
    parts = decompose(model if report is None else FitResult(model, report))
    stored: dict[str, Any] = json.loads(to_json(model, report, parts))
    return {"metrics": None if report is None else asdict(report.metrics)} | stored


def parameters_csv(model: DSBRDF) -> str:
    """Return lobe parameters as CSV, with a row for each lobe, channel and theta_diff (0, 5, ..., 85, 89 degrees).

    The amplitude is in 1/sr; the half width of a ring lobe is counted from its center.
    """
    names = ("amplitude", "kappa", "gamma", "center_deg", "elongation", "half_width_deg")
    lines = [",".join(("lobe", "channel", "theta_diff_deg", *names))]
    angles = np.radians([*range(0, 90, 5), 89.0])
    found = [lobes_in_channel(model, angles, index) for index in range(len(CHANNELS))]
    for lobe in range(model.n_lobes):
        for channel, at in zip(CHANNELS, found, strict=True):
            table = [np.degrees(angles)]
            for name in names:
                values = at[name.removesuffix("_deg")][:, lobe]
                table.append(np.degrees(values) if name.endswith("_deg") else values)
            lead = f"{lobe},{channel},"
            lines += [lead + ",".join(f"{value:.9g}" for value in row) for row in np.stack(table, axis=1).tolist()]
    return "\n".join(lines) + "\n"


def layers_csv(layers: LayeredModel) -> str:
    """Return the parameters of layers as CSV, with a row for each number; `dsbrdf.components.layers` explains them.

    A colour has a row for each channel, such as ``f0_red``; other lists have a row for each index, such as ``rise_1``.
    """
    lines = ["layer,kind,parameter,value"]
    for number, layer in enumerate(layers.layers):
        lead = f"{number},{type(layer).__name__.removesuffix('Layer').lower()}"
        for name, value in vars(layer).items():
            if isinstance(value, float):
                lines.append(f"{lead},{name},{value:.9g}")
            else:
                places = CHANNELS if name in ("f0", "albedo", "color") else range(1, len(value) + 1)
                lines += [f"{lead},{name}_{place},{one:.9g}" for place, one in zip(places, value, strict=True)]
    return "\n".join(lines) + "\n"
