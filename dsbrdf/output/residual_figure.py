"""Figure of where a fit differs from the measured profiles."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dsbrdf.data.grid import CHANNELS, THETA_DIFF, THETA_HALF
from dsbrdf.output.figure_layout import ROW_HEIGHT, empty_figure
from dsbrdf.output.figures import slice_means

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dsbrdf.data.reduction import Profiles
    from dsbrdf.model.dsbrdf import DSBRDF

_LIMIT = 100.0  # per cent: larger differences have the colour of this one
_TICKS = (0, 5, 20, 45, 90)  # degrees


def residual_figure(profiles: Profiles, model: DSBRDF) -> Figure:
    """Relative difference of fit and measurement, means over phi_diff, for each channel, theta_half and theta_diff.

    Where there is no measurement, the figure is grey.  The axis of theta_half is that of the grid, dense at the peak.
    """
    figure = empty_figure(profiles.name, 2, height=ROW_HEIGHT)
    fitted = np.stack([slice_means(model, row, profiles.horizon_cutoff, THETA_HALF) for row in range(THETA_DIFF.size)])
    measured = np.moveaxis(profiles.mean, 0, -1)
    used = (np.moveaxis(profiles.weight, 0, -1) > 0) & (measured > 0)
    percent = np.where(used, 100.0 * (fitted / np.where(used, measured, 1.0) - 1.0), np.nan)
    axes = figure.subplots(1, len(CHANNELS), sharey=True)
    for ax, channel, values in zip(axes, CHANNELS, np.moveaxis(percent, -1, 0), strict=True):
        image = ax.imshow(
            values, cmap="RdBu_r", vmin=-_LIMIT, vmax=_LIMIT, origin="lower", aspect="auto", interpolation="nearest"
        )
        ax.set_facecolor("0.85")
        ax.set_xticks(np.interp(np.radians(_TICKS), THETA_HALF, np.arange(THETA_HALF.size)), map(str, _TICKS))
        ax.set_yticks(range(0, 91, 15))
        ax.set_title(channel, fontsize=9)
        ax.set_xlabel(r"$\theta_\mathrm{half}$ [degrees]")
        ax.tick_params(labelsize=8)
    axes[0].set_ylabel(r"$\theta_\mathrm{diff}$ [degrees]")
    bar = figure.colorbar(image, ax=axes, label="(fit - measured) / measured [%]", extend="both")
    bar.ax.tick_params(labelsize=8)
    return figure
