"""Tabulate the components of many materials: a row for each surface, and for each component without surfaces."""

import csv
import io
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from dsbrdf.data.geometry import CHANNELS

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
    return text.getvalue().encode()


_LATEX = {
    "material": "material",
    "part": "part",
    "light_share": "light [\\%]",
    "alpha": "$\\alpha$",
    "tail_exponent": "tail",
    "f0": "$F_0$ (r, g, b)",
    "f70": "$F_{70}$ (r, g, b)",
    "albedo": "albedo (r, g, b)",
    "psnr": "dB",
}


def table_latex(rows: Iterable[Mapping[str, Any]]) -> bytes:
    """Return rows as a LaTeX table for the package booktabs; subscript and superscript of a value give its range."""
    lines = [f"\\begin{{tabular}}{{ll{'r' * (len(_LATEX) - 2)}}}", "\\toprule"]
    lines += [" & ".join(_LATEX.values()) + r" \\", "\\midrule"]
    for row in rows:
        surface = f" {row['surface']}" if row.get("surface") else ""
        cells = [row["material"], row["component"].replace("_", " ") + surface]
        cells = [re.sub(r"([&%#$_{}])", r"\\\1", cell) for cell in cells]
        cells += [_latex_range(row, "light_share", "{:.0f}", 100.0), _latex_range(row, "alpha", "{:.3g}", 1.0)]
        cells += [_number(row.get("tail_exponent")), *(_rgb(row, name) for name in ("f0", "f70", "albedo"))]
        cells.append(_number(row["psnr"]))
        lines.append(" & ".join(cells) + r" \\")
    return "\n".join([*lines, "\\bottomrule", "\\end{tabular}", ""]).encode()


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
