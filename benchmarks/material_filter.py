"""Choice of the materials on which a benchmark runs: flags, and the measurements that they select."""

import argparse
import os
from collections.abc import Iterator
from pathlib import Path

from dsbrdf import Measurement, read_merl
from dsbrdf.data import synthetic_measurement

REFERENCE_VARIABLE = "DSBRDF_REFERENCE_DATA"


def add_arguments(parser: argparse.ArgumentParser, *, every: int, names: str = "") -> None:
    """Add the flags ``--names`` and ``--every``."""
    parser.add_argument("--names", default=names, help="only materials whose name contains one of these, with commas")
    parser.add_argument("--every", type=int, default=every, metavar="N", help=f"every N-th material (default: {every})")


def chosen_files(arguments: argparse.Namespace) -> list[Path]:
    """Return the selected files of the folder ``DSBRDF_REFERENCE_DATA``."""
    folder = os.environ.get(REFERENCE_VARIABLE)
    if not folder:
        raise SystemExit(f"set {REFERENCE_VARIABLE} to a folder of MERL .binary files")
    words = arguments.names.split(",")
    files = [path for path in sorted(Path(folder).glob("*.binary")) if any(word in path.stem for word in words)]
    if not files:
        raise SystemExit(f"{folder} holds no .binary file that {REFERENCE_VARIABLE} and --names choose")
    return files[:: arguments.every]


def chosen_measurements(arguments: argparse.Namespace) -> Iterator[Measurement]:
    """Yield the selected measurements one by one; a synthetic plastic if there is no folder."""
    if not os.environ.get(REFERENCE_VARIABLE):
        yield synthetic_measurement(noise=0.02)
        return
    for path in chosen_files(arguments):
        yield read_merl(path)
