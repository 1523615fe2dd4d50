"""Scattered samples of known mixtures, without noise: how far the parameters of the fit are from the true ones.

Run with ``python -m benchmarks scattered``.  Each row is one mixture of 1, 2 or 3 lobes: largest relative deviations
over the lobes, the channels and four angles theta_diff, and the relative RMS over the samples.
"""

import argparse
import sys
from collections.abc import Sequence

from dsbrdf.fitting.pipeline import fit
from tests.support.mixtures import deviations, mixture, scattered_samples

LIMIT = 0.03


def main(argv: Sequence[str] | None = None) -> int:
    """Print the deviations for each mixture, and how many of them are within the limit."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks scattered", description=__doc__)
    parser.add_argument("--samples", type=int, default=5000, help="samples of each mixture (default: 5000)")
    parser.add_argument("--seeds", type=int, default=2, help="mixtures for each number of lobes (default: 2)")
    arguments = parser.parse_args(argv)
    within: dict[str, int] = {}
    total = 0
    for n_lobes in (1, 2, 3):
        for seed in range(1, arguments.seeds + 1):
            truth = mixture(n_lobes, seed)
            result = fit(scattered_samples(truth, arguments.samples), n_lobes=n_lobes, ring_lobes=0)
            found = deviations(result.model, truth)
            if not total:
                print("".join(f"{head:>12}" for head in ("lobes", "seed", *found, "rms")))
            total += 1
            for name, value in (found | {"all": max(found.values())}).items():
                within[name] = within.get(name, 0) + (value < LIMIT)
            numbers = (*found.values(), result.report.metrics.relative_rms or 0.0)
            print(f"{n_lobes:12}{seed:12}" + "".join(f"{value:12.4f}" for value in numbers), flush=True)
    counts = ", ".join(f"{name} {count}" for name, count in within.items())
    print(f"within {LIMIT:.0%}, of {total}: {counts}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
