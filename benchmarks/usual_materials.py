"""Make ``dsbrdf/fitting/usual_materials.npz`` anew: the readable lobes of every material of ``DSBRDF_REFERENCE_DATA``.

Each material is fitted with the default options, and its guide with one highlight to the fit. With ``--output`` the
file is written; without, its difference from the one in place is printed: median and largest, of logarithms.
"""

import argparse
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.material_filter import add_arguments, chosen_measurements
from dsbrdf.errors import ConvergenceWarning
from dsbrdf.fitting.guide import fit_single_highlight, guide_data
from dsbrdf.fitting.pipeline import fit
from dsbrdf.fitting.usual_materials import STORED, guides


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
            unknowns.append(fit_single_highlight(guide_data(fit(measurement).model)).mixture.unknowns)
            found.append(measurement.name)
            difference = np.abs(known.get(measurement.name, np.nan) - unknowns[-1])
            print(f"{measurement.name:32}{np.median(difference):9.4f}{difference.max():9.4f}", flush=True)
    if arguments.output is not None:
        np.savez_compressed(arguments.output, unknowns=np.array(unknowns, np.float32), names=np.array(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
