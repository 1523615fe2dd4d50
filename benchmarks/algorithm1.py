"""The fit against plain SciPy Algorithm 1, for the same number of lobes, on the same machine.

Plain SciPy is one ``least_squares(method="lm")`` call for each lobe, slice, channel and EM iteration on the raw
samples: the oracle that the tests hold the fit against. It needs minutes for a material, so four slices of one
channel are run for as many iterations as the batch needed there, and their time per iteration is multiplied by the
iterations of the whole material; ``--full`` runs every slice instead. Where both did the same number of iterations
their curves are compared.
"""

import argparse
import os
import statistics
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dsbrdf.data.grid import CHANNELS, THETA_DIFF, THETA_HALF
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.merl import read_merl
from dsbrdf.data.reduction import Profiles, profiles
from dsbrdf.data.synthetic import synthetic_measurement
from dsbrdf.errors import ConvergenceWarning
from dsbrdf.fitting import em
from dsbrdf.fitting.metrics import OUTSIDE_CENTER
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import fit
from dsbrdf.fitting.report import FitResult
from tests.support.algorithm_1 import algorithm_1, plain_lobe, raw_slice

Array = NDArray[np.float64]

SAMPLED = {(CHANNELS.index("green"), degrees) for degrees in (0, 25, 50, 70)}


def the_measurement(path: Path | None) -> Measurement:
    """Return the measurement of a file, of nickel or another reference material, or a synthetic plastic."""
    if path is None and (folder := os.environ.get("DSBRDF_REFERENCE_DATA")):
        files = sorted(Path(folder).glob("*.binary"), key=lambda file: (file.stem != "merl_nickel", file.stem))
        path = files[0] if files else None
    return synthetic_measurement(noise=0.02) if path is None else read_merl(path)


def seconds_of(run: Callable[[], FitResult], repeats: int) -> tuple[float, FitResult]:
    """Return the median time of several runs [s] and the result of the last."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = run()
        times.append(time.perf_counter() - start)
    return statistics.median(times), result


def plain_seconds(measurement: Measurement, options: FitOptions, work: dict[tuple[int, int], int]) -> dict[str, float]:
    """Time plain Algorithm 1 on (channel, row) pairs, and compare its curves with those of the batch code."""
    total, worst = 0.0, 0.0
    data = profiles(measurement, horizon_cutoff=options.horizon_cutoff)
    for (channel, row), iterations in work.items():
        samples = raw_slice(measurement, channel, row, horizon_cutoff=options.horizon_cutoff)
        start = time.perf_counter()
        found = algorithm_1(samples, int(options.n_lobes), iterations)
        total += time.perf_counter() - start
        ours, done = batch_curve(data, channel, row, int(options.n_lobes), iterations)
        if done == iterations:
            reference = sum(plain_lobe(THETA_HALF[OUTSIDE_CENTER], *parameters) for parameters in found)
            worst = max(worst, float(np.linalg.norm(ours - reference) / np.linalg.norm(reference)))
    return {"seconds": total, "difference": worst}


def batch_curve(data: Profiles, channel: int, row: int, n_lobes: int, iterations: int) -> tuple[Array, int]:
    """Return the curve of one slice by the batch code, and its number of iterations."""
    angles = THETA_HALF[OUTSIDE_CENTER]
    weight = np.where(THETA_HALF <= np.pi / 2 - THETA_DIFF[row] + 1e-9, data.weight[channel, row], 0.0)
    mean = data.mean[channel, row, OUTSIDE_CENTER]
    found = em.fit_slices(angles, mean[None], weight[None, OUTSIDE_CENTER], n_lobes, iterations=iterations)
    lobes = zip(found.kappa[0], found.gamma[0], strict=True)
    return np.asarray(sum(plain_lobe(angles, *lobe) for lobe in lobes)), int(found.iterations[0])


def fitted_slices(result: FitResult) -> dict[tuple[int, int], int]:
    """Return the EM iterations that the batch used on each (channel, row) that has data."""
    slices = result.report.knots
    rows = np.round(np.degrees(slices.theta_diff)).astype(int).tolist()
    return {
        (channel, row): slices.iterations[channel][index]
        for channel in range(len(CHANNELS))
        for index, row in enumerate(rows)
        if slices.fitted[channel][index]
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks algorithm1", description=__doc__)
    parser.add_argument("--n-lobes", type=int, default=3, help="number of lobes (default: 3)")
    parser.add_argument("--repeats", type=int, default=5, help="runs of which the median counts (default: 5)")
    parser.add_argument("--full", action="store_true", help="run plain SciPy on every slice: takes minutes")
    parser.add_argument("measurement", type=Path, nargs="?", help="MERL file (default: a reference material)")
    arguments = parser.parse_args(argv)
    measurement = the_measurement(arguments.measurement)
    paper = FitOptions(method="paper", n_lobes=arguments.n_lobes)
    usual = FitOptions(n_lobes=arguments.n_lobes)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        batch, result = seconds_of(lambda: fit(measurement, paper), arguments.repeats)
        default, _ = seconds_of(lambda: fit(measurement, usual), arguments.repeats)
    iterations = fitted_slices(result)
    total = sum(iterations.values())
    print_plain_and_ours(measurement, paper, iterations, full=arguments.full, ours={"batch": batch, "default": default})
    em_share = result.report.timings["em"]
    print(f"EM alone: {em_share:.3f} s of the batch fit, for {total} iterations of {len(iterations)} slices")
    return 0


def print_plain_and_ours(
    measurement: Measurement,
    options: FitOptions,
    iterations: dict[tuple[int, int], int],
    *,
    full: bool,
    ours: dict[str, float],
) -> None:
    """Time plain SciPy, and print one row for it and one for each of our fits."""
    total = sum(iterations.values())
    work = iterations if full else {key: iterations[key] for key in iterations.keys() & SAMPLED}
    plain = plain_seconds(measurement, options, work)
    seconds = plain["seconds"] * total / sum(work.values())
    how = (
        "every slice was run"
        if full
        else f"extrapolated to {total} slice iterations from {sum(work.values())} on {len(work)} slices"
    )
    print(f"{measurement.name}, {options.n_lobes} lobes, medians; plain SciPy: {how}")
    print(f"{'':42}{'seconds':>9}{'ratio':>8}")
    print(f"{'plain SciPy Algorithm 1, samples':42}{seconds:9.2f}{1:8.0f}")
    print(f"{'batch fit, method paper, whole call':42}{ours['batch']:9.2f}{seconds / ours['batch']:8.0f}")
    print(f"{'default method, whole call':42}{ours['default']:9.2f}{seconds / ours['default']:8.0f}")
    longest = seconds / total * options.em_iterations * len(iterations)
    print(
        f"plain SciPy without the batch's stopping rule, {options.em_iterations} iterations of every slice: "
        f"{longest:.0f} s (extrapolated)"
    )
    print(f"curves after the same number of EM iterations: relative difference at most {plain['difference']:.1e}")


if __name__ == "__main__":
    sys.exit(main())
