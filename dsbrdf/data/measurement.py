"""Define a measurement: an isotropic BRDF on the angular grid of the MERL database, interpolated at other angles.

The logarithm of a measurement is interpolated linearly in ``theta_diff``, in ``phi_diff`` and in ``sqrt(theta_half)``,
in which the nodes are evenly spaced: highlights fall by orders of magnitude from node to node. The period of
``phi_diff`` is pi by reciprocity.

A node without a measured value gets the value of the nearest measured node along theta_diff, because reflectance
changes most slowly along this angle. Thus every node has a value, and the interpolation is continuous everywhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt

from dsbrdf.arrays import Array, Indices, Mask
from dsbrdf.data.geometry import GRID_SHAPE, checked_angles
from dsbrdf.data.merl_validation import HEADER, SCALE, SHAPE, checked_values
from dsbrdf.errors import InvalidArgumentError, MeasurementFormatError

# This constant, far below any visible reflectance, is added to values before the logarithm, because log(0) is infinite.
LOG_OFFSET_PER_SR = 1e-6
# Points are evaluated in blocks of this size, because the arrays of a block stay in the processor's cache.
_POINTS_PER_BLOCK = 65536


@dataclass(frozen=True, eq=False)
class InterpolatedMeasurement:
    """Evaluate a measurement at any angles, see `Measurement.interpolated`.

    Every node has a source: the measured node whose value it takes, or the node itself if it was measured. The
    theta_diff index of the source is `diff`. The flat index of the node with theta_diff = 0 and the same theta_half and
    phi_diff as the source is `start`.
    """

    measurement: Measurement
    diff: NDArray[np.int8]  # theta_diff index of each node's source, axes (theta_half, theta_diff, phi_diff)
    start: NDArray[np.int32]  # flat index of the source's node at theta_diff = 0, axes (theta_half, phi_diff)

    def evaluate(self, theta_half: ArrayLike, theta_diff: ArrayLike, phi_diff: ArrayLike = np.pi / 2) -> Array:
        """Return values (..., 3) [1/sr] at half and difference angles (...) that broadcast [rad]; never negative.

        Beyond the last theta_half of the grid, 88 degrees, values are as at this angle. Below the horizon, values are
        extrapolated.
        """
        named = checked_angles(theta_half=theta_half, theta_diff=theta_diff, phi_diff=phi_diff)
        angles = np.broadcast_arrays(*named)
        if not all(np.isfinite(angle).all() for angle in angles):
            raise InvalidArgumentError("an angle must be a finite number")
        flat = [angle.ravel() for angle in angles]
        values = np.empty((flat[0].size, 3))
        for start in range(0, flat[0].size, _POINTS_PER_BLOCK):
            block = slice(start, start + _POINTS_PER_BLOCK)
            values[block] = self._values(*(angle[block] for angle in flat)).T
        return values.reshape(*angles[0].shape, 3)

    @property
    def source(self) -> NDArray[np.int32]:
        """Flat index of the measured node whose value each node takes, (90, 90, 180)."""
        return np.asarray(self.start[:, np.newaxis] + np.int32(GRID_SHAPE[2]) * self.diff)

    def is_measured(self, theta_half: ArrayLike, theta_diff: ArrayLike, phi_diff: ArrayLike = np.pi / 2) -> Mask:
        """Return a mask (...) of the angles whose grid cell has a valid node with a positive interpolation weight."""
        angles = np.broadcast_arrays(*checked_angles(theta_half=theta_half, theta_diff=theta_diff, phi_diff=phi_diff))
        found = np.zeros(angles[0].shape, dtype=bool)
        for weight, node in _corners(*angles):
            found |= self.measurement.valid[node] & (weight > 0.0)
        return found

    def _values(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return values (3, N) [1/sr] at angles (N,) [rad]."""
        stored = self.measurement.stored.reshape(3, -1)
        scale = self.measurement.scale[:, np.newaxis]
        logarithm = np.zeros((3, theta_half.size))
        for weight, (row, diff, column) in _corners(theta_half, theta_diff, phi_diff):
            node = self.start[row, column] + np.int32(GRID_SHAPE[2]) * self.diff[row, diff, column]
            values = np.multiply(stored[:, node], scale, order="C")  # Indexing makes the channels the fastest axis.
            logarithm += weight * np.log(np.maximum(values, 0.0) + LOG_OFFSET_PER_SR)
        return np.maximum(np.exp(logarithm) - LOG_OFFSET_PER_SR, 0.0)


def _corners(
    theta_half: Array, theta_diff: Array, phi_diff: Array
) -> Iterator[tuple[Array, tuple[Indices, Indices, Indices]]]:
    """Yield weights and nodes of the eight corners of the grid cell around each point."""
    row, row_share = _cells(np.sqrt(90.0 * np.clip(np.degrees(theta_half), 0.0, 90.0)), GRID_SHAPE[0])
    diff, diff_share = _cells(np.clip(np.degrees(theta_diff), 0.0, 90.0), GRID_SHAPE[1])
    turn = np.mod(np.degrees(phi_diff), 180.0)
    column = np.minimum(turn.astype(np.intp), GRID_SHAPE[2] - 1)
    column_share = turn - column
    for corner in range(8):
        a, b, c = corner >> 2, corner >> 1 & 1, corner & 1
        shares = ((a, row_share), (b, diff_share), (c, column_share))
        in_row, in_diff, in_column = (share if is_upper else 1.0 - share for is_upper, share in shares)
        yield in_row * in_diff * in_column, (row + a, diff + b, (column + c) % GRID_SHAPE[2])


def _cells(position: Array, count: int) -> tuple[Indices, Array]:
    """Return the index of the node at or below each position, and the interpolation weight of the node above it."""
    lower = np.minimum(position.astype(np.intp), count - 2)
    return lower, np.minimum(position - lower, 1.0)


def _nearest_valid(valid: Mask) -> tuple[NDArray[np.int8], NDArray[np.int32]]:
    """Return the arrays `diff` and `start` of `InterpolatedMeasurement`, which give each node its nearest valid node.

    The search first goes towards theta_diff = 0, away from the horizon, then in the other direction along theta_diff,
    and finally to the nearest (theta_half, phi_diff) with a valid node.
    """
    steps = np.arange(GRID_SHAPE[1], dtype=np.int8)[:, np.newaxis]
    diff = np.where(valid, steps, np.int8(-1))
    for step in range(1, GRID_SHAPE[1]):
        np.maximum(diff[:, step], diff[:, step - 1], out=diff[:, step])
    if (diff[:, 0] < 0).any():
        diff = np.where(diff < 0, valid.argmax(axis=1, keepdims=True).astype(np.int8), diff)
    row, column = np.indices((GRID_SHAPE[0], GRID_SHAPE[2]), dtype=np.int32)
    empty = np.asarray(~valid.any(axis=1))
    if empty.any():
        row, column = distance_transform_edt(empty, return_distances=False, return_indices=True)
        diff = np.moveaxis(diff, 1, 0)[:, row, column].swapaxes(0, 1)
    return diff, row * np.int32(GRID_SHAPE[1] * GRID_SHAPE[2]) + column


@dataclass(frozen=True, repr=False)
class Measurement:
    """The measurement of one material; measurements with equal bytes and names are equal.

    Attributes
    ----------
    stored : ndarray, shape (3, 90, 90, 180)
        The numbers exactly as in the file, read-only; axes (channel, theta_half, theta_diff, phi_diff).
    scale : ndarray, shape (3,)
        Factor of each channel from ``stored`` to the BRDF in 1/sr.
    valid : ndarray of bool, shape (90, 90, 180)
        Nodes with both directions above the horizon and a stored number >= 0 in at least one channel, read-only. A
        negative number in another channel of a valid node counts as 0: the colour is outside of the gamut of sRGB, or
        darker than the noise.
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
        """Interpolate values between the nodes, see `dsbrdf.data.measurement`.

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
        """The measurement as a function of continuous angles, extrapolated where nodes are not valid.

        Raises InvalidArgumentError if no node is valid.
        """
        if not self.valid.any():
            raise InvalidArgumentError("a measurement without a valid node cannot be interpolated")
        return InterpolatedMeasurement(self, *_nearest_valid(self.valid))

    def values_at(self, *nodes: int | slice) -> Array:
        """Return values (3, ...) [1/sr], none negative, at indices or slices of theta_half, theta_diff and phi_diff.

        An axis for which there is neither an index nor a slice is returned whole.
        """
        stored = self.stored[:, *nodes]
        values = stored * self.scale.reshape(3, *[1] * (stored.ndim - 1))
        return np.maximum(values, 0.0, out=values)

    @property
    def values(self) -> Array:
        """The BRDF in 1/sr, shape (3, 90, 90, 180); every access makes a new array of 35 MB.

        At nodes that are not in ``valid``, values have no meaning; at all others, none is negative.
        """
        values = self.stored * self.scale[:, np.newaxis, np.newaxis, np.newaxis]
        return np.maximum(values, 0.0, out=values, where=self.valid)

    @classmethod
    def from_values(cls, values: ArrayLike, valid: ArrayLike | None = None, name: str = "measurement") -> Measurement:
        """Make a measurement from values, as if they had been written to a file and read back.

        Parameters
        ----------
        values : array_like, shape (3, 90, 90, 180)
            The BRDF in 1/sr, axes (channel, theta_half, theta_diff, phi_diff); a node with a negative value in each
            channel is missing. A masked value counts as -1.
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
        brdf = np.asarray(np.ma.filled(values, -1.0), dtype=np.float64)
    except (TypeError, ValueError):
        right = f"The values must be real numbers of the shape {SHAPE}"
        raise MeasurementFormatError(
            f"{right}; an object of type {type(values).__name__} has no such numbers."
        ) from None
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
