"""Scattered samples: values of a BRDF at any pairs of directions."""

from __future__ import annotations

import hashlib
from collections.abc import Sized
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from dsbrdf.arrays import Array, Mask
from dsbrdf.data.merl_validation import LARGEST_VALUE, SMALLEST_PEAK
from dsbrdf.data.table_options import AS_WRITTEN, TableOptions
from dsbrdf.errors import InvalidArgumentError, MeasurementFormatError

FEWEST_SAMPLES = 50
"""Fewer samples than this do not tell what a material is like."""
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
        """Return the samples scaled, divided by the cosine or turned, as options say.

        Samples that were read with the same options are returned as they are. Raises InvalidArgumentError if they were
        read with others, or if the options are about the text of a table.
        """
        wanted = options.of_table()
        if wanted in (self.options, AS_WRITTEN):
            return self
        if self.options != AS_WRITTEN:
            raise InvalidArgumentError("the samples were read with options of a table other than those given here")
        if wanted.columns or wanted.missing:
            raise InvalidArgumentError("columns and missing are for a table in a file, not for arrays of samples")
        return self.changed(wanted)

    def changed(self, options: TableOptions) -> ScatteredSamples:
        """Return the samples multiplied, divided and turned, whatever they were read with."""
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
        if (largest := arrays["values"].max()) < SMALLEST_PEAK:
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
