"""What people and scripts read about a fit, as text and as JSON: metrics, lobes and components.

The JSON content has the form that the HTTP service gives it.
Angles are in degrees here and nowhere else in the library, because this is for display and for the wire.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dsbrdf.decomposition import Component, decompose, lobe_widths
from dsbrdf.fit import FitResult
from dsbrdf.measurement import CHANNELS
from dsbrdf.model import DSBRDF

SHOWN_THETA_DIFF = (0.0, 30.0, 60.0, 75.0)
"""Where parameters are shown [degrees]."""


def metrics_line(metrics: Mapping[str, float | None]) -> str:
    """Return the metrics in one line, those without a value left out."""
    return "   ".join(f"{name} {value:.4g}" for name, value in metrics.items() if value is not None)


def components_table(components: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return one line for each component document: lobes, half width, albedo and margin."""
    lines = [f"{'component':<16}{'lobes':<9}{'half width':>10}   {'albedo red, green, blue':<24}{'margin':>8}"]
    for component in components:
        lobes = ", ".join(str(lobe) for lobe in component["lobes"]) or "none"
        width = "" if component["half_width_deg"] is None else f"{component['half_width_deg']:.2f}°"
        albedo = "  ".join(f"{value:.4f}" for value in component["albedo"])
        margin = "" if component["margin"] is None else f"{component['margin']:.2f}"
        lines.append(f"{component['label']:<16}{lobes:<9}{width:>10}   {albedo:<24}{margin:>8}".rstrip())
    return lines


def parameters_table(
    model: DSBRDF, *, channel: str = "red", theta_diff_deg: Sequence[float] = SHOWN_THETA_DIFF
) -> list[str]:
    """Return two lines for each lobe: kappa and gamma of one channel at some theta_diff [degrees]."""
    kappa, gamma, _, _ = model.parameters_at(np.radians(theta_diff_deg))
    column = CHANNELS.index(channel)
    head = "".join(f"{angle:>10.0f}°" for angle in theta_diff_deg)
    lines = [f"{f'{channel} channel, theta_diff':<26}{head}"]
    for lobe, width in enumerate(np.degrees(lobe_widths(model)[0])):
        for name, values in (("kappa", kappa), ("gamma", gamma)):
            cells = "".join(f"{value:>11.4g}" for value in values[:, column, lobe])
            lead = f"lobe {lobe}, {width:.2f}°" if name == "kappa" else ""
            lines.append(f"{lead:<18}{name:<8}{cells}")
    return lines


def result_text(file: Path, result: FitResult) -> list[str]:
    """Return the summary of one fit: metrics, components and parameters."""
    return [
        headline(file, result),
        "",
        *components_table(component_documents(result.model)),
        "",
        *parameters_table(result.model),
        "",
    ]


def headline(file: Path, result: FitResult) -> str:
    """Return one line: the file, the number of lobes, the metrics and the time."""
    seconds = sum(result.report.timings.values())
    lobes = f"{result.model.n_lobes} lobes"
    return f"{file.stem}: {lobes}, {metrics_line(result.report.metrics)}, {seconds:.2f} s"


def component_documents(model: DSBRDF) -> list[dict[str, Any]]:
    """Return the components of a model as JSON content, from narrow to wide."""
    return [_component_document(component) for component in decompose(model)]


def lobes_document(model: DSBRDF) -> dict[str, Any]:
    """Return parameters as JSON content: kappa, gamma and center_deg of shape (3, D, K), delta (3, D)."""
    return {
        "theta_diff_deg": _degrees(model.theta_diff),
        "kappa": model.kappa.tolist(),
        "gamma": model.gamma.tolist(),
        "center_deg": _degrees(model.center),
        "delta": model.delta.tolist(),
        "interpolation": model.interpolation,
    }


def _component_document(component: Component) -> dict[str, Any]:
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
    """Return angles in degrees, without the rounding error of the conversion."""
    return np.round(np.degrees(angles), 10).tolist()
