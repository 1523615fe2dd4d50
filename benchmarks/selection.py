"""How often the automatic number of lobes is right: synthetic mixtures of 1, 2 and 3 lobes with noise.

Run with ``python -m benchmarks.selection --seeds 10``.  Every seed draws another material (which lobes, how wide, how
high, how they change towards grazing and with the channel) and other noise.
"""

import argparse
from collections import Counter

from tests.support.mixtures import NOISE, choose


def main() -> None:
    """Print the chosen numbers for each true number of lobes, and how often they are right."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10, help="materials for each number of lobes")
    seeds = parser.parse_args().seeds
    columns = [(n_lobes, rings) for rings in range(3) for n_lobes in range(1, 6)]
    right = 0
    counts = {truth: Counter(choose(truth, seed) for seed in range(seeds)) for truth in (1, 2, 3)}
    shown = [column for column in columns if column[1] == 0 or any(count[column] for count in counts.values())]
    print(f"Automatic number of lobes on synthetic mixtures with {100 * NOISE:g} % noise, {seeds} seeds each")
    print(
        "| lobes | " + " | ".join(f"chose {n}" + f" + {rings} ring" * (rings > 0) for n, rings in shown) + " | right |"
    )
    print("|---" * (len(shown) + 2) + "|")
    for truth, count in counts.items():
        right += count[(truth, 0)]
        cells = " | ".join(str(count[column]) for column in shown)
        print(f"| {truth} | {cells} | {count[(truth, 0)] / seeds:.0%} |")
    print(f"right: {right} of {3 * seeds}, {right / (3 * seeds):.1%}")


if __name__ == "__main__":
    main()
