"""Files with a table of scattered samples.

`dsbrdf.samples.text_table` finds the cells of a file, `dsbrdf.samples.columns` what they mean. What a measurement
leaves behind is set right here, counted, and said in the notes of the samples: rows without a number, directions at or
below the horizon, small negative values, vectors that are nearly of unit length.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dsbrdf.arrays import Array, Mask
from dsbrdf.data.files import known_kind
from dsbrdf.data.table_options import AS_WRITTEN, TableOptions
from dsbrdf.errors import MeasurementFormatError
from dsbrdf.samples.columns import LOWEST_COSINE, sample_columns
from dsbrdf.samples.layouts import count_names, known_format, plain_table, unfolded
from dsbrdf.samples.scattered_samples import ScatteredSamples
from dsbrdf.samples.spreadsheet import ARCHIVE, SPREADSHEET, is_spreadsheet, spreadsheet_text
from dsbrdf.samples.text_table import parse_text_table
from dsbrdf.samples.zemax import begins_as_zemax, is_zemax, zemax_table

TABLE_SUFFIXES = (".csv", ".tsv", ".txt", ".astm", SPREADSHEET)
"""Suffixes of tables of scattered samples."""
_LARGEST_FILE = 1 << 30  # [bytes]
_TABLE_TOLERANCE = 0.02
_ROUNDED = 1e-3  # tables have few digits: a smaller deviation from unit length is not worth a word
_SAME_DIRECTION = 1e-5  # of the components of unit vectors
_CONTRADICTION, _DARK = 1.25, 0.05  # factor between values of one pair of directions; of the median, which is added
_LARGEST_NOISE = 0.01  # of negative values: each as a share of the largest value, their sum as a share of all


@dataclass(frozen=True, eq=False)
class ReadTable:
    """A table that was read."""

    columns: tuple[tuple[str, str, str], ...]  # of each its name, what it was read as, and the unit, if they say them
    n_rows: int
    samples: ScatteredSamples


def is_table(path: str | os.PathLike[str]) -> bool:
    """Whether a path names a table of samples: by its suffix, or a ``.bsdf`` file of Zemax by its content."""
    suffix = Path(path).suffix.lower()
    return suffix in TABLE_SUFFIXES or (suffix == ".bsdf" and begins_as_zemax(path))


def table_suffix(path: str | os.PathLike[str]) -> str:
    """Return the suffix that goes with the content of a table, ``.txt`` or that of a spreadsheet."""
    with Path(path).open("rb") as file:
        return SPREADSHEET if file.read(len(ARCHIVE)) == ARCHIVE else ".txt"


def read_samples(path: str | os.PathLike[str], options: TableOptions = AS_WRITTEN) -> ScatteredSamples:
    """Read a table of scattered samples: a text, a ``.bsdf`` file of Zemax, or, with the extra ``xlsx``, a spreadsheet.

    The stem of the file becomes the name.

    A MeasurementFormatError says in one sentence what is wrong and what would be right; a MissingExtraError, that
    the extra is not installed.
    """
    source = Path(path)
    if source.stat().st_size > _LARGEST_FILE:
        raise MeasurementFormatError(f"The table is longer than {_LARGEST_FILE} bytes.")
    return parse_samples(source.read_bytes(), source.stem, options)


def parse_samples(data: bytes, name: str = "samples", options: TableOptions = AS_WRITTEN) -> ScatteredSamples:
    """Return the samples in the bytes of a table; errors are those of `read_samples`."""
    return read_table(data, name, options).samples


def read_table(data: bytes, name: str = "samples", options: TableOptions = AS_WRITTEN) -> ReadTable:
    """Return the samples in the bytes of a table with what was understood; errors are those of `read_samples`."""
    notes: list[str] = []
    if is_spreadsheet(data):
        data, notes = spreadsheet_text(data)
    kind = known_kind(data[:16])
    if kind is not None:
        raise MeasurementFormatError(
            f"The data is {kind}; scattered samples are a table, in a text or in a spreadsheet (.xlsx)."
        )
    named = {column.lower() for column in options.named_columns().values()}
    try:
        if is_zemax(data):
            table = zemax_table(data)
        else:
            text = plain_table(data)
            table = parse_text_table(text, lambda cell: count_names(cell) or cell.strip("'\" ").lower() in named)
        found = sample_columns(unfolded(table), options)
    except MeasurementFormatError as error:
        known = known_format(data)
        if known is None:
            raise
        raise MeasurementFormatError(
            f"The data is {known}, which is not read: write its samples as a table with theta_in, phi_in, theta_out, "
            "phi_out and value."
        ) from error
    numbers = found.numbers
    notes += found.notes
    used = np.asarray(np.isfinite(numbers).all(axis=1))
    notes += _left_out(~used, "no finite number in a column that is needed")
    first, second = (
        _unit_vectors(side, numbers[:, at : at + 3], used, notes) for side, at in (("omega_in", 0), ("omega_out", 3))
    )
    above = np.minimum(first[:, 2], second[:, 2]) > LOWEST_COSINE
    notes += _left_out(used & ~above, "a direction at or below the horizon")
    used &= above
    values = numbers[used, 6:9]
    is_grey = bool(np.all(values == values[:, :1]))
    values = np.broadcast_to(_without_noise(values[:, :1] if is_grey else values, notes), values.shape)
    notes += _contradictions(np.hstack([first[used], second[used]]), values.mean(axis=1))
    samples = ScatteredSamples.from_arrays(first[used], second[used], values, numbers[used, 9], name, tuple(notes))
    return ReadTable(found.columns, len(table.rows), samples.changed(options.of_table()))


def _unit_vectors(side: str, vectors: Array, used: Mask, notes: list[str]) -> Array:
    """Return vectors made of unit length."""
    length = np.linalg.norm(vectors, axis=1)
    off = np.where(used, np.abs(length - 1.0), 0.0)
    if off.max(initial=0.0) > _TABLE_TOLERANCE:
        raise MeasurementFormatError(
            f"In {np.count_nonzero(off > _TABLE_TOLERANCE)} of {off.size} rows {side} is not of unit length, which is "
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
            f"{several} negative, down to {-lowest:.4g}, more than noise about zero explains: if they stand for what "
            f"is missing, set missing to {-lowest:g}."
        )
    counts = "it counts" if count == 1 else "they count"
    notes.append(f"{several} negative, down to {-lowest / largest:.2%} of the largest; {counts} as 0.")
    return np.maximum(values, 0.0)


def _contradictions(pairs: Array, values: Array) -> list[str]:
    """Tell of pairs of directions (n, 6) that have several values (n,) far apart."""
    if values.size == 0:
        return []
    digits = np.rint(pairs / _SAME_DIRECTION).astype(np.int64)
    key = digits @ np.random.default_rng(0).integers(1 << 62, size=6)  # equal pairs have equal keys, in linear time
    order = np.lexsort((values, key))
    starts = np.flatnonzero(np.diff(key[order], prepend=key[order][:1] - 1))
    lowest, highest = values[order][starts], values[order][np.append(starts[1:], values.size) - 1]
    apart = highest > _CONTRADICTION * (lowest + _DARK * np.median(values))
    count = int(np.count_nonzero(apart))
    if count == 0:
        return []
    worst = starts[apart][int(np.argmax((highest - lowest)[apart]))]
    theta_in, theta_out = np.degrees(np.arccos(np.clip(pairs[order][worst][[2, 5]], 0.0, 1.0)))
    several = "1 pair of directions has" if count == 1 else f"{count} pairs of directions have"
    return [
        f"{several} values that differ by more than {_CONTRADICTION - 1.0:.0%}, such as theta_in = {theta_in:.4g} and "
        f"theta_out = {theta_out:.4g} degrees: all of them count, so that the fit is between them."
    ]


def _left_out(rows: Mask, fault: str) -> list[str]:
    count = int(np.count_nonzero(rows))
    several = "1 row has" if count == 1 else f"{count} rows have"
    return [f"{several} {fault}; {'it is' if count == 1 else 'they are'} left out."] if count else []
