"""Figure 5: error against subsampling of theta_half, the model against linear interpolation of the table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dsbrdf.data.grid import DEFAULT_HORIZON_CUTOFF
from dsbrdf.data.measurement import Measurement
from dsbrdf.errors import FitError
from dsbrdf.fitting.metrics import relative_errors, sample_errors
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import profiles_for
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.paper.materials import Computed, Material, Numbers, choose, fit_quietly
from dsbrdf.paper.paper_figure import DEFAULT_COLOUR, PAPER_COLOUR, Claim, PaperFigure, Row, Verdict, new_figure
from dsbrdf.paper.table_interpolation import means_over_phi, table_error, thinned

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FACTORS", "FIGURE", "crossing"]

FACTORS = (1, 2, 4, 8, 12, 16, 24)
WAYS = ("default", "table", "paper", "table_of_means")
PREFERRED = ("nickel", "specular-blue-phenolic", "orange-paint")
_MEASURED, _COUNT = 8, 11
_MODERATE = 4


def _choose(materials: Sequence[Material]) -> list[Material]:
    """Up to 8 measurements, then stand-ins of the materials that the paper shows elsewhere."""
    measured = choose([material for material in materials if material.measured], (), _MEASURED)
    others = [material for material in materials if material not in measured]
    return measured + choose(others, PREFERRED, min(_COUNT - len(measured), len(PREFERRED)))


def _measure(material: Material) -> Numbers:
    """relative_rms on the full data of each way after each factor, shape (ways, factors); the floor."""
    errors = [_errors(material, factor) for factor in FACTORS]
    return {"errors": np.array(errors).T, "floor": np.array(material.fit().report.metrics.floor)}


def _errors(material: Material, factor: int) -> list[float]:
    """relative_rms of each of `WAYS`."""
    full, default, paper = material.measurement, material.fit().model, material.fit(method="paper").model
    sparse = full
    if factor > 1:
        sparse = thinned(full, factor)
        default, paper = _fit(sparse, FitOptions()), _papers_fit(sparse, paper.n_lobes)
    return [
        _model_error(default, full),
        table_error(full, sparse),
        _model_error(paper, full),
        table_error(full, means_over_phi(sparse)),
    ]


def _papers_fit(sparse: Measurement, n_lobes: int) -> DSBRDF:
    """Fit by the paper's procedure with the lobes that the full data ask for, or as many as the rows allow."""
    while True:
        try:
            return _fit(sparse, FitOptions(method="paper", n_lobes=n_lobes))
        except FitError:
            if n_lobes == 1:
                raise
            n_lobes -= 1


def _fit(sparse: Measurement, options: FitOptions) -> DSBRDF:
    """Fit the profiles: the errors on the thinned samples themselves are of no use."""
    return fit_quietly(profiles_for(sparse, options), options).model


def _model_error(model: DSBRDF, full: Measurement) -> float:
    errors = relative_errors(sample_errors(model, full, DEFAULT_HORIZON_CUTOFF))
    return float("nan") if errors is None else errors.relative_rms


def crossing(model: NDArray[np.float64], table: NDArray[np.float64]) -> int | None:
    """Return the smallest factor from which on the model is never worse than the table; None if there is none."""
    worse = np.flatnonzero(~(model <= table))
    first = 0 if not worse.size else int(worse[-1]) + 1
    return FACTORS[first] if first < len(FACTORS) else None


def _crossings(one: Computed) -> tuple[int | None, int | None]:
    """Where the default fit crosses the table, and the paper's procedure the table of means."""
    default, table, paper, means = one["errors"]
    return crossing(default, table), crossing(paper, means)


def _table(computed: Sequence[Computed]) -> list[Row]:
    return [
        {
            "material": one.name,
            "data": one.data,
            "factor": factor,
            **{f"relative_rms_{way}": one["errors"][number, index] for number, way in enumerate(WAYS)},
            "floor": float(one["floor"]),
        }
        for one in computed
        for index, factor in enumerate(FACTORS)
    ]


def _draw(computed: Sequence[Computed]) -> Figure:
    columns = min(4, len(computed))
    lines = -(-len(computed) // columns)
    figure = new_figure("Figure 5: fewer rows of theta_half", 3.3 * columns, 2.6 * lines + 0.9)
    axes = figure.subplots(lines, columns, squeeze=False).ravel()
    looks = (
        ("-", DEFAULT_COLOUR, "default fit"),
        ("--", DEFAULT_COLOUR, "table, linear interpolation"),
        ("-", PAPER_COLOUR, "paper's procedure"),
        ("--", PAPER_COLOUR, "table of means over phi_diff"),
    )
    for ax, one in zip(axes, computed, strict=False):
        for values, (style, colour, label) in zip(one["errors"], looks, strict=True):
            ax.plot(FACTORS, values, style, color=colour, marker=".", ms=4, lw=1.2, label=label)
        ax.axhline(float(one["floor"]), color="black", lw=0.6, ls=":", label="floor")
        ax.set(xscale="log", yscale="log")
        ax.set_xticks(FACTORS, [str(factor) for factor in FACTORS], fontsize=7)
        ax.tick_params(axis="x", which="minor", labelbottom=False)
        ax.tick_params(axis="y", which="both", labelsize=7)
        ax.set_title(one.label, fontsize=9)
    for ax in axes[len(computed) :]:
        ax.set_axis_off()
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    figure.supxlabel("every n-th row of theta_half", fontsize=8)
    figure.supylabel("relative RMS on all data", fontsize=8)
    return figure


def _claims(computed: Sequence[Computed]) -> list[Claim]:
    found = [_crossings(one) for one in computed]
    measured = [pair for one, pair in zip(computed, found, strict=True) if one.measured]
    default, paper = ([pair[side] for pair in found] for side in range(2))
    at_four = FACTORS.index(_MODERATE)
    early = sum(factor is not None and factor <= _MODERATE for factor, _ in measured)
    listed = "; ".join(
        f"{one.label} {_factor(first)} and {_factor(second)}"
        for one, (first, second) in zip(computed, found, strict=True)
    )
    gains = np.array([one["errors"][1] / one["errors"][0] for one in computed])
    typical = ", ".join(f"{factor}: {gain:.2f}" for factor, gain in zip(FACTORS, np.median(gains, axis=0), strict=True))
    cost = np.array([one["errors"][0, at_four] / one["errors"][0, 0] for one in computed])
    return [
        Claim(
            "The model achieves higher accuracy than interpolation even when the data are only reduced moderately.",
            _verdict(default),
            f"Smallest factor from which on the fit is never worse, for the default fit against the table and for the"
            f" paper's procedure against the table of means over phi_diff: {listed}. The default fit is at or below the"
            f" table from a factor of 4 on for {early} of {len(measured)} measured materials. Error of the table over"
            f" that of the default fit, median at each factor: {typical}.",
        ),
        Claim(
            "The model is robust against subsampling.",
            "agrees" if np.median(cost) < 1.1 else "agrees in part",
            f"With every 4th row the default fit's error on all data is {np.median(cost):.2f} times that with all rows"
            f" (median; {cost.min():.2f} to {cost.max():.2f}).",
        ),
        Claim(
            "The paper's own curves cross: its model against the table of its measurements.",
            _verdict(paper),
            f"With the table of means, which like the paper's lobes knows nothing of phi_diff, the procedure crosses on"
            f" {sum(factor is not None for factor in paper)} of {len(paper)} materials. Its error hardly grows with the"
            " factor, but its error with all rows is often above that of the thinned table.",
        ),
    ]


def _verdict(crossings: Sequence[int | None]) -> Verdict:
    """Agreement where all cross at a factor of 4 or below."""
    early = sum(factor is not None and factor <= _MODERATE for factor in crossings)
    if early == len(crossings):
        return "agrees"
    return "agrees in part" if any(factor is not None for factor in crossings) else "differs"


def _factor(factor: int | None) -> str:
    return "never" if factor is None else str(factor)


FIGURE = PaperFigure(
    name="figure5",
    title="Fewer rows of theta_half",
    shows=(
        "relative_rms on all data after every n-th row of theta_half was kept. Solid: the default fit (blue) and the"
        " paper's procedure (red). Dashed: the table, interpolated linearly in theta_half or in its square root,"
        " whichever is better, with all its values over phi_diff (blue) and with means over phi_diff (red), which have"
        " the same information as the paper's lobes. Dotted: the floor of models without phi_diff."
    ),
    choose=_choose,
    measure=_measure,
    table=_table,
    draw=_draw,
    claims=_claims,
    settings=str(FACTORS),
)
