"""Fits of few samples: errors at pairs of directions that none of them is near to, with 2 % noise.

Samples are 200, 1,000 or 5,000 pairs within 80 degrees, half of them where the material reflects, or 805 in five planes
of incidence. The error is that of the means over the channels, relative to the measurement, at 6,000 other pairs:
median and 95th percentile. "table" is the fit of the whole measurement, which is what more samples lead to. "said" is
the relative_rms at the samples of the fit, "true" that at the other pairs; "warned" if the report says that samples
left out of a fit tell of a larger error. What
materials are usually like is told by all but the one that is fitted.
"""

import argparse
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from benchmarks.material_filter import add_arguments, chosen_measurements
from dsbrdf.data.geometry import half_difference
from dsbrdf.data.interpolation import interpolate
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.scattered_samples import ScatteredSamples
from dsbrdf.errors import ConvergenceWarning
from dsbrdf.fitting import usual_materials
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import fit
from dsbrdf.fitting.report import FitReport
from dsbrdf.fitting.sample_bins import scattered_metrics
from dsbrdf.model.dsbrdf import DSBRDF
from tests.support.mixtures import scattered_directions

Array = NDArray[np.float64]

NAMES = "satin,golden_yellow,ilm,azure,red-plastic"
COUNTS = (200, None, 1000, 5000)  # None: in plane
NOISE, N_OTHERS = 0.02, 6000


def main(argv: Sequence[str] | None = None) -> int:
    """Print a line for each material and kind of samples."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks few_samples", description=__doc__)
    add_arguments(parser, every=1, names=NAMES)
    arguments = parser.parse_args(argv)
    print(f"{'':40}{'median':>9}{'p95':>9}{'said':>9}{'true':>9}")
    with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):
        for measurement in chosen_measurements(arguments):
            whole = fit(measurement).model
            others = drawn(measurement, *within_cutoff(whole, N_OTHERS, 99), noise=0.0)
            print_row(f"{measurement.name}, table", whole, others, None)
            with all_but(measurement.name):
                for count in COUNTS:
                    pairs = in_plane() if count is None else within_cutoff(whole, count, 1)
                    result = fit(drawn(measurement, *pairs, noise=NOISE))
                    kind = f"{len(pairs[0])} in plane" if count is None else str(count)
                    print_row(f"{measurement.name}, {kind}", result.model, others, result.report)
    return 0


@contextmanager
def all_but(name: str) -> Iterator[None]:
    """Leave a material out of those that tell what materials are usually like."""
    known = usual_materials.guides
    with usual_materials.STORED.open("rb") as file:
        kept = known()[np.load(file)["names"] != name]
    usual_materials.guides = lambda: kept  # type: ignore[assignment]
    try:
        yield
    finally:
        usual_materials.guides = known


def within_cutoff(model: DSBRDF, count: int, seed: int) -> tuple[Array, Array]:
    """Pairs up to 80 degrees from the normal, half of them where a model reflects."""
    first, second = scattered_directions(model, 3 * count, seed)
    within = np.flatnonzero(np.minimum(first[:, 2], second[:, 2]) > np.cos(np.radians(80.0)))
    chosen = np.random.default_rng(seed).permutation(within)[:count]
    return first[chosen], second[chosen]


def in_plane() -> tuple[Array, Array]:
    """Pairs in the plane of incidence, for five angles of incidence."""
    theta_in, theta_out = np.radians([0.0, 15.0, 30.0, 45.0, 60.0]), np.radians(np.linspace(-80.0, 80.0, 161))
    first, second = (angle.ravel() for angle in np.meshgrid(-theta_in, theta_out, indexing="ij"))
    omega_in, omega_out = (
        np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta)], axis=-1) for theta in (first, second)
    )
    return omega_in, omega_out


def drawn(measurement: Measurement, omega_in: Array, omega_out: Array, *, noise: float) -> ScatteredSamples:
    """Samples of a measurement with relative noise."""
    values = np.maximum(interpolate(measurement).evaluate(*half_difference(omega_in, omega_out)), 0.0)
    noisy = values * (1.0 + noise * np.random.default_rng(1).standard_normal(values.shape))
    return ScatteredSamples.from_arrays(omega_in, omega_out, noisy, name=measurement.name)


def print_row(name: str, model: DSBRDF, others: ScatteredSamples, report: FitReport | None) -> None:
    """Print the errors of a model."""
    expected = others.values.mean(axis=1)
    found = model.evaluate_directions(others.omega_in, others.omega_out).mean(axis=1)
    error = np.abs(found - expected) / np.maximum(expected, 1e-9)
    true = scattered_metrics(model, others, FitOptions().horizon_cutoff).relative_rms or 0.0
    said = "" if report is None else f"{report.metrics.relative_rms:.4f}"
    warned = "  warned" if report and any("left out of a fit" in sentence for sentence in report.warnings) else ""
    print(f"{name:40}{np.median(error):9.4f}{np.quantile(error, 0.95):9.3f}{said:>9}{true:9.4f}{warned}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
