"""What the figures have in common: their parts, their three files, and drawing."""

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.paper.materials import Computed, Failure, Material, Measure, compute
from dsbrdf import InvalidArgumentError, render_sphere
from dsbrdf.data.files import write_atomically
from dsbrdf.output import encode_figure
from dsbrdf.rendering import displayed, sphere_normals
from dsbrdf.rendering.sphere import Source

__all__ = ["Claim", "Made", "PaperFigure", "Row", "Verdict", "draw_sphere", "make", "new_figure", "sphere", "to_bytes"]

Verdict = Literal["agrees", "agrees in part", "differs"]

Row = Mapping[str, object]
"""One line of a table, values by the names of the columns."""

LIGHTING = "environment"
"""The light of all spheres: a sky with sun, ground and window in place of the paper's light probe."""
PAPER_COLOUR = "#c92a2a"
DEFAULT_COLOUR = "#1c5fb8"
FLOOR_COLOUR = "#868e96"


@dataclass(frozen=True)
class Claim:
    """A sentence of the paper and what the numbers say of it."""

    paper: str
    verdict: Verdict
    found: str


@dataclass(frozen=True)
class PaperFigure:
    """One figure of the paper: which materials it shows, their numbers, its table, picture and claims.

    `name` is also that of its files; `settings` is what the numbers depend on besides the material.
    """

    name: str
    title: str
    shows: str
    choose: Callable[[Sequence[Material]], list[Material]]
    measure: Measure
    table: Callable[[Sequence[Computed]], list[Row]]
    draw: Callable[[Sequence[Computed]], Figure]
    claims: Callable[[Sequence[Computed]], list[Claim]]
    at_least: int = 1
    settings: str = ""


@dataclass(frozen=True, eq=False)
class Made:
    """A figure that was made: its numbers, its picture and the materials that failed."""

    figure: PaperFigure
    computed: list[Computed]
    picture: bytes
    failures: list[Failure]


def make(
    figure: PaperFigure,
    materials: Sequence[Material],
    output: Path,
    *,
    jobs: int = 1,
    progress: Callable[[float], None] = lambda _: None,
) -> Made:
    """Compute a figure and write ``NAME.png``, ``NAME.svg`` and ``NAME.csv`` into a folder.

    Numbers of each material are kept in ``kept/NAME`` inside. Raises InvalidArgumentError for too few materials.
    """
    computed, failures = compute(
        materials,
        figure.measure,
        output / "kept" / figure.name,
        settings=figure.settings,
        jobs=jobs,
        progress=progress,
    )
    if len(computed) < figure.at_least:
        reason = f"; {failures[0].file}: {failures[0].message}" if failures else ""
        wanted = f"{figure.at_least} material{'s' if figure.at_least > 1 else ''}"
        raise InvalidArgumentError(f"{figure.name} needs at least {wanted}, not {len(computed)}{reason}")
    drawn = figure.draw(computed)
    picture = encode_figure(drawn, "png", dpi=110.0)
    write_atomically(output / f"{figure.name}.png", [picture])
    write_atomically(output / f"{figure.name}.svg", [encode_figure(drawn, "svg")])
    write_atomically(output / f"{figure.name}.csv", [_csv(figure.table(computed))])
    return Made(figure, computed, picture, failures)


def _csv(rows: Sequence[Row]) -> bytes:
    text = StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def new_figure(title: str, width: float, height: float) -> Figure:
    """Return a figure with a title, of a size in inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    figure.suptitle(title, fontsize=11)
    return figure


def draw_sphere(ax: Axes, picture: NDArray[Any], caption: str = "", *, marked: bool = False) -> None:
    """Draw a displayed sphere, transparent beside it; a frame marks it."""
    _, mask = sphere_normals(len(picture))
    ax.imshow(np.dstack([picture, 255 * mask.astype(np.uint8)]), interpolation="antialiased")
    ax.set_title(caption, fontsize=8, color=PAPER_COLOUR if marked else "black")
    ax.set(xticks=[], yticks=[])
    for spine in ax.spines.values():
        spine.set(visible=marked, color=PAPER_COLOUR, linewidth=1.5)


def sphere(source: Source, size: int) -> NDArray[np.float64]:
    """Linear radiance of a sphere in the light that all figures share."""
    return render_sphere(source, lighting=LIGHTING, size=size)


def to_bytes(image: NDArray[np.float64], factor: float) -> NDArray[np.uint8]:
    """Return an image as a screen shows it, 0 to 255."""
    return np.rint(255.0 * displayed(image, factor)).astype(np.uint8)
