"""Files of samples, to the last bit, and plans of what to measure next, which are read with the table they continue."""

import csv
import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dsbrdf
from dsbrdf import InvalidArgumentError, MeasurementFormatError, ScatteredSamples, TableOptions, read_samples
from dsbrdf.data import spherical
from dsbrdf.fitting.report import SuggestedPair
from dsbrdf.samples.plan import plan_table
from tests.library.samples.test_layouts import LAYOUTS, PUBLISHED, truth
from tests.library.samples.test_reading import ANGLES, RGB, table

READ = TableOptions(scale=1.0 / 3.0, cosine="out")


def test_a_file_of_samples_restores_every_bit_and_is_its_own_identity(tmp_path: Path) -> None:
    (tmp_path / "felt.csv").write_bytes(table())
    samples = dsbrdf.read_samples(tmp_path / "felt.csv", READ)
    assert samples.name == "felt"
    stored = tmp_path / "anything.dat"
    stored.write_bytes(samples.encode())
    again = dsbrdf.read_measurement(stored)
    assert isinstance(again, ScatteredSamples)
    for name in ("omega_in", "omega_out", "values", "weight"):
        np.testing.assert_array_equal(getattr(again, name), getattr(samples, name))
    assert again.encode() == stored.read_bytes()
    assert again.sha256 == samples.sha256 == hashlib.sha256(stored.read_bytes()).hexdigest()
    assert dsbrdf.read_samples(tmp_path / "felt.csv").sha256 != samples.sha256


def test_a_file_of_samples_is_a_table_in_degrees_with_notes() -> None:
    up = np.tile([0.0, 0.0, 1.0], (60, 1))
    aside = np.tile([0.0, -0.5, np.sqrt(0.75)], (60, 1))
    samples = ScatteredSamples.from_arrays(up, aside, np.full((60, 3), [1.0, 2.5, 0.1]), notes=("A note.", "\udce4."))
    lines = samples.encode().decode().splitlines()
    names = "theta_in,phi_in,theta_out,phi_out,red,green,blue,weight"
    assert lines[:4] == ["# dsbrdf samples 1", "# A note.", "# \\udce4.", names]
    assert lines[4:] == ["0,0,30,270,1,2.5,0.1,1"] * 60
    assert ScatteredSamples.decode(samples.encode()).notes == ("A note.", "\\udce4.")


def test_a_file_of_samples_says_everything_itself(tmp_path: Path) -> None:
    stored = tmp_path / "felt.csv"
    stored.write_bytes(dsbrdf.read_samples(_written(tmp_path, table())).encode())
    with pytest.raises(InvalidArgumentError, match="scale is an option of a table of samples, and this is a file of"):
        dsbrdf.read_samples(stored, scale=2.0)
    for content in (stored.read_bytes()[:-9], b"# dsbrdf samples 1\n1,2\n"):
        with pytest.raises(MeasurementFormatError, match=r"damaged|begins with"):
            ScatteredSamples.decode(content)


def test_files_of_one_material_are_one_measurement(tmp_path: Path) -> None:
    columns = np.hstack([ANGLES, RGB])
    parts = [_written(tmp_path, table(columns=columns[at::4]), f"part{at}.txt") for at in range(4)]
    joined = dsbrdf.read_samples(parts)
    assert (joined.name, len(joined.values)) == ("part0", len(columns))
    whole = dsbrdf.read_samples(_written(tmp_path, table(columns=np.vstack([columns[at::4] for at in range(4)]))))
    assert joined.sha256 == whole.sha256
    few = [_written(tmp_path, table(columns=columns[at : at + 30]), f"few{at}.txt") for at in (0, 30)]
    assert len(dsbrdf.read_samples(few).values) == 60
    with pytest.raises(InvalidArgumentError, match="name at least one file"):
        dsbrdf.read_samples([])


UP = np.tile([0.0, 0.0, 1.0], (200, 1))
NEARLY_UNIT = np.tile([0.6004, 0.0, 0.8], (200, 1))


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ((UP, UP, UP, np.zeros(200)), "weight is not positive; leave out"),
        ((UP, UP, np.ma.masked_less(UP, 0.5)), r"values is NaN or infinite"),
        ((UP, UP, -UP), r"In 200 of 200 samples.* values is negative; no reflectance is"),
        ((UP, UP, UP, np.ones(3)), r"weight must have the shape \(200,\), not \(3,\)"),
        ((UP, UP, UP, np.full(200, 1e308)), r"200 of 200 samples.* weight is not from 1e-12 to 1e12"),
        ((UP, UP, UP, np.full(200, 1e-308)), r"200 of 200 samples.* weight is not from 1e-12 to 1e12"),
        (([["a"]], UP, UP), "omega_in must be real numbers"),
        ((1.01 * NEARLY_UNIT, UP, UP), r"In 200 of 200 samples.* omega_in is not of unit length"),
        ((UP, UP[:, ::-1], UP), r"In 200 of 200 samples.* omega_out is not above the horizon; z must be positive"),
        ((UP, UP, 1e-200 * (UP + 1.0)), "largest value is 2e-200/sr"),
    ],
)
def test_arrays_that_are_no_samples_are_refused(arrays: tuple[Any, ...], words: str) -> None:
    ScatteredSamples.from_arrays(NEARLY_UNIT, UP, UP)
    with pytest.raises(MeasurementFormatError, match=words):
        ScatteredSamples.from_arrays(*arrays)


def _written(folder: Path, content: bytes, name: str = "whole.csv") -> Path:
    path = folder / name
    path.write_bytes(content)
    return path


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


@pytest.mark.parametrize("is_turned", [False, True])
@pytest.mark.parametrize("path", SEPARATORS, ids=lambda path: path.name)
def test_a_filled_in_plan_is_read_with_the_table_that_it_continues(path: Path, is_turned: bool, tmp_path: Path) -> None:
    options = TableOptions(phi="mirror" if is_turned else None)
    separator, alone = SEPARATORS[path], read_samples(path, options)
    turn = np.array([-1.0, -1.0, 1.0] if is_turned else [1.0, 1.0, 1.0])
    in_plane = bool(np.abs(np.cross(alone.omega_in, alone.omega_out)[:, 2]).max() < 1e-3)
    pairs = PAIRS if in_plane else [*PAIRS, ASIDE]
    text = plan_table(path.read_bytes(), options, pairs).decode()
    names, *rows = csv.reader(text.splitlines(), delimiter=separator)
    angles = sorted((pair.theta_in_deg, pair.theta_out_deg, pair.phi_deg) for pair in pairs)
    theta_in, theta_out, phi = np.radians(angles).T
    expected = truth(spherical(theta_in, 0.0 * phi) * turn, spherical(theta_out, phi))[:, 0]
    n_repeats = len(rows) // len(pairs)
    for at, row in enumerate(rows):
        value = f"{expected[at // n_repeats]:.8g}".replace(".", "," if "," in "".join(row[:4]) else ".")
        row[:] = [value if cell in ("", "nan") else cell for cell in row]
    plan = tmp_path / "plan.txt"
    plan.write_text("\n".join(separator.join(row) for row in (names, *rows)) + "\n")
    both = read_samples([path, plan], options)
    assert len(both.values) == len(alone.values) + len(pairs)
    np.testing.assert_allclose(both.values, truth(both.omega_in * turn, both.omega_out), rtol=1e-4, atol=1e-5)
