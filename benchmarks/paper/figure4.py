"""Figure 4: relative RMS of every material, for the paper's procedure, the default fit and the floor.

Above: relative_rms of every material, sorted by that of the paper's procedure, on a logarithmic axis; the default fit
and the floor beside it. Below: spheres of the largest and the smallest of its errors, from top to bottom the paper's
procedure, the default fit and the data.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.paper.base import (
    DEFAULT_COLOUR,
    FLOOR_COLOUR,
    PAPER_COLOUR,
    Claim,
    Computed,
    Material,
    Numbers,
    Row,
    draw_sphere,
    new_figure,
    sphere,
    to_bytes,
)
from dsbrdf import DSBRDF, Measurement
from dsbrdf.data import DEFAULT_HORIZON_CUTOFF
from dsbrdf.fitting import relative_errors, sample_errors
from dsbrdf.rendering import exposure, sphere_normals

ERRORS = ("paper", "default", "floor", "symmetric_floor")
INNER_ROWS = 76
"""Rows of theta_diff, 0 to 75 degrees: of the paper's slices the last with data within the horizon cutoff is at 75."""
INNER = ("paper_to_75_deg", "default_to_75_deg", "floor_to_75_deg")
_SIZE = 96
_N_WORST_SHOWN = 5
_N_BEST_SHOWN = 3


def choose(materials: Sequence[Material]) -> list[Material]:
    """Choose all materials."""
    return list(materials)


def measure(material: Material) -> Numbers:
    """Errors of both fits, their sizes, and spheres of the paper's procedure, the default fit and the data."""
    paper, default = material.fit(method="paper"), material.fit()
    metrics = default.report.metrics
    measured = sphere(material.measurement, _SIZE)
    factor = exposure(measured, sphere_normals(_SIZE)[1])
    pictures = (sphere(paper.model, _SIZE), sphere(default.model, _SIZE), measured)
    return {
        "paper": np.array(paper.report.metrics.relative_rms),
        "default": np.array(metrics.relative_rms),
        "floor": np.array(metrics.floor),
        "symmetric_floor": np.array(metrics.symmetric_floor),
        **_inner_errors(material.measurement, paper.model, default.model),
        "n_lobes": np.array([paper.model.n_lobes, default.model.n_lobes]),
        "n_numbers": np.array([paper.report.n_numbers, default.report.n_numbers]),
        "spheres": np.stack([to_bytes(picture, factor) for picture in pictures]),
    }


def _inner_errors(measurement: Measurement, paper: DSBRDF, default: DSBRDF) -> Numbers:
    """Errors over theta_diff from 0 to 75 degrees, where the paper's procedure need not extrapolate."""
    found = []
    for model in (paper, default):
        errors = relative_errors(sample_errors(model, measurement, DEFAULT_HORIZON_CUTOFF), rows=slice(0, INNER_ROWS))
        found.append((np.nan, np.nan) if errors is None else (errors.relative_rms, errors.floor))
    (of_paper, floor), (of_default, _) = found
    return dict(zip(INNER, map(np.array, (of_paper, of_default, floor)), strict=True))


def _sorted(computed: Sequence[Computed]) -> list[Computed]:
    """From the largest error of the paper's procedure to the smallest."""
    return sorted(computed, key=lambda one: -float(one["paper"]))


def table(computed: Sequence[Computed]) -> list[Row]:
    """Return the rows of the table."""
    rows: list[Row] = []
    for one in _sorted(computed):
        names = (*ERRORS, *INNER)
        errors = {name if "floor" in name else f"relative_rms_{name}": float(one[name]) for name in names}
        sizes = {
            f"{count}_{name}": int(value)
            for count in ("n_lobes", "n_numbers")
            for name, value in zip(("paper", "default"), one[count], strict=True)
        }
        rows.append({"material": one.name, "data": one.data, **errors, **sizes})
    return rows


def draw(computed: Sequence[Computed]) -> Figure:
    """Draw the figure."""
    ordered = _sorted(computed)
    shown = list(range(len(ordered)))
    if len(shown) > _N_WORST_SHOWN + _N_BEST_SHOWN:
        shown = shown[:_N_WORST_SHOWN] + shown[-_N_BEST_SHOWN:]
    figure = new_figure("Figure 4: relative RMS of every material", max(11.0, 0.19 * len(ordered)), 10.5)
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=[1.15, 1.0])[:, 0]
    _draw_errors(above.subplots(), ordered)
    below.suptitle("spheres of the largest errors of the paper's procedure, then of the smallest", fontsize=9)
    axes = below.subplots(3, len(shown), squeeze=False)
    for column, number in zip(axes.T, shown, strict=True):
        one = ordered[number]
        for ax, picture in zip(column, one["spheres"], strict=True):
            draw_sphere(ax, picture)
        column[0].set_title(one.label, fontsize=6.5)
    for ax, name in zip(axes[:, 0], ("paper's procedure", "default fit", "data"), strict=True):
        ax.set_ylabel(name, fontsize=8)
    return figure


def _draw_errors(ax: Axes, ordered: Sequence[Computed]) -> None:
    places = np.arange(len(ordered))
    looks = (
        ("paper", "s", PAPER_COLOUR, "paper's procedure, lobes by Williams' test"),
        (INNER[0], "s", PAPER_COLOUR, "the same, theta_diff up to 75 degrees only"),
        ("default", "o", DEFAULT_COLOUR, "default fit"),
        (INNER[1], "o", DEFAULT_COLOUR, "the same, theta_diff up to 75 degrees only"),
        ("floor", "_", FLOOR_COLOUR, "floor: the limit of any model without phi_diff"),
    )
    for name, marker, colour, label in looks:
        face = "none" if name in INNER else colour
        ax.plot(places, [one[name] for one in ordered], marker, color=colour, mfc=face, ms=4.5, label=label)
    ax.set(yscale="log", ylabel="relative RMS", xlim=(-0.7, len(ordered) - 0.3))
    ax.set_xticks(places, [one.label for one in ordered], rotation=90, fontsize=6)
    ax.grid(axis="y", which="both", alpha=0.25)
    ax.legend(fontsize=8, ncols=2, loc="upper right")


def claims(computed: Sequence[Computed]) -> list[Claim]:
    """Judge the sentences of the paper."""
    paper, default, floor = (np.array([float(one[name]) for one in computed]) for name in ERRORS[:3])
    inner, inner_default, inner_floor = (np.array([float(one[name]) for one in computed]) for name in INNER)
    count = len(computed)
    exceptions = [one.label for one, worse in zip(computed, default >= paper, strict=True) if worse]
    ratio, inner_ratio = paper / floor, inner / inner_floor
    worst = ", ".join(one.label for one in _sorted(computed)[:3])
    return [
        Claim(
            "The model represents a wide range of real-world isotropic BRDFs accurately.",
            "agrees" if np.median(paper) < 0.1 else "agrees in part" if np.median(inner) < 0.1 else "differs",
            f"relative_rms of the paper's procedure: {_spread(paper)}. Most of it lies beyond theta_diff = 75 degrees,"
            " where its slices have no data within the horizon cutoff and the last parameters are held; up to 75"
            f" degrees it is {_spread(inner)}. Default fit: {_spread(default)};"
            f" up to 75 degrees {_spread(inner_default)}.",
        ),
        Claim(
            "The accuracy is comparable to the non-parametric bivariate model.",
            "agrees" if np.median(ratio) < 1.5 else "agrees in part" if np.median(inner_ratio) < 2.0 else "differs",
            "The floor is the error of the best bivariate table. Error of the paper's procedure over the floor:"
            f" {_spread(ratio)}; up to 75 degrees {_spread(inner_ratio)}. Default fit: {_spread(default / floor)}; its"
            f" lobes are elongated, which takes it below the floor on {int(np.sum(default < floor))} of {count}.",
        ),
        Claim(
            "Beyond the paper: the default fit has a smaller error than the paper's procedure on every material.",
            "differs" if exceptions else "agrees",
            f"It has on {count - len(exceptions)} of {count}; exceptions: {', '.join(exceptions) or 'none'}. Factor"
            f" between the two errors: {_spread(paper / default)}. Up to 75 degrees it has on"
            f" {int(np.sum(inner_default < inner))} of {count}, factor {_spread(inner / inner_default)}.",
        ),
        Claim(
            "The large errors are mainly caused by subsurface scattering: lobes at the perimeter of theta_half.",
            "agrees in part",
            f"The largest errors are those of {worst}. This program cannot tell causes, but where: the median error of"
            f" all materials falls from {np.median(paper):.3f} to {np.median(inner):.3f} without the theta_diff beyond"
            " 75 degrees. Whether that is scattering below the surface, the perimeter of theta_half or a shiny peak"
            " that grows towards grazing angles, the figure does not separate.",
        ),
    ]


def _spread(values: NDArray[np.float64]) -> str:
    return f"median {np.median(values):.3f}, {values.min():.3f} to {values.max():.3f}"
