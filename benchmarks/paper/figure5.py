"""Figure 5: error against subsampling of theta_half, the model against linear interpolation of the table.

relative_rms on all data after every n-th row of theta_half was kept. Solid: the default fit (blue) and the paper's
procedure (red). Dashed: the table, interpolated linearly in theta_half or in its square root, whichever is better, with
all its values over phi_diff (blue) and with means over phi_diff (red), which have the same information as the paper's
lobes. Dotted blue: the default fit, and the table of what it leaves at the kept rows. Dotted black: the floor of models
without phi_diff.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from matplotlib.figure import Figure

from benchmarks.paper.base import (
    DEFAULT_COLOUR,
    PAPER_COLOUR,
    Claim,
    Computed,
    Material,
    Numbers,
    Row,
    fit_quietly,
    new_figure,
    preferred,
)
from benchmarks.paper.table_interpolation import guided_table_error, means_over_phi, table_error, thinned
from dsbrdf import DSBRDF, FitError, FitOptions, Measurement
from dsbrdf.arrays import Array
from dsbrdf.data import DEFAULT_HORIZON_CUTOFF
from dsbrdf.fitting import relative_errors, sample_errors
from dsbrdf.pipeline import profiles_for

FACTORS = (1, 2, 4, 8, 12, 16, 24)
WAYS = ("default", "table", "paper", "table_of_means", "guided_table")
PREFERRED = ("nickel", "specular-blue-phenolic", "orange-paint")
_N_MEASURED = 8
_N_MATERIALS = 11
_MODERATE_FACTOR = 4
_ROUNDING = 1e-9  # an error below is that of a table with all rows


def choose(materials: Sequence[Material]) -> list[Material]:
    """Up to 8 measurements, then stand-ins of the materials that the paper shows elsewhere."""
    measured = preferred([material for material in materials if material.measured], (), _N_MEASURED)
    others = [material for material in materials if material not in measured]
    return measured + preferred(others, PREFERRED, min(_N_MATERIALS - len(measured), len(PREFERRED)))


def measure(material: Material) -> Numbers:
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
        guided_table_error(full, sparse, default.tabulate()),
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


def won(model: Array, table: Array) -> list[int]:
    """Return the factors at which the error of the model is at most that of the table."""
    return [factor for factor, better in zip(FACTORS, model <= table, strict=True) if better]


def table(computed: Sequence[Computed]) -> list[Row]:
    """Return the rows of the table."""
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


def draw(computed: Sequence[Computed]) -> Figure:
    """Draw the figure."""
    columns = min(4, len(computed))
    lines = -(-len(computed) // columns)
    figure = new_figure("Figure 5: fewer rows of theta_half", 3.3 * columns, 2.6 * lines + 1.0)
    axes = figure.subplots(lines, columns, squeeze=False).ravel()
    looks = (
        ("-", DEFAULT_COLOUR, "default fit"),
        ("--", DEFAULT_COLOUR, "table, linear interpolation"),
        ("-", PAPER_COLOUR, "paper's procedure"),
        ("--", PAPER_COLOUR, "table of means over phi_diff"),
        (":", DEFAULT_COLOUR, "default fit and table of what it leaves"),
    )
    for ax, one in zip(axes, computed, strict=False):
        for values, (style, colour, label) in zip(one["errors"], looks, strict=True):
            shown = np.where(values > _ROUNDING, values, np.nan)
            ax.plot(FACTORS, shown, style, color=colour, marker=".", ms=4, lw=1.2, label=label)
        ax.axhline(float(one["floor"]), color="black", lw=0.6, ls=":", label="floor")
        ax.set(xscale="log", yscale="log")
        ax.set_xticks(FACTORS, [str(factor) for factor in FACTORS], fontsize=7)
        ax.tick_params(axis="x", which="minor", labelbottom=False)
        ax.tick_params(axis="y", which="both", labelsize=7)
        ax.set_title(one.label, fontsize=9)
    for ax in axes[len(computed) :]:
        ax.set_axis_off()
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    figure.supylabel("relative RMS on all data; below: every n-th row of theta_half is kept", fontsize=8)
    return figure


def claims(computed: Sequence[Computed]) -> list[Claim]:
    """Judge the sentences of the paper."""
    default, table, paper, means, guided = np.moveaxis(np.array([one["errors"] for one in computed]), 1, 0)
    guided = np.where(guided > _ROUNDING, guided, 0.0)
    of_paper = [won(*pair) for pair in zip(paper, means, strict=True)]
    of_default = [won(*pair) for pair in zip(default, means, strict=True)]
    moderate = FACTORS.index(_MODERATE_FACTOR)
    of_guided = [won(*pair) for pair in zip(guided, table, strict=True)]
    cost = default[:, moderate] / default[:, 0]
    return [
        _moderate_claim(computed, default, table),
        Claim(
            "The model captures what a table of few rows misses.",
            _verdict(of_guided),
            "Where what the default fit leaves at the kept rows is interpolated and added to it, the error is at or"
            f" below that of the table alone at these factors, materials: {_counts(of_guided)}. Error of the table over"
            f" it at factor {_MODERATE_FACTOR}: {np.median(table[:, moderate] / guided[:, moderate]):.2f} (median).",
        ),
        Claim(
            "The same against a table that knows nothing of phi_diff, like the paper's lobes.",
            _verdict(of_default),
            "At or below the table of means over phi_diff, materials at each factor: the default fit"
            f" {_counts(of_default)}; the paper's procedure {_counts(of_paper)}. The error of the procedure hardly"
            " grows with the factor as long as it finds nodes enough for its lobes, but with all rows it is above the"
            " floor already, mostly beyond theta_diff = 75 degrees (Figure 4).",
        ),
        Claim(
            "The model is robust against subsampling.",
            "agrees" if np.median(cost) < 1.2 else "agrees in part",
            f"With every {_MODERATE_FACTOR}th row the default fit's error on all data is {np.median(cost):.2f} times"
            f" that with all rows (median; {cost.min():.2f} to {cost.max():.2f}).",
        ),
    ]


def _moderate_claim(computed: Sequence[Computed], default: Array, table: Array) -> Claim:
    """Judge the errors of the default fit against those of the whole table, each of shape (materials, factors)."""
    against = [won(*pair) for pair in zip(default, table, strict=True)]
    measured = [factors for one, factors in zip(computed, against, strict=True) if one.measured]
    listed = "; ".join(
        f"{one.label} {', '.join(map(str, factors)) or 'none'}" for one, factors in zip(computed, against, strict=True)
    )
    gains = ", ".join(
        f"{factor}: {gain:.2f}" for factor, gain in zip(FACTORS, np.median(table / default, axis=0), strict=True)
    )
    hopeless = int(np.sum(default[:, 0] > table[:, FACTORS.index(_MODERATE_FACTOR)]))
    return Claim(
        "The model achieves higher accuracy than interpolation even when the data are only reduced moderately.",
        _verdict(against),
        "Factors at which the default fit is at or below the table with all its values over phi_diff: "
        f"{listed}. Materials, of {len(computed)}, at each factor: {_counts(against)}; of the {len(measured)}"
        f" measured ones: {_counts(measured)}. Error of the table over that of the default fit, median: {gains}."
        f" On {hopeless} of {len(computed)} the error of the default fit with all rows is above that of the table"
        f" with every {_MODERATE_FACTOR}th already, which stores a million numbers: rows cannot mend that. With so few"
        " rows that peaks fall between them, neither is of use.",
    )


def _verdict(found: Sequence[Sequence[int]]) -> Literal["agrees", "agrees in part", "differs"]:
    """Agreement where the model wins at a moderate factor on most materials."""
    share = np.mean([_MODERATE_FACTOR in factors for factors in found])
    if share > 0.8:
        return "agrees"
    return "agrees in part" if any(found) else "differs"


def _counts(found: Sequence[Sequence[int]]) -> str:
    """Tell on how many materials the model wins at each factor."""
    return ", ".join(f"{factor}: {sum(factor in factors for factors in found)}" for factor in FACTORS)
