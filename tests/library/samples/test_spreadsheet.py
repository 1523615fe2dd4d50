"""Spreadsheets with samples: read as the same table in a text is, or refused with a sentence."""

import io
import re
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from dsbrdf import MeasurementFormatError, ScatteredSamples, read_measurement, read_samples
from dsbrdf.extras import MissingExtraError
from dsbrdf.samples.reading import parse_samples
from tests.library.samples.test_reading import RGB, table
from tests.support.reproduced import assert_reproduced

FOLDER = Path(__file__).parent
XLSX, XLS, ODS = ((FOLDER / f"plate.{suffix}").read_bytes() for suffix in ("xlsx", "xls", "ods"))
"""The table of `test_reading`."""
NOTES_AROUND = (FOLDER / "notes_around.xlsx").read_bytes()
WORKBOOK = "xl/workbook.xml"
SHEET = "xl/worksheets/sheet1.xml"
MAIN_SCHEMA = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"


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
    samples = parse_samples(NOTES_AROUND)
    assert samples.notes == (
        "The spreadsheet has 2 sheets; the longest was read, 'Data'.",
        "1 row has no finite number in a column that is needed, such as 'red'; it is left out.",
    )
    np.testing.assert_allclose(samples.values, np.delete(RGB, 5, axis=0), rtol=1e-8)


def test_hidden_rows_are_counted_in_a_note() -> None:
    content = replaced(NOTES_AROUND, "xl/worksheets/sheet2.xml", b"<row>", b'<row hidden="1">')
    assert re.search(r"[0-9]{3} hidden rows, as of a filter", parse_samples(content).notes[-2])


def test_lines_in_errors_are_rows_of_the_sheet() -> None:
    with pytest.raises(MeasurementFormatError, match="Line 10 of the table has 'x' in the column 'theta_out'"):
        read_samples(FOLDER / "wrong_cell.xlsx")


def changed(content: bytes, part: str, now: bytes | None) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            if name != part:
                new.writestr(name, old.read(name))
        if now is not None:
            new.writestr(part, now)
    return file.getvalue()


def replaced(content: bytes, part: str, old: bytes, new: bytes) -> bytes:
    with zipfile.ZipFile(io.BytesIO(content)) as file:
        return changed(content, part, re.sub(old, new, file.read(part)))


def with_sheet(rows: str) -> bytes:
    sheet = f'<worksheet xmlns="{MAIN_SCHEMA}"><sheetData>{rows}</sheetData></worksheet>'
    return changed(XLSX, SHEET, sheet.encode())


def with_many_rows() -> bytes:
    """An .ods file with a million empty rows before its last one, and after it."""
    with zipfile.ZipFile(io.BytesIO(ODS)) as file:
        text = file.read("content.xml").decode()
    row = text[text.rindex("<table:table-row>") : text.rindex("</table:table>")]
    empty = '<table:table-row table:number-rows-repeated="1048000"><table:table-cell/></table:table-row>'
    return changed(ODS, "content.xml", text.replace("</table:table>", f"{empty}{row}{empty}</table:table>").encode())


FAR_CELL = '<row r="1"><c r="A1"><v>1</v></c></row><row r="1048576"><c r="XFD1048576"/></row>'
REFUSED: dict[str, Callable[[], bytes]] = {
    "much to unpack": lambda: with_sheet(" " * (1 << 26)),
    "a cell far away": lambda: with_sheet(FAR_CELL),
    "many empty rows": with_many_rows,
    "no relations": lambda: changed(XLSX, "xl/_rels/workbook.xml.rels", None),
    "no workbook": lambda: changed(XLSX, WORKBOOK, None),
    "the start of an .xlsx": lambda: XLSX[:2000],
    "the start of an .xls": lambda: XLS[:9000],
    "an empty sheet": lambda: with_sheet(""),
    "a password": lambda: XLS[:9000] + "EncryptedPackage".encode("utf-16-le"),
    "the table is hidden": lambda: replaced(NOTES_AROUND, WORKBOOK, b'name="Data"', b'name="Data" state="hidden"'),
    "formulas without results": lambda: replaced(XLSX, SHEET, b"<row><c><v>[^<]*</v>", b"<row><c><f>B1+1</f><v/>"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_spreadsheet_that_is_no_table_is_refused(name: str) -> None:
    with pytest.raises(MeasurementFormatError) as caught:
        parse_samples(REFUSED[name]())
    assert_reproduced(f"refused/{name}", str(caught.value))


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
