"""What the figures have in common: materials and their kept fits, numbers of each material, spheres, and files.

Fits and numbers are kept in a folder beside the figures, so that a run that was interrupted goes on from there. A kept
result counts for the same file, options and version of the algorithm.
"""

import csv
import sys
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from joblib import Memory, Parallel, delayed
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dsbrdf import (
    ALGORITHM_VERSION,
    ConvergenceWarning,
    DSBRDFError,
    FitOptions,
    FitResult,
    Measurement,
    Profiles,
    fit,
    read_merl,
    render_sphere,
)
from dsbrdf.rendering import displayed, sphere_normals
from dsbrdf.rendering.sphere import Source

Numbers = dict[str, NDArray[Any]]
Row = Mapping[str, object]
"""One line of a table, values by the names of the columns."""

LIGHTING = "environment"
"""The light of all spheres: a sky with sun, ground and window in place of the paper's light probe."""
PAPER_COLOUR = "#c92a2a"
DEFAULT_COLOUR = "#1c5fb8"
FLOOR_COLOUR = "#868e96"


class Claim(NamedTuple):
    """A sentence of the paper and what the numbers say of it."""

    paper: str
    verdict: Literal["agrees", "agrees in part", "differs"]
    found: str


@dataclass(frozen=True)
class Material:
    """One measurement file, and the folder in which its fits are kept.

    A stand-in is not measured: another program's description of a material was decoded into a table.
    """

    file: Path
    kept: Path
    measured: bool = True

    @property
    def name(self) -> str:
        """Name of the file without its suffix."""
        return self.file.stem

    @cached_property
    def measurement(self) -> Measurement:
        """The measurement, read when it is first used."""
        return read_merl(self.file)

    def fit(
        self, *, method: Literal["global", "paper"] = "global", n_lobes: int | Literal["auto"] = "auto"
    ) -> FitResult:
        """Fit the measurement, or take the fit that is kept."""
        fit_once = Memory(self.kept, verbose=0).cache(_fit, ignore=["material"])
        return fit_once(self, self.file, FitOptions(method=method, n_lobes=n_lobes), _version(self))


def _fit(material: Material, _file: Path, options: FitOptions, _version: object) -> FitResult:
    return fit_quietly(material.measurement, options)


def _version(material: Material) -> tuple[object, ...]:
    return material.file.stat().st_mtime_ns, ALGORITHM_VERSION


def fit_quietly(measurement: Measurement | Profiles, options: FitOptions) -> FitResult:
    """Fit without the warning that some slices did not converge: the figures show how good the fit is."""
    with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):
        return fit(measurement, options)


@dataclass(frozen=True, eq=False)
class Computed:
    """Numbers of a material, arrays by name."""

    name: str
    measured: bool
    numbers: Numbers

    def __getitem__(self, key: str) -> NDArray[Any]:
        return self.numbers[key]

    @property
    def data(self) -> str:
        """Kind of the data in one word."""
        return "measured" if self.measured else "stand-in"

    @property
    def label(self) -> str:
        """Name for a figure; stand-ins are marked with an asterisk."""
        return self.name if self.measured else f"{self.name}*"


class PaperFigure(Protocol):
    """Module of a figure: which materials it shows, their numbers, its table, picture and claims."""

    __name__: str

    def choose(self, materials: Sequence[Material]) -> list[Material]: ...  # noqa: D102
    def measure(self, material: Material) -> Numbers: ...  # noqa: D102
    def table(self, computed: Sequence[Computed]) -> list[Row]: ...  # noqa: D102
    def draw(self, computed: Sequence[Computed]) -> Figure: ...  # noqa: D102
    def claims(self, computed: Sequence[Computed]) -> list[Claim]: ...  # noqa: D102


def find_materials(folder: Path, kept: Path, names: Sequence[str] = (), stand_ins: str = "merl_*") -> list[Material]:
    """Find the measurements of a folder; `names` are with or without what precedes the first ``_`` of a file's name."""
    found = {file: {file.stem, file.stem.partition("_")[2]} for file in sorted(folder.glob("*.binary"))}
    if missing := [name for name in names or ("",) if not any(not name or name in known for known in found.values())]:
        raise SystemExit(f"{folder} contains no material {missing[0]}".rstrip())
    return [
        Material(file, kept, measured=not fnmatch(file.stem, stand_ins))
        for file, known in found.items()
        if not names or known & set(names)
    ]


def preferred(materials: Sequence[Material], names: Sequence[str], count: int) -> list[Material]:
    """Return `count` materials: the named ones that are there, in their order, then evenly spaced others."""
    by_name = {material.name.partition("_")[2] or material.name: material for material in materials}
    by_name |= {material.name: material for material in materials}
    chosen = list(dict.fromkeys(by_name[name] for name in names if name in by_name))[:count]
    others = [material for material in materials if material not in chosen]
    missing = min(count - len(chosen), len(others))
    places = np.linspace(0, len(others) - 1, missing).round().astype(int)
    return chosen + [others[place] for place in places]


def compute(figure: PaperFigure | ModuleType, materials: Sequence[Material], kept: Path, jobs: int) -> list[Computed]:
    """Compute the numbers of every material, several at once; a material that fails is named on stderr."""
    outcomes = Parallel(n_jobs=jobs)(delayed(_outcome)(figure.__name__, replace(one), kept) for one in materials)
    computed = []
    for material, outcome in zip(materials, outcomes, strict=True):
        if isinstance(outcome, str):
            print(f"{material.file}: {outcome}", file=sys.stderr)
        else:
            computed.append(Computed(material.name, material.measured, outcome))
    return computed


def _outcome(figure: str, material: Material, kept: Path) -> Numbers | str:
    """Return the numbers of a material, or why there are none."""
    try:
        return Memory(kept, verbose=0).cache(_measured, ignore=["material"])(
            figure, material, material.file, _version(material)
        )
    except DSBRDFError as error:
        return str(error)


def _measured(figure: str, material: Material, _file: Path, _version: object) -> Numbers:
    numbers: Numbers = sys.modules[figure].measure(material)
    return numbers


def save(figure: PaperFigure, computed: Sequence[Computed], output: Path) -> None:
    """Write a figure as ``.png``, ``.svg`` and ``.csv`` into a folder."""
    path = output / figure.__name__.rpartition(".")[2]
    drawn = figure.draw(computed)
    drawn.savefig(path.with_suffix(".png"), dpi=110.0)
    drawn.savefig(path.with_suffix(".svg"))
    rows = figure.table(computed)
    with path.with_suffix(".csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


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
