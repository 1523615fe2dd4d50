"""The default fit compared with the paper's procedure and with other models that a user could choose.

One row for each way to describe a material, medians over the materials. All see the same samples and are scored on all
of them with the definitions of `dsbrdf.fitting.metrics`; the columns "0-75" do so on theta_diff 0 to 75 degrees only,
the paper's own range. Peak memory is what Python allocates during the fit of the first material, the measurement
itself left out; the time is taken apart from it.
"""

import argparse
import sys
import time
import tracemalloc
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, kron

from benchmarks.material_filter import add_arguments, chosen_measurements
from benchmarks.paper.ggx import Objective, fit_ggx
from benchmarks.scoring import PAPER_RANGE, RowPredictor, Score, errors, of_model, of_profile
from dsbrdf.data.grid import DEFAULT_HORIZON_CUTOFF
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import profiles
from dsbrdf.errors import ConvergenceWarning
from dsbrdf.fitting.metrics import OUTSIDE_CENTER
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import fit

Array = NDArray[np.float64]
Fitted = tuple[RowPredictor, int]
Method = Callable[[Measurement], Fitted]

DEFAULT, LOG, SAME_SLICES = "default", 'weighting="log"', "3 lobes, knots every 5 degrees"
PAPER, PAPER_UNMASKED = "paper", "paper, no mask"
GGX_PLAIN, GGX_LOG = "Lambert + 2 GGX", "Lambert + 2 GGX, log"
TABLE = "table, as many numbers"
_TABLE_ROWS = (4, 6, 8, 11, 14, 18, 24, 30)
_OTHERS = ((0, 2), (0, 1))  # axes of a profile beside theta_diff, and beside theta_half
_PAPER_KNOTS = tuple(range(0, 81, 5))


@dataclass(frozen=True)
class Outcome:
    """The errors of one method on one material."""

    numbers: int
    everything: Score
    inside: Score
    seconds: float
    megabytes: float | None


def of_options(options: FitOptions) -> Method:
    """Method that fits the model of this library."""

    def describe(measurement: Measurement) -> Fitted:
        model = fit(measurement, options).model
        return of_model(model), model.n_numbers

    return describe


def of_ggx(n_lobes: int, objective: Objective) -> Method:
    """Method that fits Lambert plus GGX lobes."""

    def describe(measurement: Measurement) -> Fitted:
        model = fit_ggx(measurement, n_lobes, objective, DEFAULT_HORIZON_CUTOFF)
        return model.row, model.n_numbers

    return describe


def of_table(numbers: int) -> Method:
    """Return the method that stores a table over theta_diff and theta_half, and interpolates linearly.

    The nodes are evenly spaced in the grid's own indices, over the rows and columns with data; their values are those
    of least squares, which is better than thinning out the measurement. Of some shapes the best is taken.
    """

    def describe(measurement: Measurement) -> Fitted:
        data = profiles(measurement)
        weight = np.where(OUTSIDE_CENTER, data.weight, 0.0).reshape(3, -1)
        rows, columns = (np.flatnonzero(np.any(data.weight[..., OUTSIDE_CENTER] > 0, axis=axes)) for axes in _OTHERS)
        columns = np.flatnonzero(OUTSIDE_CENTER)[columns]
        best: tuple[float, Array, int] | None = None
        for n_rows in (count for count in _TABLE_ROWS if numbers >= 6 * count):
            n_columns = round(numbers / 3 / n_rows)
            hats = kron(_hats(rows, n_rows), _hats(columns, n_columns), format="csr")
            fits = [_least_squares(hats, *channel) for channel in zip(data.mean.reshape(3, -1), weight, strict=True)]
            profile = np.array(fits).reshape(data.mean.shape)
            error = float(np.sum(weight * (profile - data.mean).reshape(3, -1) ** 2))
            if best is None or error < best[0]:
                best = error, profile, 3 * hats.shape[1]
        if best is None:
            raise ValueError(f"a table needs at least {6 * _TABLE_ROWS[0]} numbers, not {numbers}")
        return of_profile(best[1]), best[2]

    return describe


def _hats(used: NDArray[np.intp], count: int) -> csr_array:
    """Return the weights of linear interpolation between nodes at each index, shape (90, nodes)."""
    nodes = used[np.unique(np.round(np.linspace(0, used.size - 1, min(count, used.size))).astype(np.intp))]
    return csr_array(np.array([np.interp(np.arange(90.0), nodes, unit) for unit in np.eye(nodes.size)]).T)


def _least_squares(hats: csr_array, mean: Array, weight: Array) -> Array:
    """Interpolate the node values that are closest to the mean; nodes without data are 0."""
    normal = (hats.T @ (hats * weight[:, None])).toarray()
    ridge = 1e-9 * normal.diagonal().max()
    values = np.linalg.solve(normal + ridge * np.eye(len(normal)), hats.T @ (weight * mean))
    return np.asarray(hats @ values)


def compare(measurement: Measurement, *, with_memory: bool) -> dict[str, Outcome]:
    """Apply every method to one material."""
    outcomes = {DEFAULT: _outcome(measurement, of_options(FitOptions()), with_memory=with_memory)}
    others: dict[str, Method] = {
        LOG: of_options(FitOptions(weighting="log")),
        SAME_SLICES: of_options(FitOptions(n_lobes=3, ring_lobes=0, knots_deg=_PAPER_KNOTS)),
        PAPER: of_options(FitOptions(method="paper", n_lobes=3)),
        PAPER_UNMASKED: of_options(FitOptions(method="paper", n_lobes=3, mask=0.0)),
        "Lambert + 1 GGX": of_ggx(1, "plain"),
        "Lambert + 1 GGX, log": of_ggx(1, "log"),
        GGX_PLAIN: of_ggx(2, "plain"),
        GGX_LOG: of_ggx(2, "log"),
        TABLE: of_table(outcomes[DEFAULT].numbers),
    }
    return outcomes | {name: _outcome(measurement, method, with_memory=with_memory) for name, method in others.items()}


def _outcome(measurement: Measurement, method: Method, *, with_memory: bool) -> Outcome:
    start = time.perf_counter()
    predict, numbers = method(measurement)
    seconds = time.perf_counter() - start
    megabytes = None
    if with_memory:
        tracemalloc.start()
        method(measurement)
        megabytes = tracemalloc.get_traced_memory()[1] / 1e6
        tracemalloc.stop()
    found = errors(measurement, predict, DEFAULT_HORIZON_CUTOFF)
    return Outcome(numbers, found.score(), found.score(PAPER_RANGE), seconds, megabytes)


def print_table(results: dict[str, dict[str, Outcome]]) -> None:
    """Print medians over the materials for each method, and the spread of the excess."""
    materials = list(results.values())
    print(f"Medians over {len(materials)} materials, horizon cutoff 80 degrees")
    heads = ("numbers", "relative_rms", "excess", "p90", "max", "male", "relative_rms 0-75", "excess 0-75", "male 0-75")
    print(f"| {'':30} | {' | '.join((*heads, 'seconds', 'MB'))} |")
    print("|---" * (len(heads) + 3) + "|")
    for name in materials[0]:
        rows = [material[name] for material in materials]
        excess = np.array([row.everything.excess for row in rows])
        figures = [
            np.median([row.numbers for row in rows]),
            np.median([row.everything.relative_rms for row in rows]),
            *np.nanquantile(excess, [0.5, 0.9, 1.0]),
            np.median([row.everything.male for row in rows]),
            np.median([row.inside.relative_rms for row in rows]),
            np.nanmedian([row.inside.excess for row in rows]),
            np.median([row.inside.male for row in rows]),
            np.median([row.seconds for row in rows]),
            max(row.megabytes or 0.0 for row in rows),
        ]
        print(f"| {name:30} | {' | '.join(f'{figure:.4g}' for figure in figures)} |")


def print_shares(results: dict[str, dict[str, Outcome]]) -> None:
    """Print on how many materials one method has smaller errors than another, and the exceptions."""

    def rms(outcome: Outcome) -> float:
        return outcome.everything.relative_rms

    def inner_rms(outcome: Outcome) -> float:
        return outcome.inside.relative_rms

    def male(outcome: Outcome) -> float:
        return outcome.everything.male

    comparisons: tuple[tuple[str, str, str, Callable[[Outcome], float]], ...] = (
        ("relative_rms", DEFAULT, PAPER, rms),
        ("relative_rms", DEFAULT, PAPER_UNMASKED, rms),
        ("relative_rms 0-75", DEFAULT, PAPER, inner_rms),
        ("relative_rms 0-75", DEFAULT, PAPER_UNMASKED, inner_rms),
        ("relative_rms 0-75", SAME_SLICES, PAPER, inner_rms),
        ("relative_rms", DEFAULT, GGX_PLAIN, rms),
        ("male", LOG, GGX_LOG, male),
        ("male", DEFAULT, GGX_LOG, male),
        ("relative_rms", DEFAULT, TABLE, rms),
    )
    print()
    for metric, ours, theirs, figure in comparisons:
        lost = {
            name: f"{name} {figure(outcome[ours]):.4g} against {figure(outcome[theirs]):.4g}"
            for name, outcome in results.items()
            if not figure(outcome[ours]) < figure(outcome[theirs])
        }
        share = 1.0 - len(lost) / len(results)
        exceptions = f"; not on {', '.join(lost.values())}" if lost else ""
        print(f"{metric}: {ours} beats {theirs} on {share:.1%} of the materials{exceptions}")


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table and the comparison of the methods."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks alternatives", description=__doc__)
    add_arguments(parser, every=10)
    measurements = chosen_measurements(parser.parse_args(argv))
    results: dict[str, dict[str, Outcome]] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        for measurement in measurements:
            outcomes = compare(measurement, with_memory=not results)
            results[measurement.name] = outcomes
            shown = ", ".join(f"{name} {outcome.everything.excess:.3f}" for name, outcome in outcomes.items())
            print(f"{measurement.name}: excess {shown}", file=sys.stderr, flush=True)
    print_table(results)
    print_shares(results)
    return 0


if __name__ == "__main__":
    sys.exit(main())
