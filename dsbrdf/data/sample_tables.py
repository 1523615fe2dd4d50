"""Tables of scattered samples: files of text -> `ScatteredSamples`.

`dsbrdf.data.text_table` finds the cells, `dsbrdf.data.sample_columns` what they mean.  What a measurement leaves behind
is set right here, counted, and said in the notes of the samples: rows without a number, directions at or below the
horizon, small negative values, vectors that are nearly of unit length.
"""

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dsbrdf.data.file_kinds import known_kind
from dsbrdf.data.sample_columns import SampleColumns, is_known, sample_columns
from dsbrdf.data.scattered_samples import ScatteredSamples
from dsbrdf.data.text_table import parse_text_table
from dsbrdf.errors import MeasurementFormatError

Array = NDArray[np.float64]

TABLE_SUFFIXES = (".csv", ".tsv", ".txt")
"""Suffixes of tables of scattered samples."""
_LARGEST_FILE = 1 << 30  # [bytes]
_LOWEST_COSINE = 1e-6  # of a direction above the horizon: sines and cosines of angles in degrees are rounded
_UNIT_TOLERANCE = 0.02
_ROUNDED = 1e-3  # tables have few digits: a smaller deviation from unit length is not worth a word
_LARGEST_NOISE = 0.01  # of negative values: each as a share of the largest value, their sum as a share of all


def read_samples(path: str | os.PathLike[str]) -> ScatteredSamples:
    """Read a table of scattered samples.

    Parameters
    ----------
    path : path-like
        A ``.csv``, ``.tsv`` or ``.txt`` file, see the documentation of formats; its stem becomes the name.

    Returns
    -------
    ScatteredSamples

    Raises
    ------
    MeasurementFormatError
        With one sentence that says what is wrong and what would be right.
    OSError
        If the file does not exist or cannot be read.
    """
    source = Path(path)
    if source.stat().st_size > _LARGEST_FILE:
        raise MeasurementFormatError(f"The table is longer than {_LARGEST_FILE} bytes.")
    return parse_samples(source.read_bytes(), source.stem)


def parse_samples(data: bytes, name: str = "samples") -> ScatteredSamples:
    """Return the samples in the bytes of a table; errors are those of `read_samples`."""
    kind = known_kind(data[:16])
    if kind is not None:
        raise MeasurementFormatError(
            f"The data is {kind}; scattered samples are a table in a text: save a spreadsheet as .csv."
        )
    columns = sample_columns(parse_text_table(data, is_known))
    notes = list(columns.notes)
    used = _rows_with_numbers(columns, notes)
    first, second = (_unit_vectors(side, getattr(columns, side), used, notes) for side in ("omega_in", "omega_out"))
    above = np.minimum(first[:, 2], second[:, 2]) > _LOWEST_COSINE
    below = int(np.count_nonzero(used & ~above))
    if below:
        notes.append(f"{_rows(below)} a direction at or below the horizon; {_left_out(below)}.")
    used &= above
    values = _without_noise(columns.values[used], notes)
    weight = None if columns.weight is None else columns.weight[used]
    return ScatteredSamples.from_arrays(first[used], second[used], values, weight, name, notes=tuple(notes))


def _rows_with_numbers(columns: SampleColumns, notes: list[str]) -> NDArray[np.bool_]:
    parts = [columns.omega_in, columns.omega_out, columns.values]
    parts += [] if columns.weight is None else [columns.weight[:, np.newaxis]]
    used = np.isfinite(np.hstack(parts)).all(axis=1)
    lacking = int(used.size - np.count_nonzero(used))
    if lacking:
        notes.append(f"{_rows(lacking)} no finite number in a column that is needed; {_left_out(lacking)}.")
    return np.asarray(used)


def _unit_vectors(side: str, vectors: Array, used: NDArray[np.bool_], notes: list[str]) -> Array:
    """Return vectors made of unit length."""
    length = np.linalg.norm(vectors, axis=1)
    off = np.where(used, np.abs(length - 1.0), 0.0)
    if off.max(initial=0.0) > _UNIT_TOLERANCE:
        raise MeasurementFormatError(
            f"In {np.count_nonzero(off > _UNIT_TOLERANCE)} of {off.size} rows {side} is not of unit length, which is "
            f"{length[int(np.argmax(off))]:.4g} in one of them; directions are unit vectors."
        )
    if off.max(initial=0.0) > _ROUNDED:
        notes.append(f"The vectors {side} were up to {off.max():.1%} off unit length; they were made unit vectors.")
    return np.asarray(vectors / np.where(used & (length > 0.0), length, 1.0)[:, np.newaxis])


def _without_noise(values: Array, notes: list[str]) -> Array:
    """Return values with small negative ones as zero."""
    negative = values < 0.0
    count = int(np.count_nonzero(negative))
    if count == 0:
        return values
    lowest, largest = -values.min(), values.max()
    several = "1 value is" if count == 1 else f"{count} values are"
    if lowest > _LARGEST_NOISE * largest or -values[negative].sum() > _LARGEST_NOISE * values[~negative].sum():
        raise MeasurementFormatError(
            f"{several} negative, down to {-lowest:.4g}, more than noise about zero explains: write nan where there is "
            "no measurement."
        )
    counts = "it counts" if count == 1 else "they count"
    notes.append(f"{several} negative, down to {-lowest / largest:.2%} of the largest; {counts} as 0.")
    return np.maximum(values, 0.0)


def _rows(count: int) -> str:
    return "1 row has" if count == 1 else f"{count} rows have"


def _left_out(count: int) -> str:
    return "it is left out" if count == 1 else "they are left out"
