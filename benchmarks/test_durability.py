"""The durability series that have no shorter test run once; ``make soak`` runs all of them, as often as is asked."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.durability import SERIES, run
from benchmarks.durability_series.harness import end_fitting_process
from dsbrdf import write_merl
from tests.support.materials import glossy_plastic
from tests.support.soak import SOAK

ROUNDS_OF_SERIES = (
    {name: one.times for name, one in SERIES.items()} if SOAK else {"server-kill": 1, "uploads": 1, "disk": 1}
)


@pytest.fixture(scope="module")
def measurement(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A file for all series, and the end of the process that fits for them."""
    path = tmp_path_factory.mktemp("durability") / "plastic.binary"
    write_merl(path, glossy_plastic())
    yield path
    end_fitting_process()


@pytest.mark.parametrize("name", ROUNDS_OF_SERIES)
def test_series_loses_nothing_and_leaves_nothing_behind(name: str, measurement: Path) -> None:
    measured, faults = run(name, ROUNDS_OF_SERIES[name], 1, measurement)
    assert not faults, f"{measured}: {faults}"
