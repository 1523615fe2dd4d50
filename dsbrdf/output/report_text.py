"""The result of a fit as text and as JSON: metrics, lobes and components.

The JSON has the same form as in the HTTP service.  Angles are in degrees, because this is for display and for HTTP; the
rest of the library uses radians.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dsbrdf.data.grid import CHANNELS
from dsbrdf.fitting.report import FitReport, FitResult
from dsbrdf.model.decomposition import Component, decompose, lobe_widths
from dsbrdf.model.dsbrdf import DSBRDF

SHOWN_THETA_DIFF = (0.0, 30.0, 60.0, 75.0)
"""theta_diff of the parameters that are printed [degrees]."""


def metrics_line(metrics: Mapping[str, float | None]) -> str:
    """Return one line with the metrics that have a value."""
    return ", ".join(f"{name} {value:.4g}" for name, value in metrics.items() if value is not None)


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
    """Return a table of the parameters of one channel: kappa, gamma and, for ring lobes, center."""
    kappa, gamma, center, _ = model.parameters_at(np.radians(theta_diff_deg))
    column, rings = CHANNELS.index(channel), ring_lobes(model)
    head = "".join(f"{angle:>10.0f}°" for angle in theta_diff_deg)
    lines = [f"{f'{channel} channel, theta_diff':<30}{head}"]
    for lobe, width in enumerate(np.degrees(lobe_widths(model)[0])):
        lead = f"{'ring lobe' if rings[lobe] else 'lobe'} {lobe}, {width:.2f}°"
        parameters = [("kappa", kappa), ("gamma", gamma)] + ([("center", np.degrees(center))] if rings[lobe] else [])
        for name, values in parameters:
            unit = "°" if name == "center" else " "
            cells = "".join(f"{value:>10.4g}{unit}" for value in values[:, column, lobe])
            lines.append(f"{lead:<22}{name:<8}{cells}".rstrip())
            lead = ""
    return lines


def ring_lobes(model: DSBRDF) -> NDArray[np.bool_]:
    """Return which lobes are ring lobes, whose center is not 0, shape (K,)."""
    return np.asarray(np.any(model.center > 0.0, axis=(0, 1)))


def lobes_phrase(model: DSBRDF) -> str:
    """Return the numbers of lobes and ring lobes in words, such as ``3 lobes + 1 ring lobe``."""
    rings = int(np.count_nonzero(ring_lobes(model)))
    centered = model.n_lobes - rings
    words = f"{centered} {'lobe' if centered == 1 else 'lobes'}"
    return words if rings == 0 else f"{words} + {rings} {'ring lobe' if rings == 1 else 'ring lobes'}"


def selection_table(report: FitReport) -> list[str]:
    """Return a table of how the numbers of lobes and ring lobes were chosen; empty if they were given.

    Each number of lobes has E_p, Williams' t of its difference to the largest number, the critical value and whether it
    is enough.
    """
    lines = []
    if len(report.selection) > 1:
        lines.append(f"{'lobes tried':<14}{'E_p':>10}{'t':>10}{'critical value':>17}{'squared error':>16}{'BIC':>11}")
    for row in report.selection if lines else ():
        cells = "".join(
            f"{'' if row[name] is None else format(row[name], form):>{width}}"
            for name, form, width in (
                ("e_p", ".4f", 10),
                ("t", ".2f", 10),
                ("critical_value", ".3f", 17),
                ("squared_error", ".5g", 16),
                ("bic", ".0f", 11),
            )
        )
        verdict = "" if row["t"] is None else "   too few" if row["significant"] else "   enough"
        lines.append(f"{row['n_lobes']:<14}{cells}{verdict}".rstrip())
    if report.rings:
        tried = (f"{row['ring_lobes']} {'pays' if row['pays'] else 'does not pay'}" for row in report.rings)
        lines.append(f"ring lobes tried: {', '.join(tried)}")
    return lines


def bands_table(report: FitReport) -> list[str]:
    """Return a table of the errors of each channel and of each band of theta_diff with data."""
    rows = [(f"{row['channel']} channel", row) for row in report.by_channel]
    for row in report.by_theta_diff:
        low, high = np.degrees(row["theta_diff"])
        rows.append((f"theta_diff {low:.0f}° to {high:.0f}°", row))
    lines = [f"{'error':<24}{'relative_rms':>14}{'floor':>10}{'excess':>10}"] if rows else []
    for name, row in rows:
        excess = "" if row["excess"] is None else f"{row['excess']:.3f}"
        lines.append(f"{name:<24}{row['relative_rms']:>14.4f}{row['floor']:>10.4f}{excess:>10}".rstrip())
    return lines


def result_text(file: Path, result: FitResult) -> list[str]:
    """Return the report of one fit: metrics, components, parameters, choice of the number of lobes, errors."""
    lines = [headline(file, result)]
    for table in (
        components_table(component_documents(result.model)),
        parameters_table(result.model),
        selection_table(result.report),
        bands_table(result.report),
    ):
        lines += ["", *table] if table else []
    return [*lines, ""]


def headline(file: Path, result: FitResult) -> str:
    """Return one line with the file, the number of lobes, the metrics and the time."""
    seconds = sum(result.report.timings.values())
    return f"{file.stem}: {lobes_phrase(result.model)}; {metrics_line(result.report.metrics)}; {seconds:.2f} s"


def component_documents(model: DSBRDF) -> list[dict[str, Any]]:
    """Return the components of a model, from narrow to wide, as they are written to JSON."""
    return [component_document(component) for component in decompose(model)]


def lobes_document(model: DSBRDF) -> dict[str, Any]:
    """Return the parameters as they are written to JSON: kappa, gamma, center_deg (3, D, K) and delta (3, D)."""
    return {
        "theta_diff_deg": _degrees(model.theta_diff),
        "kappa": model.kappa.tolist(),
        "gamma": model.gamma.tolist(),
        "center_deg": _degrees(model.center),
        "delta": model.delta.tolist(),
        "interpolation": model.interpolation,
    }


def component_document(component: Component) -> dict[str, Any]:
    """Return one component as JSON content."""
    width = component.half_width
    return {
        "label": component.label,
        "lobes": list(component.lobes),
        "parameters": lobes_document(component),
        "albedo": component.albedo.tolist(),
        "half_width_deg": None if width is None else float(np.degrees(width)),
        "margin": component.margin,
    }


def _degrees(angles: NDArray[np.float64]) -> Any:
    """Return angles in degrees, rounded so that 5 degrees are written as 5."""
    return np.round(np.degrees(angles), 10).tolist()
