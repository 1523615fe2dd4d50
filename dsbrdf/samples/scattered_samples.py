"""Check scattered samples, which are values of a BRDF at any pairs of directions, and store samples in files.

A file of samples is an ASCII table. The file has the line ``# dsbrdf samples 1``, a line ``# `` with each note, the
names of eight columns, and a line for each sample: theta_in, phi_in, theta_out, phi_out in degrees, red, green and blue
in 1/sr, and the weight. Each number has as few digits as restore the exact number. Equal samples have equal files.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sized
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from dsbrdf.arrays import Array, Mask
from dsbrdf.data.geometry import spherical
from dsbrdf.data.merl_validation import MAX_VALUE, MIN_NONZERO_VALUE
from dsbrdf.errors import MeasurementFormatError

MIN_SAMPLES = 50
"""A measurement with fewer samples is refused, because so few samples do not determine a material."""
MAX_WEIGHT = 1e12
CANONICAL = b"# dsbrdf samples 1\n"
"""The first line of a file of samples."""
CANONICAL_NAMES = ("theta_in", "phi_in", "theta_out", "phi_out", "red", "green", "blue", "weight")
_NAMES = ",".join(CANONICAL_NAMES)
_UNIT_TOLERANCE = 1e-3
# Angles are rounded to this number of decimals, because a conversion to a unit vector and back changes later decimals.
_ANGLE_DECIMALS = 9


@dataclass(frozen=True, eq=False, repr=False)
class ScatteredSamples:
    """Values of a BRDF at n pairs of directions; make instances by `from_arrays`, which checks the arrays.

    Attributes
    ----------
    omega_in, omega_out, values : ndarray, shape (n, 3)
        Unit vectors towards the light and the viewer, and RGB [1/sr].
    weight : ndarray, shape (n,)
        Weight of each sample in the errors that a fit minimises.
    name : str
        The material's name.
    notes : tuple of str
        A sentence on each decision of the reader of a table; the warnings of a fit begin with the notes.
    """

    omega_in: Array
    omega_out: Array
    values: Array
    weight: Array
    name: str
    notes: tuple[str, ...] = ()

    @cached_property
    def sha256(self) -> str:
        """Hexadecimal digest of the samples' file, which identifies the samples independently of their name."""
        return hashlib.sha256(self.encode()).hexdigest()

    def encode(self) -> bytes:
        """Return the content of a file with the samples, which `dsbrdf.read_samples` can read back."""
        degrees = np.hstack([_degrees(self.omega_in), _degrees(self.omega_out)])
        table = np.column_stack([degrees, self.values, self.weight])
        notes = "".join(f"# {' '.join(note.split())}\n" for note in self.notes)
        rows = "\n".join(",".join(map(repr, row)) for row in table.tolist())
        return CANONICAL + f"{notes}{_NAMES}\n{rows}\n".replace(".0,", ",").replace(".0\n", "\n").encode(
            errors="backslashreplace"
        )

    @classmethod
    def decode(cls, content: bytes, name: str = "samples") -> ScatteredSamples:
        """Return the samples in the content of a file that `encode` made; raise MeasurementFormatError for others."""
        head, names, body = content.partition(f"{_NAMES}\n".encode())
        if not head.startswith(CANONICAL) or not names:
            raise MeasurementFormatError(f"A file of samples begins with {CANONICAL.decode().strip()!r} and notes.")
        try:
            notes = tuple(line.removeprefix("# ") for line in head.decode().splitlines()[1:])
            table = np.array(body.replace(b"\n", b",").rstrip(b",").split(b","), dtype=np.float64).reshape(-1, 8)
        except ValueError:
            raise MeasurementFormatError("The file of samples is damaged: write it again.") from None
        omega_in, omega_out = (spherical(*np.radians(table[:, at : at + 2].T)) for at in (0, 2))
        return cls.from_arrays(omega_in, omega_out, table[:, 4:7], table[:, 7], name, notes)

    def take(self, chosen: Mask) -> ScatteredSamples:
        """Return the samples that the mask or the indices `chosen` select."""
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
        notes: tuple[str, ...] = (),
    ) -> ScatteredSamples:
        """Check arrays of directions and values, and return them as samples.

        Parameters
        ----------
        omega_in, omega_out : array_like, shape (n, 3)
            Unit vectors, to 0.001, above the horizon (z > 0); angles are rounded to 1e-9 degrees.
        values : array_like, shape (n, 3)
            RGB [1/sr], finite and not negative; the largest value must be from 1e-8 to 1e8.
        weight : array_like, shape (n,), optional
            Weights from 1e-12 to 1e12; 1 by default.
        name : str, optional
            The material's name.
        notes : tuple of str, optional
            Sentences on decisions of the reader, as in the attribute.

        Raises
        ------
        MeasurementFormatError
            With one sentence that says what is wrong and what would be right.
        """
        count = len(values) if isinstance(values, Sized) else 0
        if count < MIN_SAMPLES:
            why = "".join(f" {note}" for note in notes if note.endswith("left out."))
            several = "is 1 sample" if count == 1 else f"are {count} samples"
            raise MeasurementFormatError(f"There {several}; a fit needs at least {MIN_SAMPLES}.{why}")
        given = {"omega_in": omega_in, "omega_out": omega_out, "values": values}
        arrays = {name: _numbers(name, array, (count, 3)) for name, array in given.items()}
        arrays["weight"] = _numbers("weight", np.ones(count) if weight is None else weight, (count,))
        values, weights, brightest = arrays["values"], arrays["weight"], arrays["values"].max()
        for side in ("omega_in", "omega_out"):
            off = np.abs(np.linalg.norm(arrays[side], axis=1) - 1.0) > _UNIT_TOLERANCE
            _refuse("is not of unit length", side, off, "directions are unit vectors")
            _refuse("is not above the horizon", side, arrays[side][:, 2] <= 0.0, "z must be positive")
            arrays[side] = spherical(*np.radians(_degrees(arrays[side]).T))
        _refuse("is negative", "values", values.min(axis=1) < 0.0, "no reflectance is")
        too_bright = f"no reflectance is; if {brightest:g} stands for a missing value, set missing to it"
        _refuse("is above 1e8/sr", "values", values.max(axis=1) > MAX_VALUE, too_bright)
        _refuse("is not positive", "weight", weights <= 0.0, "leave out what must not count")
        extreme = (weights < 1.0 / MAX_WEIGHT) | (weights > MAX_WEIGHT)
        _refuse("is not from 1e-12 to 1e12", "weight", extreme, "weights say how much samples count among each other")
        if brightest == 0.0:
            raise MeasurementFormatError("Every sample is zero in all channels; a measurement has positive values.")
        if brightest < MIN_NONZERO_VALUE:
            raise MeasurementFormatError(
                f"The largest value is {brightest:.3g}/sr, darker than any material; the values of a BRDF are in 1/sr."
            )
        for array in arrays.values():
            array.flags.writeable = False
        return cls(**arrays, name=name, notes=notes)


def _degrees(omega: Array) -> Array:
    """Return theta and phi [degrees], shape (n, 2), of directions (n, 3); phi is 0 where theta is 0."""
    theta = np.degrees(np.arctan2(np.hypot(omega[:, 0], omega[:, 1]), omega[:, 2])).round(_ANGLE_DECIMALS)
    phi = np.degrees(np.arctan2(omega[:, 1], omega[:, 0])).round(_ANGLE_DECIMALS) % 360.0
    return np.stack([theta, np.where(theta > 0.0, phi, 0.0)], axis=1)


def _numbers(name: str, array: ArrayLike, shape: tuple[int, ...]) -> Array:
    try:
        numbers = np.array(np.ma.filled(array, np.nan), dtype=np.float64)
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
