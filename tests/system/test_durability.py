"""Small versions of the durability series; ``python -m benchmarks durability`` does what is promised, in full."""

from pathlib import Path

import pytest

from tests.support.durability.series import SERIES, run

TIMES = {
    "queue": 8,
    "server-kill": 3,
    "child-kill": 3,
    "memory": 2,
    "terminate": 1,
    "uploads": 6,
    "same-file": 6,
    "disk": 1,
}


@pytest.mark.parametrize("name", SERIES)
def test_nothing_is_lost_and_nothing_stays(name: str, plastic_file: Path) -> None:
    measured, faults = run(name, TIMES[name], 1, plastic_file)
    assert not faults, f"{measured}: {faults}"
