"""Recognise the format of a file of samples by its content, and read the file.

This module reads ASTM E1392, Cornell's spectral text, ALTA, RAMI, AMBRALS and JSON; `dsbrdf.samples.optics` reads
Zemax, LightTools, FRED and Speos. A reader returns None for a text in another format. A text in no known format is a
table of rows (`dsbrdf.samples.text_table`) or a matrix over two angles.

Sources: Cornell University's Program of Computer Graphics (read by libbsdf, AstmReader, and by ALTA), pbrt-v2
(`src/materials/measured.cpp`, "Irregularly Sampled Isotropic BRDF"), ALTA's documentation of its data files (Inria),
the measurements brfpp and brfop of the RAMI benchmark (JRC), the observations of AMBRALS (jgomezdans/BRDF_modelling),
`schemas/material_brdf_schema.json` of ASAM OpenMATERIAL 3D 1.1, and `data_json_schema_v1.0.json` of the EURAMET
project BiRD.
"""

import json
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.files import known_kind
from dsbrdf.data.geometry import CHANNELS
from dsbrdf.errors import MeasurementFormatError
from dsbrdf.samples import optics
from dsbrdf.samples.cells import TextTable, check_size
from dsbrdf.samples.names import HALF_DIFFERENCE, MAX_BAND_NM, MIN_BAND_NM, VECTORS, matrix_names, meaning_of
from dsbrdf.samples.table_options import TableOptions
from dsbrdf.samples.text_table import parse_text_table

_ASTM_NAMES = re.compile(rb"(?m)^VARS[ \t]+(.*)$")
_NOT_NUMBERS = re.compile(rb"[^-+0-9.eE\s]")
_RAMI = re.compile(rb"\s*([1-9][0-9]{0,6})[ \t]+5[ \t]+[-+.0-9eE]+[ \t]*\r?\n")
_KERNELS = re.compile(rb"BRDF[ \t]+([1-9][0-9]{0,6})[ \t]+[0-9]+((?:[ \t]+[0-9.]+)+)[ \t]*\r?\n")
_JSON_START_BYTES = 100
_SPHERICAL = ("theta_in", "phi_in", "theta_out", "phi_out")
# Parametrisations of ALTA: L is the light, V the viewer, T theta, P phi; H and D are the half and difference angles.
_ALTA = {
    "RUSIN_TH_PH_TD_PD": ("theta_half", "phi_half", "theta_diff", "phi_diff"),
    "RUSIN_TH_TD_PD": HALF_DIFFERENCE,
    "RUSIN_TH_TD": HALF_DIFFERENCE[:2],
    "SPHERICAL_TL_PL_TV_PV": _SPHERICAL,
    "ISOTROPIC_TV_TL_DPHI": ("theta_out", "theta_in", "phi_out"),
    "ISOTROPIC_TL_TV_DPHI": ("theta_in", "theta_out", "phi_out"),
    "CARTESIAN": VECTORS,
}


def plain_astm(data: bytes) -> bytes:
    """Convert a file of ASTM E1392 to a text table with names and units; return any other text unchanged.

    The head of an ASTM E1392 file ends with the word VARS and the names of the columns; its angles are in radians.
    """
    found = _ASTM_NAMES.search(data)
    if found is None:
        return data
    names = (name.strip() for name in found[1].split(b","))
    in_radians = b",".join(name + b" [rad]" if name.startswith((b"theta", b"phi")) else name for name in names)
    return data[: found.start()] + in_radians + data[found.end() :]


def cornell_spectra_table(data: bytes) -> TextTable | None:
    """Return the samples of a spectral text of Cornell.

    The file has the number of wavelengths, then the wavelengths, then rows of four angles and a spectrum.
    """
    # The last word of the first 4096 bytes is dropped, because the end of these bytes may cut it.
    start, first = _without_comments(data[:4096]), _without_comments(data[:4096]).split()[:-1]
    count = int(first[0][:4]) if first and first[0].isdigit() else 0
    if _NOT_NUMBERS.search(start) or not 2 <= count < len(first):
        return None
    bands = np.array(first[1 : 1 + count], dtype=np.float64)
    if bands.min() <= MIN_BAND_NM or bands.max() >= MAX_BAND_NM or np.diff(bands).min() <= 0.0:
        return None
    rows = np.array(_without_comments(data).split()[1 + count :], dtype=np.float64).reshape(-1, 4 + count)
    return TextTable.of_numbers(
        [*(f"{name} [rad]" for name in _SPHERICAL), *(f"{band:g} nm" for band in bands)], rows.T
    )


def _without_comments(data: bytes) -> bytes:
    return re.sub(rb"#[^\n]*", b"", data)


def alta_table(data: bytes) -> TextTable | None:
    """Return the samples of a data file of ALTA, whose angles are in radians."""
    if not re.search(rb"(?m)^#PARAM_IN\b", data[:4096]):
        return None
    text = data.decode("latin-1")
    words = {name: rest.split() for name, rest in re.findall(r"(?m)^#(\w+)[ \t]+(.*)$", text)}
    form, (n_in, n_out) = words["PARAM_IN"][0], map(int, (words.get("DIM") or ["0", "0"])[:2])
    names = _ALTA.get(form)
    if names is None or len(names) != n_in or n_out not in (1, 3):
        raise MeasurementFormatError(
            f"The file of ALTA has {form} with {n_in} and {n_out} dimensions; read are {', '.join(_ALTA)} with 1 or 3 "
            "values."
        )
    rows = [line.split()[: n_in + n_out] for line in text.splitlines() if line.strip() and line[0] != "#"]
    columns = list(np.array(rows, dtype=np.float64).T)
    named = [name if name.startswith("omega") else f"{name} [rad]" for name in names]
    if form == "RUSIN_TH_TD":
        named, columns = [*named, "phi_diff [rad]"], [*columns[:2], np.full(len(rows), np.pi / 2), *columns[2:]]
    note = ("The file of ALTA has values times a cosine: set cosine to in.",) if "COSINE" in str(words) else ()
    return TextTable.of_numbers([*named, *(("value",) if n_out == 1 else CHANNELS)], columns, *note)


def rami_table(data: bytes) -> TextTable | None:
    """Return the samples of a measurement of the RAMI benchmark.

    The first line has the numbers of rows and columns, and a fraction of rays. A row has the zenith angles of sun and
    viewer, the azimuth between them [rad], the reflectance factor and its error.
    """
    rows = _rows_behind(_RAMI.match(data), data)
    names = ("SZA [rad]", "VZA [rad]", "phi_out [rad]", "BRF")
    return TextTable.of_numbers(names, rows.T[:4]) if rows.shape[1] == len(names) + 1 else None


def kernels_table(data: bytes) -> TextTable | None:
    """Return the samples in a file of observations for kernel models (AMBRALS).

    The first line has the word BRDF, the numbers of rows and bands, and the wavelengths of the bands. A row has a day,
    which may be left out, a mark of validity, zenith angle and azimuth of the viewer, zenith angle and azimuth of the
    sun, and a value for each band.
    """
    found = _KERNELS.match(data)
    rows, bands = _rows_behind(found, data), found[2].split() if found else []
    if rows.shape[1] - len(bands) not in (5, 6):
        return None
    rows = rows[:, -len(bands) - 5 :]
    names = ("VZA", "VAA", "SZA", "SAA", *(f"{float(band):g} nm" for band in bands))
    return TextTable.of_numbers(names, rows[rows[:, 0] > 0.0, 1:].T)


def _rows_behind(found: re.Match[bytes] | None, data: bytes) -> Array:
    """Return the rows of numbers below a first line that states their number; an array without columns if not found."""
    try:
        numbers = np.array(data[found.end() :].split() if found else [], dtype=np.float64)
        return numbers.reshape(int(found[1]) if found else 0, -1)
    except ValueError:
        return np.zeros((0, 0))


def json_table(data: bytes) -> TextTable | None:
    """Return the samples in JSON: rows of ASAM OpenMATERIAL 3D, or columns or records of numbers by name.

    In the BiRD project's format, the object "data" has the values and the unit of each column.
    """
    try:
        document: Any = json.loads(data) if data[:_JSON_START_BYTES].strip()[:1] in (b"{", b"[") else None
    except (ValueError, RecursionError):
        return None
    if document is None:
        return None
    if isinstance(document, dict) and "lookupTable" in (document.get("brdf") or ()):
        return _open_material_table(document["brdf"])
    places = [document, *document.values()] if isinstance(document, dict) else [document]
    columns = max((dict(_number_columns(place)) for place in places), key=len)
    length = max(map(len, columns.values()), default=0)
    columns = {name: numbers for name, numbers in columns.items() if len(numbers) == length}
    if not length:
        raise MeasurementFormatError(
            "The JSON has no lists of numbers by name, such as theta_in, phi_in, theta_out, phi_out and value, in its "
            'object or in "data".'
        )
    return TextTable.of_numbers([*columns], columns.values())


def _number_columns(held: Any) -> Iterator[tuple[str, Array]]:
    """Yield name and numbers of each column in a dict of columns or in a list of records."""
    if isinstance(held, list) and held and all(isinstance(record, dict) for record in held):
        held = {name: [record.get(name) for record in held] for name in held[0]}
    for name, values in held.items() if isinstance(held, dict) else ():
        unit = values.get("unit") if isinstance(values, dict) else None
        try:
            numbers = np.array(values.get("values") if isinstance(values, dict) else values, dtype=np.float64)
        except (TypeError, ValueError):
            continue
        if numbers.ndim == 1:
            yield (f"{name} [{unit}]" if unit else name), numbers


def _open_material_table(brdf: Any) -> TextTable:
    try:
        rows = np.array(brdf["lookupTable"], dtype=np.float64)
    except (ValueError, TypeError, KeyError):
        rows = np.zeros((0, 0))
    if rows.ndim != 2 or rows.shape[1:] != (5,):
        raise MeasurementFormatError(
            "The file of ASAM OpenMATERIAL 3D needs rows of five numbers in brdf.lookupTable: wavelength, two zenith "
            "angles, the azimuth and the BRDF."
        )
    names = ("wavelength [m]", "theta_in [rad]", "theta_out [rad]", "phi_out [rad]", "value")
    return TextTable.of_numbers(names, rows.T)


_READERS = {
    "a BSDF file of Zemax or LightTools": optics.scatter_table,
    "a BSDF file of FRED": optics.fred_table,
    "a BRDF file of Speos": optics.speos_table,
    "a file of ALTA": alta_table,
    "a measurement of RAMI": rami_table,
    "observations of AMBRALS": kernels_table,
    "JSON": json_table,
    "a spectral text of Cornell": cornell_spectra_table,
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
        table = _unfolded(parse_text_table(plain_astm(data), named), options)
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
