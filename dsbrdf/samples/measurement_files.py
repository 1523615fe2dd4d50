"""Files of measurements of any kind; the suffix tells which."""

import os
from pathlib import Path
from typing import Any

from dsbrdf.data.measurement import Measurement
from dsbrdf.data.merl import map_merl, read_merl
from dsbrdf.data.merl_validation import HEADER, HEADER_SIZE
from dsbrdf.data.rgl_material import read_rgl
from dsbrdf.data.table_options import AS_WRITTEN, TableOptions
from dsbrdf.errors import MeasurementFormatError
from dsbrdf.samples.reading import is_table, parse_samples, read_samples
from dsbrdf.samples.scattered_samples import ScatteredSamples

_OTHER_SPREADSHEETS = (".xls", ".ods")


def read_measurement(
    path: str | os.PathLike[str], options: TableOptions | None = None, **choices: Any
) -> Measurement | ScatteredSamples:
    """Read a measured material.

    Parameters
    ----------
    path : path-like
        ``.csv``, ``.tsv``, ``.txt``, ``.astm`` and ``.xlsx`` are tables of scattered samples; ``.bsdf`` is one of
        Zemax, or an RGL file, whose values are taken at the nodes of the MERL grid; any other file is a MERL
        ``.binary`` file.
    options : TableOptions, optional
        How a table is read.
    **choices
        Single options of a table by name instead: ``columns``, ``missing``, ``scale``, ``cosine``, ``phi``.

    Raises
    ------
    InvalidArgumentError
        If an option is wrong, or of a table where the file is none.
    MeasurementFormatError
        With one sentence that says what is wrong and what would be right.
    MissingExtraError
        Of a spreadsheet, if the extra ``xlsx`` is not installed.
    OSError
        If the file does not exist or cannot be read.
    """
    options = options or TableOptions(**choices)
    suffix = Path(path).suffix.lower()
    if is_table(path):
        return read_samples(path, options)
    if suffix in _OTHER_SPREADSHEETS:
        raise MeasurementFormatError(
            "The file is a spreadsheet of another kind: save it as .xlsx, or its sheet as .csv."
        )
    options.refuse_on_grid()
    return read_rgl(path).measurement() if suffix == ".bsdf" else read_merl(path)


def open_checked(
    path: str | os.PathLike[str], sha256: str, options: TableOptions = AS_WRITTEN
) -> Measurement | ScatteredSamples:
    """Return a MERL file or a table of samples that was checked before; its content tells which.

    It must not change as long as the measurement is used; `sha256` is the hexadecimal digest of its bytes.
    """
    with Path(path).open("rb") as file:
        if file.read(HEADER_SIZE) == HEADER:
            return map_merl(path, sha256)
        file.seek(0)
        return parse_samples(file.read(), Path(path).stem, options)
