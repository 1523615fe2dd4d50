"""Define a measurement: an isotropic BRDF on the angular grid of the MERL database."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from dsbrdf.arrays import Array, Mask
from dsbrdf.data.grid import GRID_SHAPE
from dsbrdf.data.interpolation import InterpolatedMeasurement, interpolate
from dsbrdf.data.merl_validation import HEADER, SCALE, SHAPE, checked_values
from dsbrdf.errors import MeasurementFormatError


@dataclass(frozen=True, repr=False)
class Measurement:
    """Hold the measurement of one material; measurements with equal bytes and names are equal.

    Attributes
    ----------
    stored : ndarray, shape (3, 90, 90, 180)
        The numbers exactly as in the file, read-only; axes (channel, theta_half, theta_diff, phi_diff).
    scale : ndarray, shape (3,)
        Factor of each channel from ``stored`` to the BRDF in 1/sr.
    valid : ndarray of bool, shape (90, 90, 180)
        Nodes with both directions above the horizon and a stored number >= 0 in at least one channel, read-only. A
        negative number marks a missing value in its own channel only: a saturated yellow can be darker than the noise
        in blue, and still have values in red and green.
    name : str
        The material's name, by default that of its file.
    sha256 : str
        Hexadecimal digest of the file's bytes: the identity of the measurement.
    """

    stored: Array = field(compare=False)
    scale: Array = field(compare=False)
    valid: Mask = field(compare=False)
    name: str
    sha256: str

    def __repr__(self) -> str:
        return f"<Measurement: {self.name!r}, sha256 {self.sha256[:12]}>"

    def evaluate(self, theta_half: ArrayLike, theta_diff: ArrayLike, phi_diff: ArrayLike = np.pi / 2) -> Array:
        """Interpolate values between the nodes, see `dsbrdf.data.interpolation`.

        Parameters
        ----------
        theta_half, theta_diff, phi_diff : array_like
            Angles that broadcast [rad].

        Returns
        -------
        ndarray, shape (..., 3)
            The BRDF in 1/sr; NaN if none of the nodes around the angles is valid, as below the horizon.

        Raises
        ------
        InvalidArgumentError
            If an angle is not finite, or the measurement has no valid node.
        """
        values = self.interpolated.evaluate(theta_half, theta_diff, phi_diff)
        values[~self.interpolated.is_measured(theta_half, theta_diff, phi_diff)] = np.nan
        return values

    @cached_property
    def interpolated(self) -> InterpolatedMeasurement:
        """The measurement as a function of continuous angles, extrapolated where nodes are not valid."""
        return interpolate(self)

    @cached_property
    def known(self) -> Mask:
        """Mask of measured values, (3, 90, 90, 180), or (1, 90, 90, 180) if all channels have the same mask."""
        masks = [self.valid & (channel >= 0.0) for channel in self.stored]
        alike = all(np.array_equal(mask, self.valid) for mask in masks)
        return self.valid[np.newaxis] if alike else np.stack(masks)

    @property
    def values(self) -> Array:
        """The BRDF in 1/sr, shape (3, 90, 90, 180); every access makes a new array of 35 MB.

        A negative value is missing, and so are all values at nodes that are not in ``valid``.
        """
        return self.stored * self.scale[:, np.newaxis, np.newaxis, np.newaxis]

    @classmethod
    def from_values(cls, values: ArrayLike, valid: ArrayLike | None = None, name: str = "measurement") -> Measurement:
        """Make a measurement from values, as if they had been written to a file and read back.

        Parameters
        ----------
        values : array_like, shape (3, 90, 90, 180)
            The BRDF in 1/sr, axes (channel, theta_half, theta_diff, phi_diff); a negative value is missing.
        valid : array_like of bool, shape (90, 90, 180), optional
            Nodes with a value; values at all other nodes are replaced by -1.
        name : str
            The material's name.

        Returns
        -------
        Measurement
            Its ``sha256`` is the digest of the file with these values; its ``values`` equal `values` up to rounding.

        Raises
        ------
        MeasurementFormatError
            If a shape is wrong or the values are not an acceptable measurement.
        """
        stored, usable, sha256 = checked_values(b"".join(merl_pieces(stored_numbers(values, valid))))
        return cls(stored=stored, scale=SCALE, valid=usable, name=name, sha256=sha256)


def merl_pieces(stored: Array) -> Iterator[bytes | memoryview]:
    """Yield the bytes of the MERL file with the given stored numbers, shape (3, 90, 90, 180)."""
    yield HEADER
    for channel in stored:
        yield np.ascontiguousarray(channel, dtype="<f8").data.cast("B")


def stored_numbers(values: ArrayLike, valid: ArrayLike | None) -> Array:
    """Divide values [1/sr] by the scale of each channel; nodes outside the mask `valid` become -1."""
    try:
        brdf = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        kind = type(values).__name__
        problem = f"The values must be real numbers of the shape {SHAPE}; an object of type {kind} has no such numbers."
        raise MeasurementFormatError(problem) from None
    if brdf.shape != SHAPE:
        raise MeasurementFormatError(f"The values have the shape {brdf.shape}; a measurement has {SHAPE}.")
    stored = brdf / SCALE[:, np.newaxis, np.newaxis, np.newaxis]
    if valid is not None:
        mask = np.asarray(valid, dtype=np.bool_)
        if mask.shape != GRID_SHAPE:
            raise MeasurementFormatError(f"The valid nodes have the shape {mask.shape}; it must be {GRID_SHAPE}.")
        stored[:, ~mask] = -1.0
    if not np.isfinite(stored).all():
        count = int((~np.isfinite(stored)).sum())
        are = "is" if count == 1 else "are"
        raise MeasurementFormatError(f"{count} of the values {are} NaN or infinite; every value must be finite.")
    return stored
