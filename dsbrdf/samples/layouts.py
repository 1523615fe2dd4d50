"""Layouts of files of samples, told by their content.

Each reader of a layout has its published source: `dsbrdf.samples.zemax`, `dsbrdf.samples.optics` (FRED, LightTools,
Speos) and `dsbrdf.samples.research` (ASTM E1392, Cornell's spectral text, ALTA, ASAM OpenMATERIAL 3D). Any other text
is a table of rows, see `dsbrdf.samples.text_table`, or a matrix of two angles.
"""

import re
from collections.abc import Sequence

import numpy as np

from dsbrdf.data.files import known_kind
from dsbrdf.errors import MeasurementFormatError
from dsbrdf.samples import optics, research
from dsbrdf.samples.cells import TextTable, check_size
from dsbrdf.samples.names import MEANINGS, constants_in, count_bands, is_known, name_and_unit
from dsbrdf.samples.table_options import TableOptions
from dsbrdf.samples.text_table import parse_text_table
from dsbrdf.samples.zemax import is_zemax, zemax_table

_READERS = (
    (optics.is_lighttools, optics.lighttools_table),
    (is_zemax, zemax_table),
    (optics.is_fred, optics.fred_table),
    (optics.is_speos, optics.speos_table),
    (research.is_alta, research.alta_table),
    (research.is_open_material, research.open_material_table),
    (research.is_cornell_spectra, research.cornell_spectra_table),
)
# Formats that are not read; the first two only where no table is found in them.
_REFUSED = {
    rb"\bE\s?-?1392\b": "a file of ASTM E1392",
    rb"\bE\s?-?2387\b": "a file of ASTM E2387",
    rb"(?i)\AOPTIS - anisotropic bsdf": "an anisotropic BSDF file of Speos",
    rb"(?i)<WindowElement": "a BSDF file of LBNL WINDOW (Klems XML)",
    rb"(?i)\A\W*TracePro": "a file of TracePro",
}
_MATRICES = ({"theta_in", "theta_out"}, {"theta_out", "phi_out"})
_START = 4096  # bytes in which a format says its name


def table_in(data: bytes, options: TableOptions) -> TextTable:
    """Return the table in the bytes of a text.

    Raises MeasurementFormatError with one sentence that says what is wrong, or which format it is that is not read.
    """
    reader = next((reader for is_layout, reader in _READERS if is_layout(data)), None)
    if reader is not None:
        return reader(data)
    kind = _refused(data[:_START], {*_REFUSED} - {*list(_REFUSED)[:2]}) or known_kind(data[:16])
    if kind is not None:
        raise MeasurementFormatError(f"The data is {kind}, which is not read: {_INSTEAD}.")
    named = {column.lower() for column in options.named_columns().values()}

    def count_names(cells: Sequence[str]) -> int:
        known = sum(_count(cell) or cell.strip("'\" ").lower() in named for cell in cells)
        return known + count_bands(cells)

    known = _refused(data, {*_REFUSED})
    try:
        table = _unfolded(parse_text_table(research.plain_astm(data), count_names, constants_in), options)
        if known is None or options.columns or table.names[0] != "1":
            return table
    except MeasurementFormatError:
        if known is None:
            raise
    raise MeasurementFormatError(f"The data is {known}, which is not read: {_INSTEAD}.")


_INSTEAD = (
    "write its samples as a table with theta_in, phi_in, theta_out, phi_out and value, in a text or in a spreadsheet "
    "(.xlsx)"
)


def _refused(data: bytes, patterns: set[bytes]) -> str | None:
    return next((kind for pattern, kind in _REFUSED.items() if pattern in patterns and re.search(pattern, data)), None)


def _count(cell: str) -> int:
    """Return how many columns a cell names: 1, or the 3 of a matrix, whose first cell tells its rows and columns."""
    return 1 if is_known(cell) else 3 if _matrix_names(cell) else 0


def _unfolded(table: TextTable, options: TableOptions) -> TextTable:
    """Return a matrix, "theta_out / theta_in" or "theta_out / phi_out" its first name, as a table of samples.

    Any other table is returned as it is.
    """
    names = _matrix_names(table.names[0]) if table.names else ()
    if not names:
        return table
    try:
        heads = np.array([float(name) for name in table.names[1 : table.n_cells]])
    except ValueError:
        raise MeasurementFormatError(
            f"The first line of the matrix has {', '.join(table.names[1:6])} where it needs the angles {names[1]}."
        ) from None
    check_size(table.n_rows * heads.size, 3)
    down = table.numbers(0)
    values = np.stack([table.numbers(at) for at in range(1, table.n_cells)], axis=1)
    rows, columns = (axis.ravel() for axis in np.meshgrid(down, heads, indexing="ij"))
    held = {
        name: np.repeat(table.numbers(at), heads.size) for at, name in enumerate(table.names) if at >= table.n_cells
    }
    given = {MEANINGS.get(name_and_unit(name)[0]) for name in (*names, *held, *options.held())}
    if "theta_in" not in given:
        raise MeasurementFormatError(
            f"The table is a matrix of {names[0]} down and {names[1]} across, at one angle of incidence, which it does "
            "not say: give it, such as constants theta_in=30."
        )
    note = f"The table is a matrix: {names[0]} goes down and {names[1]} across."
    return TextTable.of_numbers((*names, "value", *held), (rows, columns, values.ravel(), *held.values()), note)


def _matrix_names(cell: str) -> tuple[str, ...]:
    r"""Return the names in a cell such as "theta_out / theta_in" or "AOR \ AOI [deg]", that of the rows first."""
    name, unit = name_and_unit(cell)
    parts = [part.strip("_ ") for part in re.split(r"[/\\|]", name)]
    if {MEANINGS.get(part) for part in parts} not in _MATRICES or len(parts) != 2:
        return ()
    return tuple(f"{part} [{unit}]" if unit else part for part in parts)
