"""Spreadsheets with samples: read as the same table in a text is, or refused with a sentence."""

import io
import sys
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock
from xml.sax.saxutils import escape

import numpy as np
import pytest

from dsbrdf import MeasurementFormatError, ScatteredSamples, read_measurement
from dsbrdf.extras import MissingExtraError
from dsbrdf.samples.reading import parse_samples
from tests.library.samples.test_reading import ANGLES, DIRECTION, RGB, table

NAMES = (*DIRECTION, "red", "green", "blue")
ROWS = np.hstack([ANGLES, RGB]).tolist()


SCHEMAS = "http://schemas.openxmlformats.org"


def spreadsheet(**sheets: Sequence[Sequence[Any]]) -> bytes:
    """An .xlsx file."""
    main, links = f"{SCHEMAS}/spreadsheetml/2006/main", f"{SCHEMAS}/officeDocument/2006/relationships"
    titles = "".join(f'<sheet name="{title}" sheetId="{at}" r:id="r{at}"/>' for at, title in enumerate(sheets, 1))
    targets = "".join(
        f'<Relationship Id="r{at}" Target="worksheets/sheet{at}.xml" Type="{links}/worksheet"/>'
        for at in range(1, len(sheets) + 1)
    )
    book = f'<Relationship Id="r1" Target="xl/workbook.xml" Type="{links}/officeDocument"/>'
    parts = {
        "_rels/.rels": f'<Relationships xmlns="{SCHEMAS}/package/2006/relationships">{book}</Relationships>',
        "xl/workbook.xml": f'<workbook xmlns="{main}" xmlns:r="{links}"><sheets>{titles}</sheets></workbook>',
        "xl/_rels/workbook.xml.rels": f'<Relationships xmlns="{SCHEMAS}/package/2006/relationships">{targets}'
        "</Relationships>",
    }
    for at, rows in enumerate(sheets.values(), 1):
        lines = "".join(f"<row>{''.join(map(xlsx_cell, row))}</row>" for row in rows)
        parts[f"xl/worksheets/sheet{at}.xml"] = sheet_of(lines)
    return archive(parts)


def sheet_of(rows: str) -> str:
    return f'<worksheet xmlns="{SCHEMAS}/spreadsheetml/2006/main"><sheetData>{rows}</sheetData></worksheet>'


def xlsx_cell(value: Any) -> str:
    if value is None:
        return "<c/>"
    text = escape(str(value))
    return f'<c t="inlineStr"><is><t>{text}</t></is></c>' if isinstance(value, str) else f"<c><v>{text}</v></c>"


def archive(parts: dict[str, str]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as made:
        for name, content in parts.items():
            made.writestr(name, content)
    return file.getvalue()


XLS, ODS = ((Path(__file__).parent / f"plate.{suffix}").read_bytes() for suffix in ("xls", "ods"))
"""The table of `test_reading`."""


@pytest.mark.parametrize("content", [spreadsheet(Table1=[NAMES, *ROWS]), ODS, XLS])
def test_a_sheet_is_read_as_the_same_table_in_a_text(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "felt.XLSX"
    path.write_bytes(content)
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


def with_sheet(rows: str) -> bytes:
    return changed(VALID_SPREADSHEET, "xl/worksheets/sheet1.xml", sheet_of(rows).encode())


def with_many_rows() -> bytes:
    """An .ods file with a million empty rows before its last one, and after it."""
    with zipfile.ZipFile(io.BytesIO(ODS)) as file:
        text = file.read("content.xml").decode()
    row = text[text.rindex("<table:table-row>") : text.rindex("</table:table>")]
    empty = '<table:table-row table:number-rows-repeated="1048000"><table:table-cell/></table:table-row>'
    return changed(ODS, "content.xml", text.replace("</table:table>", f"{empty}{row}{empty}</table:table>").encode())


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (lambda: with_sheet(" " * (1 << 26)), "more than 67108864 bytes when it is unpacked"),
        (
            lambda: with_sheet('<row r="1"><c r="A1"><v>1</v></c></row><row r="1048576"><c r="XFD1048576"/></row>'),
            "a sheet with more than 5000000 cells, empty ones between others included; save its sheet as .csv.",
        ),
        (with_many_rows, "a sheet with more than 5000000 cells"),
        (
            lambda: changed(VALID_SPREADSHEET, "xl/_rels/workbook.xml.rels", None),
            "The spreadsheet cannot be read; save its sheet as .csv.",
        ),
        (lambda: changed(VALID_SPREADSHEET, "xl/workbook.xml", None), "The file is a ZIP archive, as"),
        (lambda: VALID_SPREADSHEET[:2000], "The file is a ZIP archive, as"),
        (lambda: XLS[:9000], "The spreadsheet cannot be read; save its sheet as .csv."),
        (lambda: spreadsheet(Data=[]), "The table is empty"),
    ],
)
def test_a_spreadsheet_that_is_no_table_is_refused(content: Callable[[], bytes], words: str) -> None:
    with pytest.raises(MeasurementFormatError) as caught:
        parse_samples(content())
    assert words in str(caught.value)


def test_without_the_extra_the_way_out_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "python_calamine", None)
    with pytest.raises(MissingExtraError) as caught:
        parse_samples(VALID_SPREADSHEET)
    assert str(caught.value) == (
        "python_calamine must be installed for spreadsheets, which can also be saved as .csv: "
        "pip install 'dsbrdf[xlsx]'"
    )


def test_a_panic_of_the_library_is_a_damaged_file(monkeypatch: pytest.MonkeyPatch) -> None:
    panic = type("PanicException", (BaseException,), {})
    monkeypatch.setattr("python_calamine.CalamineWorkbook", SimpleNamespace(from_filelike=Mock(side_effect=panic)))
    with pytest.raises(MeasurementFormatError, match="The spreadsheet cannot be read; save its sheet"):
        parse_samples(VALID_SPREADSHEET)
