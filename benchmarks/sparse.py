"""Fewer measured rows of theta_half: the default fit against interpolation of the table (Nishino 2009, figure 5).

Every 2nd, 4th, 8th, 16th or 32nd node of theta_half is kept, the others are marked invalid; relative_rms is taken on
the full measurement, and the PSNR of a lit sphere under three lights and in the environment. The table is
interpolated linearly along theta_half for each theta_diff and phi_diff, between the kept valid nodes, those
beyond the horizon cutoff included, which the fit does not see. Beyond the last valid node its value is held, before
the first too; a line without any valid node is 0. Linear in theta_half and linear in the table's index (theta_half is
spaced by squares) are both tried for each material and factor, and the better one counts.

That table keeps 180 values over phi_diff for every theta_diff. Where the kept rows are close enough it goes below the
bivariate floor, which no model that ignores phi_diff can reach however good it is. So the same interpolation of the
table of means over phi_diff is shown too: it has the floor in common with the fit, and still more than ten times
its numbers.
"""

import argparse
import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.material_filter import add_arguments, chosen_measurements
from benchmarks.paper.table_interpolation import RowPredictor, interpolated_rows, means_over_phi, thinned
from benchmarks.scoring import errors, of_model
from dsbrdf.data.grid import DEFAULT_HORIZON_CUTOFF, GRID_SHAPE, THETA_HALF
from dsbrdf.data.measurement import Measurement
from dsbrdf.errors import ConvergenceWarning
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import fit
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.render import render_sphere, sphere_likeness

Array = NDArray[np.float64]

LIGHTINGS = ("three_lights", "environment")
_SIZE = 64
FACTORS = (2, 4, 8, 16, 32)
COORDINATES = (THETA_HALF, np.arange(90.0))
"""The coordinate in which the table is interpolated: the angle or the index."""


def filled(measurement: Measurement, predict: RowPredictor) -> Measurement:
    """Return predicted values as a measurement, valid where the full one is."""
    values = np.stack([predict(i) for i in range(GRID_SHAPE[0])], axis=1)
    return Measurement.from_values(values, measurement.valid, measurement.name)


def psnr(measurement: Measurement, other: DSBRDF | Measurement) -> Array:
    """PSNR of the lit spheres of something beside those of the full data, under each of `LIGHTINGS` [dB]."""
    return np.array(
        [
            sphere_likeness(*(render_sphere(one, lighting=lighting, size=_SIZE) for one in (measurement, other)))[0]
            for lighting in LIGHTINGS
        ]
    )


@dataclass(frozen=True, eq=False)
class Figures:
    """relative_rms on the full data of one thinned material, and PSNR of the fit and the table."""

    fit: float
    table: float
    means: float
    fit_psnr: Array
    table_psnr: Array

    def __str__(self) -> str:
        seen = " / ".join(", ".join(f"{value:.1f}" for value in values) for values in (self.fit_psnr, self.table_psnr))
        return f"{self.fit:.4f} / {self.table:.4f} / {self.means:.4f}; {seen}"


def figures(measurement: Measurement, factor: int) -> Figures:
    """Fit and interpolate every ``factor``-th row, and compare with all of them."""

    def relative_rms(predict: RowPredictor) -> float:
        return errors(measurement, predict, DEFAULT_HORIZON_CUTOFF).score().relative_rms

    sparse = thinned(measurement, factor)
    means = means_over_phi(sparse)
    model = fit(sparse, FitOptions()).model
    tables = [interpolated_rows(sparse, coordinate) for coordinate in COORDINATES]
    seen = [psnr(measurement, filled(measurement, table)) for table in tables]
    return Figures(
        relative_rms(of_model(model)),
        min(relative_rms(table) for table in tables),
        min(relative_rms(interpolated_rows(means, coordinate)) for coordinate in COORDINATES),
        psnr(measurement, model),
        np.max(seen, axis=0),
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Print relative_rms of the fit and of the tables for each material and factor."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks sparse", description=__doc__)
    add_arguments(parser, every=1, names="rgl_")
    found: list[list[Figures]] = []
    print(
        "on the full data after keeping every n-th row of theta_half: relative_rms of the default fit / table /"
        " table of means; PSNR of the fit / table (three lights, environment)"
    )
    print(f"| {'':32} | floor | full fit | " + " | ".join(str(factor) for factor in FACTORS) + " |")
    print("|---" * (len(FACTORS) + 3) + "|")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        for measurement in chosen_measurements(parser.parse_args(argv)):
            metrics = fit(measurement, FitOptions()).report.metrics
            found.append([figures(measurement, factor) for factor in FACTORS])
            cells = [f"{metrics.floor:.4f}", f"{metrics.relative_rms:.4f}", *map(str, found[-1])]
            print(f"| {measurement.name:32} | {' | '.join(cells)} |", flush=True)
    print()
    for index, factor in enumerate(FACTORS):
        column = [row[index] for row in found]
        wins = sum(item.fit < item.table for item in column), sum(item.fit < item.means for item in column)
        seen = np.sum([item.fit_psnr > item.table_psnr for item in column], axis=0)
        print(
            f"{factor}: in relative_rms the fit beats the table on {wins[0]}, the table of means on {wins[1]};"
            f" in PSNR the table on {seen[0]} (three lights), {seen[1]} (environment) of {len(column)}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
