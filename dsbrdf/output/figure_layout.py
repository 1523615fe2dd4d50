"""How figures are laid out, and what they draw of a model: its components, each with its own lobe, or its lobes.

Rows of panels stand below each other, with one style of ticks and legends. Ticks are a few round numbers, written out,
on linear and on logarithmic axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.fitting.decomposition import LABELS, decompose
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.reflectance import ReflectanceModel
from dsbrdf.output.report_text import lobes_in_channel

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import FigureBase

PAIR_WIDTH, ROW_HEIGHT = 5.5, 3.4  # of two panels, and of a row of them, in inches
_ABOVE, _BELOW, _LEFT, _RIGHT, _LEGEND_LINE = 0.6, 0.6, 0.7, 0.15, 0.18  # margins, in inches
_MOST = 6  # ticks of a logarithmic axis
_TENTHS, _HALVES, _DIGITS = (np.arange(1.0, 10.0, step) for step in (0.1, 0.5, 1.0))
_MANTISSAS = (_TENTHS, _HALVES, _DIGITS, (1.0, 2.0, 5.0), (1.0, 3.0), (1.0,))


def panel_pairs(figure: FigureBase, slices: int) -> list[tuple[Axes, Axes]]:
    """Return two panels for each slice, side by side."""
    axes = figure.subplots(1, 2 * slices, squeeze=False, width_ratios=[1.7, 1.0] * slices)[0]
    return list(zip(axes[::2], axes[1::2], strict=True))


def finish_row(figure: FigureBase, named: Sequence[Axes], *, slices: int, columns: int) -> None:
    """Draw the legend of some panels at the bottom of their row, and set the margins, the same in all rows."""
    draw_legend(figure, named, columns=columns, outside=False)
    below = _BELOW + _LEGEND_LINE * -(-len(figure.legends[0].get_texts()) // columns)
    width = PAIR_WIDTH * slices
    figure.subplots_adjust(
        left=_LEFT / width,
        right=1.0 - _RIGHT / width,
        bottom=below / ROW_HEIGHT,
        top=1.0 - _ABOVE / ROW_HEIGHT,
        wspace=0.36,
    )


def draw_legend(figure: FigureBase, axes: Sequence[Axes], *, columns: int, outside: bool = True) -> None:
    """Draw one legend under the panels, with the labelled lines of ``axes``, each label once."""
    lines = {str(line.get_label()): line for ax in axes for line in ax.get_legend_handles_labels()[0]}
    place: Literal["outside lower center", "lower center"] = "outside lower center" if outside else "lower center"
    figure.legend(list(lines.values()), list(lines), loc=place, ncols=columns, fontsize=8, frameon=False)


def set_ticks(ax: Axes) -> None:
    """Set the ticks of a plot whose limits are final; angles up to 90 degrees have them every 15 or 30 degrees."""
    from matplotlib.ticker import MaxNLocator

    low, high = ax.get_xlim()
    if high == 90.0:
        ax.set_xticks(np.arange(low, high + 1.0, 30.0 if low < 0.0 else 15.0))
    else:
        ax.xaxis.set_major_locator(MaxNLocator(nbins=5, steps=[1, 2, 5, 10], symmetric=True))
    if ax.get_yscale() == "log":
        ax.set_yticks(log_ticks(*ax.get_ylim()))
        ax.set_yticks([], minor=True)
    else:
        ax.yaxis.set_major_locator(MaxNLocator(nbins=6, steps=[1, 2, 5, 10]))
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter("{x:g}")
    ax.tick_params(labelsize=8)


def log_ticks(low: float, high: float) -> Array:
    """Return at most six round numbers between two, as many as there can be, for a logarithmic axis."""
    decades = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1.0)
    for mantissas in _MANTISSAS:
        ticks = np.round([mantissa * 10.0**decade for decade in decades for mantissa in mantissas], 12)
        ticks = ticks[(ticks >= low) & (ticks <= high)]
        if ticks.size <= _MOST:
            return ticks
    return ticks[:: -(-ticks.size // _MOST)]


LOBE_COLOURS = ("#e8590c", "#7048e8", "#0c8599", "#c2255c", "#5c940d", "#a0522d", "#4263eb", "#868e96")
COMPONENT_COLOURS = dict(zip(LABELS, LOBE_COLOURS, strict=False))


@dataclass(frozen=True)
class FigurePart:
    """A curve of one part of a model; one without a label is thin and not named in the legend."""

    source: ReflectanceModel
    colour: str  # as Matplotlib has it
    style: str  # as Matplotlib has it
    label: str = ""


def component_parts(model: DSBRDF) -> list[FigurePart]:
    """Components of a model, and below each, dashed, its own lobe."""
    parts = []
    for component in decompose(model):
        colour = COMPONENT_COLOURS[component.label]
        width = f"half width {np.degrees(component.half_width):.2g}°"
        parts += [
            FigurePart(component.lobe, colour, "--"),
            FigurePart(component, colour, "-", f"{component.label.replace('_', ' ')}, {width}"),
        ]
    return parts


def lobe_parts(model: DSBRDF, channel: int) -> list[FigurePart]:
    """The lobes of a model, rings and cusps dashed, with their width at theta_diff = 0, and the delta term."""
    at = lobes_in_channel(model, 0.0, channel)
    widths, centers = np.degrees(at["half_width"]), np.degrees(at["center"])
    parts = []
    for lobe, is_ring in enumerate(model.is_ring):
        name = f"lobe {lobe}"
        if is_ring:
            name = f"cusp {lobe}" if centers[lobe] < 0.0 else f"ring lobe {lobe} at {centers[lobe]:.2g}°"
        label = f"{name}, half width {widths[lobe]:.2g}°"
        colour = LOBE_COLOURS[lobe % len(LOBE_COLOURS)]
        parts.append(FigurePart(model.select((lobe,), with_delta=False), colour, "--" if is_ring else "-", label))
    if model.delta.any():
        parts.append(FigurePart(model.select((), with_delta=True), LOBE_COLOURS[-1], ":", "delta term"))
    return parts
