"""Define the common parts of all figures: sizes, colours, rows of panels, legends, ticks and image files."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING, Literal

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.errors import InvalidArgumentError, one_of
from dsbrdf.extras import require

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase, SubFigure

IMAGE_FORMATS = ("png", "svg", "pdf")
"""Image formats in which figures can be written."""

CHANNEL_COLOURS = ("#c92a2a", "#2b8a3e", "#1c5fb8")
LINE_STYLES = ("-", "--", "-.", ":")
LOBE_COLOURS = ("#e8590c", "#7048e8", "#0c8599", "#c2255c", "#5c940d", "#a0522d", "#4263eb", "#868e96")
PAIR_WIDTH_IN = 5.5
"""Width of two panels side by side [inches]."""
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


def empty_figure(title: str, pairs: int, *, height: float, fixed: bool = False) -> Figure:
    """Return a figure with a title and room for pairs of panels; Matplotlib sets the margins unless `fixed`."""
    require("plot", "matplotlib", purpose="figures")
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    layout = None if fixed else ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.06)
    figure = Figure(figsize=(PAIR_WIDTH_IN * pairs, height), layout=layout)
    figure._repr_png_ = lambda: encode_figure(figure, dpi=80.0)  # type: ignore[attr-defined]  # Notebooks call this to show a figure.
    figure.suptitle(title, parse_math=False)  # A dollar sign in a material's name does not begin a formula.
    return figure


def figure_of_rows(title: str, pairs: int, heights: Sequence[float]) -> tuple[Figure, Iterable[SubFigure]]:
    """Return a figure with a title, and its rows of the given heights [inches], for panels with fixed margins."""
    figure = empty_figure("", pairs, height=_TITLE_HEIGHT_IN + sum(heights), fixed=True)
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
    figure.legend(list(lines.values()), list(lines), loc=place, ncols=columns, fontsize=8, frameon=False)


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
