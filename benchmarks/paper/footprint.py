"""Footprint: error against the numbers stored, for this model, GGX lobes, small tables and another program's model.

The tables hold the mean over phi_diff at some nodes of theta_half and theta_diff, evenly spaced in the grid's indices,
and are interpolated linearly in them, logarithms of the values in between.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.paper.ggx import fit_ggx
from benchmarks.paper.materials import Computed, Material, Numbers, choose, fit_quietly
from benchmarks.paper.paper_figure import (
    DEFAULT_COLOUR,
    FLOOR_COLOUR,
    PAPER_COLOUR,
    Claim,
    PaperFigure,
    Row,
    new_figure,
    sphere,
)
from benchmarks.paper.table_interpolation import relative_rms
from dsbrdf.arrays import Evaluate
from dsbrdf.data.grid import DEFAULT_HORIZON_CUTOFF, PHI_DIFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.merl import read_merl
from dsbrdf.data.reduction import Profiles, profiles
from dsbrdf.fitting.options import FitOptions
from dsbrdf.model.render import sphere_likeness

__all__ = ["FIGURE", "SmallTable"]

Array = NDArray[np.float64]

PREFERRED = ("satin_purple", "vch_golden_yellow", "nickel", "specular-blue-phenolic")
MODEL, PARAMETRIC, GGX, TABLE, PEER = WAYS = ("default fit", "parametric fit", "GGX lobes", "table", "neural encoding")
LOBES = (1, 2, 3, 4)
"""Numbers of lobes, without rings, beside the automatic one."""
GGX_LOBES = (1, 2, 3)
TABLE_SIDES = (4, 6, 8, 10, 13, 16, 20, 26)
"""Nodes of theta_half, and of theta_diff: 48 to 2,028 numbers."""
PEER_NUMBERS = 675
"""Numbers of the neural encoding of Sztrajman et al. 2021."""
_SIZE = 64
_DARK = 1e-9  # [1/sr]: where the logarithm of a value is taken


@dataclass(frozen=True, eq=False)
class SmallTable:
    """Means over phi_diff at few nodes, shape (3, sides, sides) over theta_half and theta_diff [1/sr]."""

    nodes: Array

    @classmethod
    def of(cls, data: Profiles, side: int) -> "SmallTable":
        """Take evenly spaced nodes; where there are no data, the nearest theta_half with data."""
        filled = data.mean.transpose(0, 2, 1).copy()
        seen = (data.weight.sum(axis=0) > 0.0).T
        rows = np.arange(len(seen))
        for column in range(seen.shape[1]):
            known = np.flatnonzero(seen[:, column])
            if known.size:
                nearest = known[np.abs(rows[:, None] - known).argmin(axis=1)]
                filled[:, :, column] = filled[:, nearest, column]
        half, diff = (np.linspace(0, size - 1, side).round().astype(int) for size in seen.shape)
        return cls(filled[:, half][:, :, diff])

    @property
    def n_numbers(self) -> int:
        """Numbers stored."""
        return int(self.nodes.size)

    def evaluate(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:  # noqa: ARG002
        """Values (n, 3) for angles (n,) [1/sr]."""
        side = self.nodes.shape[1]
        # Of 0 to side - 1, where the nodes are: theta_half runs with the square of its index.
        places = (np.sqrt(theta_half / (np.pi / 2)) * THETA_HALF.size, theta_diff / (np.pi / 2) * THETA_DIFF.size)
        across, along = (np.clip(place / (THETA_DIFF.size - 1), 0.0, 1.0) * (side - 1) for place in places)
        i, j = (np.minimum(place.astype(np.intp), side - 2) for place in (across, along))
        u, v = across - i, along - j
        logs = np.log(np.maximum(self.nodes, _DARK))
        below = (1.0 - u) * logs[:, i, j] + u * logs[:, i + 1, j]
        above = (1.0 - u) * logs[:, i, j + 1] + u * logs[:, i + 1, j + 1]
        return np.exp((1.0 - v) * below + v * above).T


def _choose(materials: Sequence[Material]) -> list[Material]:
    return choose(materials, PREFERRED, len(PREFERRED))


def _measure(material: Material) -> Numbers:
    """For each way, numbers stored, relative_rms and PSNR of a sphere, shape (points, 3); the floor."""
    measurement = material.measurement
    lit = sphere(measurement, _SIZE)

    def likeness(source: Evaluate | Measurement) -> float:
        return sphere_likeness(lit, sphere(source, _SIZE))[0]

    def point(n_numbers: int, evaluate: Evaluate) -> list[float]:
        return [n_numbers, relative_rms(measurement, lambda i: _row(evaluate, i)), likeness(evaluate)]

    found: dict[str, list[list[float]]] = {way: [] for way in WAYS}
    for way, options in _fits():
        result = fit_quietly(measurement, options)
        error = result.report.metrics.relative_rms
        found[way].append([result.model.n_numbers, error or 0.0, likeness(result.model.evaluate_unmasked)])
    for count in GGX_LOBES:
        microfacets = fit_ggx(measurement, count, "plain", DEFAULT_HORIZON_CUTOFF)
        found[GGX].append(point(microfacets.n_numbers, microfacets.evaluate))
    means = profiles(measurement, horizon_cutoff=None)
    for side in TABLE_SIDES:
        table = SmallTable.of(means, side)
        found[TABLE].append(point(table.n_numbers, table.evaluate))
    if material.peer is not None:
        encoded = read_merl(material.peer)
        error = relative_rms(measurement, lambda i: encoded.stored[:, i] * encoded.scale[:, None, None])
        found[PEER].append([PEER_NUMBERS, error, likeness(encoded)])
    floor = material.fit().report.metrics.floor
    return {way: np.array(points).reshape(-1, 3) for way, points in found.items()} | {"floor": np.array(floor)}


def _fits() -> list[tuple[str, FitOptions]]:
    """Ways and options of the fits: with few lobes, and automatic."""
    ways = {MODEL: FitOptions(), PARAMETRIC: FitOptions(variation="parametric")}
    few = [(way, count) for way in ways for count in LOBES]
    numbered = [(way, FitOptions(n_lobes=count, ring_lobes=0, variation=ways[way].variation)) for way, count in few]
    return [*numbered, *ways.items()]


def _row(evaluate: Evaluate, i: int) -> Array:
    """Values on the theta_half row i, shape (3, 90 theta_diff, 180 phi_diff)."""
    theta_diff, phi_diff = (angles.ravel() for angles in np.meshgrid(THETA_DIFF, PHI_DIFF, indexing="ij"))
    values = evaluate(np.full(theta_diff.size, THETA_HALF[i]), theta_diff, phi_diff)
    return values.T.reshape(3, THETA_DIFF.size, PHI_DIFF.size)


def _table(computed: Sequence[Computed]) -> list[Row]:
    return [
        {
            "material": one.name,
            "data": one.data,
            "way": way,
            "numbers": int(numbers),
            "relative_rms": error,
            "psnr_db": psnr,
            "floor": float(one["floor"]),
        }
        for one in computed
        for way in WAYS
        for numbers, error, psnr in one[way]
    ]


def _draw(computed: Sequence[Computed]) -> Figure:
    figure = new_figure("Footprint: error against numbers stored", 3.2 * len(computed), 6.2)
    axes = figure.subplots(2, len(computed), squeeze=False, sharex=True)
    looks = {
        MODEL: ("-o", DEFAULT_COLOUR),
        PARAMETRIC: ("--o", DEFAULT_COLOUR),
        GGX: ("-s", PAPER_COLOUR),
        TABLE: ("-.", FLOOR_COLOUR),
        PEER: ("*", "black"),
    }
    for column, one in zip(axes.T, computed, strict=True):
        for way, (style, colour) in looks.items():
            points = one[way][np.argsort(one[way][:, 0], kind="stable")]
            for ax, values in zip(column, points[:, 1:].T, strict=True):
                ax.plot(points[:, 0], values, style, color=colour, ms=4, lw=1.1, label=way)
        column[0].axhline(float(one["floor"]), color="black", lw=0.6, ls=":", label="floor of models without phi_diff")
        column[0].set(xscale="log", yscale="log")
        column[0].set_title(one.label, fontsize=9)
        column[1].set_xlabel("numbers stored", fontsize=8)
        for ax in column:
            ax.tick_params(labelsize=7, which="both")
            ax.grid(alpha=0.25)
    axes[0, 0].set_ylabel("relative RMS", fontsize=8)
    axes[1, 0].set_ylabel("PSNR of a sphere [dB]", fontsize=8)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, fontsize=8, frameon=False)
    return figure


def _claims(computed: Sequence[Computed]) -> list[Claim]:
    automatic = np.array([one[MODEL][-1] for one in computed])
    parametric = np.array([one[PARAMETRIC][-1] for one in computed])
    needed = [_numbers_for(one[TABLE], own[1]) for one, own in zip(computed, automatic, strict=True)]
    told = ", ".join(f"{one.label} {number}" for one, number in zip(computed, needed, strict=True))
    smaller = sum(not number.isdigit() or int(number) > own[0] for number, own in zip(needed, automatic, strict=True))
    ggx = np.array([one[GGX][:, 1].min() for one in computed])
    share, cost = parametric[:, :2].T / automatic[:, :2].T
    claims = [
        Claim(
            "The model is as accurate as a non-parametric one with a much smaller footprint.",
            "agrees" if smaller == len(computed) else "agrees in part" if smaller else "differs",
            f"Numbers of the smallest table, of those up to {3 * TABLE_SIDES[-1] ** 2}, that has the error of the"
            f" default fit: {told}. The default fit stores {automatic[:, 0].min():.0f} to {automatic[:, 0].max():.0f}."
            f" Error of the best GGX model, at most {GGX_LOBES[-1]} lobes, over that of the default fit:"
            f" {np.median(ggx / automatic[:, 1]):.2f} (median).",
        ),
        Claim(
            "Future work of the paper: lobes whose change with theta_diff has few coefficients.",
            "agrees" if np.median(cost) < 1.1 else "agrees in part",
            f'variation="parametric" stores {np.median(share):.2f} of the numbers of the default fit and has'
            f" {np.median(cost):.2f} times its error (medians; errors {cost.min():.2f} to {cost.max():.2f}).",
        ),
    ]
    return claims + _peer_claim(computed)


def _peer_claim(computed: Sequence[Computed]) -> list[Claim]:
    pairs = [(one[MODEL][-1], one[PEER][0]) for one in computed if len(one[PEER])]
    if not pairs:
        return []
    better = [
        sum(bool(own[index] * sign < peer[index] * sign) for own, peer in pairs) for index, sign in ((1, 1), (2, -1))
    ]
    return [
        Claim(
            "Beyond the paper: a neural encoding of 675 numbers.",
            "agrees" if min(better) == len(pairs) else "agrees in part" if max(better) else "differs",
            f"With fewer numbers the default fit has a smaller error on {better[0]} and a higher PSNR on {better[1]} of"
            f" {len(pairs)}.",
        )
    ]


def _numbers_for(points: Array, error: float) -> str:
    """Return the least numbers that reach an error, or words."""
    enough = points[points[:, 1] <= error, 0]
    return f"{enough.min():.0f}" if enough.size else "none"


FIGURE = PaperFigure(
    name="footprint",
    title="error against the numbers stored",
    shows=(
        "Above: relative_rms, below: PSNR of a sphere in the light that all figures share, against the numbers that"
        " each model stores. Solid blue: fits with 1 to 4 lobes and, the last point, the automatic one. Dashed blue:"
        ' the same with variation="parametric". Red: Lambert and 1 to 3 GGX lobes. Grey: tables of means over phi_diff,'
        " linear in logarithms between the nodes. Star: another program's neural encoding, where its tables are given."
    ),
    choose=_choose,
    measure=_measure,
    table=_table,
    draw=_draw,
    claims=_claims,
    settings=f"{LOBES} {GGX_LOBES} {TABLE_SIDES}",
)
