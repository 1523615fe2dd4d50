"""Layered models beside the models they come from: how much like the measurement they look, and what they cost.

For each material: the structure found, the time of `decompose`, the numbers of the layered model, then PSNR of a lit
sphere against the measurement under both lightings of `dsbrdf.render_sphere`, of the model, of its layers and of the
nearest OpenPBR surface. With ``--models`` the fits are read from a folder of ``.json`` files of the materials' names.
"""

import argparse
import time
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.material_filter import add_arguments, chosen_measurements
from dsbrdf import ConvergenceWarning, decompose, fit, render_sphere
from dsbrdf.output.export.materialx import fit_openpbr
from dsbrdf.output.serialize import read_model_file
from dsbrdf.rendering import LIGHTINGS, sphere_likeness

HEADS = ("seconds", "numbers", "model", "", "layers", "", "OpenPBR", "", "seconds")
QUANTILES = {"smallest": 0.0, "median": 0.5, "largest": 1.0}


def main(argv: Sequence[str]) -> int:
    """Print one line for each material, and the spread of each column."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks layers", description=__doc__)
    add_arguments(parser, every=1)
    parser.add_argument("--models", type=Path, help="folder of fits (default: the materials are fitted)")
    arguments = parser.parse_args(argv)
    print(f"PSNR [dB]: {', '.join(LIGHTINGS)}")
    print(f"{'':68}" + "".join(f"{head:>9}" for head in HEADS))
    rows = []
    with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):
        for measurement in chosen_measurements(arguments):
            stored = arguments.models and arguments.models / f"{measurement.name}.json"
            model = read_model_file(stored)[0] if stored else fit(measurement).model
            start = time.perf_counter()
            found = decompose(model)
            seconds = time.perf_counter() - start
            start = time.perf_counter()
            surface = fit_openpbr(model.evaluate, found.layers).surface
            of_surface = time.perf_counter() - start
            row = [seconds, found.layers.n_numbers]
            for source in (model, found.layers, surface):
                for lighting in LIGHTINGS:
                    pair = (render_sphere(one, lighting=lighting) for one in (measurement, source))
                    row.append(sphere_likeness(*pair)[0])
            rows.append([*row, of_surface])
            print_row(f"{measurement.name:30}{found.structure:38}", rows[-1])
    for quantile, level in QUANTILES.items():
        print_row(f"{quantile} of {len(rows)}", np.quantile(rows, level, axis=0).tolist())
    return 0


def print_row(name: str, figures: Sequence[float]) -> None:
    """Print one line."""
    print(f"{name:68}" + "".join(f"{figure:9.2f}" for figure in figures), flush=True)
