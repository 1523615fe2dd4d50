"""What the service does under kills, many clients and a full disk: one row a series, with its target and its result.

Every series has a real server to itself, in a process of its own, and looks at it from outside: its answers, its
database, its files, and the processes that the operating system shows.  Random moments come from a generator whose
seed is printed.  The exit code is 1 if a row is missed.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from dsbrdf.data.merl import write_merl
from dsbrdf.data.synthetic import synthetic_measurement
from tests.support.durability.series import SERIES, run

_SHOWN = 10  # faults of a series


def main(argv: Sequence[str] | None = None) -> int:
    """Print a table with a row for each series."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks durability", description=__doc__)
    parser.add_argument("--only", choices=SERIES, metavar="NAME", help=f"one series of: {', '.join(SERIES)}")
    parser.add_argument("--times", type=int, metavar="N", help="how often, instead of what is asked")
    parser.add_argument("--seed", type=int, default=int(time.time()), help="of the random moments (default: the time)")
    arguments = parser.parse_args(argv)
    missed = 0
    with tempfile.TemporaryDirectory() as folder:
        measurement = Path(folder) / "plastic.binary"
        write_merl(measurement, synthetic_measurement(noise=0.02, seed=1))
        print(f"seed {arguments.seed}\n| series | asked | measured | seconds | |\n|---|---|---|---|---|", flush=True)
        for name in [arguments.only] if arguments.only else SERIES:
            begin = time.monotonic()
            measured, faults = run(name, arguments.times or SERIES[name].times, arguments.seed, measurement)
            seconds = f"{time.monotonic() - begin:.0f}"
            verdict = "missed" if faults else "ok"
            print(f"| {name} | {SERIES[name].asked} | {measured} | {seconds} | {verdict} |", flush=True)
            for fault in faults[:_SHOWN]:
                print(f"  {name}: {fault}", file=sys.stderr, flush=True)
            missed += bool(faults)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
