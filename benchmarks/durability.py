"""What the service does under kills, many clients and a full disk (which needs root): one row a series."""

from collections.abc import Sequence

from benchmarks.server import concurrency, crashes, restores
from benchmarks.server.runner import Scenario
from benchmarks.server.runner import main as run_scenarios

SERIES = {
    "queue": Scenario(concurrency.queued, 500),
    "server-kill": Scenario(crashes.server_killed, 50),
    "child-kill": Scenario(crashes.child_killed, 100),
    "memory": Scenario(crashes.out_of_memory, 20),
    "terminate": Scenario(crashes.terminated, 20),
    "uploads": Scenario(concurrency.uploads, 32),
    "same-file": Scenario(concurrency.same_file, 50),
    "restores": Scenario(restores.restored, 200),
    "disk": Scenario(concurrency.full_disk, 5),
}


def main(argv: Sequence[str]) -> int:
    """Print a table with a row for each series."""
    return run_scenarios("durability", __doc__, SERIES, argv)
