"""Error against numbers stored: the default fit with 1 to 8 lobes beside the automatic one.

For each number of lobes, without rings: medians over the materials of the numbers stored and of what the report
says of the error. The automatic fit stands below, so that one sees what it gives away and what it saves.
"""

import argparse
import sys
import time
import warnings
from collections.abc import Sequence

import numpy as np

from benchmarks.material_filter import add_arguments, chosen_measurements
from dsbrdf.data.measurement import Measurement
from dsbrdf.errors import ConvergenceWarning
from dsbrdf.fitting.options import MAX_LOBES, FitOptions
from dsbrdf.fitting.pipeline import fit

METRICS = ("relative_rms", "excess", "male", "albedo_error", "psnr", "ssim")
WAYS = {f"{n} lobes": FitOptions(n_lobes=n, ring_lobes=0) for n in range(1, MAX_LOBES + 1)} | {
    "3 lobes, 2 ring lobes": FitOptions(n_lobes=3, ring_lobes=2),
    "automatic": FitOptions(),
    "automatic, student": FitOptions(lobe="student"),
}


def figures(measurement: Measurement, options: FitOptions) -> list[float]:
    """Numbers stored, the metrics and the seconds of one fit; NaN for a metric that there is not."""
    start = time.perf_counter()
    report = fit(measurement, options).report
    seconds = time.perf_counter() - start
    metrics = [report.metrics[name] for name in METRICS]
    return [report.n_numbers, *(np.nan if value is None else value for value in metrics), seconds]


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks numbers", description=__doc__)
    add_arguments(parser, every=7)
    found: dict[str, list[list[float]]] = {way: [] for way in WAYS}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        for measurement in chosen_measurements(parser.parse_args(argv)):
            for way, options in WAYS.items():
                found[way].append(figures(measurement, options))
            print(measurement.name, file=sys.stderr, flush=True)
    print(f"Medians over {len(found['automatic'])} materials")
    print(f"| {'':22} | {' | '.join(('numbers', *METRICS, 'seconds'))} |")
    print("|---" * (len(METRICS) + 3) + "|")
    for way, rows in found.items():
        print(f"| {way:22} | {' | '.join(f'{value:.4g}' for value in np.nanmedian(rows, axis=0))} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
