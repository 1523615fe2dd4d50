"""Scattered samples: values of a BRDF at any pairs of directions."""

from __future__ import annotations

import hashlib
from collections.abc import Sized
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dsbrdf.data.merl_validation import LARGEST_VALUE
from dsbrdf.errors import MeasurementFormatError

Array = NDArray[np.float64]

FEWEST_SAMPLES = 200
"""Fewer samples than this do not determine a model."""
_UNIT_TOLERANCE = 1e-3


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
    notes : tuple of str
        What the reader of a table decided, a sentence each; the report of a fit begins its warnings with them.
    """

    omega_in: Array
    omega_out: Array
    values: Array
    weight: Array
    name: str
    sha256: str
    notes: tuple[str, ...] = ()

    def take(self, chosen: NDArray[np.bool_]) -> ScatteredSamples:
        """Return the samples that are `chosen`, shape (n,); name and digest stay those of all."""
        arrays = {name: getattr(self, name)[chosen] for name in ("omega_in", "omega_out", "values", "weight")}
        return replace(self, **arrays)

    def divided_by_cosine(self, side: str) -> ScatteredSamples:
        """Return the samples, values divided by the cosine of theta_in or theta_out; ``side`` is "in" or "out"."""
        cosine = self.omega_in[:, 2] if side == "in" else self.omega_out[:, 2]
        return replace(self, values=self.values / cosine[:, np.newaxis])

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
            RGB [1/sr], finite and not negative.
        weight : array_like, shape (n,), optional
            Positive; 1 by default.
        name : str, optional
            The material's name.
        notes : tuple of str, optional
            See the attribute.

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
        return cls(**arrays, name=name, sha256=digest.hexdigest(), notes=notes)


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
