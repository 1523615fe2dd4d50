"""Tables that do not have a row for each sample, and files of instruments that are told by their content.

A file of ASTM E1392, as the measurements of Cornell University's Program of Computer Graphics are, has lines of a word
and a value, then the names of the columns after the word VARS, then the samples; its angles are in radians.
"""

import re

from dsbrdf.samples.names import MEANINGS, is_known, name_and_unit
from dsbrdf.samples.text_table import TextTable, check_size

_THETAS = {"theta_in", "theta_out"}
_ASTM_NAMES = re.compile(rb"(?m)^VARS[ \t]+(.*)$")
_FORMATS = {
    rb"\bE\s?-?1392\b": "a file of ASTM E1392",
    rb"\bE\s?-?2387\b": "a file of ASTM E2387",
}


def known_format(data: bytes) -> str | None:
    """Return what the text is, such as "a file of ASTM E1392"; None for any other."""
    return next((name for pattern, name in _FORMATS.items() if re.search(pattern, data)), None)


def plain_table(data: bytes) -> bytes:
    """Return a file of ASTM E1392 as a table with names and units, each row on its line; any other text as it is."""
    found = _ASTM_NAMES.search(data)
    if found is None:
        return data
    names = (name.strip() for name in found[1].split(b","))
    in_radians = b",".join(name + b" [rad]" if name.startswith((b"theta", b"phi")) else name for name in names)
    return b"\n" * data.count(b"\n", 0, found.start()) + in_radians + data[found.end() :]


def count_names(cell: str) -> int:
    """Return how many columns a cell names: 1, or the 3 of a matrix, whose first cell tells its rows and columns."""
    return 1 if is_known(cell) else 3 if _matrix_names(cell) else 0


def unfolded(table: TextTable) -> TextTable:
    """Return a matrix of incidence against receiver, "theta_out / theta_in" its first name, as a table of samples.

    Any other table is returned as it is.
    """
    names = _matrix_names(table.names[0])
    if len(names) < 2:
        return table
    check_size(len(table.rows) * (len(table.names) - 1), 3)
    rows = [[row[0], head, cell] for row in table.rows for head, cell in zip(table.names[1:], row[1:], strict=True)]
    lines = [line for line in table.lines for _ in table.names[1:]]
    return TextTable((*names, "value"), ("", "", ""), rows, lines, table.separator)


def _matrix_names(cell: str) -> tuple[str, ...]:
    r"""Return the names in a cell such as "theta_out / theta_in" or "AOR \ AOI [deg]", that of the rows first."""
    name, unit = name_and_unit(cell)
    parts = [part.strip("_ ") for part in re.split(r"[/\\|]", name)]
    if {MEANINGS.get(part) for part in parts} != _THETAS or len(parts) != 2:
        return ()
    return tuple(f"{part} [{unit}]" if unit else part for part in parts)
