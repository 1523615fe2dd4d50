"""Parse tables of numbers without any names.

Columns are named 1 to n, by their positions. A line of fewer numbers begins a block: its numbers apply to the rows of
the block, as further columns that are named n + 1 and so on.
"""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from dsbrdf.errors import MeasurementFormatError
from dsbrdf.samples.cells import SEPARATORS, TextTable, about_foot, as_number, check_size, split_cells, wrong_count

# The separator is chosen by this number of lines.
_N_TRIED_LINES = 50

NumberedLines = Sequence[tuple[int, str]]
"""Lines of a text, each with its number from 1."""


def unnamed_table(numbered: NumberedLines) -> TextTable:
    """Return the table in numbered lines; lines before the first number are a title.

    Raises MeasurementFormatError for a line with words between lines of numbers.
    """
    count, separator, first = _layout(numbered)
    lines = numbered[first:]
    check_size(len(lines), count)
    found = list(split_cells((line for _, line in lines), separator))
    while found and not (_numbers(found[-1], separator) or _numbers(lines[len(found) - 1][1].split(), separator)):
        found.pop()
    lines, foot = lines[: len(found)], lines[len(found) :]
    width = Counter(map(len, found)).most_common(1)[0][0] if found else 0
    if len(found) != len(lines) or count < 2:
        begins = f"begins with {numbered[0][1][:80]!r}" if numbered else "is empty"
        words = " in words that are understood" if numbered else ""
        raise MeasurementFormatError(
            f"The table {begins} and has no line that names its columns{words}; it needs one such as theta_in, phi_in, "
            "theta_out, phi_out, red, green, blue."
        )
    rows, at, blocks, block = list[list[str]](), list[int](), list[list[float]](), list[float]()
    for (number, line), cells in zip(lines, found, strict=True):
        if len(cells) > width:
            raise wrong_count(number, len(cells), separator, width)
        if len(cells) == width:
            rows.append(cells)
            at.append(number)
            blocks.append(block)
            continue
        block = _numbers(cells, separator) or _numbers(line.split(), separator)
        if not block:
            raise MeasurementFormatError(
                f"Line {number} of the table has {line[:40]!r} between lines that have numbers alone."
            )
    size = max(map(len, blocks))
    columns = np.array([[*block, *[np.nan] * (size - len(block))] for block in blocks]).T
    names = tuple(str(place) for place in range(1, width + size + 1))
    return TextTable(names, rows, at, separator, tuple(columns) if size else (), about_foot(foot))


def _layout(numbered: NumberedLines) -> tuple[int, str, int]:
    """Return the largest number of cells of a line of numbers, their separator, and the index of the first line."""
    best = (0, " ", 0)
    for separator in SEPARATORS:
        cells = list(split_cells((line for _, line in numbered[:_N_TRIED_LINES]), separator))
        lines = zip(cells, numbered, strict=False)
        widest = max((len(row) for row in cells if _numbers(row, separator)), default=0)
        if widest > best[0]:
            begins = (bool(_numbers(row, separator) or _numbers(line.split(), separator)) for row, (_, line) in lines)
            best = (widest, separator, list(begins).index(True))
    return best


def _numbers(cells: Sequence[str], separator: str) -> list[float]:
    """Return the numbers in cells; an empty list if a cell has words."""
    numbers = [number for cell in cells if (number := as_number(cell, separator)) is not None]
    return numbers if len(numbers) == len(cells) else []
