"""Figure 4: relative RMS of every material, for the paper's procedure, the default fit and the floor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dsbrdf.model.image_metrics import exposure
from dsbrdf.model.render import sphere_normals
from dsbrdf.paper.materials import Computed, Material, Numbers
from dsbrdf.paper.paper_figure import (
    DEFAULT_COLOUR,
    FLOOR_COLOUR,
    PAPER_COLOUR,
    Claim,
    PaperFigure,
    Row,
    draw_sphere,
    new_figure,
    sphere,
    to_bytes,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["FIGURE"]

ERRORS = ("paper", "default", "floor", "symmetric_floor")
_SIZE = 96
_WORST, _BEST = 5, 3  # materials whose spheres are shown
_PAPERS_LARGEST = 0.3  # about, read from the paper's figure


def _measure(material: Material) -> Numbers:
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
        "n_lobes": np.array([paper.model.n_lobes, default.model.n_lobes]),
        "n_numbers": np.array([paper.report.n_numbers, default.report.n_numbers]),
        "spheres": np.stack([to_bytes(picture, factor) for picture in pictures]),
    }


def _sorted(computed: Sequence[Computed]) -> list[Computed]:
    """From the largest error of the paper's procedure to the smallest."""
    return sorted(computed, key=lambda one: -float(one["paper"]))


def _table(computed: Sequence[Computed]) -> list[Row]:
    rows: list[Row] = []
    for one in _sorted(computed):
        errors = {name if "floor" in name else f"relative_rms_{name}": float(one[name]) for name in ERRORS}
        sizes = {
            f"{count}_{name}": int(value)
            for count in ("n_lobes", "n_numbers")
            for name, value in zip(("paper", "default"), one[count], strict=True)
        }
        rows.append({"material": one.name, "data": one.data, **errors, **sizes})
    return rows


def _draw(computed: Sequence[Computed]) -> Figure:
    ordered = _sorted(computed)
    shown = list(range(len(ordered)))
    if len(shown) > _WORST + _BEST:
        shown = shown[:_WORST] + shown[-_BEST:]
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
        ("default", "o", DEFAULT_COLOUR, "default fit"),
        ("floor", "_", FLOOR_COLOUR, "floor: the limit of any model without phi_diff"),
    )
    for name, marker, colour, label in looks:
        ax.plot(places, [one[name] for one in ordered], marker, color=colour, ms=4.5, label=label)
    ax.set(yscale="log", ylabel="relative RMS", xlim=(-0.7, len(ordered) - 0.3))
    ax.set_xticks(places, [one.label for one in ordered], rotation=90, fontsize=6)
    ax.grid(axis="y", which="both", alpha=0.25)
    ax.legend(fontsize=8, loc="lower left")


def _claims(computed: Sequence[Computed]) -> list[Claim]:
    paper, default, floor = (np.array([float(one[name]) for one in computed]) for name in ERRORS[:3])
    count = len(computed)
    below_floor = int(np.sum(default < floor))
    exceptions = [one.label for one, worse in zip(computed, default >= paper, strict=True) if worse]
    worst = _sorted(computed)[0]
    return [
        Claim(
            "The model represents a wide range of real-world isotropic BRDFs accurately.",
            "agrees" if np.median(paper) < 0.1 else "agrees in part",
            f"relative_rms of the paper's procedure: {_spread(paper)}; above {_PAPERS_LARGEST} on"
            f" {int(np.sum(paper > _PAPERS_LARGEST))} of {count}. Default fit: {_spread(default)}.",
        ),
        Claim(
            "The accuracy is comparable to the non-parametric bivariate model.",
            "agrees" if np.median(paper / floor) < 1.5 else "differs",
            f"The floor is the error of the best bivariate table: {_spread(floor)}. The paper's procedure has"
            f" {np.median(paper / floor):.2f} times that (median; {(paper / floor).min():.2f} to"
            f" {(paper / floor).max():.1f}), the default fit {np.median(default / floor):.2f} times"
            f" ({(default / floor).min():.2f} to {(default / floor).max():.2f}): its lobes are elongated, which takes"
            f" it below the floor on {below_floor} of {count}.",
        ),
        Claim(
            "Beyond the paper: the default fit has a smaller error than the paper's procedure on every material.",
            "agrees" if not exceptions else "differs",
            f"It has on {count - len(exceptions)} of {count}; exceptions: {', '.join(exceptions) or 'none'}. Factor"
            f" between the two errors: {_spread(paper / default)}.",
        ),
        Claim(
            "The large errors are mainly caused by subsurface scattering: lobes at the perimeter of theta_half.",
            "agrees in part",
            f"The largest error is that of {worst.label}. On the worst tenth the default fit, which has ring lobes and"
            f" elongated ones, lowers the median from {_worst_tenth(paper, paper):.3f} to"
            f" {_worst_tenth(default, paper):.3f}. Mirror-like materials are among the worst too; there the procedure"
            " misses the peak, not the perimeter.",
        ),
    ]


def _spread(values: NDArray[np.float64]) -> str:
    return f"median {np.median(values):.3f}, {values.min():.3f} to {values.max():.3f}"


def _worst_tenth(values: NDArray[np.float64], by: NDArray[np.float64]) -> float:
    """Median of the values at the largest tenth of another array."""
    count = max(1, by.size // 10)
    return float(np.median(values[np.argsort(-by)[:count]]))


FIGURE = PaperFigure(
    name="figure4",
    title="Relative RMS of every material",
    shows=(
        "Above: relative_rms of every material, sorted by that of the paper's procedure, on a logarithmic axis; the"
        " default fit and the floor beside it. Below: spheres of the largest and the smallest of its errors,"
        " from top to bottom the paper's procedure, the default fit and the data."
    ),
    choose=list,
    measure=_measure,
    table=_table,
    draw=_draw,
    claims=_claims,
)
