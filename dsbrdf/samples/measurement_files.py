"""Read a measurement from a file whose kind is recognised by its content."""

import os
import re
from pathlib import Path
from typing import Any, Literal

from dsbrdf.data.measurement import Measurement
from dsbrdf.data.merl import map_merl, read_merl
from dsbrdf.data.merl_validation import HEADER
from dsbrdf.data.rgl_material import read_rgl
from dsbrdf.errors import MeasurementFormatError
from dsbrdf.samples.cells import utf_16_of
from dsbrdf.samples.reading import parse_samples, read_samples
from dsbrdf.samples.scattered_samples import ScatteredSamples
from dsbrdf.samples.table_options import AS_WRITTEN, TableOptions

START_BYTES = 4096
"""This number of bytes at the beginning of a file is enough to recognise the kind of the file."""
_RGL = b"tensor_file\0"
_OLD_SPREADSHEET = b"\xd0\xcf\x11\xe0"  # .xls
_CONTROLS = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f]")
_NAMES = {"merl": "a MERL file", "rgl": "an RGL file"}

MeasurementKind = Literal["merl", "rgl", "samples"]
"""Kinds of measurement files: MERL tables, RGL ``.bsdf`` files, and texts or spreadsheets of samples."""


def measurement_kind(start: bytes) -> MeasurementKind:
    """Return the kind of a file from its first `START_BYTES` bytes, or from all bytes of a shorter file.

    A text or a spreadsheet contains samples; other data that do not begin like an RGL file count as MERL. Raises
    MeasurementFormatError for spreadsheets other than ``.xlsx``.
    """
    if start.startswith(_RGL):
        return "rgl"
    if start.startswith(_OLD_SPREADSHEET) or (start.startswith(b"PK") and b"opendocument.spreadsheet" in start):
        raise MeasurementFormatError(
            "The file is a spreadsheet of another kind: save it as .xlsx, or its sheet as .csv."
        )
    is_text = utf_16_of(start) is not None or not _CONTROLS.search(start)
    return "samples" if start and not start.startswith(HEADER) and (is_text or start.startswith(b"PK")) else "merl"


def kind_of_file(path: str | os.PathLike[str]) -> MeasurementKind:
    """Return the kind of a file; raise OSError, or MeasurementFormatError as `measurement_kind` does."""
    with Path(path).open("rb") as file:
        return measurement_kind(file.read(START_BYTES))


def read_measurement(
    path: str | os.PathLike[str], options: TableOptions | None = None, **choices: Any
) -> Measurement | ScatteredSamples:
    """Read a measured material.

    Parameters
    ----------
    path : path-like
        A MERL file, an RGL file, whose values are taken at the nodes of the MERL grid, or a table of samples, see
        `read_samples`. The content determines the kind, whatever the suffix.
    options : TableOptions, optional
        Options for reading a table.
    **choices
        Single options of a table by name, instead of `options`, as for `read_samples`.

    Raises
    ------
    InvalidArgumentError
        If an option is wrong, or an option of tables is set but the file is not a table.
    MeasurementFormatError
        With one sentence that says what is wrong and what would be right.
    MissingExtraError
        If a spreadsheet is given, and the extra ``xlsx`` is not installed.
    OSError
        If the file does not exist or cannot be read.
    """
    options = TableOptions.chosen(options, choices)
    kind = kind_of_file(path)
    if kind == "samples":
        return read_samples(path, options)
    options.refuse(_NAMES[kind])
    return read_rgl(path).measurement() if kind == "rgl" else read_merl(path)


def open_checked(path: str | os.PathLike[str], sha256: str) -> Measurement | ScatteredSamples:
    """Return a MERL file or a file of samples that was checked before.

    The file must not change while the measurement is in use; `sha256` is the hexadecimal digest of its bytes.
    """
    if kind_of_file(path) == "merl":
        return map_merl(path, sha256)
    return parse_samples(Path(path).read_bytes(), Path(path).stem, AS_WRITTEN)
