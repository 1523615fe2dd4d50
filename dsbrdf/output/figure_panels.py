"""Define the parts of figures: colours, rows of panels, legends, ticks, image files, and the panels of one slice.

A slice of theta_diff has two panels, one with all angles and one with the peak.
"""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING, Literal

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import THETA_DIFF, THETA_HALF
from dsbrdf.errors import InvalidArgumentError, one_of
from dsbrdf.extras import require

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase, SubFigure

    from dsbrdf.data.reduction import Profiles
    from dsbrdf.data.synthetic import Reflectance


IMAGE_FORMATS = ("png", "svg", "pdf")
"""Image formats in which figures can be written."""

CHANNEL_COLOURS = ("#c92a2a", "#2b8a3e", "#1c5fb8")
LINE_STYLES = ("-", "--", "-.", ":")
LOBE_COLOURS = ("#e8590c", "#7048e8", "#0c8599", "#c2255c", "#5c940d", "sienna", "#4263eb", "gray", "gold", "plum")
_WIDTH_IN = 11.0
ROW_HEIGHT_IN = 3.4
"""Height of a row of panels [inches]."""
_TITLE_HEIGHT_IN = 0.4
_MAX_LOG_TICKS = 6  # A logarithmic axis has at most this number of ticks, so that the labels do not overlap.
_TENTHS, _HALVES, _DIGITS = (np.arange(1.0, 10.0, step) for step in (0.1, 0.5, 1.0))
_TICK_MANTISSAS = (_TENTHS, _HALVES, _DIGITS, (1.0, 2.0, 5.0), (1.0, 3.0), (1.0,))


def encode_figure(figure: Figure, image_format: str = "png", *, dpi: float = 150.0) -> bytes:
    """Encode a figure as an image file in one of `IMAGE_FORMATS`; `dpi` is the resolution of a PNG.

    Raises InvalidArgumentError if the format is unknown.
    """
    if image_format not in IMAGE_FORMATS:
        raise InvalidArgumentError(f"the image format must be {one_of(IMAGE_FORMATS)}, not {image_format!r}")
    buffer = BytesIO()
    figure.savefig(buffer, format=image_format, dpi=dpi, metadata={"Date": None} if image_format == "svg" else None)
    return buffer.getvalue()


def empty_figure(title: str, height: float, *, fixed: bool = False) -> Figure:
    """Return a figure with a title and room for two pairs of panels; Matplotlib sets the margins unless `fixed`."""
    require("plot", "matplotlib", purpose="figures")
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    layout = None if fixed else ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.06)
    figure = Figure(figsize=(_WIDTH_IN, height), layout=layout)
    figure._repr_png_ = lambda: encode_figure(figure, dpi=80.0)  # type: ignore[attr-defined]  # Notebooks call this to show a figure.
    figure.suptitle(title, parse_math=False)  # A dollar sign in a material's name does not begin a formula.
    return figure


def figure_of_rows(title: str, heights: Sequence[float]) -> tuple[Figure, Iterable[SubFigure]]:
    """Return a figure with a title, and its rows of the given heights [inches], for panels with fixed margins."""
    figure = empty_figure("", _TITLE_HEIGHT_IN + sum(heights), fixed=True)
    parts = figure.subfigures(1 + len(heights), 1, squeeze=False, height_ratios=[_TITLE_HEIGHT_IN, *heights])
    head, *rows = parts[:, 0]
    # A dollar sign in a material's name does not begin a formula.
    head.suptitle(title, y=0.5, va="center", parse_math=False)
    return figure, rows


def draw_legend(
    figure: FigureBase, axes: Sequence[Axes], columns: int, place: Literal["outside lower center", "lower center"]
) -> None:
    """Draw one legend under the panels, which names each label of the lines in ``axes`` once."""
    lines = {str(line.get_label()): line for ax in axes for line in ax.get_legend_handles_labels()[0]}
    legend = figure.legend(list(lines.values()), list(lines), loc=place, ncols=columns, fontsize=8, frameon=False)
    for text in legend.get_texts():
        text.set_parse_math(False)


def set_ticks(ax: Axes) -> None:
    """Set a few round ticks within the final limits of both axes; angles up to 90 degrees get multiples of 15 or 30."""
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
    """Return round tick values for a logarithmic axis, as many as `_MAX_LOG_TICKS` allows."""
    decades = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1.0)
    for mantissas in _TICK_MANTISSAS:
        ticks = np.round([mantissa * 10.0**decade for decade in decades for mantissa in mantissas], 12)
        ticks = ticks[(ticks >= low) & (ticks <= high)]
        if ticks.size <= _MAX_LOG_TICKS:
            return ticks
    return ticks[:: -(-ticks.size // _MAX_LOG_TICKS)]


CURVE_THETA_HALF = np.concatenate([np.linspace(0.0, 1.0, 500)[:-1] ** 2 * np.pi / 2, [np.pi / 2]])
"""Angles theta_half [rad] at which curves are computed, dense at the peak."""
SLICE_ROWS = (0, 45)
"""Indices of the theta_diff whose slices are drawn, which are 0 and 45 degrees."""
PHI_DIFF_FRACTIONS = (np.arange(24) + 0.5) / 24
"""Angles phi_diff of a mean, as fractions of the way from 90 degrees to the smallest phi_diff within the cutoff."""
_TOP_MARGIN_IN = 0.6
_BOTTOM_MARGIN_IN = 0.6
_LEFT_MARGIN_IN = 0.7
_RIGHT_MARGIN_IN = 0.15
_LEGEND_LINE_HEIGHT_IN = 0.18
_MIN_PEAK_RATIO = 1.3  # A curve has no peak if the ratio of its highest to its lowest value is smaller.
_MAX_PEAK_THETA_HALF = np.radians(60.0)  # The end of a peak, where its curve is lowest, is searched up to this angle.


def panel_pairs(figure: FigureBase) -> list[tuple[Axes, Axes]]:
    """Return two panels side by side for each of `SLICE_ROWS`: one for all angles, and one for the peak."""
    axes = figure.subplots(1, 4, width_ratios=[1.7, 1.0] * 2)
    return list(zip(axes[::2], axes[1::2], strict=True))


def finish_row(figure: FigureBase, named: Sequence[Axes], columns: int) -> None:
    """Draw a legend at the bottom of a row, and set the margins of the row's panels."""
    draw_legend(figure, named, columns, "lower center")
    below = _BOTTOM_MARGIN_IN + _LEGEND_LINE_HEIGHT_IN * -(-len(figure.legends[0].get_texts()) // columns)
    figure.subplots_adjust(
        left=_LEFT_MARGIN_IN / _WIDTH_IN,
        right=1.0 - _RIGHT_MARGIN_IN / _WIDTH_IN,
        bottom=below / ROW_HEIGHT_IN,
        top=1.0 - _TOP_MARGIN_IN / ROW_HEIGHT_IN,
        wspace=0.36,
    )


def slice_means(
    model: Reflectance, row: int, horizon_cutoff: float | None, theta_half: Array = CURVE_THETA_HALF
) -> Array:
    """Return a model's means (n, 3) [1/sr] over phi_diff, at angles theta_half (n,) [rad].

    The argument `row` is the index of theta_diff on the measurement's grid. As in profiles, pairs with a direction
    farther than `horizon_cutoff` [rad] from the normal are left out; if no pair is left, the value at phi_diff = 90
    degrees is returned. The mean is over phi_diff up to 90 degrees only, because the values at phi_diff and at 180
    degrees - phi_diff are equal.
    """
    cutoff = np.pi / 2 if horizon_cutoff is None else horizon_cutoff
    level, swing = np.cos(theta_half) * np.cos(THETA_DIFF[row]), np.sin(theta_half) * np.sin(THETA_DIFF[row])
    first = np.arccos(np.clip((level - np.cos(cutoff)) / np.maximum(swing, 1e-12), 0.0, 1.0))
    phi_diff = np.pi / 2 - (np.pi / 2 - first)[:, None] * PHI_DIFF_FRACTIONS
    return model.evaluate(theta_half[:, None], THETA_DIFF[row], phi_diff).mean(axis=1)


def measured_means(profiles: Profiles, row: int, channel: int) -> tuple[Array, Array]:
    """Return theta_half [rad] and the measured mean over phi_diff [1/sr] at the nodes where the mean is positive."""
    mean = profiles.mean[channel, row]
    used = (profiles.weight[channel, row] > 0) & (mean > 0)
    return THETA_HALF[used], mean[used]


def set_limits(pair: tuple[Axes, Axes], row: int, fitted: Array, measured: Array) -> None:
    """Set the axes of two panels: all angles with a logarithmic scale, and the peak with a linear scale."""
    top = float(max(fitted.max(), measured.max(initial=0.0), 1e-6))
    bottom = float(measured.min(initial=top))
    all_angles, peak = pair
    all_angles.set(yscale="log", xlim=(-90, 90), ylim=(0.4 * bottom, 2.0 * top), ylabel="BRDF [1/sr]")
    all_angles.set_title(rf"$\theta_\mathrm{{diff}}$ = {np.degrees(THETA_DIFF[row]):.0f}°", fontsize=9)
    # The half width is where the curve is halfway between its highest and its lowest value. A nearly constant curve has
    # no peak, and a rise near the horizon is none.
    curve = fitted.reshape(CURVE_THETA_HALF.size, -1).sum(axis=1)
    lowest = int(np.argmin(curve[CURVE_THETA_HALF <= _MAX_PEAK_THETA_HALF]))
    high, low = float(curve[: lowest + 1].max()), float(curve[lowest])
    has_peak = high >= _MIN_PEAK_RATIO * low and high > 0.0
    half_width = CURVE_THETA_HALF[np.flatnonzero(curve[: lowest + 1] >= 0.5 * (high + low))[-1]] if has_peak else 0.0
    extent = min(4.0 * float(np.degrees(half_width)), 90.0) if has_peak else 90.0
    peak.set(xlim=(-extent, extent), ylim=(0.0, 1.08 * top))
    peak.set_title("the peak, linear axis" if has_peak else "the same, linear axis", fontsize=9)
    for ax in pair:
        ax.set_xlabel(r"$\theta_\mathrm{half}$ [degrees]")
        set_ticks(ax)
    if extent == 90.0:
        peak.set_xticks(range(-90, 91, 45))  # The panel of the peak is too narrow for more ticks.


def draw_curve(
    ax: Axes, values: Array, colour: str, *, label: str, style: str = "-", width: float | None = None
) -> None:
    """Draw a curve over `CURVE_THETA_HALF` and its mirror image; without `width`, a curve without a label is thin."""
    width = width or (1.2 if label else 0.8)
    ax.plot(*_mirrored(CURVE_THETA_HALF, values), style, color=colour, linewidth=width, label=label)


def draw_points(ax: Axes, theta_half: Array, values: Array, colour: str, marker: str, label: str) -> None:
    """Draw measured points as hollow markers, mirrored about theta_half = 0; leave out markers that would overlap."""
    spacing = np.radians(ax.get_xlim()[1] / 36.0)
    kept: list[int] = []
    for node, angle in enumerate(theta_half):
        if not kept or angle - theta_half[kept[-1]] >= spacing:
            kept.append(node)
    ax.plot(*_mirrored(theta_half[kept], values[kept]), marker, color=colour, mfc="none", ms=3.4, mew=0.6, label=label)


def _mirrored(theta_half: Array, values: Array) -> tuple[Array, Array]:
    """Return a curve over theta_half [degrees] with its mirror image on the negative side."""
    degrees = np.degrees(theta_half)
    return np.concatenate([-degrees[::-1], degrees]), np.concatenate([values[::-1], values])
