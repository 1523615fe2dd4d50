"""The durability series that have no shorter test run once; ``make soak`` runs all of them, as often as is asked."""

from pathlib import Path

import pytest

from benchmarks.durability import SERIES
from benchmarks.server.runner import run
from dsbrdf import Measurement, write_merl
from tests.support.soak import SOAK

REPEATS_OF_A_SHORT_RUN = {"server-kill": 1, "uploads": 3, "disk": 1}
REPEATS = {name: one.amount for name, one in SERIES.items()} if SOAK else REPEATS_OF_A_SHORT_RUN


@pytest.mark.parametrize("name", REPEATS)
def test_series_loses_nothing_and_leaves_nothing_behind(name: str, plastic: Measurement, tmp_path: Path) -> None:
    write_merl(tmp_path / "plastic.binary", plastic)
    (row,) = run(SERIES[name], REPEATS[name], 1, tmp_path / "plastic.binary")
    assert row.holds, row.measured
