"""Convert spreadsheets (``.xlsx``) to the text of a table; the conversion needs the optional extra ``xlsx``."""

import csv
import io
import zipfile
from collections.abc import Iterable, Sequence
from typing import Any

from dsbrdf.errors import MeasurementFormatError
from dsbrdf.extras import require
from dsbrdf.samples.cells import MAX_CELLS

_ARCHIVE = b"PK\x03\x04"
_WORKBOOK = "xl/workbook.xml"
_PIECE_BYTES = 1 << 20
_MAX_UNPACKED_BYTES = 1 << 26
_MAX_TAGS = (
    2_000_000  # A file with more XML tags is refused, because openpyxl would take over 5 s; a cell has four tags.
)
_MAX_ROWS = 1 << 20  # A sheet with more rows is refused, because no spreadsheet program writes so many.
_MAX_TEXT_LENGTH = 1 << 26  # A sheet is refused if its text is longer [characters].


def is_spreadsheet(data: bytes) -> bool:
    """Return whether the bytes of a file are a spreadsheet (``.xlsx``)."""
    if not data.startswith(_ARCHIVE):
        return False
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return _WORKBOOK in archive.namelist()
    except zipfile.BadZipFile:
        return False


def spreadsheet_text(data: bytes) -> tuple[bytes, list[str]]:
    """Return the longest sheet of a file as text, cells separated by semicolons, and notes on the choice.

    A line of the text is a row of the sheet; a formula is replaced by its result, which the file stores. Raises
    MeasurementFormatError if the file cannot be read or is too long, and MissingExtraError without openpyxl.
    """
    require("xlsx", "openpyxl", purpose="spreadsheets, which can also be saved as .csv")
    import openpyxl

    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            _check_work(archive)
        workbook = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
        texts = {sheet.title: _text(sheet.iter_rows(values_only=True)) for sheet in workbook.worksheets}
    except (MeasurementFormatError, MemoryError):
        raise
    except Exception as error:  # A damaged file raises exceptions of many types, from openpyxl, XML and ZIP.
        raise MeasurementFormatError("The spreadsheet cannot be read; save its sheet as .csv.") from error
    title = max(texts, key=lambda name: len(texts[name]), default="")
    notes = [f"The spreadsheet has {len(texts)} sheets; the longest was read, {title!r}."] if len(texts) > 1 else []
    return texts.get(title, "").encode(), notes


def _check_work(archive: zipfile.ZipFile) -> None:
    """Count the XML tags of a spreadsheet; raise MeasurementFormatError if the file would take too long to read."""
    n_bytes = n_tags = 0
    for part in archive.namelist():
        with archive.open(part) as file:
            while piece := file.read(_PIECE_BYTES):
                n_bytes, n_tags = n_bytes + len(piece), n_tags + piece.count(b"<")
                if n_bytes > _MAX_UNPACKED_BYTES or n_tags > _MAX_TAGS:
                    raise MeasurementFormatError(
                        f"The spreadsheet has more than {_MAX_TAGS // 4} cells, or {_MAX_UNPACKED_BYTES} bytes when it "
                        "is unpacked; save its sheet as .csv."
                    )


def _text(rows: Iterable[Sequence[Any]]) -> str:
    """Return rows as lines of equally many cells, with a separator at the end; a row without content is empty."""
    lines: list[list[str]] = []
    length = n_cells = 0
    for row in rows:
        n_cells += len(row)
        # Rows and cells that the file leaves out count too, because openpyxl yields them as empty.
        if n_cells > MAX_CELLS or len(lines) == _MAX_ROWS:
            most = f"{_MAX_ROWS} rows or {MAX_CELLS} cells, empty ones between others included"
            raise MeasurementFormatError(f"The sheet has more than {most}; save it as .csv.")
        lines.append([" ".join(str(cell).split()) if cell is not None else "" for cell in row])
        length += sum(map(len, lines[-1])) + len(row)
        if length > _MAX_TEXT_LENGTH:
            raise MeasurementFormatError(f"The sheet has more than {_MAX_TEXT_LENGTH} characters; save it as .csv.")
    width = max((at for line in lines for at, cell in enumerate(line, 1) if cell), default=0)
    text = io.StringIO()
    writer = csv.writer(text, delimiter=";", lineterminator="\n")
    for line in lines:
        cells = line[:width]
        writer.writerow([*cells, *[""] * (width + 1 - len(cells))] if any(cells) else [])
    return text.getvalue()
