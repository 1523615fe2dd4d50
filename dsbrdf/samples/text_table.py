"""Tables of numbers as people and instruments write them: bytes -> the cells under each column's name.

Cells are separated by commas, semicolons, tabs or blanks; where it is not the comma, numbers may have a decimal comma.
Lines that begin with ``#``, ``%``, ``//`` or ``!`` are comments; the line that names the columns may be one, and lines
without a known name may stand before it. A line below the names without any number gives the units.
"""

import codecs
import csv
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.errors import MeasurementFormatError

_SEPARATORS = {";": "semicolons", "\t": "tabs", ",": "commas", " ": "blanks"}
_COMMENT = re.compile(r"^\s*(#+|%+|//|!)")
_LINES_BEFORE_NAMES = 500
_LINES_OF_UNITS = 20
MAX_CELLS = 5_000_000  # They take 5 s and 1 GB to read.
MAX_COLUMNS = 4096
_MAX_LINE_LENGTH = 1 << 17  # [characters]; 4096 columns with all their digits are shorter.
_MAX_HEAD_LENGTH = 1 << 18  # [characters]; the line of names is not looked for behind them.
_MISSING = {"", "nan", "na", "n/a", "null", "none", "-", "--"}


@dataclass(frozen=True, eq=False)
class TextTable:
    """Cells of a table."""

    names: tuple[str, ...]  # of each column, as written
    units: tuple[str, ...]  # of each column, as written; an empty one is none
    rows: list[list[str]]  # each with one cell for each name
    lines: list[int]  # number of each row's line in the file, from 1
    separator: str

    def numbers(self, column: int) -> Array:
        """Return the numbers of a column, NaN where there is none; a MeasurementFormatError names what is no number."""
        cells = [row[column] for row in self.rows]
        try:
            return np.array(cells, dtype=np.float64)
        except ValueError:  # missing cells, decimal commas, or no numbers at all
            return np.array([self._number(place, column) for place in range(len(cells))])

    def _number(self, place: int, column: int) -> float:
        cell = self.rows[place][column].strip()
        number = _as_number(cell, self.separator)
        if number is None:
            raise MeasurementFormatError(
                f"Line {self.lines[place]} of the table has {cell[:40]!r} in the column {self.names[column]!r}; "
                "write a number, or nan where there is none."
            )
        return number


def check_size(n_rows: int, n_columns: int) -> None:
    """Raise MeasurementFormatError if a table takes too long to read; it is asked before the cells are made."""
    if n_columns > MAX_COLUMNS:
        raise MeasurementFormatError(f"The table has {n_columns} columns; it may have {MAX_COLUMNS}.")
    if n_rows * n_columns > MAX_CELLS:
        raise MeasurementFormatError(
            f"The table has {n_rows} rows of {n_columns} cells, and it may have {MAX_CELLS} cells; leave out rows, or "
            "columns that are not needed."
        )


def parse_text_table(data: bytes, count_names: Callable[[str], int]) -> TextTable:
    """Return the table in the bytes of a text.

    `count_names` says how many known columns a cell names: the line with most of them names the columns. A
    MeasurementFormatError says in one sentence what is wrong and what would be right.
    """
    lines = _text(data).splitlines()
    _check_lengths(lines)
    place, names = _find_names(lines, count_names)
    kept = [(number, line.strip(" ")) for number, line in enumerate(lines[place + 1 :], place + 2) if _is_row(line)]
    check_size(len(kept), len(names))
    units, separator = ("",) * len(names), ","
    for row in kept[:_LINES_OF_UNITS]:
        separator = _separator_of_rows(row, names)
        first = _cells(row[1], separator)
        if not _has_words(first, separator):
            break
        units = tuple(cell.strip(" []()") for cell in first[: len(names)])
        kept = kept[1:]
    numbers = [number for number, _ in kept]
    split = _split([line for _, line in kept], separator)
    rows = [_checked_row(cells, number, names) for number, cells in zip(numbers, split, strict=True)]
    return TextTable(names, units, rows, numbers, separator)


def _text(data: bytes) -> str:
    """Decode UTF-8, UTF-16 with its mark, as spreadsheets write it, or the Western European code page."""
    encoding = "utf-16" if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    if re.search(r"[\x00-\x08\x0e-\x1f\x7f-\x9f]", text):
        raise MeasurementFormatError("The data is not a text; a table of samples is a text in UTF-8.")
    return text


def _is_row(line: str) -> bool:
    return bool(line.strip()) and _COMMENT.match(line) is None


def _check_lengths(lines: Sequence[str]) -> None:
    longest = max(lines, key=len, default="")
    if len(longest) > _MAX_LINE_LENGTH:
        raise MeasurementFormatError(
            f"Line {lines.index(longest) + 1} of the table has {len(longest)} characters; it may have "
            f"{_MAX_LINE_LENGTH}."
        )


def _find_names(lines: Sequence[str], count_names: Callable[[str], int]) -> tuple[int, tuple[str, ...]]:
    """Return the index of the line that names the columns, and the names."""
    best: tuple[int, int, tuple[str, ...]] = (0, 0, ())
    length = 0
    for place, line in enumerate(islice(lines, _LINES_BEFORE_NAMES)):
        length += len(line)
        if length - len(line) > _MAX_HEAD_LENGTH:
            break
        words = _COMMENT.sub("", line, count=1).strip()
        for separator in _SEPARATORS:
            names = tuple(name.strip() for name in _cells(words, separator))
            names = names[:-1] if names and not names[-1] else names
            known = sum(count_names(name) for name in names)
            if known > best[0]:
                best = known, place, names
    if best[0] > 0:
        return best[1:]
    first = next((line.strip() for line in lines if line.strip()), "")
    begins = f"begins with {first[:80]!r}" if first else "is empty"
    raise MeasurementFormatError(
        f"The table {begins} and has no line that names its columns; it needs one such as "
        "theta_in, phi_in, theta_out, phi_out, red, green, blue."
    )


def _separator_of_rows(row: tuple[int, str], names: tuple[str, ...]) -> str:
    """Return what separates the cells of the first row: what gives one cell for each name."""
    number, line = row
    counts = {separator: len(_cells(line, separator)) for separator in _SEPARATORS}
    for separator, count in counts.items():
        if count == len(names) or (count == len(names) + 1 and line.endswith(separator)):
            return separator
    used = next(separator for separator, count in counts.items() if count > 1 or separator == " ")
    raise _wrong_count(number, counts[used], used, names)


def _cells(line: str, separator: str) -> list[str]:
    return next(_split([line], separator), [])


def _split(lines: Sequence[str], separator: str) -> Iterator[list[str]]:
    """Yield the cells of each line, so that the first wrong one ends the reading."""
    blank = separator == " "
    spaced = (line.replace("\t", " ") if blank else line for line in lines)
    try:
        reader = csv.reader(spaced, delimiter=separator, skipinitialspace=True)
        for number, cells in enumerate(reader, 1):
            if reader.line_num > number:  # Every line is a row, whatever its quotation marks.
                raise MeasurementFormatError("A quotation mark in the table is not closed on its line.")
            yield cells
    except csv.Error:
        raise MeasurementFormatError(
            f"The table cannot be split into cells: one is longer than {csv.field_size_limit()} characters, or a "
            "quotation mark is not closed."
        ) from None


def _checked_row(cells: list[str], number: int, names: tuple[str, ...]) -> list[str]:
    if len(cells) == len(names) + 1 and not cells[-1]:  # the line ends with a separator
        return cells[:-1]
    if len(cells) != len(names):
        raise _wrong_count(number, len(cells), "", names)
    return cells


def _wrong_count(number: int, count: int, separator: str, names: tuple[str, ...]) -> MeasurementFormatError:
    between = f", separated by {_SEPARATORS[separator]}" if separator and count > 1 else ""
    hint = "; separate numbers with a decimal comma by semicolons" if separator == "," and count > len(names) else ""
    return MeasurementFormatError(
        f"Line {number} of the table has {count} {'cell' if count == 1 else 'cells'}{between}, and the line of names "
        f"has {len(names)}{hint}."
    )


def _has_words(cells: Sequence[str], separator: str) -> bool:
    """Whether cells are no sample: some words, and no number beside them."""
    numbers = [_as_number(cell, separator) for cell in cells]
    return None in numbers and all(number is None or np.isnan(number) for number in numbers)


def _as_number(cell: str, separator: str) -> float | None:
    """Return the number in a cell, NaN for a cell that says that there is none, or None for other words."""
    text = cell.strip().replace("\N{MINUS SIGN}", "-")
    if text.lower() in _MISSING:
        return float("nan")
    if separator != "," and "." not in text:
        text = text.replace(",", ".", 1)
    try:
        return float(text)
    except ValueError:
        return None
