"""How the cost of a fit grows: with the number of lobes, of knots, and of materials in one and two processes.

Medians over the materials, from the file to the report; every process has one thread. The table has one row for each
setting: seconds for a material, and numbers stored. The rows for many materials are wall time from the files, with the
processes already started; an advantage from two processes needs two idle cores.
"""

import argparse
import os
import sys
import time
import warnings
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.material_filter import REFERENCE_VARIABLE, add_arguments, chosen_files, chosen_measurements
from dsbrdf.data.merl import read_merl, write_merl
from dsbrdf.errors import ConvergenceWarning
from dsbrdf.fitting.options import MAX_LOBES, FitOptions
from dsbrdf.fitting.pipeline import fit

LOBES = tuple(range(1, MAX_LOBES + 1))
KNOTS = (4, 6, 10, 14)
MATERIALS = (1, 10, 70)
PROCESSES = (1, 2)
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def seconds(path: Path, options: FitOptions) -> tuple[float, int]:
    """Return the time from the file to the report [s], and how many numbers the model stores."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        start = time.perf_counter()
        model = fit(read_merl(path), options).model
        return time.perf_counter() - start, model.n_numbers


def with_knots(count: int) -> FitOptions:
    """Return options for three lobes and the given number of knots, closer towards grazing angles."""
    degrees = np.unique(np.round(89.0 * np.sin(np.linspace(0.0, np.pi / 2, count))))
    return FitOptions(n_lobes=3, knots_deg=tuple(degrees.astype(int).tolist()))


def timed_batch(files: Sequence[Path], processes: int) -> float:
    """Return the wall time of default fits of files by several processes [s]."""
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        list(pool.map(_ready, range(4 * processes)))
        start = time.perf_counter()
        list(pool.map(seconds, files, [FitOptions()] * len(files)))
        return time.perf_counter() - start


def _ready(_: int) -> None:
    """Do nothing: the process has then started and imported its modules before the time is measured."""
    time.sleep(0.1)


def _row(setting: str, figures: list[tuple[float, int]]) -> str:
    times, numbers = np.array(figures).T
    return f"| {setting:32} | {np.median(times):.2f} | {times.max():.2f} | {np.median(numbers):.0f} |"


def main(argv: Sequence[str] | None = None) -> int:
    """Print one table of all settings."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks cost", description=__doc__)
    add_arguments(parser, every=7)
    parser.add_argument("--few", type=int, default=4, metavar="N", help="materials for lobes and knots (default: 4)")
    arguments = parser.parse_args(argv)
    with TemporaryDirectory() as folder:
        _print_costs(_files(arguments, Path(folder)), arguments.few)
    return 0


def _files(arguments: argparse.Namespace, folder: Path) -> list[Path]:
    """Return the chosen files, or the chosen synthetic measurements written to a folder."""
    if os.environ.get(REFERENCE_VARIABLE):
        return chosen_files(arguments)
    files = []
    for material in chosen_measurements(arguments):
        files.append(folder / f"{material.name}.binary")
        write_merl(files[-1], material)
    return files


def _print_costs(files: Sequence[Path], count_few: int) -> None:
    few = files[:: max(len(files) // count_few, 1)][:count_few]
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))  # for the processes that are still to be started
    print(f"Seconds for a material; lobes and knots on {len(few)} materials")
    print(f"| {'':32} | median | largest | numbers |\n|---|---|---|---|")
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        list(pool.map(seconds, few[:1], [FitOptions()]))  # warm up
        for label, options in (
            ("default", FitOptions()),
            ("paper", FitOptions(method="paper")),
            *((f"{n_lobes} lobes", FitOptions(n_lobes=n_lobes, ring_lobes=0)) for n_lobes in LOBES),
            *((f"3 lobes, {rings} ring lobes", FitOptions(n_lobes=3, ring_lobes=rings)) for rings in (1, 2)),
        ):
            print(_row(label, list(pool.map(seconds, few, [options] * len(few)))), flush=True)
        for count in KNOTS:
            figures = list(pool.map(seconds, few, [with_knots(count)] * len(few)))
            print(_row(f"3 lobes, rings auto, {count} knots", figures), flush=True)
    for count in sorted({min(count, len(files)) for count in MATERIALS}):
        for processes in PROCESSES:
            wall = timed_batch(files[:count], processes)
            label = f"default, {count} materials, {processes} process{'es' * (processes > 1)}"
            print(f"| {label:32} | {wall / count:.2f} | in all {wall:.2f} | |", flush=True)


if __name__ == "__main__":
    sys.exit(main())
