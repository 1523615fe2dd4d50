"""Split a text or a spreadsheet into cells, and read the numbers in the cells.

Spreadsheets (``.xlsx``, ``.ods``, ``.xls``) need the optional extra ``xlsx``.
"""

import codecs
import csv
import io
import re
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.errors import MeasurementFormatError
from dsbrdf.extras import require

SEPARATORS = {";": "semicolons", "\t": "tabs", ",": "commas", "|": "bars", " ": "blanks"}
"""Characters that can separate cells, with their names for error messages."""
MAX_CELLS = 5_000_000
"""Tables with more cells are refused, because they would take 5 s and 1 GB to read."""
MAX_COLUMNS = 4096
_MISSING = {"", "nan", "na", "n/a", "n.a.", "null", "none", "missing", "-nan(ind)"}
_N_TRIED_BYTES = 64  # This number of bytes at the start of a text is enough to recognise UTF-16.
_PRINTED = frozenset((*b"\t\r\n", *range(32, 127)))
# Cells without a number are "#N/A" and "#DIV/0!" in spreadsheets, "1.#INF" and "-1.#IND" of programs for Windows, and
# hyphens below the head of a Markdown table.
_NO_NUMBER = re.compile(r"(?:-?1\.)?#.*|:?-+:?")
# A tolerance, a degree sign or the mark of a footnote behind a number is ignored.
_TOLERANCE = re.compile(r"(?:±.*|[\N{DEGREE SIGN}*]\s*)$")
# Spreadsheets turn numbers such as 1.5 into dates, and show numbers as times.
_DATE = re.compile(r"\d{4}-\d\d-\d\d.*|.*\d:\d\d(?:[:.].*)?")
# A blank of normal width separates cells, not thousands.
_THOUSANDS = re.compile(r"[-+]?\d{1,3}(?:(?:[\xa0\u2009\u202f'’]\d{3})+(?:[.,]\d*)?|(?:,\d{3})+\.\d*)")
_DECIMAL_POINT = re.compile(r"\d\.\d+(?![\d,])")
_COMMA_OF_THOUSANDS = re.compile(r"\s*[1-9]\d{0,2}(?:,\d{3})+\s*")
_FORTRAN_EXPONENT = re.compile(r"(?<=[0-9.])[dD](?=[-+0-9])")

Constants = dict[str, float]
"""Numbers by name, such as theta_in, that a line of a file states for all rows below the line."""


@dataclass(frozen=True, eq=False)
class TextTable:
    """Cells of a table, and further columns whose numbers are not in its cells.

    Attributes
    ----------
    names : tuple of str
        The name of each column with its unit, as written in the file.
    rows, lines : list
        Cells of each row, one for each of the first names, and the number of the row's line in the file, from 1.
    separator : str
        The character between cells.
    columns : tuple of ndarray
        Numbers of the last columns, which have no cells.
    notes : tuple of str
        A sentence on each decision of the reader.
    """

    names: tuple[str, ...]
    rows: list[list[str]]
    lines: list[int]
    separator: str = " "
    columns: tuple[Array, ...] = ()
    notes: tuple[str, ...] = ()

    @classmethod
    def of_numbers(cls, names: Sequence[str], columns: Iterable[Array], *notes: str) -> "TextTable":
        """Return a table without cells, made of columns of numbers."""
        return cls(tuple(names), [], [], columns=tuple(columns), notes=notes)

    @property
    def n_rows(self) -> int:
        """Return the number of rows."""
        return len(self.columns[0]) if self.columns else len(self.rows)

    @property
    def n_cells(self) -> int:
        """Return the number of columns that have cells."""
        return len(self.names) - (len(self.columns) if self.rows else 0)

    def numbers(self, column: int) -> Array:
        """Return the numbers of a column, NaN for empty cells; raise MeasurementFormatError for a word."""
        if column >= len(self.names) - len(self.columns):
            return self.columns[column - len(self.names)]
        cells = [row[column] for row in self.rows]
        # NumPy would read 1_0 as 10, and cannot convert a column with empty cells, decimal commas or words.
        with suppress(ValueError):
            if not any("_" in cell for cell in cells):
                return np.array(cells, dtype=np.float64)
        _refuse_commas_of_thousands(self.names[column], cells, self.separator)
        return np.array([self._number(place, column) for place in range(len(cells))])

    def varies(self, column: int) -> bool:
        """Return whether a column has different numbers; the result is False for a column of words."""
        try:
            return len(np.unique(self.numbers(column))) > 1
        except MeasurementFormatError:
            return False

    def words(self, column: int) -> list[str]:
        """Return the different words in a column, in their order; an empty list for a column of numbers."""
        cells = dict.fromkeys(row[column].strip() for row in self.rows) if column < self.n_cells else {}
        return [*filter(None, cells)] if any(as_number(cell) is None for cell in cells) else []

    def with_columns(self, columns: dict[str, Array], *notes: str) -> "TextTable":
        """Return the table with additional columns of numbers, which are given by name."""
        return replace(
            self,
            names=(*self.names, *columns),
            columns=(*self.columns, *columns.values()),
            notes=(*self.notes, *notes),
        )

    def _number(self, place: int, column: int) -> float:
        cell = self.rows[place][column].strip()
        number = as_number(cell)
        if number is None:
            where = f"Line {self.lines[place]} of the table has {cell[:40]!r} in the column {self.names[column]!r}"
            remedy = "write a number, or nan where there is none"
            if _DATE.fullmatch(cell):
                remedy = "it is a date or a time: write the number, and give its cell the format of a number"
            raise MeasurementFormatError(f"{where}; {remedy}.")
        return number


def _refuse_commas_of_thousands(name: str, cells: Sequence[str], separator: str) -> None:
    """Raise MeasurementFormatError if commas may separate thousands in a column whose other cells have no comma.

    In a table separated by commas, cells with decimal commas are in quotation marks.
    """
    commas = [cell for cell in cells if "," in cell and "." not in cell]
    has_points = any(map(_DECIMAL_POINT.search, cells))
    has_whole_numbers = separator == "," or any(cell.strip().isdigit() for cell in cells)
    if commas and (has_points or (has_whole_numbers and all(map(_COMMA_OF_THOUSANDS.fullmatch, commas)))):
        raise MeasurementFormatError(
            f"In the column {name!r}, a comma or a point may separate thousands, as in {commas[0].strip()[:40]!r}: "
            "write its numbers without separators of thousands."
        )


def decoded(data: bytes) -> str:
    """Decode a text in UTF-16 or UTF-8, or else in the code page of Windows, which decodes any byte."""
    try:
        text = data.decode(utf_16_of(data) or "utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")
    if re.search(r"[\x00-\x08\x0e-\x19\x1b-\x1f\x7f]", text):
        raise MeasurementFormatError("The data is not a text; a table of samples is a text in UTF-8.")
    return text.rstrip("\x1a")  # DOS ends a text with this character.


def utf_16_of(data: bytes) -> str | None:
    """Return the encoding of a text in UTF-16, with or without a byte order mark; None for another encoding."""
    first, second = data[:_N_TRIED_BYTES:2], data[1:_N_TRIED_BYTES:2]
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    is_ascii = len(second) > 1 and not any(second) and all(byte in _PRINTED for byte in first)
    return "utf-16-le" if is_ascii else None


def check_size(n_rows: int, n_columns: int) -> None:
    """Raise MeasurementFormatError if a table has so many cells that reading them would take too long."""
    if n_columns > MAX_COLUMNS:
        raise MeasurementFormatError(f"The table has {n_columns} columns; it may have at most {MAX_COLUMNS}.")
    if n_rows * n_columns > MAX_CELLS:
        raise MeasurementFormatError(
            f"The table has {n_rows} rows of {n_columns} cells; it may have at most {MAX_CELLS} cells. Leave out rows, "
            "or columns that are not needed."
        )


def split_cells(lines: Iterable[str], separator: str) -> Iterator[list[str]]:
    """Yield the cells of each line; raise MeasurementFormatError at the first line that cannot be split."""
    spaced = (line.replace("\t", " ") for line in lines) if separator == " " else lines
    try:
        reader = csv.reader(spaced, delimiter=separator, skipinitialspace=True)
        for number, cells in enumerate(reader, 1):
            if reader.line_num > number:  # A quotation mark that is not closed would join all lines to one cell.
                raise MeasurementFormatError("A quotation mark in the table is not closed on its line.")
            yield cells
    except csv.Error:
        raise MeasurementFormatError(
            f"The table cannot be split into cells: one is longer than {csv.field_size_limit()} characters, or a "
            "quotation mark is not closed."
        ) from None


def wrong_count(number: int, count: int, separator: str, n_names: int) -> MeasurementFormatError:
    """Return the error for a line whose number of cells differs from the number of column names."""
    between = f", separated by {SEPARATORS[separator]}" if separator and count > 1 else ""
    hint = "; separate numbers with a decimal comma by semicolons" if separator == "," and count > n_names else ""
    return MeasurementFormatError(
        f"Line {number} of the table has {count} {'cell' if count == 1 else 'cells'}{between}, and the line of names "
        f"has {n_names}{hint}."
    )


def about_foot(lines: Sequence[tuple[int, str]]) -> tuple[str, ...]:
    """Return a sentence that says which lines below the last row of a table were not read, or nothing."""
    if not lines:
        return ()
    kind = "line is no row" if len(lines) == 1 else f"{len(lines)} lines are no rows"
    return (f"The last {kind} of the table, from {lines[0][1][:40]!r} on, and not read.",)


def as_number(cell: str) -> float | None:
    """Return the number in a cell, NaN for an empty cell or a word such as "n/a", or None for other words."""
    text = _TOLERANCE.sub("", cell).strip().lstrip("'").replace("\N{MINUS SIGN}", "-").replace("\N{EN DASH}", "-")
    if text.lower() in _MISSING or _NO_NUMBER.fullmatch(text):
        return float("nan")
    if _THOUSANDS.fullmatch(text):
        text = re.sub(r"[\xa0\u2009\u202f'’]|,(?=.*\.)", "", text)
    if "," in text:
        thousands = "." if text.rfind(",") > text.rfind(".") else ","
        text = text.replace(thousands, "").replace(",", ".")
    try:
        return None if "_" in text else float(_FORTRAN_EXPONENT.sub("e", text))
    except ValueError:
        return None


OLD_WORKBOOK = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
"""First bytes of an ``.xls`` file."""
# The part of an archive that holds the sheets of an .xlsx, or the sheets of an .ods, makes it a spreadsheet.
_WORKBOOKS = {"xl/workbook.xml", "content.xml"}
_ENCRYPTED = "EncryptedPackage".encode(
    "utf-16-le"
)  # This part of an .xlsx with a password stands in the frame of .xls.
_MAX_UNPACKED_BYTES = 1 << 26
_XLSX_COLUMN = re.compile(rb'<c r="([A-Z]{1,3})')
_XLSX_NO_RESULT = re.compile(rb"</f>(?:<v ?/>|<v></v>)?</c>")
_HIDDEN_ROW = re.compile(rb'<row [^>]*hidden="(?:1|true)"|<table:table-row [^>]*visibility="(?:collapse|filter)"')
_XLSX_ROW = re.compile(rb'<row r="([0-9]{1,9})"')
_ODS_EMPTY_COLUMNS = re.compile(rb'columns-repeated="([0-9]{1,9})"/>(?=<table:table-cell [^>]*value)')
_ODS_REPEATED_ROWS = re.compile(rb'rows-repeated="([0-9]{1,9})"')


def is_spreadsheet(data: bytes) -> bool:
    """Return whether the bytes of a file are a spreadsheet (``.xlsx``, ``.ods`` or ``.xls``)."""
    if not data.startswith(b"PK\x03\x04"):
        return data.startswith(OLD_WORKBOOK)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return not _WORKBOOKS.isdisjoint(archive.namelist())
    except zipfile.BadZipFile:
        return False


def spreadsheet_text(data: bytes) -> tuple[bytes, list[str]]:
    """Return the longest sheet of a file as text, cells separated by semicolons, and notes on the choice.

    A line of the text is a row of the sheet; a formula is replaced by its result, which the file stores. Raises
    MeasurementFormatError if the file cannot be read or is too long, and MissingExtraError without python-calamine.
    """
    require("xlsx", "python_calamine", purpose="spreadsheets, which can also be saved as .csv")
    from python_calamine import CalamineError, CalamineWorkbook, PasswordError, SheetVisibleEnum

    try:
        n_formulas, n_hidden = (0, 0) if data.startswith(OLD_WORKBOOK) else _check_extent(data)
        with CalamineWorkbook.from_filelike(io.BytesIO(data)) as book:
            count = len(book.sheet_names)
            shown = [sheet.name for sheet in book.sheets_metadata if sheet.visible == SheetVisibleEnum.Visible]
            texts = {name: _text(book.get_sheet_by_name(name).to_python(False)) for name in shown}
    except BaseException as error:
        # Some damaged files make the library panic; this error is no `Exception`, and its class has no public name.
        unreadable = isinstance(error, CalamineError | zipfile.BadZipFile | zlib.error | EOFError | RuntimeError)
        if not unreadable and type(error).__name__ != "PanicException":
            raise
        locked = isinstance(error, PasswordError) or _ENCRYPTED in data
        fault = (
            "is protected by a password; save it without one" if locked else "cannot be read; save its sheet as .csv"
        )
        raise MeasurementFormatError(f"The spreadsheet {fault}.") from error
    title = max(texts, key=lambda name: len(texts[name]), default="")
    longest = "longest" if len(texts) == count else "longest that is not hidden"
    notes = [f"The spreadsheet has {count} sheets; the {longest} was read, {title!r}."] if count > 1 else []
    if n_formulas:
        several = "1 formula has" if n_formulas == 1 else f"{n_formulas} formulas have"
        notes.append(f"{several} no result in the file until a spreadsheet program saves it; such cells are left out.")
    if n_hidden:
        notes.append(f"The spreadsheet has {n_hidden} hidden rows, as of a filter; they are read like all others.")
    return texts.get(title, "").encode(), notes


def _check_extent(data: bytes) -> tuple[int, int]:
    """Return the numbers of formulas without results and of hidden rows in an archive.

    Raises MeasurementFormatError if the archive, or the rectangle around the cells of a sheet, is too large.
    """
    n_bytes = n_formulas = n_hidden = 0
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        for part in archive.namelist():
            with archive.open(part) as file:
                content = file.read(_MAX_UNPACKED_BYTES - n_bytes + 1)
            n_bytes += len(content)
            n_hidden += len(_HIDDEN_ROW.findall(content))
            n_formulas += len(_XLSX_NO_RESULT.findall(content))
            column = max((letters.rjust(3) for letters in _XLSX_COLUMN.findall(content)), default=b"")
            n_columns = sum(max(letter - 64, 0) * 26**place for place, letter in enumerate(reversed(column)))
            n_rows = max(map(int, _XLSX_ROW.findall(content)), default=0)
            if written := content.count(b"<table:table-row"):
                gaps = map(int, _ODS_EMPTY_COLUMNS.findall(content))
                n_columns = content.count(b"<table:table-cell") // written + max(gaps, default=0)
                repeated = _ODS_REPEATED_ROWS.findall(content, 0, max(content.rfind(b"office:value"), 0))
                n_rows = written + sum(map(int, repeated))
            if n_bytes > _MAX_UNPACKED_BYTES or n_columns * n_rows > MAX_CELLS:
                raise MeasurementFormatError(
                    f"The spreadsheet has more than {_MAX_UNPACKED_BYTES} bytes when it is unpacked, or a sheet with "
                    f"more than {MAX_CELLS} cells, empty ones between others included; save its sheet as .csv."
                )
    return n_formulas, n_hidden


def _text(rows: Iterable[Sequence[Any]]) -> str:
    """Return rows as lines of equally many cells, with a separator at the end; a row without content is empty."""
    lines = [[" ".join(str(cell).split()) for cell in row] for row in rows]
    width = max((at for line in lines for at, cell in enumerate(line, 1) if cell), default=0)
    text = io.StringIO()
    writer = csv.writer(text, delimiter=";", lineterminator="\n")
    for line in lines:
        writer.writerow([*line[:width], ""] if any(line) else [])
    return text.getvalue()
