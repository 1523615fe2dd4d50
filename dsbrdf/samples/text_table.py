"""Parse tables of numbers as people and instruments write them: from bytes to cells under names of columns.

Cells are separated by commas, semicolons, tabs, bars or blanks; if the separator is not the comma, numbers may have a
decimal comma. Lines that begin with ``#``, ``%``, ``//`` or ``!`` are comments. The line that names the columns may be
a comment, and need not be the first line. A line without any number directly below the column names gives the units. A
line with a name and a number, such as ``#intheta 30``, gives an angle to all rows below the line.
"""

import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from itertools import islice

import numpy as np

from dsbrdf.errors import MeasurementFormatError
from dsbrdf.samples.cells import (
    MAX_COLUMNS,
    SEPARATORS,
    Constants,
    TextTable,
    about_foot,
    as_number,
    check_size,
    decoded,
    split_cells,
    wrong_count,
)
from dsbrdf.samples.names import constants_in, count_names, meaning_of, name_and_unit, wavelength_of

NumberedLines = Sequence[tuple[int, str]]
"""Lines of a text, each with its number in the file, from 1."""
_N_TRIED_LINES = 50  # If a table does not name its columns, the separator is found from at most this number of lines.
_COMMENT = re.compile(r"^\s*(#+|%+|//|!)")
_BEGINS_NUMBER = tuple("+-.0123456789")
_NUMBERS = re.compile(r"[-+.,;\s\deE]*")
_NUMBER_WITH_UNIT = re.compile(r"[-+]?\d*\.?\d+ ?[a-zA-Z\N{DEGREE SIGN}%]")
_MAX_LINES_BEFORE_NAMES = 500
_MAX_LINES_OF_UNITS = 20
_MAX_LINE_LENGTH = 1 << 17  # A longer line is refused; a line of 4096 numbers with all digits is shorter [characters].
_MAX_HEAD_LENGTH = 1 << 18  # The column names are searched only in this part at the beginning of a file [characters].
_LISTED = re.compile(
    r"[ \t]*(?:[#%!]+[ \t]*(?:column|col\.?|field)?|column|col\.?|field)[ \t]*([0-9]+)[ \t]*[-:=.)][ \t]*(\S.*)", re.I
)
# The line with the most names names the columns; with a name for each cell of the row below, it has this many more.
_MATCHING_NAMES_BONUS = 2
# If the line below the column names has at least this number of names, the line is a translation and has no units.
_MIN_NAMES = 2
# A table is transposed only if at least this number of lines begin with a column name.
_MIN_TRANSPOSED_LINES = 3


def parse_text_table(data: bytes, named: Collection[str] = (), *, by_position: bool = False) -> TextTable:
    """Return the table in the bytes of a text.

    The line with most known column names is taken to name the columns. In addition to the built-in names, the names in
    `named`, in lower case, are known. If columns are named `by_position`, a line of names that does not fit the rows is
    ignored. Raises MeasurementFormatError with a sentence that names the mistake and the remedy.
    """
    lines = decoded(data).splitlines()
    longest = max(lines, key=len, default="")
    if len(longest) > _MAX_LINE_LENGTH:
        raise MeasurementFormatError(
            f"Line {lines.index(longest) + 1} of the table has {len(longest)} characters; it may have "
            f"at most {_MAX_LINE_LENGTH}."
        )
    if transposed := _transposed(lines, named):
        return transposed
    place, names = _find_names(lines, named)
    rows, held, titles = _rows_and_constants(lines, place)
    try:
        table = _named_table(rows, names) if names else unnamed_table(rows)
    except MeasurementFormatError:
        if not by_position:
            raise
        table = unnamed_table(rows)
    # A constant that lines between the rows give, such as theta_in, becomes a column.
    blocks = [held[number] for number in table.lines]
    constants = dict.fromkeys(name for block in {id(block): block for block in blocks}.values() for name in block)
    columns = {name: np.array([block.get(name, np.nan) for block in blocks]) for name in constants}
    same = " and ".join(name for name, column in columns.items() if np.ptp(column) == 0.0)
    notes = [f"The head of the file gives {same}."] if same else []
    if titles:
        notes.append(
            f"The line {titles[0][:40]!r} between the rows was taken for a title: if another material or angle begins "
            "below it, write each in a file of its own."
        )
    return table.with_columns(columns, *notes)


def rows_of(lines: Sequence[str]) -> NumberedLines:
    """Return the lines of a text that are neither empty nor comments, each with its number in the file."""
    return [(number, line.strip()) for number, line in enumerate(lines, 1) if _is_row(line)]


def _named_table(lines: NumberedLines, names: tuple[str, ...]) -> TextTable:
    """Return the table in the lines below the column names; the first of these lines may give units."""
    check_size(len(lines), len(names))
    separator, first = ",", 0
    numbered = [[line.strip('"') for line in line.replace(",", " ").split()] for _, line in lines[:3]]
    if [row[:1] for row in numbered] == [["1"], ["2"], ["3"]] and {len(row) for row in numbered} == {len(names) + 1}:
        names = ("row", *names)  # R numbers the rows in a column without a name.
    for number, line in lines[:_MAX_LINES_OF_UNITS]:
        separator = _separator_of_row(number, line, len(names))
        cells = [cell.strip(" []()") for cell in _cells(line, separator)]
        numbers = [as_number(cell) for cell in cells]
        are_words = all(number is None or np.isnan(number) for number in numbers)
        if None not in numbers or not are_words or any(map(_NUMBER_WITH_UNIT.match, cells)):
            break
        first += 1
        if count_names(cells) < _MIN_NAMES:
            pairs = zip(names, cells, strict=False)
            names = tuple(name if name_and_unit(name)[1] or not unit else f"{name} [{unit}]" for name, unit in pairs)
    at = [number for number, _ in lines[first:]]
    found = list(split_cells((line for _, line in lines[first:]), separator))
    n_rows = len(found)
    while n_rows and not _fits(found[n_rows - 1], len(names)) and not _numbers(found[n_rows - 1]):
        n_rows -= 1
    for number, cells in zip(at, found[:n_rows], strict=False):
        if not _fits(cells, len(names)):
            raise wrong_count(number, len(cells), "", len(names))
    rows = [cells[: len(names)] for cells in found[:n_rows]]
    return TextTable(names, rows, at[:n_rows], separator, notes=about_foot(lines[first + n_rows :]))


def _rows_and_constants(lines: Sequence[str], place: int) -> tuple[NumberedLines, dict[int, Constants], list[str]]:
    """Return the rows below the column names with their line numbers, by line number the constants, and titles.

    A title is a line of words between rows, above column names, without a constant that differs from the one before.
    """
    rows, held, now, titles = list[tuple[int, str]](), dict[int, Constants](), Constants(), list[str]()
    names = _without_comment(lines[place]) if place >= 0 else None
    for number, line in enumerate(lines, 1):
        text = line.strip(" ")
        bare = text if text[:1] in _BEGINS_NUMBER else _without_comment(text)
        found = constants_in(bare) if bare[:1].isalpha() and bare != names else {}
        if found or bare == names:
            now, words = now | found, list[str]()
            while rows and rows[-1][1][0].isalpha() and not rows[0][1][0].isalpha():
                words.append(rows.pop()[1])  # This line is no row, because constants or column names follow.
            titles += words if rows and bare == names and held[rows[-1][0]] == now else []
        elif bare and number > place + 1 and _is_row(text):
            rows.append((number, text))
            held[number] = now
    return rows, held, titles


def _find_names(lines: Sequence[str], named: Collection[str]) -> tuple[int, tuple[str, ...]]:
    """Return the index of the line that names the columns, and the names; -1 and no names if there is no such line."""
    if listed := _listed_names(lines):
        return listed
    best: tuple[int, int, int, tuple[str, ...]] = (0, 0, -1, ())
    length = 0
    for place, line in enumerate(islice(lines, _MAX_LINES_BEFORE_NAMES)):
        length += len(line)
        if length - len(line) > _MAX_HEAD_LENGTH:
            break
        words = _without_comment(line)
        if _NUMBERS.fullmatch(words):  # A row of numbers has no names, and searching it for names would be slow.
            continue
        below = filter(_is_row, islice(lines, place + 1, place + 1 + _MAX_LINES_BEFORE_NAMES))
        row = next(below, "").strip(" ")
        at = place
        if not row and _COMMENT.match(line):  # A comment without rows below may name the columns of the rows above.
            at, row = -1, next(filter(_is_row, lines), "").strip(" ")
        splits = [_cells(row, separator) for separator in SEPARATORS]
        for names in _candidates(words, is_glued=re.match(r"\s*[#%!]+\w", line) is not None):
            if len(names) > 2 * MAX_COLUMNS:
                continue
            known = count_names(names, named)
            fits = any(_fits(cells, len(names)) for cells in splits)
            has_numbers = any(name and not wavelength_of(name) and as_number(name) is not None for name in names)
            if has_numbers and (known == 1 or not fits):
                continue  # The line is no line of column names, but a constant, a transposed column or a title.
            score = known + _MATCHING_NAMES_BONUS * fits
            if known > 0 and (score, fits) > best[:2]:
                best = score, fits, at, names
    _, _, place, names = best if best[0] > 1 else (0, 0, -1, ())
    above = next(filter(_is_row, reversed(lines[:place])), "") if len({*names}) < len(names) else ""
    return place, _with_groups(names, above)


def _with_groups(names: tuple[str, ...], above: str) -> tuple[str, ...]:
    """Return column names, each with its group in front: theta below incident in the line above is "incident theta"."""
    for groups in (_cells(above, separator) for separator in SEPARATORS):
        if 1 < len(groups) <= len(names) + 1:
            group, found = "", list[str]()
            for at, name in enumerate(names):
                group = groups[at].strip() or group if at < len(groups) else group
                found.append(f"{group} {name}" if meaning_of(f"{group} {name}") else name)
            return tuple(found)
    return names


def _listed_names(lines: Sequence[str]) -> tuple[int, tuple[str, ...]] | None:
    """Return column names that have a line each, such as "Column 1: theta_in", and the index of the last such line."""
    names = list[str]()
    for place, line in enumerate(lines[:_MAX_LINES_BEFORE_NAMES]):
        found = _LISTED.fullmatch(line[:_MAX_HEAD_LENGTH])
        if found and int(found[1][:9]) == len(names) + 1:
            names.append(found[2].strip())
        elif len(names) > _MIN_NAMES and count_names(names) > _MIN_NAMES:
            return place - 1, tuple(names)
        else:
            names = []
    return None


def _candidates(words: str, *, is_glued: bool) -> Iterator[tuple[str, ...]]:
    """Yield the column names in a line, split by each separator, and again without a label such as "format:".

    A label without a colon is a word that is not understood before names that are, or is glued to the comment mark.
    """
    label, _, rest = words.partition(":")
    for text in (rest.strip(), words) if rest and " " not in label else (words,):
        for separator in SEPARATORS:
            names = tuple(name.strip() for name in _cells(text, separator))
            n_named = max((at for at, name in enumerate(names, 1) if name), default=0)
            yield names[: max(n_named, len(names) - 1)]  # The last name is empty if the line ends with a separator.
            yield names[:n_named]
            is_last_known = bool(names) and (meaning_of(names[-1]) or wavelength_of(names[-1]))
            if len(names) > 2 and not meaning_of(names[0]) and (is_glued or is_last_known):
                yield names[1:]


def _transposed(lines: Sequence[str], named: Collection[str]) -> TextTable | None:
    """Return a table whose lines are columns, each beginning with the column's name; None for any other table."""
    kept = rows_of(lines)
    for separator in SEPARATORS if kept else ():
        cells = [(number, _cells(line, separator)) for number, line in kept[:_MAX_LINES_BEFORE_NAMES]]
        begun = [(number, line) for number, line in cells if len(line) > 2 and count_names(line[:1], named) == 1]
        found = [(number, line) for number, line in begun if as_number(line[1]) is not None]
        names = tuple(line[0].strip() for _, line in found)
        is_transposed = len(found) >= _MIN_TRANSPOSED_LINES and len({*names}) == len(found)
        if is_transposed and len({len(line) for _, line in found}) == 1:
            rows = [list(row) for row in zip(*(line[1:] for _, line in found), strict=True)]
            note = "The columns of the table stand in its lines, each after its name."
            return TextTable(names, rows, [found[0][0]] * len(rows), separator, notes=(note,))
    return None


def _without_comment(line: str) -> str:
    """Return a line without the comment mark, such as #, at the beginning."""
    return _COMMENT.sub("", line, count=1).strip()


def _is_row(line: str) -> bool:
    return bool(line.strip()) and _COMMENT.match(line) is None


def _separator_of_row(number: int, line: str, n_names: int) -> str:
    """Return the separator that splits a row into one cell for each column name."""
    splits = {separator: _cells(line, separator) for separator in SEPARATORS}
    for separator, cells in splits.items():
        if _fits(cells, n_names):
            return separator
    used = next(separator for separator, cells in splits.items() if len(cells) > 1 or separator == " ")
    raise wrong_count(number, len(splits[used]), used, n_names)


def _fits(cells: Sequence[str], n_names: int) -> bool:
    """Return whether a row has a cell for each column name, and only empty cells after the last name."""
    return len(cells) >= n_names and not any(map(str.strip, cells[n_names:]))


def _cells(line: str, separator: str) -> list[str]:
    return next(split_cells([line], separator), [])


def unnamed_table(numbered: NumberedLines) -> TextTable:
    """Return the table in numbered lines that do not name the columns; lines before the first number are a title.

    Columns are named 1 to n, by their positions. A line with fewer numbers than the rows begins a block of rows: the
    numbers of this line become the columns n + 1, n + 2 and so on of all rows in the block. Raises
    MeasurementFormatError for words between lines of numbers.
    """
    count, separator, first = _layout(numbered)
    lines = numbered[first:]
    check_size(len(lines), count)
    found = list(split_cells((line for _, line in lines), separator))
    while found and not (_numbers(found[-1]) or _numbers(lines[len(found) - 1][1].split())):
        found.pop()
    width = Counter(map(len, found)).most_common(1)[0][0] if found else 0
    if not found or count < 2:
        begins = f"begins with {numbered[0][1][:80]!r}" if numbered else "is empty"
        words = " in words that are understood" if numbered else ""
        raise MeasurementFormatError(
            f"The table {begins} and has no line that names its columns{words}; it needs one such as theta_in, phi_in, "
            "theta_out, phi_out, red, green, blue."
        )
    rows, at, blocks, block = list[list[str]](), list[int](), list[list[float]](), list[float]()
    for (number, line), cells in zip(lines, found, strict=False):
        if len(cells) > width:
            raise wrong_count(number, len(cells), separator, width)
        if len(cells) == width:
            rows.append(cells)
            at.append(number)
            blocks.append(block)
            continue
        block = _numbers(cells) or _numbers(line.split())
        if not block:
            raise MeasurementFormatError(
                f"Line {number} of the table has {line[:40]!r} between lines of numbers alone."
            )
    size = max(map(len, blocks))
    columns = np.array([[*block, *[np.nan] * (size - len(block))] for block in blocks]).T
    names = tuple(str(place) for place in range(1, width + size + 1))
    return TextTable(names, rows, at, separator, tuple(columns) if size else (), about_foot(lines[len(found) :]))


def _layout(numbered: NumberedLines) -> tuple[int, str, int]:
    """Return the largest number of cells in a line of numbers, the separator, and the index of the first such line."""
    best = (0, " ", 0)
    for separator in SEPARATORS:
        cells = list(split_cells((line for _, line in numbered[:_N_TRIED_LINES]), separator))
        lines = zip(cells, numbered, strict=False)
        widest = max((len(row) for row in cells if _numbers(row)), default=0)
        if widest > best[0]:
            begins = (bool(_numbers(row) or _numbers(line.split())) for row, (_, line) in lines)
            best = (widest, separator, list(begins).index(True))
    return best


def _numbers(cells: Sequence[str]) -> list[float]:
    """Return the numbers in cells; an empty list if any of the cells has words."""
    numbers = [number for cell in cells if (number := as_number(cell)) is not None]
    return numbers if len(numbers) == len(cells) else []
