"""Figure of how the parameters of a model run over theta_diff."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dsbrdf.model.decomposition import decompose, lobe_reaches
from dsbrdf.output.figures import CHANNEL_COLOURS, LINE_STYLES, LOBE_COLOURS, ROW_HEIGHT, draw_legend, empty_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dsbrdf.model.dsbrdf import DSBRDF

_ANGLES = np.radians(np.linspace(0.0, 89.0, 200))
_WIDTH_TICKS = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 45, 90)
_MARKERS = ("", "o", "s", "^")  # of lobes of one component that have the same line style


def parameters_figure(model: DSBRDF, *, title: str = "") -> Figure:
    """Amplitude of each lobe in red, green and blue, its half width and its elongation, over theta_diff.

    Parameters
    ----------
    model : DSBRDF
    title : str, optional
        Such as the name of the material.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    figure = empty_figure(title, 2, height=ROW_HEIGHT + 0.4)
    amplitudes, widths, elongations = figure.subplots(1, 3)
    parameters = model.parameters_at(_ANGLES)
    reaches = np.degrees(lobe_reaches(model, _ANGLES)[0])
    degrees = np.degrees(_ANGLES)
    for component in decompose(model):
        colour = LOBE_COLOURS[component.label]
        for lobe in component.lobes:
            repeat, style = divmod(lobe, len(LINE_STYLES))
            look = {
                "linestyle": LINE_STYLES[style],
                "linewidth": 1.2,
                "marker": _MARKERS[repeat % len(_MARKERS)],
                "markevery": 25,
                "markersize": 3.5,
            }
            label = f"{lobe}: {component.label.replace('_', ' ')}{' (ring)' if model.is_ring[lobe] else ''}"
            for channel, channel_colour in enumerate(CHANNEL_COLOURS):
                amplitudes.plot(degrees, parameters["amplitude"][:, channel, lobe], color=channel_colour, **look)
            widths.plot(degrees, reaches[:, lobe], color=colour, label=label, **look)
            elongations.plot(degrees, parameters["elongation"][:, lobe], color=colour, **look)
    amplitudes.set(yscale="log", title="amplitude in red, green and blue [1/sr]")
    widths.set(yscale="log", title="half width [degrees]")
    low, high = widths.get_ylim()
    ticks = [tick for tick in _WIDTH_TICKS if low <= tick <= high]
    widths.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    widths.set_yticks([], minor=True)
    elongations.set(title="elongation, 0 for a round lobe")
    for ax in (amplitudes, widths, elongations):
        ax.set(xlim=(0, 90), xlabel=r"$\theta_\mathrm{diff}$ [degrees]", xticks=range(0, 91, 15))
        ax.title.set_fontsize(9)
        ax.tick_params(labelsize=8)
    draw_legend(figure, widths, columns=4)
    return figure
