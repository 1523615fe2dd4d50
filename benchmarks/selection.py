"""Synthetic mixtures of 1, 2 and 3 lobes with noise: how often their number is found, and how well their parameters.

Run with ``python -m benchmarks selection --seeds 20``. Every seed draws another material (which lobes, how wide, how
high, how elongated, how they change towards grazing angles and with the channel) and other noise.
"""

import argparse
from collections import Counter
from collections.abc import Sequence

import numpy as np

from tests.support.models import NOISE, deviations, found_by_fit, mixture, numbers_of_lobes

LIMIT = 0.02


def main(argv: Sequence[str]) -> int:
    """Print the chosen numbers for each true number of lobes, and how far the parameters are from the true ones."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks selection", description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="materials for each number of lobes (default: 20)")
    seeds = parser.parse_args(argv).seeds
    right, found = 0, list[dict[str, float]]()
    print(f"Automatic number of lobes on synthetic mixtures with {100 * NOISE:g} % noise, {seeds} seeds each")
    for n_lobes in (1, 2, 3):
        counts: Counter[tuple[int, int]] = Counter()
        for seed in range(seeds):
            model = found_by_fit(n_lobes, seed)
            numbers = numbers_of_lobes(model)
            counts[numbers] += 1
            if numbers == (n_lobes, 0):
                found.append(deviations(model, mixture(n_lobes, seed)))
        right += counts[n_lobes, 0]
        chosen = ", ".join(f"{lobes} + {rings} ring: {count}" for (lobes, rings), count in sorted(counts.items()))
        print(f"{n_lobes} lobes, found {chosen}")
    print(f"right: {right} of {3 * seeds}, {right / (3 * seeds):.1%}")
    print(f"{'largest relative deviation of':32}{'median':>9}{'p95':>9}{'largest':>9}{'within 2 %':>12}")
    for name in found[0] if found else ():
        values = np.array([one[name] for one in found])
        row = "".join(f"{value:9.4f}" for value in np.quantile(values, [0.5, 0.95, 1.0]))
        print(f"{name:32}{row}{np.mean(values < LIMIT):12.0%}")
    return 0
