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

import codecs
import json
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.files import known_kind
from dsbrdf.data.geometry import CHANNELS
from dsbrdf.errors import MeasurementFormatError
from dsbrdf.samples import optics
from dsbrdf.samples.cells import TextTable, check_size, decoded, utf_16_of
from dsbrdf.samples.columns import SPHERICAL
from dsbrdf.samples.names import (
    ANGLE_UNITS,
    HALF_DIFFERENCE,
    MAX_BAND_NM,
    MIN_BAND_NM,
    TRISTIMULUS,
    VECTORS,
    count_names,
    matrix_names,
    meaning_of,
    name_and_unit,
)
from dsbrdf.samples.table_options import TableOptions
from dsbrdf.samples.text_table import parse_text_table

_ASTM_NAMES = re.compile(rb"(?m)^VARS[ \t]+(.*)$")
_NOT_NUMBERS = re.compile(rb"[^-+0-9.eE\s]")
_RAMI = re.compile(rb"\s*([1-9][0-9]{0,6})[ \t]+5[ \t]+[-+.0-9eE]+[ \t]*\r?\n")
_KERNELS = re.compile(rb"BRDF[ \t]+([1-9][0-9]{0,6})[ \t]+[0-9]+((?:[ \t]+[0-9.]+)+)[ \t]*\r?\n")
_JSON_START_BYTES = 100
_HEAD_BYTES = 4096  # The name of the unit is searched only in this part at the beginning of a file.
_GRADIANS = re.compile(rb"\bgon\b|(?i:\bgradians?\b)")  # An instrument may be called GON.
# Parametrisations of ALTA: L is the light, V the viewer, T theta, P phi; H and D are the half and difference angles.
# The angles x and y are theta_out times the cosine and the sine of phi_out.
_ALTA = {
    "RUSIN_TH_PH_TD_PD": ("theta_half", "phi_half", "theta_diff", "phi_diff"),
    "RUSIN_TH_TD_PD": HALF_DIFFERENCE,
    "RUSIN_TH_TD": HALF_DIFFERENCE[:2],
    "SPHERICAL_TL_PL_TV_PV": SPHERICAL,
    "ISOTROPIC_TV_TL_DPHI": ("theta_out", "theta_in", "phi_out"),
    "ISOTROPIC_TL_TV_DPHI": ("theta_in", "theta_out", "phi_out"),
    "ISOTROPIC_TL_TV_PROJ_DPHI": ("theta_in", "x", "y"),
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
    return TextTable.of_numbers([*(f"{name} [rad]" for name in SPHERICAL), *(f"{band:g} nm" for band in bands)], rows.T)


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
            f"The file of ALTA has the parametrisation {form} with {n_in} coordinates and {n_out} values; only "
            f"{', '.join(_ALTA)}, with 1 or 3 values, can be read."
        )
    rows = [line.split()[: n_in + n_out] for line in text.splitlines() if line.strip() and line[0] != "#"]
    columns = list(np.array(rows, dtype=np.float64).T)
    if "x" in names:
        x, y = columns[1:3]
        columns[1:3], names = [np.hypot(x, y), np.arctan2(y, x)], ("theta_in", "theta_out", "phi_out")
    named = [name if name.startswith("omega") else f"{name} [rad]" for name in names]
    if form == "RUSIN_TH_TD":
        named, columns = [*named, "phi_diff [rad]"], [*columns[:2], np.full(len(rows), np.pi / 2), *columns[2:]]
    note = ("The file of ALTA has values times a cosine: set cosine to in.",) if "COSINE" in str(words) else ()
    colors = TRISTIMULUS if "XYZ_COLOR" in words.get("PARAM_OUT", ()) else CHANNELS
    return TextTable.of_numbers([*named, *(("value",) if n_out == 1 else colors)], columns, *note)


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
    """Return the samples in JSON: rows of ASAM OpenMATERIAL 3D, or columns, records or lines of records by name.

    In the BiRD project's format, the object "data" has the values and the unit of each column.
    """
    if data[:_JSON_START_BYTES].strip()[:1] not in (b"{", b"["):
        return None
    try:
        document: Any = json.loads(data)
    except (ValueError, RecursionError):
        try:
            document = [json.loads(line) for line in data.splitlines() if line.strip()]
        except (ValueError, RecursionError):
            return None
    if isinstance(document, dict) and str(document.get("format")).startswith("dsbrdf"):
        raise MeasurementFormatError("The file is a stored model of dsbrdf, not a measurement: dsbrdf show prints it.")
    if isinstance(document, dict) and "lookupTable" in (document.get("brdf") or ()):
        return _open_material_table(document["brdf"])
    places = {"": document, **(document if isinstance(document, dict) else {})}
    tables = {title: dict(_json_columns(place)) for title, place in places.items()}
    n_names = {title: count_names([*columns]) for title, columns in tables.items()}
    title = max(tables, key=lambda title: (n_names[title], len(tables[title])))
    columns, alike = tables[title], [other for other in tables if n_names[other] == n_names[title]]
    length = max(map(len, columns.values()), default=0)
    for name in [name for name, cells in columns.items() if len(cells) != length]:
        if meaning_of(name) not in (None, "wavelength"):
            raise MeasurementFormatError(
                f"The list {name!r} in the JSON has the length {len(columns[name])}, and the longest list {length}: "
                "give each sample a number in each list."
            )
        del columns[name]
    if not length:
        raise MeasurementFormatError(
            "The JSON has no lists of numbers by name, such as theta_in, phi_in, theta_out, phi_out and value, in its "
            'object or in "data".'
        )
    notes = (f"The JSON has {len(alike)} tables; the first was read, {title!r}.",) if len(alike) > 1 else ()
    check_size(length, len(columns))
    rows = [list(cells) for cells in zip(*columns.values(), strict=True)]
    return TextTable((*columns,), rows, [*range(1, length + 1)], notes=notes)


def _json_columns(held: Any) -> Iterator[tuple[str, list[str]]]:
    """Yield name and cells of each column in a dict of columns or in a list of records, which may lack some."""
    if isinstance(held, list) and held and all(isinstance(record, dict) for record in held):
        names = dict.fromkeys(name for record in held for name in record)
        held = {name: [record.get(name) for record in held] for name in names}
    for name, values in held.items() if isinstance(held, dict) else ():
        unit = values.get("unit") if isinstance(values, dict) else None
        cells = values.get("values", [*values.values()]) if isinstance(values, dict) else values
        if isinstance(cells, list):
            yield (f"{name} [{unit}]" if unit else name), ["" if cell is None else str(cell) for cell in cells]


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


class Layout(NamedTuple):
    """Describe a layout of files with samples: its name, a line by which it is recognised, and its reader, if any."""

    name: str
    example: str
    reader: Callable[[bytes], TextTable | None] | None = None


LAYOUTS = (
    Layout("table, directions as angles", "theta_in,phi_in,theta_out,phi_out,red,green,blue"),
    Layout("table, directions in one plane", "AOI [deg];AOR [deg];BRDF [1/sr]"),
    Layout("table, half and difference angles", "theta_half,theta_diff,phi_diff,value"),
    Layout("table, directions as vectors", "wi_x wi_y wi_z wo_x wo_y wo_z r g b"),
    Layout("table, cosines of the angles", "cos(theta_i) cos(theta_v) relative azimuth BRF"),
    Layout("table, phase angle", "incidence emission phase I/F"),
    Layout("table, angle from the mirror direction", "theta_i, theta_s - theta_i, BSDF"),
    Layout("table, a column for each wavelength", "vza,vaa,sza,saa,450 nm,550 nm,650 nm"),
    Layout("table, a row for each wavelength", "wavelength [nm],theta_i,theta_r,brdf"),
    Layout("table, CIE XYZ", "theta_in,theta_out,phi_out,CIE X,CIE Y,CIE Z"),
    Layout("table, Mueller matrix", "theta_i,theta_r,phi_r,f_r11,f_r12,f_r13,f_r14"),
    Layout("table, names of columns in lines of their own", "Column 1: theta_in"),
    Layout("table, columns in lines", "theta_in,30,30,30,60,60,60"),
    Layout("table, angles in lines between the rows", "AOI: 30 deg"),
    Layout("table without names, with the option columns", "30 180 15 0 0.148"),
    Layout("matrix of two angles, or of wavelength and angle", "theta_out / phi_out,0,30,60,90"),
    Layout("pgII, Mountain and Tekari of pab advanced technologies", "#format: theta phi BSDF"),
    Layout("ASTM E1392 and E2387 with names, angles in radians", "VARS theta_i,phi_i,theta_s,phi_s,bsdf"),
    Layout("tabular BSDF of Zemax, text of LightTools (front side)", "ScatterRadial 91", optics.scatter_table),
    Layout("tabulated BSDF of FRED", "type bsdf_data", optics.fred_table),
    Layout(".brdf text of Speos, proportional to the BSDF", "OPTIS - brdf surface file v5.0", optics.speos_table),
    Layout("text of ALTA", "#PARAM_IN ISOTROPIC_TV_TL_DPHI", alta_table),
    Layout("BRF of the RAMI benchmark", "76 5 1.0", rami_table),
    Layout("observations for kernel models (AMBRALS)", "BRDF 96 2 550 650", kernels_table),
    Layout("JSON: ASAM OpenMATERIAL 3D, BiRD, or columns by name", '{"brdf": {"lookupTable": [[5.5e-07,', json_table),
    Layout("spectral text of Cornell University, as in pbrt-v2", "31 400 410 420 430", cornell_spectra_table),
    Layout("spreadsheet: .xlsx, .ods or .xls, its longest sheet", "AOI, AOR, BRDF in the cells of the first row"),
    Layout("file of samples of dsbrdf", "# dsbrdf samples 1"),
)
"""The layouts of files with samples, as `docs/formats.md` and ``dsbrdf table --layouts`` list them."""
# A file of one of these standards is refused unless a line of the file names the columns.
_STANDARD = re.compile(rb"\bE\s?-?(1392|2387)\b")


def table_in(data: bytes, options: TableOptions) -> TextTable:
    """Return the table in the bytes of a text.

    Raises MeasurementFormatError with a sentence that names the mistake, or the file's format if that is unsupported.
    """
    if (kind := known_kind(data[:64])) is not None:  # An archive that is no spreadsheet comes this far.
        raise MeasurementFormatError(f"The file is {kind}.")
    if utf_16_of(data) or data.startswith(codecs.BOM_UTF8):  # The readers understand bytes of ASCII without a mark.
        data = decoded(data).encode()
    for layout in LAYOUTS:
        try:
            table = layout.reader(data) if layout.reader else None
        except MeasurementFormatError:
            raise
        except (ValueError, LookupError):
            start = data[:40].decode("latin-1").splitlines()[0]
            raise MeasurementFormatError(
                f"The file begins with {start!r}, as {layout.name} does, and goes on otherwise: it is cut off, "
                "damaged, or of another kind."
            ) from None
        if table is not None:
            return table
    standard, positions = _STANDARD.search(data), [name.isdecimal() for name in options.named_columns().values()]
    named = {column.lower() for column in options.named_columns().values() if not column.isdecimal()}
    try:
        if re.search(rb"(?im)^#[ \t]*colorimetry[ \t:=]+CIE-?XYZ\b", data):  # Its head names one column for the three.
            data = re.sub(rb"(?m)^(#format:.*\s)\S+[ \t]*\r?$", rb"\1cie_x cie_y cie_z", data, count=1)
        table = parse_text_table(plain_astm(data), named, by_position=any(positions))
        if not standard or table.names[0] != "1" or options.columns:
            _refuse_unnamed_gradians(data, (*table.names, *options.named_columns()))
            return _unfolded(table, options)
    except MeasurementFormatError:
        if not standard:
            raise
    raise MeasurementFormatError(
        f"The file is of ASTM E{standard[1].decode()}, without the names of its columns: write a line with them above "
        "the rows, such as theta_in,phi_in,theta_out,phi_out,value."
    )


def _refuse_unnamed_gradians(data: bytes, names: Sequence[str]) -> None:
    """Raise MeasurementFormatError if the head of a file names gradians, and no column has a unit of angles."""
    found = _GRADIANS.search(data, 0, _HEAD_BYTES)
    if found and not any(name_and_unit(name)[1] in ANGLE_UNITS for name in names):
        raise MeasurementFormatError(
            f"The file names {found[0].decode()}, but no column has this unit: name each angle as in theta_in_gon."
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
            "not say: give it, as in --constants theta_in=30."
        )
    down, *constants = (np.repeat(column, across.size) for column in (table.numbers(0), *held.values()))
    note = f"The table is a matrix: {names[0]} goes down and {names[1]} across."
    columns = (down, np.tile(across, table.n_rows), values.ravel(), *constants)
    return TextTable.of_numbers((*names, "value", *held), columns, *table.notes, note)
