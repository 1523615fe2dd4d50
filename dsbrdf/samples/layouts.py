"""Layouts of files of samples, recognised by their content.

Each reader of a layout has its published source: `dsbrdf.samples.optics` (Zemax, LightTools, FRED, Speos) and
`dsbrdf.samples.research` (ASTM E1392, Cornell's spectral text, ALTA, ASAM OpenMATERIAL 3D); it returns None for a text
of another layout. Any other text is a table of rows, see `dsbrdf.samples.text_table`, or a matrix of two angles.
"""

import re

import numpy as np

from dsbrdf.data.files import known_kind
from dsbrdf.errors import MeasurementFormatError
from dsbrdf.samples import optics, research
from dsbrdf.samples.cells import TextTable, check_size
from dsbrdf.samples.names import matrix_names, meaning_of
from dsbrdf.samples.table_options import TableOptions
from dsbrdf.samples.text_table import parse_text_table

_READERS = (
    optics.scatter_table,
    optics.fred_table,
    optics.speos_table,
    research.alta_table,
    research.open_material_table,
    research.cornell_spectra_table,
)
_REFUSED = {
    rb"(?i)\AOPTIS - anisotropic bsdf": "an anisotropic BSDF file of Speos",
    rb"(?i)<WindowElement": "a BSDF file of LBNL WINDOW (Klems XML)",
    rb"(?i)\A\W*TracePro": "a file of TracePro",
}
# Files of these formats are read if they name their columns.
_REFUSED_WITHOUT_NAMES = {
    rb"\bE\s?-?1392\b": "a file of ASTM E1392",
    rb"\bE\s?-?2387\b": "a file of ASTM E2387",
}
_START_BYTES = 4096  # A format says its name in so many bytes.


def table_in(data: bytes, options: TableOptions) -> TextTable:
    """Return the table in the bytes of a text.

    Raises MeasurementFormatError with one sentence that says what is wrong, or which format it is that is not read.
    """
    for reader in _READERS:
        if (table := reader(data)) is not None:
            return table
    if kind := _format_of(data[:_START_BYTES], _REFUSED) or known_kind(data[:16]):
        raise _not_read(kind)
    kind = _format_of(data, _REFUSED_WITHOUT_NAMES)
    named = {column.lower() for column in options.named_columns().values()}
    try:
        table = _unfolded(parse_text_table(research.plain_astm(data), named), options)
    except MeasurementFormatError as error:
        raise (_not_read(kind) if kind else error) from None
    if kind and table.names[0] == "1" and not options.columns:
        raise _not_read(kind)
    return table


def _format_of(data: bytes, patterns: dict[bytes, str]) -> str | None:
    return next((kind for pattern, kind in patterns.items() if re.search(pattern, data)), None)


def _not_read(kind: str) -> MeasurementFormatError:
    return MeasurementFormatError(
        f"The data is {kind}, which is not read: write its samples as a table with theta_in, phi_in, theta_out, "
        "phi_out and value, in a text or in a spreadsheet (.xlsx)."
    )


def _unfolded(table: TextTable, options: TableOptions) -> TextTable:
    """Return a matrix, "theta_out / theta_in" or "theta_out / phi_out" its first name, as a table of samples.

    Any other table is returned as it is.
    """
    names = matrix_names(table.names[0]) if table.names else ()
    if not names:
        return table
    try:
        across = np.array([float(name) for name in table.names[1 : table.n_cells]])
    except ValueError:
        raise MeasurementFormatError(
            f"The first line of the matrix has {', '.join(table.names[1:6])} where it needs the angles {names[1]}."
        ) from None
    check_size(table.n_rows * across.size, 3)
    values = np.stack([table.numbers(at) for at in range(1, table.n_cells)], axis=1)
    held = {name: table.numbers(at) for at, name in enumerate(table.names) if at >= table.n_cells}
    if "theta_in" not in map(meaning_of, (*names, *held, *options.held())):
        raise MeasurementFormatError(
            f"The table is a matrix of {names[0]} down and {names[1]} across, at one angle of incidence, which it does "
            "not say: give it, such as constants theta_in=30."
        )
    down, *constants = (np.repeat(column, across.size) for column in (table.numbers(0), *held.values()))
    note = f"The table is a matrix: {names[0]} goes down and {names[1]} across."
    columns = (down, np.tile(across, table.n_rows), values.ravel(), *constants)
    return TextTable.of_numbers((*names, "value", *held), columns, *table.notes, note)
