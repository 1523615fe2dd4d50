"""Read a measurement from a file, whose content determines its kind.

The module `dsbrdf.samples.layouts` finds the cells of a table of samples, and `dsbrdf.samples.directions` reads the
cells. This module repairs faults of a measurement, and describes each repair in a note: rows without a number,
directions at or below the horizon, zeros for missing values, small negative values, and vectors that are nearly of unit
length.
"""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dsbrdf.arrays import Array, Mask
from dsbrdf.data.files import known_kind
from dsbrdf.data.geometry import GRID_SHAPE
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.merl import map_merl, read_merl
from dsbrdf.data.rgl import read_rgl
from dsbrdf.errors import InvalidArgumentError, MeasurementFormatError
from dsbrdf.samples.cells import OLD_WORKBOOK, TextTable, is_spreadsheet, spreadsheet_text, utf_16_of
from dsbrdf.samples.columns import Description
from dsbrdf.samples.directions import LOWEST_COSINE, SampleRows, read_columns
from dsbrdf.samples.layouts import table_in
from dsbrdf.samples.scattered_samples import CANONICAL, CANONICAL_NAMES, ScatteredSamples
from dsbrdf.samples.table_options import AS_WRITTEN, TableOptions
from dsbrdf.samples.values import MAX_NOISE_FRACTION, about_repeated, unmeasured_zeros

START_BYTES = 4096
"""This number of bytes at the beginning of a file is enough to recognise the kind of the file."""
RGL_START = b"tensor_file\0"
"""First bytes of an RGL ``.bsdf`` file."""
_CONTROLS = re.compile(rb"[\x00-\x08\x0e-\x19\x1b-\x1f\x7f]")
_MAX_LIKELY_SIZE = 100_000  # A larger number is no dimension of a grid: the file is of another kind.
_NAMES = {"merl": "a MERL file", "rgl": "an RGL file"}

MeasurementKind = Literal["merl", "rgl", "samples"]
"""Kinds of measurement files: MERL tables, RGL ``.bsdf`` files, and texts or spreadsheets of samples."""


def measurement_kind(start: bytes) -> MeasurementKind:
    """Return the kind of a file from its first `START_BYTES` bytes, or from all bytes of a shorter file.

    A text or a spreadsheet contains samples. Raises MeasurementFormatError, with what to do, for all other files than
    those that begin with the dimensions of a grid, which count as MERL.
    """
    if start.startswith(RGL_START):
        return "rgl"
    if start.startswith((b"PK\x03\x04", OLD_WORKBOOK)):
        return "samples"
    if (kind := known_kind(start)) is not None:
        raise MeasurementFormatError(f"The file is {kind}.")
    if utf_16_of(start):
        return "samples"
    dimensions = [struct.unpack(order, start[:12].ljust(12)) for order in ("<3i", ">3i")]
    if any(0 < min(sizes) <= max(sizes) < _MAX_LIKELY_SIZE for sizes in dimensions):
        return "merl"
    if not _CONTROLS.search(start):
        return "samples"
    raise MeasurementFormatError(
        f"The file is of an unknown kind: neither a MERL file, which begins with the dimensions {GRID_SHAPE}, nor a "
        ".bsdf file of the RGL database, nor a text or spreadsheet with a table of samples."
    )


def kind_of_file(path: str | os.PathLike[str]) -> MeasurementKind:
    """Return the kind of a file; raise OSError if the file cannot be read, and MeasurementFormatError for a pipe."""
    source = Path(path)
    if source.exists() and not (source.is_file() or source.is_dir()):
        # The bytes that are read here would be missing when the measurement is read from the pipe.
        raise MeasurementFormatError("A pipe or a device can be read only once: save the measurement in a file first.")
    with source.open("rb") as file:
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
    samples = samples_in(Path(path), TableOptions.chosen(options, choices))
    if samples is not None:
        return samples
    return read_rgl(path).measurement() if kind_of_file(path) == "rgl" else read_merl(path)


def samples_in(path: Path, options: TableOptions = AS_WRITTEN) -> ScatteredSamples | None:
    """Return the samples in a file; None for a measurement on a grid. Raises as `read_measurement`."""
    kind = kind_of_file(path)
    if kind == "samples":
        return read_samples(path, options)
    options.refuse(_NAMES[kind])
    return None


def open_checked(path: str | os.PathLike[str], sha256: str) -> Measurement | ScatteredSamples:
    """Return a MERL file or a file of samples that was checked before.

    The file must not change while the measurement is in use; `sha256` is the hexadecimal digest of its bytes.
    """
    if kind_of_file(path) == "merl":
        return map_merl(path, sha256)
    return parse_samples(Path(path).read_bytes(), Path(path).stem, AS_WRITTEN)


_MAX_FILE_BYTES = 1 << 30
# A file is refused if the length of a direction vector deviates from 1 by more.
_MAX_LENGTH_DEVIATION = 0.02
# A note says that vectors were scaled if a length deviates from 1 by more; smaller deviations are rounding errors.
_ROUNDED_LENGTH_DEVIATION = 1e-3
# Components of unit vectors are rounded to this step, so that nearly equal directions count as equal.
_SAME_COMPONENT = 1e-5
# Values at one pair of directions contradict each other if their ratio is larger than this factor.
_CONTRADICTION_FACTOR = 1.25
# This fraction of the median is added to the lower value before the ratio is taken, because dark values are noisy.
_DARK_FRACTION = 0.05


@dataclass(frozen=True, eq=False)
class ReadTable:
    """Samples of a table that was read, a description of its columns, and the number of its rows."""

    columns: Description
    n_rows: int
    samples: ScatteredSamples


def read_samples(
    path: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    options: TableOptions | None = None,
    **choices: Any,
) -> ScatteredSamples:
    """Read a table of scattered samples.

    Parameters
    ----------
    path : path-like, or several
        A text, a ``.bsdf`` file of Zemax and others that `docs/formats.md` lists, or, with the extra ``xlsx``, a
        spreadsheet (``.xlsx``, ``.ods``, ``.xls``). Several files of one material become one measurement. The stem of
        the first file becomes the name.
    options : TableOptions, optional
        Options for reading the table.
    **choices
        Options by name, instead of `options`: ``columns``, ``constants``, ``missing``, ``scale``, ``cosine``, ``phi``.

    Raises
    ------
    InvalidArgumentError
        If an option is wrong.
    MeasurementFormatError
        With one sentence that says what is wrong and what would be right.
    MissingExtraError
        If a spreadsheet is given, and the extra ``xlsx`` is not installed.
    OSError
        If a file does not exist or cannot be read.
    """
    options = TableOptions.chosen(options, choices)
    paths = [Path(one) for one in ([path] if isinstance(path, str | os.PathLike) else path)]
    if not paths:
        raise InvalidArgumentError("name at least one file with a table of samples")
    if any(source.stat().st_size > _MAX_FILE_BYTES for source in paths):
        raise MeasurementFormatError(f"The table is longer than {_MAX_FILE_BYTES} bytes.")
    found = list[tuple[str, SampleRows]]()
    for source in paths:
        try:
            found.append((source.name, _read(source.read_bytes(), options)))
        except MeasurementFormatError as error:
            raise error if len(paths) == 1 else MeasurementFormatError(f"{source.name}: {error}") from None
    return _joined(found, paths[0].stem, options)


def parse_samples(data: bytes, name: str = "samples", options: TableOptions = AS_WRITTEN) -> ScatteredSamples:
    """Return the samples in the bytes of a table; raise the errors that `read_samples` raises."""
    return read_table(data, name, options).samples


def read_table(data: bytes, name: str = "samples", options: TableOptions = AS_WRITTEN) -> ReadTable:
    """Return the samples in the bytes of a table, and a description of the table; raise as `read_samples` does."""
    rows = _read(data, options)
    return ReadTable(rows.columns, rows.n_rows, _joined([(name, rows)], name, options))


def _read(data: bytes, options: TableOptions) -> SampleRows:
    if data.startswith(CANONICAL):
        options.refuse("a file of samples, which says everything itself")
        made = ScatteredSamples.decode(data)
        numbers = np.column_stack([made.omega_in, made.omega_out, made.values, made.weight])
        columns = tuple((name, name, "") for name in CANONICAL_NAMES)
        is_grey = bool(np.all(made.values == made.values[:, :1]))
        return SampleRows(numbers, made.values, made.notes, columns, len(numbers), is_grey, is_clean=True)
    return read_columns(cells_of(data, options), options)


def cells_of(data: bytes, options: TableOptions) -> TextTable:
    """Return the cells of a file with a table; raise MeasurementFormatError if the file is of another kind."""
    if (kind := measurement_kind(data[:START_BYTES])) != "samples":
        raise MeasurementFormatError(f"The file is {_NAMES[kind]}, a measurement on a grid, and no table of samples.")
    data, notes = spreadsheet_text(data) if is_spreadsheet(data) else (data, [])
    table = table_in(data, options)
    return replace(table, notes=(*notes, *table.notes))


def _joined(files: Sequence[tuple[str, SampleRows]], name: str, options: TableOptions) -> ScatteredSamples:
    """Return the usable rows of all files as samples; a note that does not hold for all files begins with a name."""
    grey = [file for file, rows in files if rows.is_grey]
    if grey and len(grey) < len(files):
        raise MeasurementFormatError(
            f"The file {grey[0]} has one column of values, and other files have colours, which grey samples would make "
            "paler: write red, green and blue in each file."
        )
    shared = set[str].intersection(*({*rows.notes} for _, rows in files))
    said = (note if note in shared else f"{file}: {note}" for file, rows in files for note in rows.notes)
    notes = [*dict.fromkeys(said)]
    written = [rows for _, rows in files if not rows.is_clean]
    numbers = [rows.numbers for _, rows in files if rows.is_clean]
    if written:
        numbers.append(_in_units(_usable(written, notes), options, notes))
    omega_in, omega_out, values, weight = np.split(np.concatenate(numbers), (3, 6, 9), axis=1)
    return ScatteredSamples.from_arrays(omega_in, omega_out, values, weight[:, 0], name, tuple(notes))


def _usable(found: Sequence[SampleRows], notes: list[str]) -> Array:
    """Return the rows with measured values above the horizon, and make their vectors unit vectors."""
    numbers = np.concatenate([rows.numbers for rows in found])
    used = np.asarray(np.isfinite(numbers).all(axis=1))
    gap = next((f", such as {rows.gap[:40]!r}" for rows in found if rows.gap), "")
    notes += _left_out(~used, f"no finite number in a column that is needed{gap}")
    for side, part in (("omega_in", slice(0, 3)), ("omega_out", slice(3, 6))):
        numbers[:, part] = _unit_vectors(side, numbers[:, part], used, notes)
    above = np.minimum(numbers[:, 2], numbers[:, 5]) > LOWEST_COSINE
    away = "" if above[used].any() else ", though directions point away from the surface, whose normal is z"
    notes += _left_out(used & ~above, f"a direction at or below the horizon{away}")
    used &= above
    if len({rows.written.shape[1] for rows in found}) == 1 and sum(len(rows.written) for rows in found) == len(used):
        notes += about_repeated(np.concatenate([rows.written for rows in found])[used])
    numbers = numbers[used]
    empty, said = unmeasured_zeros(numbers[:, :3], numbers[:, 3:6], numbers[:, 6:9])
    notes += said
    return numbers[~empty]


def _in_units(numbers: Array, options: TableOptions, notes: list[str]) -> Array:
    """Return rows with values in 1/sr, after the division by a cosine and the turn of omega_in that options ask for."""
    omega_in, omega_out, values, weight = np.split(numbers, (3, 6, 9), axis=1)
    is_grey = bool(np.all(values == values[:, :1]))
    values = np.broadcast_to(_without_noise(values[:, :1] if is_grey else values, notes), values.shape)
    if options.cosine is not None:
        values = values / (omega_in if options.cosine == "in" else omega_out)[:, 2:]
    if options.phi == "mirror":
        omega_in = omega_in * (-1.0, -1.0, 1.0)
    notes += _contradictions(np.hstack([omega_in, omega_out]), values.mean(axis=1))
    return np.hstack([omega_in, omega_out, values * options.scale, weight])


def _unit_vectors(side: str, vectors: Array, used: Mask, notes: list[str]) -> Array:
    """Return vectors divided by their length; raise MeasurementFormatError if a length is too far from 1."""
    length = np.linalg.norm(vectors, axis=1)
    off = np.where(used, np.abs(length - 1.0), 0.0)
    if count := np.count_nonzero(off > _MAX_LENGTH_DEVIATION):
        raise MeasurementFormatError(
            f"In {count} of {off.size} rows {side} is no unit vector; one has the length "
            f"{length[int(np.argmax(off))]:.4g}. Write directions as unit vectors."
        )
    if off.max(initial=0.0) > _ROUNDED_LENGTH_DEVIATION:
        notes.append(f"The vectors {side} were up to {off.max():.1%} off unit length; they were made unit vectors.")
    return np.asarray(vectors / np.where(used & (length > 0.0), length, 1.0)[:, np.newaxis])


def _without_noise(values: Array, notes: list[str]) -> Array:
    """Replace small negative values by 0; raise MeasurementFormatError for large negative values."""
    negative = values < 0.0
    count = int(np.count_nonzero(negative))
    if count == 0:
        return values
    lowest, largest, allowed = -values.min(), values.max(), MAX_NOISE_FRACTION
    several, they_count = ("1 value is", "it counts") if count == 1 else (f"{count} values are", "they count")
    if 2 * count > values.size:
        raise MeasurementFormatError(
            f"Most values are negative, down to {-lowest:.4g}, which no BRDF is: if they are decibels or other "
            "logarithms, write the values themselves, in 1/sr."
        )
    if lowest > allowed * largest or -values[negative].sum() > allowed * values[~negative].sum():
        raise MeasurementFormatError(
            f"{several} negative, down to {-lowest:.4g}, more than noise about zero explains: if they stand for "
            f"missing values, set missing to {-lowest:g}."
        )
    notes.append(f"{several} negative, down to {-lowest / largest:.2%} of the largest; {they_count} as 0.")
    return np.maximum(values, 0.0)


def _contradictions(pairs: Array, values: Array) -> list[str]:
    """Return a sentence if equal pairs of directions (n, 6) have very different values (n,)."""
    if values.size == 0:
        return []
    digits = np.rint(pairs / _SAME_COMPONENT).astype(np.int64)
    # Each pair is reduced to one random hash, because sorting hashes is faster than sorting rows of six numbers.
    key = digits @ np.random.default_rng(0).integers(1 << 62, size=6)
    order = np.lexsort((values, key))
    starts = np.flatnonzero(np.diff(key[order], prepend=key[order][:1] - 1))
    lowest, highest = values[order][starts], values[order][np.append(starts[1:], values.size) - 1]
    apart = highest > _CONTRADICTION_FACTOR * (lowest + _DARK_FRACTION * np.median(values))
    count = int(np.count_nonzero(apart))
    if count == 0:
        return []
    worst = starts[apart][int(np.argmax((highest - lowest)[apart]))]
    theta_in, theta_out = np.degrees(np.arccos(np.clip(pairs[order][worst][[2, 5]], 0.0, 1.0)))
    several = "1 pair of directions has" if count == 1 else f"{count} pairs of directions have"
    return [
        f"{several} values that differ by more than {_CONTRADICTION_FACTOR - 1.0:.0%}, such as theta_in = "
        f"{theta_in:.4g} and theta_out = {theta_out:.4g} degrees: all of them count, so that the fit is between them."
    ]


def _left_out(rows: Mask, fault: str) -> list[str]:
    count = int(np.count_nonzero(rows))
    several, they_are = ("1 row has", "it is") if count == 1 else (f"{count} rows have", "they are")
    return [f"{several} {fault}; {they_are} left out."] if count else []
