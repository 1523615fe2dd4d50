"""Recognise the format of a file of samples by its content, and read the file.

The readers of known formats are in `dsbrdf.samples.optics` (Zemax, LightTools, FRED, Speos) and
`dsbrdf.samples.research` (ASTM E1392, Cornell's spectral text, ALTA, RAMI, AMBRALS, JSON). A reader returns None for a
text in another format. A text in no known format is a table of rows (`dsbrdf.samples.text_table`) or a matrix over two
angles.
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

_READERS = {
    "a BSDF file of Zemax or LightTools": optics.scatter_table,
    "a BSDF file of FRED": optics.fred_table,
    "a BRDF file of Speos": optics.speos_table,
    "a file of ALTA": research.alta_table,
    "a measurement of RAMI": research.rami_table,
    "observations of AMBRALS": research.kernels_table,
    "JSON": research.json_table,
    "a spectral text of Cornell": research.cornell_spectra_table,
}
_REFUSED = {
    rb"(?i)\AOPTIS - anisotropic bsdf": "an anisotropic BSDF file of Speos",
    rb"(?i)<WindowElement": "a BSDF file of LBNL WINDOW (Klems XML)",
    rb"(?i)\A\W*TracePro": "a file of TracePro",
    rb"\A\s*IESNA": "the light distribution of a lamp (IES LM-63)",
    rb"\A\s*PDS_VERSION_ID": "a label of the Planetary Data System, which describes another file",
}
# A file in one of these formats is refused unless a line of the file names the columns.
_REFUSED_WITHOUT_NAMES = {
    rb"\bE\s?-?1392\b": "a file of ASTM E1392",
    rb"\bE\s?-?2387\b": "a file of ASTM E2387",
}
_START_BYTES = 4096  # The name of an unsupported format is searched only in this number of bytes at the beginning.


def table_in(data: bytes, options: TableOptions) -> TextTable:
    """Return the table in the bytes of a text.

    Raises MeasurementFormatError with a sentence that names the mistake, or the file's format if that is unsupported.
    """
    for kind, reader in _READERS.items():
        try:
            table = reader(data)
        except MeasurementFormatError:
            raise
        except (ValueError, LookupError):
            raise MeasurementFormatError(f"The data begins as {kind}, but is cut off or damaged.") from None
        if table is not None:
            return table
    if known := _format_of(data[:_START_BYTES], _REFUSED) or known_kind(data[:16]):
        raise _not_read(known)
    known = _format_of(data, _REFUSED_WITHOUT_NAMES)
    named = {column.lower() for column in options.named_columns().values() if not column.isdecimal()}
    try:
        table = _unfolded(parse_text_table(research.plain_astm(data), named), options)
    except MeasurementFormatError as error:
        raise (_not_read(known) if known else error) from None
    if known and table.names[0] == "1" and not options.columns:
        raise _not_read(known)
    return table


def _format_of(data: bytes, patterns: dict[bytes, str]) -> str | None:
    return next((kind for pattern, kind in patterns.items() if re.search(pattern, data)), None)


def _not_read(kind: str) -> MeasurementFormatError:
    return MeasurementFormatError(
        f"The data is {kind}, which is not read: write its samples as a table with theta_in, phi_in, theta_out, "
        "phi_out and value, in a text or in a spreadsheet (.xlsx)."
    )


def _unfolded(table: TextTable, options: TableOptions) -> TextTable:
    """Convert a matrix of values over two angles to a table of samples; return any other table unchanged.

    The first cell of a matrix names both angles, as in "theta_out / theta_in" or "theta_out / phi_out".
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
