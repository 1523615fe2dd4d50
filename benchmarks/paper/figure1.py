"""Figure 1: slices at theta_diff = 0 in the incident plane, a fit of 3 lobes, and the lobes of it.

Row (a): measured values (squares) at phi_diff = 0 (right) and 90 degrees (left) and 3 lobes fitted by the paper's
procedure, for each colour channel. Row (b): its three lobes (red, green, blue), their sum and the data of the red
channel (black). Last row: the default fit. The axis is logarithmic, the paper's is linear.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.paper.base import Claim, Computed, Material, Numbers, Row, new_figure, preferred
from dsbrdf.data import CHANNELS, THETA_HALF
from dsbrdf.fitting import OUTSIDE_CENTER
from dsbrdf.output.figure_panels import CHANNEL_COLOURS

PREFERRED = ("nickel", "specular-blue-phenolic", "satin_purple", "ilm_l3_37_matte", "acrylic_felt_pink")
SIDES = ((-1.0, 90), (1.0, 0))  # sign of theta_half and phi_diff [degrees], which is also the column, as in the paper
LOBE_COLOURS = ("#e03131", "#2f9e44", "#1971c2")
_N_LOBES = 3
_DATA = "measured"


def choose(materials: Sequence[Material]) -> list[Material]:
    """Choose the materials of the figure."""
    return preferred(materials, PREFERRED, 5)


def measure(material: Material) -> Numbers:
    """Values (2 sides, 3, 90) of the data and the fits, and (lobes, 3, 90) of each lobe [1/sr]; which are valid."""
    measurement = material.measurement
    paper, default = material.fit(method="paper", n_lobes=_N_LOBES).model, material.fit().model
    columns = [column for _, column in SIDES]
    lobes = [paper.select((k,), with_delta=False).evaluate(THETA_HALF, 0.0).T for k in range(paper.n_lobes)]
    return {
        _DATA: np.moveaxis(measurement.stored[:, :, 0, columns] * measurement.scale[:, None, None], 2, 0),
        "valid": measurement.valid[:, 0, columns].T,
        "paper": np.stack([paper.evaluate(THETA_HALF, 0.0).T] * 2),
        "default": np.stack([default.evaluate(THETA_HALF, 0.0, np.radians(column)).T for column in columns]),
        "lobes": np.stack(lobes),
    }


def table(computed: Sequence[Computed]) -> list[Row]:
    """Return the rows of the table."""
    rows: list[Row] = []
    for one in computed:
        for side, (sign, phi) in enumerate(SIDES):
            for node in np.flatnonzero(one["valid"][side]).tolist():
                for channel, colour in enumerate(CHANNELS):
                    values = {key: one[key][side, channel, node] for key in (_DATA, "paper", "default")}
                    lobes = {f"lobe_{k + 1}": lobe[channel, node] for k, lobe in enumerate(one["lobes"])}
                    angle = sign * np.degrees(THETA_HALF[node])
                    where = {"material": one.name, "data": one.data, "theta_half_deg": angle, "phi_diff_deg": phi}
                    rows.append({**where, "channel": colour, **values, **lobes})
    return rows


def draw(computed: Sequence[Computed]) -> Figure:
    """Draw the figure."""
    figure = new_figure("Figure 1: slices at theta_diff = 0 in the incident plane", 3.1 * len(computed), 8.4)
    axes = figure.subplots(3, len(computed), squeeze=False)
    for column, one in zip(axes.T, computed, strict=True):
        bottom = max(0.3 * float(one[_DATA][:, :, :80].min()), 1e-4)
        top = 2.0 * float(max(one[_DATA].max(), one["paper"].max()))
        for ax, key in zip(column, ("paper", "", "default"), strict=True):
            ax.set(yscale="log", xlim=(-90, 90), ylim=(bottom, top), xticks=range(-90, 91, 45))
            ax.tick_params(which="both", labelsize=7)
            if key:
                _draw_channels(ax, one, key)
            else:
                _draw_lobes(ax, one)
        column[0].set_title(one.label, fontsize=9)
        column[2].set_xlabel(r"$\theta_\mathrm{half}$ [degrees]", fontsize=8)
    names = ("(a) paper's procedure, 3 lobes", "(b) its lobes, red channel", "default fit")
    for ax, name in zip(axes[:, 0], names, strict=True):
        ax.set_ylabel(f"{name}\nBRDF [1/sr]", fontsize=8)
    return figure


def _draw_channels(ax: Axes, one: Computed, key: str) -> None:
    """Draw squares for the data and lines for a fit, in the colours of the channels."""
    angles = np.degrees(THETA_HALF)
    for side, (sign, _) in enumerate(SIDES):
        shown = _spread_out(one["valid"][side])
        for channel, colour in enumerate(CHANNEL_COLOURS):
            data = one[_DATA][side, channel]
            ax.plot(sign * angles[shown], data[shown], "s", color=colour, mfc="none", ms=3.0, mew=0.5)
            ax.plot(sign * angles, one[key][side, channel], color=colour, lw=1.1)


def _draw_lobes(ax: Axes, one: Computed) -> None:
    """Draw the red channel: dots for the data, black for the fit, a colour for each lobe."""
    angles = np.degrees(THETA_HALF)
    for side, (sign, _) in enumerate(SIDES):
        shown = _spread_out(one["valid"][side])
        ax.plot(sign * angles[shown], one[_DATA][side, 0, shown], ".", color="black", ms=3.0)
        ax.plot(sign * angles, one["paper"][side, 0], color="black", lw=1.1)
        for colour, lobe in zip(LOBE_COLOURS, one["lobes"], strict=True):
            ax.plot(sign * angles, lobe[0], color=colour, lw=1.0)


def _spread_out(valid: NDArray[Any]) -> NDArray[np.intp]:
    """Nodes that are drawn: valid and at least 2 degrees apart."""
    steps = np.floor(np.degrees(THETA_HALF) / 2.0)
    return np.flatnonzero(valid & np.concatenate([[True], np.diff(steps) > 0]))


def relative_rms(one: Computed, key: str) -> float:
    """Error of a fit over the valid nodes from 1 degree on, both sides and all channels."""
    used = np.broadcast_to((one["valid"] & OUTSIDE_CENTER)[:, None], one[_DATA].shape)
    data, values = one[_DATA][used], one[key][used]
    return float(np.sqrt(np.sum((data - values) ** 2) / np.sum(data**2)))


def asymmetry(one: Computed) -> float:
    """Deviation of the two sides of the data from their mean, as a share of the data."""
    used = np.broadcast_to((one["valid"].all(axis=0) & OUTSIDE_CENTER)[None], one[_DATA].shape[1:])
    left, right = (one[_DATA][side][used] for side in range(2))
    return float(np.sqrt(0.5 * np.sum((left - right) ** 2) / np.sum(left**2 + right**2)))


def _half_widths(one: Computed) -> list[float]:
    """Largest theta_half at which each lobe of the red channel has half of its height [degrees]."""
    last = [np.flatnonzero(lobe >= 0.5 * lobe.max())[-1] for lobe in one["lobes"][:, 0]]
    return [float(np.degrees(THETA_HALF[node])) for node in last]


def claims(computed: Sequence[Computed]) -> list[Claim]:
    """Judge the sentences of the paper."""
    paper, default = ([relative_rms(one, key) for one in computed] for key in ("paper", "default"))
    sides = [asymmetry(one) for one in computed]
    widths = [_half_widths(one) for one in computed]
    distinct = [max(one) / max(min(one), 1e-3) for one in widths]
    shown = "; ".join(
        f"{one.label} {', '.join(f'{width:.2g}' for width in found)}"
        for one, found in zip(computed, widths, strict=True)
    )
    return [
        Claim(
            "The profiles of theta_diff = 0 slices are center-peaked and symmetric about theta_half = 0.",
            "agrees" if max(sides) < 0.05 else "agrees in part",
            f"The two sides (phi_diff 0 and 90 degrees) deviate from their mean by {min(sides):.1%} to {max(sides):.1%}"
            " of the data. That says little: at theta_diff = 0 both directions are the half vector, and phi_diff has no"
            " meaning there; what the symmetry costs at other theta_diff is the floor of Figure 4.",
        ),
        Claim(
            "The model with 3 lobes accurately fits the measured data despite the significantly varying shapes.",
            "agrees" if max(paper) < 0.1 else "agrees in part",
            f"In this slice relative_rms from 1 degree on is {min(paper):.3f} to {max(paper):.3f} for the paper's"
            f" procedure with 3 lobes, and {min(default):.3f} to {max(default):.3f} for the default fit, which fits"
            " all theta_diff at once.",
        ),
        Claim(
            "Each lobe clearly captures a distinct characteristic of the reflectance.",
            "agrees" if min(distinct) > 3.0 else "agrees in part",
            f"Half widths of the three lobes, red channel [degrees]: {shown}.",
        ),
    ]
