"""Make ``dsbrdf/fitting/usual_materials.npz`` anew: the readable lobes of every material of ``DSBRDF_REFERENCE_DATA``.

Each material is fitted with the default options, and its first lobes to the fit. With ``--output`` the
file is written; without, its difference from the one in place is printed: median and largest, of logarithms.
"""

import argparse
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.material_filter import add_arguments, chosen_measurements
from dsbrdf.data.grid import DEFAULT_HORIZON_CUTOFF
from dsbrdf.errors import ConvergenceWarning
from dsbrdf.fitting.first_lobes import fit_first_lobes
from dsbrdf.fitting.least_squares import FitData
from dsbrdf.fitting.pipeline import fit
from dsbrdf.fitting.usual_materials import STORED, guides
from dsbrdf.fitting.weighting import center_share, interval_ends, seen_weight, trust
from dsbrdf.model.reflectance import ReflectanceModel

_ROWS = np.radians([0.0, 10, 20, 30, 40, 48, 55, 61, 66, 70, 73, 76, 79, 82, 85, 88])
_COLUMNS = np.radians(np.concatenate([[0.0], np.geomspace(0.1, 2.0, 9), np.linspace(1.73, 9.27, 29) ** 2]))
_AZIMUTHS = np.radians(np.arange(9.0, 90.0, 18.0))


def values_of(model: ReflectanceModel) -> FitData:
    """Values of a model, with weights as those of "balanced": the error that a lit sphere shows, and the plain one."""
    theta_half, theta_diff, phi_diff = np.broadcast_arrays(
        _COLUMNS[:, np.newaxis], _ROWS[:, np.newaxis, np.newaxis], _AZIMUTHS
    )
    values = model.evaluate_unmasked(theta_half.ravel(), theta_diff.ravel(), phi_diff.ravel())
    mean = np.moveaxis(values.reshape(*theta_half.shape, 3), -1, 0)
    level = np.cos(theta_diff) * np.cos(theta_half)
    swing = np.sin(theta_diff) * np.sin(theta_half) * np.cos(phi_diff)
    lowest = np.maximum(level - swing, 0.0)
    trusted = trust(lowest, DEFAULT_HORIZON_CUTOFF) * np.diff(interval_ends(_ROWS))[:, np.newaxis, np.newaxis]
    solid_angle = -np.diff(np.cos(interval_ends(_COLUMNS)))[:, np.newaxis] * (np.sin(2.0 * theta_diff) + 0.1)
    lit = trusted * lowest * (level + swing) * solid_angle
    over_phi = (np.sum(lit * mean, axis=3) / np.maximum(lit.sum(axis=2), 1e-300))[..., np.newaxis]
    typical = np.sum(lit * mean) / (3.0 * lit.sum())
    seen = seen_weight(lit, over_phi, typical)
    center = center_share(_COLUMNS) * np.gradient(np.sqrt(_COLUMNS))
    plain = np.broadcast_to(trusted * center[:, np.newaxis], mean.shape)
    weight = np.add(*(1.0 / (np.sum(part * mean**2) or 1.0) * part for part in (seen, plain)))
    return FitData(mean, weight, np.cos(phi_diff) ** 2, _ROWS, _COLUMNS)


def main(argv: Sequence[str] | None = None) -> int:
    """Print one line for each material, and write the file if asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks usual_materials", description=__doc__)
    add_arguments(parser, every=1)
    parser.add_argument("--output", type=Path, metavar="FILE", help="the .npz file to write")
    arguments = parser.parse_args(argv)
    with STORED.open("rb") as file:
        names = np.load(file)["names"].tolist()
    unknowns, found, known = [], [], dict(zip(names, guides(), strict=True))
    with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):
        for measurement in chosen_measurements(arguments):
            unknowns.append(fit_first_lobes(values_of(fit(measurement).model)).unknowns)
            found.append(measurement.name)
            difference = np.abs(known.get(measurement.name, np.nan) - unknowns[-1])
            print(f"{measurement.name:32}{np.median(difference):9.4f}{difference.max():9.4f}", flush=True)
    if arguments.output is not None:
        np.savez_compressed(arguments.output, unknowns=np.array(unknowns, np.float32), names=np.array(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
