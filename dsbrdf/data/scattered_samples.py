"""Scattered samples: values of a BRDF at any pairs of directions, and the files of text that they are read from.

`dsbrdf.data.text_table` finds the cells of a file, `dsbrdf.data.sample_columns` what they mean. What a measurement
leaves behind is set right here, counted, and said in the notes of the samples: rows without a number, directions at or
below the horizon, small negative values, vectors that are nearly of unit length.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sized
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from dsbrdf.arrays import Array, Mask
from dsbrdf.data.files import known_kind
from dsbrdf.data.merl_validation import LARGEST_VALUE
from dsbrdf.data.sample_columns import sample_columns
from dsbrdf.data.sample_layouts import is_name, known_format, unfolded
from dsbrdf.data.table_options import AS_WRITTEN, TableOptions
from dsbrdf.data.text_table import parse_text_table
from dsbrdf.errors import InvalidArgumentError, MeasurementFormatError

FEWEST_SAMPLES = 50
"""Fewer samples than this do not tell what a material is like."""
SMALLEST_MAXIMUM = 1e-8
"""The largest value of samples is at least this [1/sr]."""
LARGEST_WEIGHT = 1e12
_UNIT_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False, repr=False)
class ScatteredSamples:
    """Values of a BRDF at n pairs of directions; made by `from_arrays`, which says more of the arrays.

    Attributes
    ----------
    omega_in, omega_out, values : ndarray, shape (n, 3)
        Unit vectors towards the light and the viewer, and RGB [1/sr].
    weight : ndarray, shape (n,)
        How much each sample counts.
    name, sha256 : str
        Of the material; hexadecimal digest of the arrays, the identity of the samples.
    notes : tuple of str
        What the reader of a table decided, a sentence each; the report of a fit begins its warnings with them.
    options : TableOptions
        With which they were read.
    """

    omega_in: Array
    omega_out: Array
    values: Array
    weight: Array
    name: str
    sha256: str
    notes: tuple[str, ...] = ()
    options: TableOptions = AS_WRITTEN

    def take(self, chosen: Mask) -> ScatteredSamples:
        """Return the samples that are `chosen`, shape (n,); name and digest stay those of all."""
        arrays = {name: getattr(self, name)[chosen] for name in ("omega_in", "omega_out", "values", "weight")}
        return replace(self, **arrays)

    def divided_by_cosine(self, side: str) -> ScatteredSamples:
        """Return the samples, values divided by the cosine of theta_in or theta_out; ``side`` is "in" or "out"."""
        cosine = self.omega_in[:, 2] if side == "in" else self.omega_out[:, 2]
        return replace(self, values=self.values / cosine[:, np.newaxis])

    def with_options(self, options: TableOptions) -> ScatteredSamples:
        """Return the samples multiplied, divided and turned as options say; as they are if they were read with these.

        Raises InvalidArgumentError if they were read with others, or if the options are about the text of a table.
        """
        wanted = options.of_table()
        if wanted in (self.options, AS_WRITTEN):
            return self
        if self.options != AS_WRITTEN:
            raise InvalidArgumentError("the samples were read with options of a table other than those given here")
        if wanted.columns or wanted.missing:
            raise InvalidArgumentError("columns and missing are for a table in a file, not for arrays of samples")
        return self._changed(wanted)

    def _changed(self, options: TableOptions) -> ScatteredSamples:
        if options == AS_WRITTEN:
            return self
        samples = self if options.cosine is None else self.divided_by_cosine(options.cosine)
        omega_in = self.omega_in * ((-1.0, -1.0, 1.0) if options.phi == "mirror" else 1.0)
        values = samples.values * options.scale
        changed = self.from_arrays(omega_in, self.omega_out, values, self.weight, self.name, self.notes)
        return replace(changed, options=options)

    def __repr__(self) -> str:
        return f"<ScatteredSamples: {self.name!r}, {len(self.values)} samples>"

    @classmethod
    def from_arrays(
        cls,
        omega_in: ArrayLike,
        omega_out: ArrayLike,
        values: ArrayLike,
        weight: ArrayLike | None = None,
        name: str = "samples",
        notes: tuple[str, ...] = (),
    ) -> ScatteredSamples:
        """Return checked samples.

        Parameters
        ----------
        omega_in, omega_out : array_like, shape (n, 3)
            Unit vectors, to 0.001, above the horizon (z > 0).
        values : array_like, shape (n, 3)
            RGB [1/sr], finite and not negative; the largest from 1e-8 to 1e8.
        weight : array_like, shape (n,), optional
            From 1e-12 to 1e12; 1 by default.
        name : str, optional
            The material's name.
        notes : tuple of str, optional
            See the attribute.

        Raises
        ------
        MeasurementFormatError
            With one sentence that says what is wrong and what would be right.
        """
        count = len(values) if isinstance(values, Sized) else 0
        if count < FEWEST_SAMPLES:
            raise MeasurementFormatError(
                f"There {'is 1 sample' if count == 1 else f'are {count} samples'}; a fit needs at least "
                f"{FEWEST_SAMPLES}."
            )
        arrays = {
            "omega_in": _numbers("omega_in", omega_in, (count, 3)),
            "omega_out": _numbers("omega_out", omega_out, (count, 3)),
            "values": _numbers("values", values, (count, 3)),
            "weight": _numbers("weight", np.ones(count) if weight is None else weight, (count,)),
        }
        for side in ("omega_in", "omega_out"):
            length = np.linalg.norm(arrays[side], axis=1)
            off = np.abs(length - 1.0) > _UNIT_TOLERANCE
            _refuse("is not of unit length", side, off, "directions are unit vectors")
            _refuse("is not above the horizon", side, arrays[side][:, 2] <= 0.0, "z must be positive")
            arrays[side] /= length[:, np.newaxis]
        _refuse("is negative", "values", arrays["values"].min(axis=1) < 0.0, "no reflectance is")
        brightest = arrays["values"].max()
        too_bright = f"no reflectance is; if {brightest:g} stands for what is missing, set missing to it"
        _refuse("is above 1e8/sr", "values", arrays["values"].max(axis=1) > LARGEST_VALUE, too_bright)
        weights = arrays["weight"]
        _refuse("is not positive", "weight", weights <= 0.0, "leave out what must not count")
        extreme = (weights < 1.0 / LARGEST_WEIGHT) | (weights > LARGEST_WEIGHT)
        _refuse("is not from 1e-12 to 1e12", "weight", extreme, "weights say how much samples count among each other")
        if not arrays["values"].any():
            raise MeasurementFormatError("Every sample is zero in all channels; a measurement has positive values.")
        if (largest := arrays["values"].max()) < SMALLEST_MAXIMUM:
            raise MeasurementFormatError(
                f"The largest value is {largest:.3g}/sr, darker than any material; the values of a BRDF are in 1/sr."
            )
        digest = hashlib.sha256()
        for array in arrays.values():
            digest.update(array.astype("<f8").tobytes())
            array.flags.writeable = False
        omega_in, omega_out, values, weight = arrays.values()
        return cls(omega_in, omega_out, values, weight, name, digest.hexdigest(), notes)


def _numbers(name: str, array: ArrayLike, shape: tuple[int, ...]) -> Array:
    try:
        numbers = np.array(array, dtype=np.float64)
    except (TypeError, ValueError):
        raise MeasurementFormatError(f"The {name} must be real numbers of the shape {shape}.") from None
    if numbers.shape != shape:
        raise MeasurementFormatError(f"The {name} must have the shape {shape}, not {numbers.shape}.")
    finite = np.isfinite(numbers.reshape(shape[0], -1)).all(axis=1)
    _refuse("is NaN or infinite", name, np.logical_not(finite), "numbers are finite")
    return numbers


def _refuse(fault: str, name: str, wrong: Mask, right: str) -> None:
    if wrong.any():
        first = int(np.argmax(wrong)) + 1
        raise MeasurementFormatError(
            f"In {np.count_nonzero(wrong)} of {wrong.size} samples, the first of them number {first}, {name} {fault}; "
            f"{right}."
        )


TABLE_SUFFIXES = (".csv", ".tsv", ".txt")
"""Suffixes of tables of scattered samples."""
_LARGEST_FILE = 1 << 30  # [bytes]
_LOWEST_COSINE = 1e-6  # of a direction above the horizon: sines and cosines of angles in degrees are rounded
_TABLE_TOLERANCE = 0.02
_ROUNDED = 1e-3  # tables have few digits: a smaller deviation from unit length is not worth a word
_FEW_VALUES, _MANY_EQUAL, _FAR_OFF = 10, 4, 3.0  # different values; equal ones; a factor to the next value
_CLEARLY_LIT = 0.02  # of the median: noise about zero has values below
_LARGEST_NOISE = 0.01  # of negative values: each as a share of the largest value, their sum as a share of all


def read_samples(path: str | os.PathLike[str], options: TableOptions = AS_WRITTEN) -> ScatteredSamples:
    """Read a table of scattered samples: a ``.csv``, ``.tsv`` or ``.txt`` file, whose stem becomes the name.

    A MeasurementFormatError says in one sentence what is wrong and what would be right.
    """
    source = Path(path)
    if source.stat().st_size > _LARGEST_FILE:
        raise MeasurementFormatError(f"The table is longer than {_LARGEST_FILE} bytes.")
    return parse_samples(source.read_bytes(), source.stem, options)


def parse_samples(data: bytes, name: str = "samples", options: TableOptions = AS_WRITTEN) -> ScatteredSamples:
    """Return the samples in the bytes of a table; errors are those of `read_samples`."""
    kind = known_kind(data[:16])
    if kind is not None:
        raise MeasurementFormatError(
            f"The data is {kind}; scattered samples are a table in a text: save a spreadsheet as .csv."
        )
    named = {column.lower() for column in options.named_columns().values()}
    try:
        table = parse_text_table(data, lambda cell: is_name(cell) or cell.strip("'\" ").lower() in named)
        numbers, notes = sample_columns(unfolded(table), options)
    except MeasurementFormatError as error:
        found = known_format(data)
        if found is None:
            raise
        raise MeasurementFormatError(
            f"The data is {found}, which is not read: write its samples as a table with theta_in, phi_in, theta_out, "
            "phi_out and value."
        ) from error
    used = np.asarray(np.isfinite(numbers).all(axis=1))
    notes += _left_out(~used, "no finite number in a column that is needed")
    first, second = (
        _unit_vectors(side, numbers[:, at : at + 3], used, notes) for side, at in (("omega_in", 0), ("omega_out", 3))
    )
    above = np.minimum(first[:, 2], second[:, 2]) > _LOWEST_COSINE
    notes += _left_out(used & ~above, "a direction at or below the horizon")
    used &= above
    values = numbers[used, 6:9]
    is_grey = bool(np.all(values == values[:, :1]))
    if values.size:
        notes += _repeated(values[:, 0])
    values = np.broadcast_to(_without_noise(values[:, :1] if is_grey else values, notes), values.shape)
    samples = ScatteredSamples.from_arrays(first[used], second[used], values, numbers[used, 9], name, tuple(notes))
    return samples._changed(options.of_table())


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


def _repeated(values: Array) -> list[str]:
    """Name the smallest and the largest value where many samples have it and the next one is far off."""
    found, counts = np.unique(values, return_counts=True)
    if found.size < _FEW_VALUES:
        return []
    least = max(_FAR_OFF * found[0], _CLEARLY_LIT * float(np.median(values)))
    extremes = (("smallest", 0, found[1] > least), ("largest", -1, found[-1] > _FAR_OFF * found[-2]))
    return [
        f"{counts[place]} samples have the same {which} value, {found[place]:g}, far from all others: if it stands for "
        f"what is missing, set missing to {found[place]:g}."
        for which, place, is_far in extremes
        if is_far and counts[place] >= _MANY_EQUAL
    ]


def _left_out(rows: Mask, fault: str) -> list[str]:
    count = int(np.count_nonzero(rows))
    several = "1 row has" if count == 1 else f"{count} rows have"
    return [f"{several} {fault}; {'it is' if count == 1 else 'they are'} left out."] if count else []
