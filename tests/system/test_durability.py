"""Short durability series; ``make soak`` and ``python -m benchmarks durability`` run what is promised, in full."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.durability.harness import end_fitting_process
from tests.support.durability.series import SERIES, run
from tests.support.soak import repeats

TIMES = {
    "queue": 4,
    "server-kill": 1,
    "child-kill": 1,
    "memory": 1,
    "terminate": 1,
    "uploads": 4,
    "same-file": 4,
    "restores": 6,
    "disk": 1,
}


@pytest.fixture(scope="module", autouse=True)
def no_process_is_left() -> Iterator[None]:
    """End the process that all series share."""
    yield
    end_fitting_process()


@pytest.mark.parametrize("name", SERIES)
def test_series_loses_nothing_and_leaves_nothing_behind(name: str, plastic_file: Path) -> None:
    measured, faults = run(name, repeats(TIMES[name], SERIES[name].times), 1, plastic_file)
    assert not faults, f"{measured}: {faults}"
