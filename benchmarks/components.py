"""How true the components are: where the truth is known, and where a highlight lies over the diffuse part.

Known: 15 synthetic materials, GGX on the diffuse term of `dsbrdf.data.synthetic`, five roughnesses on three grounds
with 2 % noise. The diffuse albedo at normal incidence, channels added, and the colour of the highlight are compared.

On measurements, two tables. Misfits are distances of each component's own layers from its values, for components with
2 % of the light: peak, colour, half width, albedo as `dsbrdf.components.Misfit` has them; components whose parameters
are withheld count apart. Dents are the deviations of a wider component under a highlight, as a fraction of its largest
value around it, at theta_diff 0, 30 and 45 degrees in every channel where it holds 5 % of the light: of the diffuse
part below 12 degrees of theta_half, and how far the middle of a lobe below a spike is under its largest value.
"""

import argparse
import itertools
import os
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import asdict, astuple
from pathlib import Path

import numpy as np

from benchmarks.material_filter import REFERENCE_VARIABLE, add_arguments, chosen_measurements
from dsbrdf import DSBRDF, ConvergenceWarning, Decomposition, decompose, fit, profiles
from dsbrdf.arrays import Array
from dsbrdf.data import synthetic_measurement
from dsbrdf.output.serialize import read_model_file

ROUGHNESSES = (0.03, 0.06, 0.1, 0.15, 0.35)
GROUNDS = {"red": (0.40, 0.16, 0.10), "grey": (0.50, 0.50, 0.50), "dark": (0.10, 0.08, 0.06)}
COAT = (0.04, 0.04, 0.04)
MAX_SEPARABLE_ROUGHNESS = 0.15  # A rougher highlight is as wide as the diffuse part.
NOISE = 0.02
DENT_ANGLES = np.radians([0.0, 30.0, 45.0])
ANGLES_UNDER_HIGHLIGHT = np.radians(np.linspace(0.0, 12.0, 49))
ANGLES_AROUND_HIGHLIGHT = np.radians(np.linspace(8.0, 40.0, 65))
MIN_DIFFUSE_FRACTION = 0.05
MIN_DESCRIBED_LIGHT = 0.02
# integral of cos (1 - (1 - cos / 2)**5) d cos from 0 to 1, by which the diffuse term's albedo is known
_FALL = 0.5 - 4.0 * ((1.0 - 0.5**6) / 6.0 - (1.0 - 0.5**7) / 7.0)


def true_diffuse_albedo(ground: tuple[float, float, float]) -> Array:
    """Albedo of the diffuse term at normal incidence, shape (3,)."""
    return np.asarray(np.array(ground) * (1.0 - np.array(COAT)) * 56.0 / 23.0 * (1.0 - 0.5**5) * _FALL)


def print_known() -> None:
    """Print the errors of the synthetic materials and their spread."""
    albedo_errors, colour_errors = [], []
    for (name, ground), roughness in itertools.product(GROUNDS.items(), ROUGHNESSES):
        material = synthetic_measurement(roughness=roughness, diffuse=ground, specular=COAT, noise=NOISE)
        parts = decompose(fit(profiles(material)).model)
        found = dict(zip(parts.labels, parts.albedos, strict=True))
        diffuse = found.pop("diffuse", np.zeros(3))
        specular = sum(found.values(), np.zeros(3))
        albedo_errors.append(abs(diffuse.sum() / true_diffuse_albedo(ground).sum() - 1.0))
        colour_errors.append(float(np.abs(specular / (specular.max() or 1.0) - 1.0).max()))
        widths = ", ".join(f"{np.degrees(part.half_width):.1f}" for part in parts if part.half_width is not None)
        errors = f"diffuse {albedo_errors[-1]:6.1%}, colour of the highlight {colour_errors[-1]:.3f}"
        print(f"{name:5} roughness {roughness:4g}: {errors}, half widths {widths}", flush=True)
    smooth = np.tile(np.array(ROUGHNESSES) <= MAX_SEPARABLE_ROUGHNESS, len(GROUNDS))
    albedo, colour = np.array(albedo_errors), np.array(colour_errors)
    print(
        f"diffuse albedo: median {np.median(albedo):.1%}, largest {albedo.max():.1%}; up to roughness"
        f" {MAX_SEPARABLE_ROUGHNESS} at most {albedo[smooth].max():.1%}, and the colour of the highlight at most"
        f" {colour[smooth].max():.3f}"
    )


def dents(parts: Decomposition) -> list[float]:
    """Deviations of the diffuse part under a highlight and of the lobe under a spike, by angle and channel."""
    found = []
    measure = np.sin(2.0 * ANGLES_AROUND_HIGHLIGHT)
    for theta_diff in DENT_ANGLES.tolist():
        whole = parts.model.evaluate(ANGLES_AROUND_HIGHLIGHT, theta_diff)
        if parts.diffuse is not None:
            around = parts.diffuse.evaluate(ANGLES_AROUND_HIGHLIGHT, theta_diff)
            under = parts.diffuse.evaluate(ANGLES_UNDER_HIGHLIGHT, theta_diff)
            deviation = np.abs(under / around.max(axis=0) - 1.0).max(axis=0)
            found += deviation[(measure @ around) / (measure @ whole) > MIN_DIFFUSE_FRACTION].tolist()
        if parts.specular_lobe is not None and parts.specular_spike is not None:
            lobe = parts.specular_lobe.evaluate(ANGLES_UNDER_HIGHLIGHT, theta_diff)
            share = (measure @ parts.specular_lobe.evaluate(ANGLES_AROUND_HIGHLIGHT, theta_diff)) / (measure @ whole)
            found += (1.0 - lobe[0] / lobe.max(axis=0))[share > MIN_DIFFUSE_FRACTION].tolist()
    return found


def print_measured(models: Iterable[tuple[str, DSBRDF]]) -> None:
    """Print the dents and misfits of materials, and their spread."""
    every, misfits, n_components = [], [], 0
    for name, model in models:
        parts = decompose(model)
        found = dents(parts)
        every += found
        print(f"{name:34} deviation under a highlight {max(found, default=0.0):6.1%}", flush=True)
        for part in parts:
            if part.light_share < MIN_DESCRIBED_LIGHT:
                continue
            n_components += 1
            withheld = any(surface.f0 is None or surface.alpha is None for surface in part.surfaces)
            if not withheld:
                misfits.append([np.nan if off is None else off for off in astuple(part.misfit)])
            words = ", ".join(f"{name} {off:.3f}" for name, off in asdict(part.misfit).items() if off is not None)
            print(f"    {part.label:16} {words}{', withheld' if withheld else ''}", flush=True)
    print(f"under a highlight: p90 of the deviation {np.quantile(every, 0.9):.1%}")
    median, p90 = np.nanquantile(np.array(misfits), [0.5, 0.9], axis=0)
    for name, *figures in zip(("peak", "colour", "half width", "albedo"), median, p90, strict=True):
        print(f"{name}: median {figures[0]:.3f}, p90 {figures[1]:.3f}")
    print(f"withheld: {n_components - len(misfits)} of {n_components} components")


def main(argv: Sequence[str]) -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks components", description=__doc__)
    add_arguments(parser, every=1)
    parser.add_argument("--models", type=Path, help="folder of fits (default: the materials are fitted)")
    arguments = parser.parse_args(argv)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        if arguments.models:
            print_measured((path.stem, read_model_file(path)[0]) for path in sorted(arguments.models.glob("*.json")))
            return 0
        print_known()
        if os.environ.get(REFERENCE_VARIABLE):
            chosen = chosen_measurements(arguments)
            print_measured((measurement.name, fit(profiles(measurement)).model) for measurement in chosen)
    return 0
