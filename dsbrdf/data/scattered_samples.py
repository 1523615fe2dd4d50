"""Scattered samples: values of a BRDF at any pairs of directions, from a table of comma-separated values.

The first line of a table names its columns, in any order: ``omega_in_x``, ``omega_in_y``, ``omega_in_z`` and the same
of ``omega_out``, the unit vectors towards the light and the viewer with the normal along z; ``red``, ``green`` and
``blue`` in 1/sr; and, if samples are not to count alike, ``weight``.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sized
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dsbrdf.data.file_kinds import known_kind
from dsbrdf.data.grid import CHANNELS
from dsbrdf.data.merl_validation import LARGEST_VALUE
from dsbrdf.errors import MeasurementFormatError

__all__ = ["FEWEST_SAMPLES", "ScatteredSamples", "parse_samples", "read_samples"]

Array = NDArray[np.float64]

FEWEST_SAMPLES = 200
"""Fewer samples than this do not determine a model."""
DIRECTIONS = tuple(f"{name}_{axis}" for name in ("omega_in", "omega_out") for axis in "xyz")
_REQUIRED = (*DIRECTIONS, *CHANNELS)
_WEIGHT = "weight"
_UNIT_TOLERANCE = 1e-3  # tables have few digits
_LARGEST_FILE = 1 << 30  # [bytes]


@dataclass(frozen=True, eq=False, repr=False)
class ScatteredSamples:
    """Values of a BRDF at n pairs of directions; made by `from_arrays`.

    Attributes
    ----------
    omega_in, omega_out : ndarray, shape (n, 3)
        Unit vectors towards the light and the viewer; the normal is (0, 0, 1).
    values : ndarray, shape (n, 3)
        RGB [1/sr].
    weight : ndarray, shape (n,)
        What a sample counts.
    name : str
        The material's name.
    sha256 : str
        Hexadecimal digest of the arrays: the identity of the samples.
    """

    omega_in: Array
    omega_out: Array
    values: Array
    weight: Array
    name: str
    sha256: str

    def take(self, chosen: NDArray[np.bool_]) -> ScatteredSamples:
        """Return the samples that are `chosen`, shape (n,); name and digest stay those of all."""
        arrays = {name: getattr(self, name)[chosen] for name in ("omega_in", "omega_out", "values", "weight")}
        return replace(self, **arrays)

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
    ) -> ScatteredSamples:
        """Return checked samples.

        Parameters
        ----------
        omega_in, omega_out : array_like, shape (n, 3)
            Unit vectors, to 0.001, above the horizon (z > 0).
        values : array_like, shape (n, 3)
            RGB [1/sr], finite and not negative.
        weight : array_like, shape (n,), optional
            Positive; 1 by default.
        name : str, optional
            The material's name.

        Returns
        -------
        ScatteredSamples

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
            arrays[side] = _unit(side, arrays[side])
        _refuse("is negative", "values", arrays["values"].min(axis=1) < 0.0, "no reflectance is")
        _refuse("is above 1e8/sr", "values", arrays["values"].max(axis=1) > LARGEST_VALUE, "no reflectance is")
        _refuse("is not positive", "weight", arrays["weight"] <= 0.0, "leave out what must not count")
        if not arrays["values"].any():
            raise MeasurementFormatError("Every sample is zero in all channels; a measurement has positive values.")
        digest = hashlib.sha256()
        for array in arrays.values():
            digest.update(array.astype("<f8").tobytes())
            array.flags.writeable = False
        return cls(**arrays, name=name, sha256=digest.hexdigest())


def read_samples(path: str | os.PathLike[str]) -> ScatteredSamples:
    """Read a table of scattered samples.

    Parameters
    ----------
    path : path-like
        A ``.csv`` file, see the module; its stem becomes the name.

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
        raise MeasurementFormatError(f"The data is {kind}; scattered samples are a table of comma-separated values.")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise MeasurementFormatError("The table is not a text in UTF-8.") from None
    head, _, body = text.partition("\n")
    columns = [column.strip().lower() for column in head.split(",")]
    missing = [column for column in _REQUIRED if column not in columns]
    if missing:
        raise MeasurementFormatError(
            f"The first line of the table must name its columns; it lacks {missing[0]!r} of {', '.join(_REQUIRED)}."
        )
    unknown = [column for column in columns if column not in (*_REQUIRED, _WEIGHT)]
    if unknown or len(set(columns)) != len(columns):
        fault = f"the unknown column {unknown[0]!r}" if unknown else "a column twice"
        raise MeasurementFormatError(f"The table has {fault}; besides the required ones there may be {_WEIGHT!r}.")
    try:
        rows = np.loadtxt(StringIO(body), delimiter=",", ndmin=2) if body.strip() else np.empty((0, len(columns)))
    except ValueError as error:
        reason = str(error).partition(";")[0].rstrip(".")
        raise MeasurementFormatError(f"A row of the table is not {len(columns)} numbers: {reason}.") from None
    if rows.shape[1] != len(columns):
        raise MeasurementFormatError(f"The rows of the table have {rows.shape[1]} numbers, not {len(columns)}.")
    of = {column: rows[:, index] for index, column in enumerate(columns)}
    omega_in, omega_out, values = (
        np.stack([of[column] for column in part], axis=1) for part in (DIRECTIONS[:3], DIRECTIONS[3:], CHANNELS)
    )
    return ScatteredSamples.from_arrays(omega_in, omega_out, values, of.get(_WEIGHT), name)


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


def _unit(name: str, vectors: Array) -> Array:
    length = np.linalg.norm(vectors, axis=1)
    _refuse("is not of unit length", name, np.abs(length - 1.0) > _UNIT_TOLERANCE, "directions are unit vectors")
    _refuse("is not above the horizon", name, vectors[:, 2] <= 0.0, "z must be positive")
    return np.asarray(vectors / length[:, np.newaxis])


def _refuse(fault: str, name: str, wrong: NDArray[np.bool_], right: str) -> None:
    if wrong.any():
        first = int(np.argmax(wrong)) + 1
        raise MeasurementFormatError(
            f"In {np.count_nonzero(wrong)} of {wrong.size} samples, the first of them number {first}, {name} {fault}; "
            f"{right}."
        )
