"""Spreadsheets with samples: read as the same table in a text is, or refused with a sentence."""

import re
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from dsbrdf import MeasurementFormatError, ScatteredSamples, read_measurement, read_samples
from dsbrdf.extras import MissingExtraError
from dsbrdf.samples.reading import parse_samples
from tests.library.samples.test_reading import RGB, table

FOLDER = Path(__file__).parent
XLSX, XLS, ODS = ((FOLDER / f"plate.{suffix}").read_bytes() for suffix in ("xlsx", "xls", "ods"))
"""The table of `test_reading`."""


@pytest.mark.parametrize("content", [XLSX, ODS, XLS])
def test_a_sheet_is_read_as_the_same_table_in_a_text(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "felt.XLSX"
    path.write_bytes(content)
    found, expected = read_measurement(path), parse_samples(table())
    assert isinstance(found, ScatteredSamples)
    np.testing.assert_allclose(found.values, expected.values, rtol=1e-8)
    np.testing.assert_allclose(found.omega_out, expected.omega_out, atol=1e-8)
    assert (found.name, found.notes) == ("felt", ())


def test_what_people_write_around_a_table_is_left_out() -> None:
    samples = read_samples(FOLDER / "notes_around.xlsx")
    assert samples.notes == (
        "The spreadsheet has 2 sheets; the longest was read, 'Data'.",
        "1 row has no finite number in a column that is needed, such as 'red'; it is left out.",
    )
    np.testing.assert_allclose(samples.values, np.delete(RGB, 5, axis=0), rtol=1e-8)


def test_hidden_rows_are_counted_in_a_note() -> None:
    assert re.search(r"[0-9]{3} hidden rows, as of a filter", read_samples(FOLDER / "hidden_rows.xlsx").notes[-2])


def test_without_the_extra_the_way_out_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "python_calamine", None)
    said = r"must be installed for spreadsheets, which can also be saved as \.csv: pip install 'dsbrdf\[xlsx\]'$"
    with pytest.raises(MissingExtraError, match=said):
        parse_samples(XLSX)


def test_a_panic_of_the_library_is_a_damaged_file(monkeypatch: pytest.MonkeyPatch) -> None:
    panic = type("PanicException", (BaseException,), {})
    monkeypatch.setattr("python_calamine.CalamineWorkbook", SimpleNamespace(from_filelike=Mock(side_effect=panic)))
    with pytest.raises(MeasurementFormatError, match="The spreadsheet cannot be read; save its sheet"):
        parse_samples(XLSX)
