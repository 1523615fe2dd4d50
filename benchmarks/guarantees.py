"""What every fitted model promises, tried on many pairs of directions.

For each material 1,000,000 random pairs above the horizon and 200,000 within 3 degrees of the mirror direction (a tenth
of the theta_out of these at grazing angles): negative and non-finite values, the largest relative difference of f(in,
out) and f(out, in), and of steps of 0.001 degrees of theta_half, theta_diff and phi_diff the largest change of f, as a
share of the largest f within a fifth of a degree of theta_half. Components are checked for negative values and for
their sum.
"""

import argparse
import warnings
from collections.abc import Sequence

import numpy as np

from benchmarks.material_filter import add_arguments, chosen_measurements
from dsbrdf import DSBRDF, ConvergenceWarning, decompose, fit
from dsbrdf.arrays import Array
from dsbrdf.data import half_difference

ANGLE_STEP = float(np.radians(0.001))
REACH = np.radians(np.linspace(-0.2, 0.2, 9))
HEADS = ("negative", "not finite", "reciprocity", "step half", "step diff", "step phi", "sum of parts")


def directions(z: Array, azimuth: Array) -> Array:
    """Unit vectors with these heights."""
    radius = np.sqrt(np.maximum(1.0 - z * z, 0.0))
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=-1)


def pairs(count: int, n_mirror: int) -> tuple[Array, Array]:
    """Random pairs of directions, and pairs within 3 degrees of the mirror direction."""
    random = np.random.default_rng(0)
    total = count + n_mirror
    first, second = (directions(random.uniform(0.0, 1.0, total), random.uniform(0.0, 2 * np.pi, total)) for _ in "ab")
    grazing = slice(count, count + n_mirror // 10)
    first[grazing] = directions(random.uniform(0.0, 0.1, n_mirror // 10), random.uniform(0.0, 6.3, n_mirror // 10))
    mirror = first[count:] * np.array([-1.0, -1.0, 1.0])
    side = np.cross(mirror, random.standard_normal(mirror.shape))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    turn = np.radians(3.0) * np.sqrt(random.uniform(size=(n_mirror, 1)))
    tilted = np.cos(turn) * mirror + np.sin(turn) * side
    second[count:] = np.where(tilted[:, 2:] > 0.0, tilted, mirror)
    return first, second


def check(model: DSBRDF, omega_in: Array, omega_out: Array) -> list[float]:
    """Figures in the order of `HEADS`."""
    value = model.evaluate_directions(omega_in, omega_out)
    swapped = model.evaluate_directions(omega_out, omega_in)
    parts = [component.evaluate_directions(omega_in, omega_out) for component in decompose(model)]
    theta_half, theta_diff, phi_diff = half_difference(omega_in, omega_out)
    theta_half, theta_diff = (
        np.minimum(theta_half, np.pi / 2 - ANGLE_STEP),
        np.minimum(theta_diff, np.pi / 2 - ANGLE_STEP),
    )
    here = model.evaluate_unmasked(theta_half, theta_diff, phi_diff)
    scale = here.copy()
    for shift in REACH.tolist():
        np.maximum(
            scale, model.evaluate_unmasked(np.clip(theta_half + shift, 0.0, np.pi / 2), theta_diff, phi_diff), out=scale
        )
    steps = []
    for axis in range(3):
        moved = [angle + ANGLE_STEP * (n == axis) for n, angle in enumerate((theta_half, theta_diff, phi_diff))]
        steps.append(float((np.abs(model.evaluate_unmasked(*moved) - here) / scale).max()))
    return [
        float(np.count_nonzero(value < 0.0) + sum(np.count_nonzero(part < 0.0) for part in parts)),
        float(np.count_nonzero(~np.isfinite(value))),
        float((np.abs(value - swapped) / value).max()),
        *steps,
        float((np.abs(sum(parts) - value) / value).max()),
    ]


def main(argv: Sequence[str]) -> int:
    """Print the figures of each material and the largest of all."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks guarantees", description=__doc__)
    add_arguments(parser, every=7)
    parser.add_argument("--pairs", type=int, default=1_000_000, help="random pairs (default: 1000000)")
    arguments = parser.parse_args(argv)
    omega_in, omega_out = pairs(arguments.pairs, arguments.pairs // 5)
    rows = []
    print(f"{'':34}" + "".join(f"{head:>14}" for head in HEADS))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        for measurement in chosen_measurements(arguments):
            rows.append(check(fit(measurement).model, omega_in, omega_out))
            print(f"{measurement.name:34}" + "".join(f"{figure:14.2g}" for figure in rows[-1]), flush=True)
    print(f"{f'largest of {len(rows)}':34}" + "".join(f"{figure:14.2g}" for figure in np.max(rows, axis=0)))
    return 0
