"""Outliers: what samples a hundred times too large cost the robust fit.

One sample in a hundred, of each channel by itself and with a fixed seed, is multiplied by 100. The table shows
relative_rms against the data without outliers: of the robust fit to these, of the robust fit to the data with
outliers, and the ratio of the two. Another ratio is that of the robust fit to the data without the nodes that were
hit: what it differs from 1 by is not the outliers' doing, but that other lobes are found on slightly other data.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.material_filter import add_arguments, chosen_measurements
from benchmarks.paper.materials import fit_quietly
from dsbrdf.data.measurement import Measurement
from dsbrdf.fitting.metrics import relative_errors, sample_errors
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import profiles_for

SHARE, FACTOR, SEED = 0.01, 100.0, 13
LARGEST_COST = 0.02
"""Of relative_rms, as a share."""
COLUMNS = ("all data", "with outliers", "ratio", "without nodes hit", "ratio")


def hit_samples(measurement: Measurement, seed: int = SEED) -> NDArray[np.bool_]:
    """Return which samples become outliers, shape (3, 90, 90, 180)."""
    return np.random.default_rng(seed).random(measurement.stored.shape) < SHARE


def spoiled(measurement: Measurement, hit: NDArray[np.bool_]) -> Measurement:
    """Return the measurement with outliers."""
    return replace(measurement, stored=np.where(hit, FACTOR * measurement.stored, measurement.stored))


def relative_rms(measurement: Measurement, truth: Measurement) -> float:
    """Fit a measurement robustly and return the error against the truth."""
    options = FitOptions(robust=True)
    model = fit_quietly(profiles_for(measurement, options), options).model
    errors = relative_errors(sample_errors(model, truth, options.horizon_cutoff))
    return float("nan") if errors is None else errors.relative_rms


def figures(measurement: Measurement) -> list[float]:
    """Errors of one material in the order of `COLUMNS`."""
    hit = hit_samples(measurement)
    left = replace(measurement, valid=measurement.valid & ~hit.any(axis=0))
    clean, outliers, without = (
        relative_rms(data, measurement) for data in (measurement, spoiled(measurement, hit), left)
    )
    return [clean, outliers, outliers / clean, without, without / clean]


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; the exit code is 1 if outliers cost more than they may on some material."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks robustness", description=__doc__)
    add_arguments(parser, every=1)
    found = []
    print(f"{'':34}{''.join(f'{name:>19}' for name in COLUMNS)}")
    for measurement in chosen_measurements(parser.parse_args(argv)):
        found.append(figures(measurement))
        print(f"{measurement.name:34}{''.join(f'{value:19.4f}' for value in found[-1])}", flush=True)
    for title, column in (("with outliers", 2), ("without the nodes hit", 4)):
        ratio = np.array(found)[:, column]
        within = int(np.sum(ratio <= 1.0 + LARGEST_COST))
        spread = f"median {np.median(ratio):.4f}, p90 {np.quantile(ratio, 0.9):.4f}, largest {ratio.max():.4f}"
        print(f"ratio {title}: {spread}; at most {1.0 + LARGEST_COST:g}: {within} of {len(ratio)}")
    return int(any(row[2] > 1.0 + LARGEST_COST for row in found))


if __name__ == "__main__":
    sys.exit(main())
