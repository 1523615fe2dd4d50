"""Fits of few samples, or of samples in one plane, with 2 % noise: errors over all directions, and what is said.

Samples are drawn half in proportion to reflected light and half anywhere, up to 80 degrees from the normal, over all
directions or in one plane of incidence. "error" is the relative RMS at 6,000 other pairs over all directions, "median"
the median relative error of the channels' mean there; "expected" is what the report says of it, beside the ratio of
both. "plane" is the error at other pairs in the plane, "left out" what the report says of samples left out. With
``--next``, instead, the error after adding the twenty directions that the report names, beside twenty at random; a
report of samples that are enough names none.
"""

import argparse
import warnings
from collections.abc import Callable, Sequence

import numpy as np

from benchmarks.material_filter import add_arguments, chosen_measurements
from dsbrdf import ConvergenceWarning, FitResult, Measurement, ScatteredSamples, fit
from dsbrdf.arrays import Array
from dsbrdf.data import half_difference, spherical

Pairs = tuple[Array, Array]
Truth = Callable[[Array, Array], Array]

NAMES = "satin,aurora_white,golden_yellow,nickel,pickled-oak,merl_white-paint"
COUNTS = tuple((in_plane, count) for in_plane in (True, False) for count in (50, 100, 300, 1000, 5000))
NOISE = 0.02
N_OTHERS = 6000


def main(argv: Sequence[str]) -> int:
    """Print a line for each material and kind of samples, then the figures over all materials."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks few_samples", description=__doc__)
    add_arguments(parser, every=1, names=NAMES)
    parser.add_argument("--next", action="store_true", help="measure the directions that are named")
    arguments = parser.parse_args(argv)
    with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):
        for measurement in chosen_measurements(arguments):
            if arguments.next:
                print_next(measurement)
            else:
                print_errors(measurement)
    if not arguments.next:
        print_figures()
    return 0


_ERRORS: dict[tuple[bool, int], list[tuple[float, float, float]]] = {}


def print_errors(measurement: Measurement) -> None:
    """Print the errors of one material."""
    truth = truth_of(measurement)
    others = drawn(truth, N_OTHERS, 99, noise=0.0)
    for in_plane, count in COUNTS:
        result = fit(drawn(truth, count, 3, in_plane=in_plane))
        metrics, (error, median) = result.report.metrics, errors(result, others)
        expected = metrics.relative_rms_expected or np.nan
        near, _ = errors(result, drawn(truth, N_OTHERS, 98, in_plane=in_plane, noise=0.0))
        _ERRORS.setdefault((in_plane, count), []).append((error, median, expected))
        print(
            f"{measurement.name:26}{count:6}{' plane' if in_plane else '':6} error {error:6.3f} median {median:6.3f} "
            f"expected {expected:6.3f} ratio {error / expected:5.2f} | there {near:6.3f} left out "
            f"{metrics.relative_rms_left_out:6.3f} at samples {metrics.relative_rms:6.3f}",
            flush=True,
        )


def print_figures() -> None:
    """Print what is said of all materials."""
    plane, more = (np.array(_ERRORS[True, count])[:, 0] for count in (300, 5000))
    print(f"in one plane: largest {max(plane.max(), more.max()):.3f}, growth at most {(more / plane).max():.2f}")
    print(f"50 samples: median {np.median(np.array(_ERRORS[False, 50])[:, 1]):.3f}")
    rows = [row for (_, count), found in _ERRORS.items() if count <= 1000 for row in found]
    ratio = np.array([error / expected for error, _, expected in rows])
    print(
        f"true over expected, {ratio.size} tables of up to 1000 samples: median {np.median(ratio):.2f}, beyond it "
        f"{np.mean(ratio > 1.0):.0%}, p90 {np.quantile(ratio, 0.9):.2f}"
    )


def print_next(measurement: Measurement) -> None:
    """Print errors after twenty more samples, named by the report or at random, of five times 100 samples."""
    truth = truth_of(measurement)
    others, wins = drawn(truth, N_OTHERS, 99, noise=0.0), []
    for seed in range(5):
        pairs = directions_drawn(truth, 100, seed, in_plane=seed % 2 == 1)
        first = fit(samples_at(truth, pairs))
        if not first.report.measure_next:
            print(f"{measurement.name:26} before {errors(first, others)[0]:6.3f} nothing named", flush=True)
            continue
        theta_in, theta_out, phi = np.radians(
            [(pair.theta_in_deg, pair.theta_out_deg, pair.phi_deg) for pair in first.report.measure_next]
        ).T
        named = spherical(theta_in, np.zeros_like(phi)), spherical(theta_out, phi)
        found = [errors(first, others)[0]]
        for more in (named, directions_drawn(truth, 20, 50 + seed)):
            both = np.concatenate([pairs[0], more[0]]), np.concatenate([pairs[1], more[1]])
            found.append(errors(fit(samples_at(truth, both)), others)[0])
        wins.append(found[1] <= found[2])
        print(f"{measurement.name:26} before {found[0]:6.3f} named {found[1]:6.3f} random {found[2]:6.3f}", flush=True)
    print(f"{measurement.name:26} named are better in {sum(wins)} of {len(wins)}", flush=True)


def truth_of(measurement: Measurement) -> Truth:
    """The measurement's values at pairs of directions."""
    data = measurement.interpolated
    return lambda omega_in, omega_out: np.maximum(data.evaluate(*half_difference(omega_in, omega_out)), 0.0)


def directions_drawn(truth: Truth, count: int, seed: int, *, in_plane: bool = False) -> Pairs:
    """Pairs up to 80 degrees from the normal: half in proportion to reflected light, half anywhere."""
    random, many = np.random.default_rng(seed), 8 * count
    if in_plane:
        sines = random.uniform(-1.0, 1.0, many), random.uniform(0.0, 1.0, many)
        thetas, phis = [np.arcsin(np.sin(np.radians(80.0)) * sine) for sine in sines], [np.zeros(many)] * 2
    else:
        cosines = [np.sqrt(random.uniform(np.cos(np.radians(80.0)) ** 2, 1.0, many)) for _ in range(2)]
        thetas, phis = [np.arccos(cosine) for cosine in cosines], [random.uniform(0.0, 2.0 * np.pi, many) for _ in "io"]
    first, second = (spherical(theta, phi) for theta, phi in zip(thetas, phis, strict=True))
    light = truth(first, second).mean(axis=1) * first[:, 2]
    lit = random.choice(many, count // 2, replace=False, p=light / light.sum())
    chosen = np.concatenate([lit, random.choice(many, count - count // 2, replace=False)])
    return first[chosen], second[chosen]


def samples_at(truth: Truth, pairs: Pairs, noise: float = NOISE) -> ScatteredSamples:
    """Values with relative noise."""
    values = truth(*pairs)
    noisy = values * (1.0 + noise * np.random.default_rng(1).standard_normal(values.shape))
    return ScatteredSamples.from_arrays(*pairs, np.maximum(noisy, 0.0))


def drawn(truth: Truth, count: int, seed: int, *, in_plane: bool = False, noise: float = NOISE) -> ScatteredSamples:
    """Samples at `directions_drawn`."""
    return samples_at(truth, directions_drawn(truth, count, seed, in_plane=in_plane), noise)


def errors(result: FitResult, others: ScatteredSamples) -> tuple[float, float]:
    """Relative RMS, and median relative error of the channels' mean."""
    found, expected = result.model.evaluate_directions(others.omega_in, others.omega_out), others.values
    rms = float(np.sqrt(np.sum((found - expected) ** 2) / np.sum(expected**2)))
    mean = expected.mean(axis=1)
    return rms, float(np.median(np.abs(found.mean(axis=1) - mean) / np.maximum(mean, 1e-9)))
