"""Variance of the model's own sampling against that of a rough surface.

The other way to sample draws one half from the visible normals of GGX (Heitz 2018), with the roughness that has the
least variance for this material and angle, and the other half from the cosine of the normal. Both variances are those
of f cos(theta_in) / pdf, mean over the channels, as a share of the squared directional albedo, estimated from the same
directions; "below" is the share of the model's directions below the horizon.
"""

import argparse
import warnings
from collections.abc import Sequence

import numpy as np

from benchmarks.material_filter import add_arguments, chosen_measurements
from dsbrdf import DSBRDF, ConvergenceWarning, fit
from dsbrdf.arrays import Array

ANGLES = (0.0, 30.0, 60.0, 75.0, 80.0, 85.0, 87.0, 89.0)
"""theta_out [degrees]."""
ROUGHNESSES = np.geomspace(0.002, 1.0, 40)
N_SAMPLES = 200_000


def figures(model: DSBRDF, theta_out: float) -> tuple[float, float, float]:
    """Relative variances of the model's sampling and of the other, and the share below the horizon."""
    omega_out = np.array([np.sin(theta_out), 0.0, np.cos(theta_out)])
    drawn = model.sample(np.broadcast_to(omega_out, (N_SAMPLES, 3)), np.random.default_rng(1))
    above = drawn.pdf > 0.0
    weight, pdf = drawn.weight.mean(axis=1), np.where(above, drawn.pdf, 1.0)
    squared_mean = weight.mean() ** 2
    cosine = np.maximum(drawn.omega_in[:, 2], 0.0) / np.pi
    second_moments = [
        np.mean(weight**2 * pdf / np.where(above, 0.5 * visible(drawn.omega_in, omega_out, alpha) + 0.5 * cosine, 1.0))
        for alpha in ROUGHNESSES
    ]
    return (
        float(np.mean(weight**2) / squared_mean - 1.0),
        float(min(second_moments) / squared_mean - 1.0),
        float(1.0 - above.mean()),
    )


def visible(omega_in: Array, omega_out: Array, alpha: float) -> Array:
    """Density per solid angle of omega_in (n, 3) as omega_out mirrored at a visible normal of GGX."""
    half = omega_in + omega_out
    half /= np.linalg.norm(half, axis=1)[:, None]
    tangent2 = 1.0 / np.maximum(half[:, 2], 1e-9) ** 2 - 1.0
    distribution = 1.0 / (np.pi * alpha**2 * half[:, 2] ** 4 * (1.0 + tangent2 / alpha**2) ** 2)
    masking = 2.0 / (1.0 + np.sqrt(1.0 + alpha**2 * (1.0 / omega_out[2] ** 2 - 1.0)))
    return np.asarray(masking * distribution / (4.0 * omega_out[2]))


def main(argv: Sequence[str]) -> int:
    """Print a line for each material and angle, and the largest ratio."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks sampling", description=__doc__)
    add_arguments(parser, every=1, names="rgl_")
    arguments = parser.parse_args(argv)
    print(f"{'material':32}{'theta_out':>10}{'model':>10}{'GGX':>10}{'ratio':>8}{'below':>8}")
    ratios = []
    for measurement in chosen_measurements(arguments):
        with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):
            model = fit(measurement).model
        for angle in ANGLES:
            ours, theirs, below = figures(model, float(np.radians(angle)))
            ratios.append(ours / theirs)
            print(
                f"{measurement.name:32}{angle:10.0f}{ours:10.4f}{theirs:10.4f}{ratios[-1]:8.2f}{below:8.1%}", flush=True
            )
    print(f"largest ratio: {max(ratios):.2f}")
    return 0
