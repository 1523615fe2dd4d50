"""How much the components change when the data change a little.

Each material is fitted as it is, with the horizon cutoff at 76 instead of 80 degrees, with 1 % noise, and with every
second row of theta_diff left out. The change of a component is that of its directional albedo at normal incidence,
channels added, as a share of it; components that hold less than 1 % of the albedo do not count.

With ``--tiny``, the changes are six that nobody would notice, and the figure is the range of psnr against spheres of
the unchanged measurement.
"""

import argparse
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.material_filter import add_arguments, chosen_measurements
from dsbrdf import ConvergenceWarning, FitOptions, Measurement, decompose, fit
from dsbrdf.arrays import Array
from dsbrdf.components import LABELS
from dsbrdf.rendering import render_sphere, sphere_likeness

NOISE = 0.01
TINY_NOISE = 0.001
CUTOFF = 76.0  # degrees
SMALLEST_SHARE = 0.01


def changes_of(measurement: Measurement) -> dict[str, tuple[Measurement, FitOptions]]:
    """The changed measurements, and the options that they are fitted with."""
    random = np.random.default_rng(0)
    noisy = measurement.values * (1.0 + NOISE * random.standard_normal(measurement.values.shape))
    noisy = np.where(measurement.values >= 0.0, np.maximum(noisy, 0.0), -1.0)
    thinned = measurement.valid.copy()
    thinned[:, 1::2] = False
    return {
        "cutoff 76 degrees": (measurement, FitOptions(horizon_cutoff_deg=CUTOFF)),
        "1 % noise": (Measurement.from_values(noisy, measurement.valid, measurement.name), FitOptions()),
        "every second theta_diff": (replace(measurement, valid=thinned), FitOptions()),
    }


def tiny_changes_of(measurement: Measurement) -> dict[str, tuple[Measurement, list[int]]]:
    """Return six nearly equal measurements, each with the order of its channels."""

    def noisy(seed: int) -> Measurement:
        factor = 1.0 + TINY_NOISE * np.random.default_rng(seed).standard_normal(measurement.stored.shape)
        return replace(measurement, stored=measurement.stored * factor)

    def without(place: tuple[slice | int, ...]) -> Measurement:
        valid = measurement.valid.copy()
        valid[place] = False
        return replace(measurement, valid=valid)

    usual, turned = [0, 1, 2], [2, 0, 1]
    exchanged = replace(measurement, stored=measurement.stored[turned], scale=measurement.scale[turned])
    return {
        "0.1 % noise": (noisy(1), usual),
        "0.1 % noise, other seed": (noisy(2), usual),
        "1 % brighter": (replace(measurement, scale=1.01 * measurement.scale), usual),
        "channels exchanged": (exchanged, turned),
        "without a theta_half": (without((20,)), usual),
        "without a theta_diff": (without((slice(None), 40)), usual),
    }


def likenesses(measurement: Measurement) -> Array:
    """Return psnr [dB] of the fits of a measurement and of its tiny changes, shape (7,)."""
    reference = render_sphere(measurement)
    found = []
    for changed, order in [(measurement, [0, 1, 2]), *tiny_changes_of(measurement).values()]:
        brightness = changed.scale.sum() / measurement.scale.sum()
        image = render_sphere(fit(changed).model) / brightness
        found.append(sphere_likeness(reference[..., order], image)[0])
    return np.array(found)


def print_likenesses(measurements: Iterable[Measurement]) -> None:
    """Print the range of psnr of each material under tiny changes, and the median and the largest range."""
    ranges = []
    for measurement in measurements:
        found = likenesses(measurement)
        ranges.append(np.ptp(found))
        print(f"{measurement.name:34} {ranges[-1]:5.2f} dB: {' '.join(f'{psnr:.2f}' for psnr in found)}", flush=True)
    print(f"range of psnr: median {np.median(ranges):.2f} dB, largest {max(ranges):.2f} dB")


def albedos(measurement: Measurement, options: FitOptions) -> Array:
    """Albedo of each component at normal incidence, channels added, 0 for an absent one, shape (3,)."""
    found = {component.label: component.albedo.sum() for component in decompose(fit(measurement, options).model)}
    return np.array([found.get(label, 0.0) for label in LABELS])


def main(argv: Sequence[str]) -> int:
    """Print the changes of each material and their spread."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks stability", description=__doc__)
    add_arguments(parser, every=7)
    parser.add_argument("--tiny", action="store_true", help="print the range of psnr under tiny changes instead")
    arguments = parser.parse_args(argv)
    found: dict[str, list[Array]] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        if arguments.tiny:
            print_likenesses(chosen_measurements(arguments))
            return 0
        print(f"{'relative change of the albedo of: ' + ', '.join(LABELS)}")
        for measurement in chosen_measurements(arguments):
            before = albedos(measurement, FitOptions())
            counts = before > SMALLEST_SHARE * before.sum()
            for what, (changed, options) in changes_of(measurement).items():
                change = np.abs(albedos(changed, options) - before) / np.where(counts, before, np.inf)
                found.setdefault(what, []).append(change[counts])
                cells = "".join(f"{c:9.1%}" if used else f"{'-':>9}" for c, used in zip(change, counts, strict=True))
                print(f"{measurement.name:34} {what:24}{cells}", flush=True)
    for what, every in (found | {"all": [np.concatenate(rows) for rows in found.values()]}).items():
        spread = np.quantile(np.concatenate(every), [0.5, 0.9, 1.0])
        print(f"{what:24} median {spread[0]:.1%}, p90 {spread[1]:.1%}, largest {spread[2]:.1%}")
    return 0
