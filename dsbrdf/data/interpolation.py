"""Evaluate a measurement at any angles: interpolate its logarithm linearly between the nodes of the grid.

The interpolation is linear in ``theta_diff``, in ``phi_diff`` and in ``sqrt(theta_half)``, because the nodes are evenly
spaced in the square root. The period of ``phi_diff`` is pi by reciprocity. The logarithm is interpolated because
highlights fall by orders of magnitude from node to node.

A node without a measured value gets the value of the nearest measured node along theta_diff, because reflectance
changes most slowly along this angle. Thus every node has a value, and the interpolation is continuous everywhere.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt

from dsbrdf.arrays import Array, Indices, Mask
from dsbrdf.data.geometry import checked_angles
from dsbrdf.data.grid import GRID_SHAPE
from dsbrdf.errors import InvalidArgumentError

# This constant, far below any visible reflectance, is added to values before the logarithm, because log(0) is infinite.
_LOG_OFFSET_PER_SR = 1e-6
# Points are evaluated in blocks of this size, because the arrays of a block stay in the processor's cache.
_POINTS_PER_BLOCK = 65536


class Grid(Protocol):
    """Declare the attributes of `dsbrdf.Measurement` that the interpolation reads."""

    @property
    def stored(self) -> Array: ...  # noqa: D102
    @property
    def scale(self) -> Array: ...  # noqa: D102
    @property
    def valid(self) -> Mask: ...  # noqa: D102
    @property
    def known(self) -> Mask: ...  # noqa: D102


@dataclass(frozen=True, eq=False)
class InterpolatedMeasurement:
    """Evaluate a measurement at any angles; `interpolate` makes an instance.

    Every node has a source: the measured node whose value it takes, or the node itself if it was measured. The
    theta_diff index of the source is `diff`. The flat index of the node with theta_diff = 0 and the same theta_half and
    phi_diff as the source is `start`. Both arrays have the axis C first, of length 3 if the channels are measured at
    different nodes, otherwise 1.
    """

    measurement: Grid
    diff: NDArray[np.int8]  # theta_diff index of each node's source, axes (channel, theta_half, theta_diff, phi_diff)
    start: NDArray[np.int32]  # flat index of the source's node at theta_diff = 0, axes (channel, theta_half, phi_diff)

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
        """Flat index of the measured node whose value each node takes, (1 or 3 channels, 90, 90, 180)."""
        return np.asarray(self.start[:, :, np.newaxis] + np.int32(GRID_SHAPE[2]) * self.diff)

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
            nodes = self.start[:, row, column] + np.int32(GRID_SHAPE[2]) * self.diff[:, row, diff, column]
            found = stored[:, nodes[0]] if len(nodes) == 1 else np.take_along_axis(stored, nodes, axis=1)
            logarithm += weight * np.log(found * scale + _LOG_OFFSET_PER_SR)
        return np.maximum(np.exp(logarithm) - _LOG_OFFSET_PER_SR, 0.0)


def _corners(
    theta_half: Array, theta_diff: Array, phi_diff: Array
) -> Iterator[tuple[Array, tuple[Indices, Indices, Indices]]]:
    """Yield weights and nodes of the eight corners of the grid cell around each point."""
    rows = np.sqrt(90.0 * np.clip(np.degrees(theta_half), 0.0, 90.0))
    row, row_share = _cells(rows, GRID_SHAPE[0])
    diff, diff_share = _cells(np.clip(np.degrees(theta_diff), 0.0, 90.0), GRID_SHAPE[1])
    turn = np.mod(np.degrees(phi_diff), 180.0)
    column = np.minimum(turn.astype(np.intp), GRID_SHAPE[2] - 1)
    column_share = turn - column
    for corner in range(8):
        a, b, c = corner >> 2, corner >> 1 & 1, corner & 1
        weight = (
            (row_share if a else 1.0 - row_share)
            * (diff_share if b else 1.0 - diff_share)
            * (column_share if c else 1.0 - column_share)
        )
        yield weight, (row + a, diff + b, (column + c) % GRID_SHAPE[2])


def interpolate(measurement: Grid) -> InterpolatedMeasurement:
    """Return a continuous function that equals the measurement at its valid nodes."""
    if not measurement.valid.any():
        raise InvalidArgumentError("a measurement without a valid node cannot be interpolated")
    sources = [_nearest_valid(channel) for channel in measurement.known]
    diff, start = (np.stack(parts) for parts in zip(*sources, strict=True))
    return InterpolatedMeasurement(measurement, diff, start)


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
