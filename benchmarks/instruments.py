"""What dsbrdf says of a good measurement and of the same measurement with a fault of an instrument.

For each fault: the codes of the findings, the PSNR of the fit against the measurement without the fault, and against
the measurement with it. ``--pictures FOLDER`` writes a strip of lit spheres for each fault of a paint, which the page
"What can be wrong with a measurement" shows: the measurement, the same with the fault, and the fit of this.
"""

import argparse
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

import dsbrdf
from benchmarks.material_filter import add_arguments, chosen_measurements
from dsbrdf import Measurement
from dsbrdf.arrays import Array
from dsbrdf.data import PHI_DIFF, THETA_DIFF, THETA_HALF, directions, half_difference, incident_cosines, read_rgl
from dsbrdf.output.sphere_panels import cut_out
from dsbrdf.rendering import sphere_likeness
from dsbrdf.rendering.sphere import displayed, exposure, sphere_normals

LOWEST = np.minimum(*incident_cosines(THETA_HALF[:, None, None], THETA_DIFF[:, None], PHI_DIFF))
SPHERE_PIXELS = 160
SIZE = 64
NAMES = "nickel,red-plastic,satin_purple,gold-paint,alumina-oxide"
PAINT = Path(__file__).parents[1] / "examples" / "satin_purple.bsdf"


def _random(values: Array) -> np.random.Generator:
    return np.random.default_rng(values.shape[1])


def _highlight(values: Array) -> float:
    """Return a typical value of the highlight, 3 degrees from its centre."""
    return float(values[:, 16, :30].mean())


def clipped(values: Array) -> Array:
    """Clip the highlight at its value 3 degrees from the centre."""
    return np.minimum(values, _highlight(values))


def eight_bits(values: Array) -> Array:
    """Round to steps of a hundredth of the highlight, as 8 bits do whose exposure just holds the highlight."""
    step = 0.01 * _highlight(values)
    return np.minimum(np.round(values / step), 255.0) * step


def stray_light(values: Array) -> Array:
    """Add a tenth of the highlight to every sample."""
    return values + 0.1 * _highlight(values)


def bad_horizon(values: Array) -> Array:
    """Multiply samples beyond 80 degrees by random factors, whose logarithms have a standard deviation of 1.5."""
    factors = np.exp(1.5 * _random(values).standard_normal(values.shape))
    return np.where(np.cos(np.radians(80.0)) > LOWEST, values * factors, values)


def no_centre(values: Array) -> Array:
    """Leave out theta_half below 2 degrees."""
    return np.where((THETA_HALF < np.radians(2.0))[:, None, None], -1.0, values)


def saturated_colour(values: Array) -> Array:
    """Subtract a little blue, as a colour outside of sRGB has."""
    return values - np.array([0.0, 0.0, 0.6 * float(np.median(values[2]))])[:, None, None, None]


def dead_time(values: Array) -> Array:
    """Lose counts of a detector at high rates: a quarter of them in the highlight."""
    return values / (1.0 + values / (3.0 * _highlight(values)))


def lamp_drift(values: Array) -> Array:
    """Change the lamp by 5 % from one sweep of equal theta_diff to the next."""
    return values * np.exp(0.05 * _random(values).standard_normal(THETA_DIFF.size))[:, None]


def tilted(values: Array) -> Array:
    """Tilt the sample by 0.3 degrees."""
    turn = np.radians(0.3)
    rotation = np.array([[np.cos(turn), 0.0, np.sin(turn)], [0.0, 1.0, 0.0], [-np.sin(turn), 0.0, np.cos(turn)]])
    source, result = Measurement.from_values(values, LOWEST > 0.0).interpolated, np.empty_like(values)
    for row, angle in enumerate(THETA_HALF):
        first, second = directions(angle, THETA_DIFF[:, None], PHI_DIFF)
        result[:, row] = np.moveaxis(source.evaluate(*half_difference(first @ rotation, second @ rotation)), -1, 0)
    return result


def exposure_step(values: Array) -> Array:
    """Merge two exposures whose calibration differs by 10 %."""
    return np.where(values > 0.5 * _highlight(values), 1.1 * values, values)


def repeated(values: Array) -> Array:
    """Repeat every second theta_half in place of its neighbour."""
    return np.repeat(values[:, ::2], 2, axis=1)


def swapped(values: Array) -> Array:
    """Exchange red and blue in the sweeps from 45 degrees of theta_diff on."""
    return np.concatenate([values[:, :, :45], values[::-1, :, 45:]], axis=2)


FAULTS: dict[str, Callable[[Array], Array]] = {
    function.__name__: function
    for function in (
        clipped,
        eight_bits,
        stray_light,
        bad_horizon,
        no_centre,
        saturated_colour,
        dead_time,
        lamp_drift,
        tilted,
        exposure_step,
        repeated,
        swapped,
    )
}


def with_fault(measurement: Measurement, fault: str) -> Measurement:
    """Return a measurement with a fault."""
    return Measurement.from_values(FAULTS[fault](np.maximum(measurement.values, 0.0)), measurement.valid, fault)


def likeness(measurement: Measurement, result: dsbrdf.FitResult) -> float:
    """Return the PSNR [dB] between lit spheres of a measurement and of a fit."""
    return sphere_likeness(dsbrdf.render_sphere(measurement, size=SIZE), dsbrdf.render_sphere(result, size=SIZE))[0]


def write_pictures(folder: Path) -> None:
    """Write a strip of spheres of each fault of the paint in ``examples``."""
    from PIL import Image

    paint = read_rgl(PAINT).measurement()
    folder.mkdir(parents=True, exist_ok=True)
    spheres = {"": dsbrdf.render_sphere(paint, size=SPHERE_PIXELS)}
    factor = exposure(spheres[""], sphere_normals(SPHERE_PIXELS)[1])
    for fault in FAULTS:
        spoiled = with_fault(paint, fault)
        panels = [
            spheres[""],
            *(dsbrdf.render_sphere(one, size=SPHERE_PIXELS) for one in (spoiled, dsbrdf.fit(spoiled))),
        ]
        strip = np.concatenate([cut_out(displayed(panel, factor)) for panel in panels], axis=1)
        Image.fromarray(np.rint(255.0 * strip).astype(np.uint8)).save(folder / f"{fault}.webp", quality=80)


def main(argv: Sequence[str] | None = None) -> int:
    """Print a row for each fault of each material, or write the pictures."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks instruments", description=__doc__)
    add_arguments(parser, every=1, names=NAMES)
    parser.add_argument("--pictures", type=Path, help="write the pictures of the documentation to this folder")
    arguments = parser.parse_args(argv)
    warnings.simplefilter("ignore", dsbrdf.ConvergenceWarning)
    if arguments.pictures is not None:
        write_pictures(arguments.pictures)
        return 0
    print(f"{'material':<24}{'fault':<18}{'truth':>7}{'data':>7}  findings")
    for measurement in chosen_measurements(arguments):
        for fault in ("", *FAULTS):
            spoiled = with_fault(measurement, fault) if fault else measurement
            result = dsbrdf.fit(spoiled)
            codes = " ".join(found.code for found in result.report.findings_of_fit)
            numbers = f"{likeness(measurement, result):>7.1f}{likeness(spoiled, result):>7.1f}"
            print(f"{measurement.name:<24}{fault or 'none':<18}{numbers}  {codes}", flush=True)
    return 0
