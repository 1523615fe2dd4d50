"""Plans of what to measure next: once they are filled in, they are read with the table that they continue."""

import csv
from pathlib import Path

import numpy as np
import pytest

from dsbrdf import TableOptions, read_samples
from dsbrdf.data import spherical
from dsbrdf.fitting.report import SuggestedPair
from dsbrdf.samples.plan import plan_table
from tests.library.samples.test_layouts import LAYOUTS, truth

PUBLISHED = Path(__file__).parent / "published"
PAIRS = [SuggestedPair(60.0, 25.0, 180.0), SuggestedPair(20.0, 55.0, 0.0), SuggestedPair(20.0, 20.0, 180.0)]
ASIDE = SuggestedPair(40.0, 70.0, 130.0)
SEPARATORS = {
    LAYOUTS / "german_windows.csv": ";",
    LAYOUTS / "remote_sensing.csv": ",",
    LAYOUTS / "half_difference.csv": ",",
    LAYOUTS / "vectors.csv": ",",
    LAYOUTS / "zemax.txt": ",",
    PUBLISHED / "pgii.txt": "\t",
    PUBLISHED / "cosines.dat": ";",
    PUBLISHED / "photometry.tab": " ",
    PUBLISHED / "micrometres.csv": ",",
    PUBLISHED / "fred_in_plane.txt": ",",
}


@pytest.mark.parametrize("path", SEPARATORS, ids=lambda path: path.name)
def test_a_filled_in_plan_is_read_with_the_table_that_it_continues(path: Path, tmp_path: Path) -> None:
    separator, alone = SEPARATORS[path], read_samples(path)
    in_plane = bool(np.abs(np.cross(alone.omega_in, alone.omega_out)[:, 2]).max() < 1e-3)
    pairs = PAIRS if in_plane else [*PAIRS, ASIDE]
    text = plan_table(path.read_bytes(), TableOptions(), pairs).decode()
    names, *rows = csv.reader(text.splitlines(), delimiter=separator)
    expected = [_truth_of(pair) for pair in sorted(pairs, key=lambda pair: (pair.theta_in_deg, pair.theta_out_deg))]
    n_repeats = len(rows) // len(pairs)
    for at, row in enumerate(rows):
        value = f"{expected[at // n_repeats]:.8g}".replace(".", "," if "," in "".join(row[:4]) else ".")
        row[:] = [value if cell in ("", "nan") else cell for cell in row]
    plan = tmp_path / "plan.txt"
    plan.write_text("\n".join(separator.join(row) for row in (names, *rows)) + "\n")
    both = read_samples([path, plan])
    assert len(both.values) == len(alone.values) + len(pairs)
    np.testing.assert_allclose(both.values, truth(both.omega_in, both.omega_out), rtol=1e-4, atol=1e-5)


def _truth_of(pair: SuggestedPair) -> float:
    omega_in = spherical(np.radians([pair.theta_in_deg]), np.zeros(1))
    omega_out = spherical(np.radians([pair.theta_out_deg]), np.radians([pair.phi_deg]))
    return float(truth(omega_in, omega_out)[0, 0])
