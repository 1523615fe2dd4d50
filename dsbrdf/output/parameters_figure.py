"""Figure of how the parameters of lobes run over theta_diff."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dsbrdf.fitting.decomposition import LobeParameters, decompose
from dsbrdf.output.figure_layout import (
    COMPONENT_COLOURS,
    LOBE_COLOURS,
    ROW_HEIGHT,
    draw_legend,
    empty_figure,
    set_ticks,
)
from dsbrdf.output.figures import CHANNEL_COLOURS
from dsbrdf.output.report_text import lobes_in_channel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from dsbrdf.model.dsbrdf import DSBRDF

_ANGLES = np.radians(np.linspace(0.0, 85.0, 200))
_STYLES = ("-", "--", "-.", ":")


def parameters_figure(model: DSBRDF, *, title: str = "", model_lobes: bool = False) -> Figure:
    """Height in red, green and blue, half width, tail and elongation over theta_diff: the components' own lobes.

    With `model_lobes`, those of the model instead, with kappa as the tail, and the green channel's shape where each
    channel has its own. The title is such as the name of the material.
    """
    figure = empty_figure(title, 2, height=1.7 * ROW_HEIGHT)
    heights, widths, tails, elongations = figure.subplots(2, 2).flat
    degrees = np.degrees(_ANGLES)
    for number, (label, colour, at) in enumerate(_model_lobes(model) if model_lobes else _own_lobes(model)):
        style = _STYLES[number % len(_STYLES)]
        for values, channel_colour in zip(at.height.T, CHANNEL_COLOURS, strict=True):
            heights.plot(degrees, values, style, color=channel_colour, linewidth=1.2)
        for ax, values in ((widths, np.degrees(at.half_width)), (tails, at.tail), (elongations, at.elongation)):
            ax.plot(degrees, values, style, color=colour, linewidth=1.2, label=label)
    heights.set(yscale="log", title="height in red, green and blue [1/sr]")
    widths.set(yscale="log", title="half width [degrees]")
    tails.set(title="kappa" if model_lobes else "tail, 2 for GGX, less for longer ones")
    elongations.set(title="elongation, 0 for a round lobe")
    _include(tails, 0.0, 2.5)
    _include(elongations, -0.25, 1.25)
    for ax in (heights, widths, tails, elongations):
        ax.set(xlim=(0, 90), xlabel=r"$\theta_\mathrm{diff}$ [degrees]")
        ax.title.set_fontsize(9)
        set_ticks(ax)
    draw_legend(figure, [widths], columns=4)
    return figure


def _own_lobes(model: DSBRDF) -> list[tuple[str, str, LobeParameters]]:
    """Label, colour and own lobe of each component."""
    return [
        (part.label.replace("_", " "), COMPONENT_COLOURS[part.label], part.parameters_at(_ANGLES))
        for part in decompose(model)
    ]


def _model_lobes(model: DSBRDF) -> list[tuple[str, str, LobeParameters]]:
    """Label, colour and parameters of each lobe of a model."""
    heights, at = model.parameters_at(_ANGLES)["amplitude"], lobes_in_channel(model, _ANGLES, 1)
    return [
        (
            f"{'ring lobe' if is_ring else 'lobe'} {k}",
            LOBE_COLOURS[k % len(LOBE_COLOURS)],
            LobeParameters(heights[..., k], at["half_width"][:, k], at["kappa"][:, k], at["elongation"][:, k]),
        )
        for k, is_ring in enumerate(model.is_ring)
    ]


def _include(ax: Axes, low: float, high: float) -> None:
    """Widen the axis to usual values, so that small differences look small."""
    bottom, top = ax.get_ylim()
    ax.set_ylim(min(low, bottom), max(high, top))
