"""Draw the parameters of a model over theta_diff."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dsbrdf.components.decomposition import decompose
from dsbrdf.output.figure_parts import (
    CHANNEL_COLOURS,
    LINE_STYLES,
    LOBE_COLOURS,
    ROW_HEIGHT_IN,
    draw_legend,
    empty_figure,
    set_ticks,
)
from dsbrdf.output.report_text import lobes_in_channel

if TYPE_CHECKING:
    from collections.abc import Iterable

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from dsbrdf.components.component import Component
    from dsbrdf.model.dsbrdf import DSBRDF

_CURVE_THETA_DIFF = np.radians(np.linspace(0.0, 85.0, 200))


def parameters_figure(model: DSBRDF, *, title: str = "", model_lobes: bool = False) -> Figure:
    """Draw the RGB values of a model's components at theta_half = 0, and their directional albedo.

    With `model_lobes`, draw the amplitude, half width, kappa and elongation of the model's lobes instead. The amplitude
    is the mean of the channels; half width and kappa are from the green channel.
    """
    return _lobes_figure(model, title) if model_lobes else components_figure(decompose(model), title)


def components_figure(components: Iterable[Component], title: str) -> Figure:
    """Draw the RGB values of components at theta_half = 0 over theta_diff, and their directional albedo."""
    figure = empty_figure(title, 2, height=ROW_HEIGHT_IN)
    heights, albedos = figure.subplots(1, 2)
    degrees, seen = np.degrees(_CURVE_THETA_DIFF), np.linspace(0.0, 80.0, 17)
    for number, part in enumerate(components):
        style = LINE_STYLES[number % len(LINE_STYLES)]
        reflected = part.directional_albedo(np.radians(seen))
        for ax, angles, values in ((heights, degrees, part.height(_CURVE_THETA_DIFF)), (albedos, seen, reflected)):
            for channel_colour, curve in zip(CHANNEL_COLOURS, values.T, strict=True):
                ax.plot(angles, curve, style, color=channel_colour, linewidth=1.2)
        low, high = np.transpose(part.ranges.albedo)
        places = 1.0 + 3.0 * number + np.arange(3)  # The albedo ranges of the three channels are drawn side by side.
        albedos.vlines(places, low, high, colors=CHANNEL_COLOURS, linestyles=style, linewidth=2.5, alpha=0.5)
        heights.plot([], [], style, color="0.3", linewidth=1.2, label=part.label.replace("_", " "))
    heights.set(
        yscale="log", title=r"height at $\theta_\mathrm{half}$ = 0 [1/sr]", xlabel=r"$\theta_\mathrm{diff}$ [degrees]"
    )
    albedos.set(
        title="directional albedo; at the left its 90 % ranges at 0°", xlabel=r"$\theta_\mathrm{out}$ [degrees]"
    )
    albedos.set_ylim(bottom=0.0)
    for ax in (heights, albedos):
        ax.set(xlim=(0, 90))
        ax.title.set_fontsize(9)
        set_ticks(ax)
    draw_legend(figure, [heights], 4, "outside lower center")
    return figure


def _lobes_figure(model: DSBRDF, title: str) -> Figure:
    figure = empty_figure(title, 2, height=1.7 * ROW_HEIGHT_IN)
    heights, widths, kappas, elongations = figure.subplots(2, 2).flat
    degrees = np.degrees(_CURVE_THETA_DIFF)
    amplitude = model.parameters_at(_CURVE_THETA_DIFF)["amplitude"].mean(axis=-2)
    at = lobes_in_channel(model, _CURVE_THETA_DIFF, 1)
    for lobe, is_ring in enumerate(model.is_ring):
        style, colour = LINE_STYLES[lobe % len(LINE_STYLES)], LOBE_COLOURS[lobe % len(LOBE_COLOURS)]
        label = f"{'ring lobe' if is_ring else 'lobe'} {lobe}"
        shapes = (amplitude, np.degrees(at["half_width"]), at["kappa"], at["elongation"])
        for ax, values in zip((heights, widths, kappas, elongations), shapes, strict=True):
            ax.plot(degrees, values[:, lobe], style, color=colour, linewidth=1.2, label=label)
    heights.set(yscale="log", title="height, mean of the channels [1/sr]")
    widths.set(yscale="log", title="half width [degrees]")
    kappas.set(title="kappa")
    elongations.set(title="elongation, 0 for a round lobe")
    _include(kappas, 0.0, 2.5)
    _include(elongations, -0.25, 1.25)
    for ax in (heights, widths, kappas, elongations):
        ax.set(xlim=(0, 90), xlabel=r"$\theta_\mathrm{diff}$ [degrees]")
        ax.title.set_fontsize(9)
        set_ticks(ax)
    draw_legend(figure, [widths], 4, "outside lower center")
    return figure


def _include(ax: Axes, low: float, high: float) -> None:
    """Widen a vertical axis to include `low` and `high`, so that small variations look small."""
    bottom, top = ax.get_ylim()
    ax.set_ylim(min(low, bottom), max(high, top))
