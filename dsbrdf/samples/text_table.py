"""Tables of numbers as people and instruments write them: bytes -> the cells under each column's name.

Cells are separated by commas, semicolons, tabs or blanks; where it is not the comma, numbers may have a decimal comma.
Lines that begin with ``#``, ``%``, ``//`` or ``!`` are comments; the line that names the columns may be one, and other
lines may stand before it. A line below the names without any number gives the units. A line of a word and a number,
such as ``#intheta 30``, holds for the rows after it. Where no line has names, columns are named by their positions, 1
to n, and lines of fewer numbers, one block of rows after each, continue them.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from dsbrdf.errors import MeasurementFormatError
from dsbrdf.samples.cells import (
    SEPARATORS,
    Constants,
    TextTable,
    as_number,
    check_size,
    decoded,
    split_cells,
    wrong_count,
)
from dsbrdf.samples.unnamed import unnamed_table

_COMMENT = re.compile(r"^\s*(#+|%+|//|!)")
_BEGINS_NUMBER = tuple("+-.0123456789")
_MAX_LINES_BEFORE_NAMES = 500
_MAX_LINES_OF_UNITS = 20
_MAX_LINE_LENGTH = 1 << 17  # [characters]; 4096 columns with all their digits are shorter.
_MAX_HEAD_LENGTH = 1 << 18  # [characters]; the line of names is not looked for behind them.
# Fewer lines that begin with a name are no table whose columns stand in lines.
_MIN_TRANSPOSED_LINES = 3


def parse_text_table(
    data: bytes, count_names: Callable[[Sequence[str]], int], constants_in: Callable[[str], Constants]
) -> TextTable:
    """Return the table in the bytes of a text.

    `count_names` says how many columns some cells name: the line with most of them names the columns. `constants_in`
    returns the numbers that a line gives to all rows after it. A MeasurementFormatError says in one sentence what is
    wrong and what would be right.
    """
    lines = decoded(data).splitlines()
    _check_lengths(lines)
    found = _find_names(lines, count_names) or _transposed(lines, count_names)
    if isinstance(found, TextTable):
        return found
    place, names = found or (-1, ())
    kept, blocks = _rows_and_constants(lines, place, constants_in)
    if not names:
        return _with_blocks(unnamed_table(kept), blocks)
    check_size(len(kept), len(names))
    units, separator = ("",) * len(names), ","
    for row in kept[:_MAX_LINES_OF_UNITS]:
        separator = _separator_of_rows(row, names)
        first = _cells(row[1], separator)
        if not _has_words(first, separator):
            break
        units = tuple(cell.strip(" []()") for cell in first[: len(names)])
        kept, blocks = kept[1:], blocks[1:]
    numbers = [number for number, _ in kept]
    split = split_cells((line for _, line in kept), separator)
    rows = [_checked_row(cells, number, names) for number, cells in zip(numbers, split, strict=True)]
    return _with_blocks(TextTable(names, units, rows, numbers, separator), blocks)


def decoded_lines(data: bytes) -> list[tuple[int, str]]:
    """Return the lines of a text that are no comments, each with its number."""
    return [(at, line.strip()) for at, line in enumerate(decoded(data).splitlines(), 1) if _is_row(line)]


def without_comment(line: str) -> str:
    """Return a line without the mark that makes it a comment."""
    return _COMMENT.sub("", line, count=1).strip()


def _rows_and_constants(
    lines: Sequence[str], place: int, constants_in: Callable[[str], Constants]
) -> tuple[list[tuple[int, str]], list[Constants]]:
    """Return the rows below the line of names with their numbers, and what holds for each."""
    kept, held, now = list[tuple[int, str]](), list[Constants](), Constants()
    names = without_comment(lines[place]) if place >= 0 else None
    for number, line in enumerate(lines, 1):
        text = line.strip(" ")
        bare = text if text[:1] in _BEGINS_NUMBER else without_comment(text)
        found = constants_in(bare) if bare[:1].isalpha() and bare != names else {}
        if found:
            now = now | found
        elif bare and number > place + 1 and bare != names and _is_row(text):
            kept.append((number, text))
            held.append(now)
    return kept, held


def _with_blocks(table: TextTable, blocks: Sequence[Constants]) -> TextTable:
    """Add what held for each row as columns."""
    names = list(dict.fromkeys(name for block in {id(block): block for block in blocks}.values() for name in block))
    columns = [np.array([block.get(name, np.nan) for block in blocks]) for name in names]
    same = {name: column[0] for name, column in zip(names, columns, strict=True) if np.ptp(column) == 0.0}
    held = " and ".join(f"{name} = {number:g}" for name, number in same.items())
    notes = (f"All rows have {held}, as the head of the file says.",) if held else ()
    return replace(
        table,
        names=(*table.names, *names),
        units=(*table.units, *[""] * len(names)),
        columns=(*table.columns, *columns),
        notes=(*table.notes, *notes),
    )


def _check_lengths(lines: Sequence[str]) -> None:
    longest = max(lines, key=len, default="")
    if len(longest) > _MAX_LINE_LENGTH:
        raise MeasurementFormatError(
            f"Line {lines.index(longest) + 1} of the table has {len(longest)} characters; it may have "
            f"{_MAX_LINE_LENGTH}."
        )


def _find_names(
    lines: Sequence[str], count_names: Callable[[Sequence[str]], int]
) -> tuple[int, tuple[str, ...]] | None:
    """Return the index of the line that names the columns, and the names; None if no line does."""
    best: tuple[int, int, int, tuple[str, ...]] = (0, 0, 0, ())
    length = 0
    for place, line in enumerate(islice(lines, _MAX_LINES_BEFORE_NAMES)):
        length += len(line)
        if length - len(line) > _MAX_HEAD_LENGTH:
            break
        words = without_comment(line)
        widths = _widths_of_rows(lines, place + 1)
        for names in _candidates(words):
            known = count_names(names)
            if known == 1 and any(as_number(name, " ") is not None for name in names):
                continue  # It is a number for all rows, or one column of a table that stands in lines.
            fits = len(names) in widths
            if known > 0 and (known + fits, fits) > best[:2]:
                best = known + fits, fits, place, names
    return None if not best[0] or (best[0] == 1 and not best[1]) else best[2:]


def _candidates(words: str) -> Iterator[tuple[str, ...]]:
    """Yield what a line names with each separator, and without a label such as "format:" before the names."""
    label, _, rest = words.partition(":")
    for text in (words, rest.strip()) if rest and " " not in label else (words,):
        for separator in SEPARATORS:
            names = tuple(name.strip() for name in _cells(text, separator))
            yield names[:-1] if names and not names[-1] else names


def _widths_of_rows(lines: Sequence[str], start: int) -> set[int]:
    """Return how many cells the first row from a line on has, with each separator."""
    rows = (line.strip(" ") for line in islice(lines, start, start + _MAX_LINES_BEFORE_NAMES) if _is_row(line))
    row = next(rows, "")
    counts = {(separator, len(_cells(row, separator))) for separator in SEPARATORS}
    return {count - 1 if row.endswith(separator) and count > 1 else count for separator, count in counts}


def _transposed(lines: Sequence[str], count_names: Callable[[Sequence[str]], int]) -> TextTable | None:
    """Return a table whose columns stand in lines, each after its name; None for another table."""
    kept = [(number, line.strip()) for number, line in enumerate(lines, 1) if _is_row(line)]
    for separator in SEPARATORS if kept else ():
        cells = [(number, _cells(line, separator)) for number, line in kept[:_MAX_LINES_BEFORE_NAMES]]
        named = [(number, line) for number, line in cells if len(line) > 2 and count_names(line[:1])]
        if len(named) >= _MIN_TRANSPOSED_LINES and len({len(line) for _, line in named}) == 1:
            names = tuple(line[0].strip() for _, line in named)
            rows = [list(row) for row in zip(*(line[1:] for _, line in named), strict=True)]
            note = "The columns of the table stand in its lines, each after its name."
            return TextTable(names, ("",) * len(names), rows, [named[0][0]] * len(rows), separator, (), (note,))
    return None


def _is_row(line: str) -> bool:
    return bool(line.strip()) and _COMMENT.match(line) is None


def _separator_of_rows(row: tuple[int, str], names: tuple[str, ...]) -> str:
    """Return what separates the cells of the first row: what gives one cell for each name."""
    number, line = row
    counts = {separator: len(_cells(line, separator)) for separator in SEPARATORS}
    for separator, count in counts.items():
        if count == len(names) or (count == len(names) + 1 and line.endswith(separator)):
            return separator
    used = next(separator for separator, count in counts.items() if count > 1 or separator == " ")
    raise wrong_count(number, counts[used], used, names)


def _cells(line: str, separator: str) -> list[str]:
    return next(split_cells([line], separator), [])


def _checked_row(cells: list[str], number: int, names: tuple[str, ...]) -> list[str]:
    if len(cells) == len(names) + 1 and not cells[-1]:  # the line ends with a separator
        return cells[:-1]
    if len(cells) != len(names):
        raise wrong_count(number, len(cells), "", names)
    return cells


def _has_words(cells: Sequence[str], separator: str) -> bool:
    """Whether cells are no sample: some words, and no number beside them."""
    numbers = [as_number(cell, separator) for cell in cells]
    return None in numbers and all(number is None or np.isnan(number) for number in numbers)
