"""RGL ``.bsdf`` files as MERL tables and back, and as ``.bsdf`` files made of ``.bsdf`` files.

Columns: how much values of swapped directions differ in the file, which no MERL table can hold, as a share of the
larger one (median); then of the table, of the ``.bsdf`` file made of the table, and of the one made of the file itself,
the relative difference from the file's values, means over the channels, at 10,000 pairs up to 80 degrees from the
normal, half of them near the mirror direction (median and 95th percentile; values below 1e-3 /sr count as 1e-3).
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.exports import MIN_REFERENCE_VALUE, pairs
from dsbrdf import parse_merl
from dsbrdf.data import encode_merl, half_difference, parse_rgl, read_rgl
from dsbrdf.output.export.rgl import rgl_bsdf


def main(argv: Sequence[str]) -> int:
    """Print a line for each file."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks round_trips", description=__doc__)
    parser.add_argument(
        "--files", nargs="+", default=[], type=Path, metavar="FILE", help="RGL .bsdf files, as published"
    )
    heads = ("swapped", "table", "p95", "and back", "p95", ".bsdf", "p95")
    print(f"{'file':28}" + "".join(f"{head:>10}" for head in heads))
    first, second = pairs()
    for path in parser.parse_args(argv).files:
        material = read_rgl(path)
        table = parse_merl(encode_merl(material.measurement()))
        of_table = table.interpolated.evaluate(*half_difference(first, second))
        copies = (parse_rgl(rgl_bsdf(source)).evaluate_directions(first, second) for source in (table, material))
        expected = material.evaluate_directions(first, second).mean(axis=1)
        figures = [float(material.non_reciprocity())]
        for values in (of_table, *copies):
            error = np.abs(values.mean(axis=1) - expected) / np.maximum(expected, MIN_REFERENCE_VALUE)
            figures += [float(np.median(error)), float(np.quantile(error, 0.95))]
        print(f"{path.name:28}" + "".join(f"{figure:10.4f}" for figure in figures), flush=True)
    return 0
