"""Files as instruments and other programs write them, of a known truth: read right, or told what they are."""

from pathlib import Path

import numpy as np
import pytest

from dsbrdf import MeasurementFormatError, TableOptions, read_measurement, read_samples
from dsbrdf.arrays import Array
from dsbrdf.samples import layouts
from dsbrdf.samples.doubts import sample_doubts
from dsbrdf.samples.reading import read_table
from tests.support.reproduced import assert_reproduced, digest

MIRROR_60 = 0.48
"""The truth at 60 degrees, in the mirror direction [1/sr]."""
LAYOUTS, HABITS, PUBLISHED = (Path(__file__).parent / name for name in ("layouts", "habits", "published"))
"""Tables of instruments, tables with habits of their writers, and layouts of other programs (published_sources.md)."""


def truth(omega_in: Array, omega_out: Array) -> Array:
    """Diffuse, with a highlight about the mirror direction."""
    half = omega_in + omega_out
    theta_half = np.arccos(np.clip(half[:, 2] / np.linalg.norm(half, axis=1), -1.0, 1.0))
    return np.asarray(0.08 + 0.4 * np.exp(-((theta_half / 0.25) ** 2)))[:, None] * np.ones(3)


OPTIONS = {
    "band_of_remote_sensing.csv": TableOptions(columns="value=band"),
    "blocks_without_names.txt": TableOptions(columns="theta_out=1,phi_out=2,value=3,theta_in=4,phi_in=5"),
    "columns_of_a_lamp.csv": TableOptions(columns="theta_in=1,phi_in=lamp q,theta_out=3,phi_out=4"),
    "matrix_at_one_incidence.csv": TableOptions(constants="theta_in=40,phi_in=180"),
    **dict.fromkeys(
        ("radians_by_an_option.csv", "radians_by_an_option_and_not_degrees.csv"),
        TableOptions(columns="theta_in_rad=lamp,phi_in_rad=2,theta_out_rad=camera,phi_out_rad=4"),
    ),
    "positions_count_cells_of_rows.txt": TableOptions(columns="theta_out=1,phi_out=2,theta_in=3,phi_in=4,value=6"),
}


@pytest.mark.parametrize(
    "path", [*LAYOUTS.iterdir(), *HABITS.iterdir(), *PUBLISHED.iterdir()], ids=lambda path: path.name
)
def test_files_are_read_with_the_options_that_they_need(path: Path) -> None:
    if path.name in OPTIONS:
        with pytest.raises(MeasurementFormatError) as caught:
            read_samples(path)
        assert_reproduced(f"refused/{path.name}", str(caught.value))
    found = read_table(path.read_bytes(), options=OPTIONS.get(path.name, TableOptions()))
    samples, columns = found.samples, "; ".join(" ".join(column) for column in found.columns)
    said = [*samples.notes, *sample_doubts(samples).sentences, digest([samples.omega_in, samples.omega_out])]
    rows = f"{found.n_rows} rows, {len(samples.values)} samples"
    assert_reproduced(f"tables/{path.name}", [rows, columns, *said], 1e-5)
    assert len(samples.values) >= 54
    assert np.ptp(samples.values) > 0.2
    np.testing.assert_allclose(samples.values, truth(samples.omega_in, samples.omega_out), rtol=1e-4, atol=1e-5)


OTHER_KINDS = sorted((Path(__file__).parent / "other_kinds").iterdir())


@pytest.mark.parametrize("path", OTHER_KINDS, ids=lambda path: path.stem)
def test_every_reader_names_another_kind_of_file_alike(path: Path) -> None:
    sentences = set()
    for read in (read_measurement, read_samples, lambda file: read_table(file.read_bytes())):
        with pytest.raises(MeasurementFormatError) as caught:
            read(path)
        sentences.add(str(caught.value))
    (sentence,) = sentences
    assert_reproduced(f"refused/{path.name}", sentence)


def test_the_page_on_formats_lists_every_layout_with_its_example() -> None:
    page = (Path(__file__).parents[3] / "docs/formats.md").read_text()
    rows = [f"| {layout.name} | `{layout.example}` |" for layout in layouts.LAYOUTS]
    assert "\n".join(rows) in page
