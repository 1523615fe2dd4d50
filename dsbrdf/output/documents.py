"""Convert components to JSON documents, CSV and LaTeX, and summarise a table of samples.

The command line, stored fits and the HTTP service have the same documents; their angles are in degrees. A table of
components has a row for each surface, and for each component without surfaces.
"""

import csv
import io
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from dsbrdf.components.component import Component
from dsbrdf.components.decomposition import Fitted, decompose
from dsbrdf.data.geometry import CHANNELS
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.samples.doubts import sample_doubts
from dsbrdf.samples.reading import ReadTable

LOBE_THETA_DIFF = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0)
"""Angles theta_diff [degrees] for which a document lists the component's values at theta_half = 0."""


def component_documents(model: DSBRDF | Fitted) -> list[dict[str, Any]]:
    """Return the JSON documents of the components of a model or a fit, the narrowest component first."""
    return [component_document(component) for component in decompose(model)]


def component_document(component: Component) -> dict[str, Any]:
    """Return the JSON document of one component: its fraction of the light, layers, surfaces, misfit and ranges."""
    width = component.half_width
    return {
        "label": component.label,
        "structure": component.structure,
        "light_share": component.light_share,
        "albedo": component.albedo.tolist(),
        "color": component.color.tolist(),
        "half_width_deg": None if width is None else float(np.degrees(width)),
        "layers": asdict(component.layers)["layers"],
        "surfaces": [asdict(surface) for surface in component.surfaces],
        "misfit": asdict(component.misfit),
        "remarks": list(component.remarks),
        "lobe": {
            "theta_diff_deg": list(LOBE_THETA_DIFF),
            "height": component.height(np.radians(LOBE_THETA_DIFF)).tolist(),
        },
        "ranges": asdict(component.ranges),
    }


_RANGES = ("", "_low", "_high")
COLUMNS = (
    *("material", "component", "surface"),
    *(f"light_share{end}" for end in _RANGES),
    *(f"alpha{end}" for end in _RANGES),
    "tail_exponent",
    *(f"{name}_{channel}{end}" for name in ("f0", "f70", "albedo") for channel in CHANNELS for end in _RANGES),
    *("half_width_deg", "psnr"),
)
"""Columns of the table; the columns ``_low`` and ``_high`` have the ends of the 90 % range of a parameter."""


def component_rows(
    material: str, components: Sequence[Mapping[str, Any]], psnr: float | None
) -> Iterator[dict[str, Any]]:
    """Yield the table rows of a material, from the documents of its components and the PSNR of its fit [dB]."""
    for part in components:
        own = {"material": material, "component": part["label"], "half_width_deg": part["half_width_deg"], "psnr": psnr}
        own |= _with_range("light_share", part["light_share"], part["ranges"]["light_share"])
        own |= _by_channel("albedo", part["albedo"], part["ranges"]["albedo"])
        for number, surface in enumerate(part["surfaces"], 1):
            row = own | {"surface": number, "tail_exponent": surface["tail_exponent"]}
            row |= _with_range("alpha", surface["alpha"], surface["alpha_range"])
            for name in ("f0", "f70"):
                row |= _by_channel(name, surface[name], surface[f"{name}_range"])
            yield row
        if not part["surfaces"]:
            yield own


def _with_range(name: str, value: float | None, spread: Sequence[float] | None) -> dict[str, Any]:
    return dict(zip((f"{name}{end}" for end in _RANGES), (value, *(spread or (None, None))), strict=True))


def _by_channel(name: str, values: Sequence[float] | None, spreads: Sequence[Sequence[float]] | None) -> dict[str, Any]:
    cells: dict[str, Any] = {}
    for index, channel in enumerate(CHANNELS):
        spread = None if spreads is None else spreads[index]
        cells |= _with_range(f"{name}_{channel}", None if values is None else values[index], spread)
    return cells


def table_csv(rows: Iterable[Mapping[str, Any]], columns: Sequence[str] = COLUMNS) -> bytes:
    """Return rows as CSV with a header line; a cell without a value is empty."""
    text = io.StringIO()
    table = csv.DictWriter(text, columns, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    return text.getvalue().encode(errors="backslashreplace")  # The name of a file need not be Unicode.


_LATEX_HEADS = (
    *("material", "part", "light [\\%]", "albedo (r, g, b)", "surface", "$\\alpha$", "tail"),
    *("$F_0$ (r, g, b)", "$F_{70}$ (r, g, b)", "dB"),
)


def table_latex(rows: Iterable[Mapping[str, Any]]) -> bytes:
    """Return rows as a LaTeX table for the packages booktabs and multirow.

    Subscript and superscript of a value give its range. A cell that several rows share is written once.
    """
    rows = list(rows)
    materials = [row["material"] for row in rows]
    parts = [(row["material"], row["component"]) for row in rows]
    lines = [f"\\begin{{tabular}}{{ll{'r' * (len(_LATEX_HEADS) - 2)}}}", "\\toprule"]
    lines += [" & ".join(_LATEX_HEADS) + r" \\", "\\midrule"]
    for index, row in enumerate(rows):
        if index and materials[index] != materials[index - 1]:
            lines.append("\\addlinespace")
        texts = row["material"], row["component"].replace("_", " ")
        name, part = (re.sub(r"([&%#$_{}])", r"\\\1", text) for text in texts)
        cells = [_shared(materials, index, name), _shared(parts, index, part)]
        cells += [_shared(parts, index, _latex_range(row, "light_share", "{:.0f}", 100.0))]
        cells += [_shared(parts, index, _rgb(row, "albedo")), _number(row.get("surface"))]
        cells += [_latex_range(row, "alpha", "{:.3g}", 1.0), _number(row.get("tail_exponent"))]
        cells += [_rgb(row, "f0"), _rgb(row, "f70"), _shared(materials, index, _number(row["psnr"]))]
        lines.append(" & ".join(cells) + r" \\")
    return "\n".join([*lines, "\\bottomrule", "\\end{tabular}", ""]).encode(errors="backslashreplace")


def _shared(keys: Sequence[object], index: int, text: str) -> str:
    """Return the text of a cell that spans all rows with one key, which is empty in all rows but the first."""
    count = keys.count(keys[index])
    if index and keys[index - 1] == keys[index]:
        return ""
    return text if count == 1 or not text else f"\\multirow{{{count}}}{{*}}{{{text}}}"


def _latex_range(row: Mapping[str, Any], name: str, form: str, factor: float) -> str:
    if row.get(name) is None:
        return ""
    value, low, high = (form.format(factor * row[f"{name}{end}"]) for end in _RANGES)
    return f"${value}_{{{low}}}^{{{high}}}$"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


def _rgb(row: Mapping[str, Any], name: str) -> str:
    values = [row.get(f"{name}_{channel}") for channel in CHANNELS]
    return "" if values[0] is None else ", ".join(map(_number, values))


ANGLE_NAMES = ("theta_in_deg", "theta_out_deg", "phi_deg")
"""Names of the angles of a sample in a summary; phi is the azimuth from omega_in to omega_out, 0 to 360 degrees."""
_N_SHOWN_SAMPLES = 5
_MAX_LISTED_ANGLES = 12  # A summary lists the angles of incidence only if there are at most this many.
_MAX_IN_PLANE_DISTANCE_DEG = 0.5  # A sample at most this far from the plane of incidence counts as in the plane.


def summary_of_table(found: ReadTable) -> dict[str, Any]:
    """Return columns, ranges, warnings and the first samples of a table as JSON content.

    A row of ``first`` has the angles `ANGLE_NAMES`, then red, green and blue [1/sr] of one sample. The object
    ``ranges`` has the minimum and maximum over all samples of each of these columns.
    """
    samples = found.samples
    theta_in, theta_out = (np.arccos(np.clip(side[:, 2], -1.0, 1.0)) for side in (samples.omega_in, samples.omega_out))
    phi_in, phi_out = (np.arctan2(side[:, 1], side[:, 0]) for side in (samples.omega_in, samples.omega_out))
    phi = np.degrees(phi_out - phi_in).round(9) % 360.0
    rows = np.column_stack([np.degrees(theta_in), np.degrees(theta_out), phi, samples.values])
    incidence = np.unique(rows[:, 0].round(1))
    aside = np.abs(np.sin(np.radians(phi))) * np.sin(theta_out)
    return {
        "n_rows": found.n_rows,
        "n_samples": len(samples.values),
        "columns": [{"name": name, "read_as": meaning or None, "unit": unit} for name, meaning, unit in found.columns],
        "ranges": {
            name: [float(column.min()), float(column.max())]
            for name, column in zip((*ANGLE_NAMES, *CHANNELS), rows.T, strict=True)
        },
        "angles_of_incidence_deg": incidence.tolist() if incidence.size <= _MAX_LISTED_ANGLES else None,
        "in_plane_of_incidence": float(np.mean(aside <= np.sin(np.radians(_MAX_IN_PLANE_DISTANCE_DEG)))),
        "warnings": [*samples.notes, *sample_doubts(samples).sentences],
        "first": rows[:_N_SHOWN_SAMPLES].tolist(),
    }
