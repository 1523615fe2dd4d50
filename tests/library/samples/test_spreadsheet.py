"""Spreadsheets with samples: read as the same table in a text is, or refused with a sentence."""

import io
import sys
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pytest

from dsbrdf import MeasurementFormatError, ScatteredSamples, read_measurement
from dsbrdf.extras import MissingExtraError
from dsbrdf.samples.reading import parse_samples
from tests.library.samples.test_reading import ANGLES, DIRECTION, RGB, table

NAMES = (*DIRECTION, "red", "green", "blue")
ROWS = np.hstack([ANGLES, RGB]).tolist()


def spreadsheet(**sheets: Sequence[Sequence[Any]]) -> bytes:
    book = openpyxl.Workbook()
    book.remove(book.active)
    for title, rows in sheets.items():
        sheet = book.create_sheet(title)
        for row in rows:
            sheet.append(list(row))
    file = io.BytesIO()
    book.save(file)
    return file.getvalue()


def test_a_sheet_is_read_as_the_same_table_in_a_text(tmp_path: Path) -> None:
    path = tmp_path / "felt.XLSX"
    path.write_bytes(spreadsheet(Table1=[NAMES, *ROWS]))
    found, expected = read_measurement(path), parse_samples(table())
    assert isinstance(found, ScatteredSamples)
    np.testing.assert_allclose(found.values, expected.values, rtol=1e-8)
    np.testing.assert_allclose(found.omega_out, expected.omega_out, atol=1e-8)
    assert (found.name, found.notes) == ("felt", ())


def test_what_people_write_around_a_table_is_left_out() -> None:
    rows: list[list[Any]] = [[*row, None] for row in ROWS]
    rows[3] += [None, 'measured; "twice",\nby hand']
    rows[5][4] = None
    units = ["deg"] * 4 + [None, "1/sr", "1/sr"]
    data = [["Gonio 3"], [], NAMES, units, *rows[:100], [], *rows[100:]]
    samples = parse_samples(spreadsheet(Info=[["a", 1.0]], Data=data))
    assert samples.notes == (
        "The spreadsheet has 2 sheets; the longest was read, 'Data'.",
        "1 row has no finite number in a column that is needed; it is left out.",
    )
    np.testing.assert_allclose(samples.values, np.delete(RGB, 5, axis=0), rtol=1e-8)


def test_lines_in_errors_are_rows_of_the_sheet() -> None:
    rows = [list(row) for row in ROWS]
    rows[7][2] = "x"
    with pytest.raises(MeasurementFormatError, match="Line 10 of the table has 'x' in the column 'theta_out'"):
        parse_samples(spreadsheet(Data=[["a title"], NAMES, *rows]))


def changed(content: bytes, part: str, now: bytes | None) -> bytes:
    """The archive with another content of a part, or without it."""
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            if name != part:
                new.writestr(name, old.read(name))
        if now is not None:
            new.writestr(part, now)
    return file.getvalue()


VALID_SPREADSHEET = spreadsheet(Data=[NAMES, *ROWS])


NAMESPACE = b"http://schemas.openxmlformats.org/spreadsheetml/2006/main"


def with_sheet(rows: bytes) -> bytes:
    whole = b'<worksheet xmlns="%b"><sheetData>%b</sheetData></worksheet>' % (NAMESPACE, rows)
    return changed(VALID_SPREADSHEET, "xl/worksheets/sheet1.xml", whole)


def with_long_string(rows: bytes) -> bytes:
    """The sheet, whose cells may share a string of 32,000 characters."""
    kind = b"application/vnd.openxmlformats-officedocument.spreadsheetml.sharedStrings+xml"
    types = zipfile.ZipFile(io.BytesIO(VALID_SPREADSHEET)).read("[Content_Types].xml")
    more = b'<Override PartName="/xl/sharedStrings.xml" ContentType="%b"/></Types>' % kind
    content = changed(with_sheet(rows), "[Content_Types].xml", types.replace(b"</Types>", more))
    strings = b'<sst xmlns="%b"><si><t>%b</t></si></sst>' % (NAMESPACE, b"x" * 32_000)
    return changed(content, "xl/sharedStrings.xml", strings)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (lambda: with_sheet(b"<row>" + b"<c><v>1</v></c>" * 510_000 + b"</row>"), "has more than 500000 cells, or"),
        (lambda: with_sheet(b" " * (1 << 26)), "or 67108864 bytes when it is unpacked; save its sheet as .csv."),
        (
            lambda: with_sheet(b'<row r="1"><c><v>1</v></c></row><row r="1048576000"><c><v>1</v></c></row>'),
            "The sheet has more than 1048576 rows or 5000000 cells, empty ones between others included; save",
        ),
        (
            lambda: changed(VALID_SPREADSHEET, "xl/_rels/workbook.xml.rels", None),
            "The spreadsheet cannot be read; save its sheet as .csv.",
        ),
        (lambda: changed(VALID_SPREADSHEET, "xl/workbook.xml", None), "write its samples as a table"),
        (lambda: VALID_SPREADSHEET[:2000], "write its samples as a table"),
        (
            lambda: with_long_string(b"<row>" + b'<c t="s"><v>0</v></c>' * 2100 + b"</row>"),
            "The sheet has more than 67108864 characters",
        ),
        (lambda: spreadsheet(Data=[]), "The table is empty"),
    ],
)
def test_a_spreadsheet_that_is_no_table_is_refused(content: Callable[[], bytes], words: str) -> None:
    with pytest.raises(MeasurementFormatError) as caught:
        parse_samples(content())
    assert words in str(caught.value)


def test_without_the_extra_the_way_out_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(MissingExtraError) as caught:
        parse_samples(VALID_SPREADSHEET)
    assert str(caught.value) == (
        "openpyxl must be installed for spreadsheets, which can also be saved as .csv: pip install 'dsbrdf[xlsx]'"
    )
