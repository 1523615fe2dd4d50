"""Read and write the tensor files and the warps of the RGL material database (Dupuy and Jakob 2018, section 4).

A tensor file stores named arrays one after the other, with little-endian numbers:

    "tensor_file" 0x00, version 1 0 (two bytes), number of fields (uint32), and for each field
    length of the name (uint16), name, number of axes (uint16), type (uint8), offset of the data (uint64),
    length of each axis (uint64); the data follow.

A warp maps uniform samples of the unit square to points of the square with a given density. One coordinate of a sample
gives the row of the point, by the marginal density; the other gives the column, by the conditional density of the row.
The density is a table with bilinear interpolation.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dsbrdf.arrays import Array, Indices
from dsbrdf.errors import MeasurementFormatError


@dataclass(frozen=True, eq=False)
class Warp:
    """Hold one warp, or a stack of warps for increasing values of a parameter, interpolated linearly in between."""

    density: Array  # density at each node, axes (..., row, column)
    conditional: Array  # integral of the density along each row, up to each node, axes (..., row, column)
    marginal: Array  # integral of the density over all rows up to each row, axes (..., row)

    @classmethod
    def of(cls, table: ArrayLike) -> "Warp":
        """Make the warp of a density table (..., rows, columns), whose values are not negative and not all 0."""
        density = np.asarray(table, dtype=np.float64)
        height, width = density.shape[-2:]
        conditional = _running(density) / (width - 1)
        marginal = _running(conditional[..., -1]) / (height - 1)
        total = marginal[..., -1:, None]
        return cls(density / total, conditional / total, marginal / total[..., 0])

    def sample(self, columns: Array, rows: Array) -> tuple[Array, Array]:
        """Map uniform samples of the unit square, `columns` and `rows`, to points (x, y) by a single warp."""
        height, width = self.density.shape
        row = np.clip(np.searchsorted(self.marginal, rows, side="right") - 1, 0, height - 2)
        ends = self.conditional[:, -1]
        down = _invert_linear(ends[row], ends[row + 1], (rows - self.marginal[row]) * (height - 1))
        mixed = (1.0 - down)[:, None] * self.conditional[row] + down[:, None] * self.conditional[row + 1]
        target = columns * mixed[:, -1]
        column = np.clip(np.sum(mixed <= target[:, None], axis=1) - 1, 0, width - 2)
        left, right = (
            (1.0 - down) * self.density[row, column + i] + down * self.density[row + 1, column + i] for i in (0, 1)
        )
        rest = (target - np.take_along_axis(mixed, column[:, None], axis=1)[:, 0]) * (width - 1)
        across = _invert_linear(left, right, rest)
        return (column + across) / (width - 1), (row + down) / (height - 1)

    def invert(self, lower: Indices, share: Array, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the uniform samples (columns, rows) that a stack of warps maps to points (x, y).

        The warp of each point is interpolated between the warps ``lower`` and ``lower + 1``, with the weights
        ``1 - share`` and ``share``.
        """
        upper = np.minimum(lower + 1, len(self.density) - 1)
        height, width = self.density.shape[1:]
        row, down = _cell(y, height)
        column, across = _cell(x, width)

        def mixed(table: Array, *place: Indices | int) -> Array:
            return np.asarray((1.0 - share) * table[lower, *place] + share * table[upper, *place])

        def along(i: int, j: int) -> Array:
            return mixed(self.density, row + i, column + j)

        left = (1.0 - down) * along(0, 0) + down * along(1, 0)
        right = (1.0 - down) * along(0, 1) + down * along(1, 1)
        before = (1.0 - down) * mixed(self.conditional, row, column) + down * mixed(self.conditional, row + 1, column)
        ends = mixed(self.conditional, row, -1), mixed(self.conditional, row + 1, -1)
        whole = (1.0 - down) * ends[0] + down * ends[1]
        within = across * (left + 0.5 * across * (right - left)) / (width - 1)
        columns = np.where(whole > 0.0, (before + within) / np.where(whole > 0.0, whole, 1.0), 0.0)
        rows = mixed(self.marginal, row) + down * (ends[0] + 0.5 * down * (ends[1] - ends[0])) / (height - 1)
        return np.clip(columns, 0.0, 1.0), np.clip(rows, 0.0, 1.0)


def bilinear(table: Array, x: Array, y: Array, of: Indices | None = None) -> Array:
    """Interpolate a table (..., rows, columns) at points (x, y) of the unit square; x varies along a row.

    With ``of``, the table is a stack of tables, and the point with index n is interpolated in the table ``of[n]``.
    """
    row, down = _cell(y, table.shape[-2])
    column, across = _cell(x, table.shape[-1])
    place: tuple[Any, ...] = (...,) if of is None else (of,)
    upper = (1.0 - across) * table[*place, row, column] + across * table[*place, row, column + 1]
    lower = (1.0 - across) * table[*place, row + 1, column] + across * table[*place, row + 1, column + 1]
    return (1.0 - down) * upper + down * lower


def _cell(position: Array, count: int) -> tuple[Indices, Array]:
    """Return the index of the node below each position from 0 to 1, and the interpolation weight of the node above."""
    lower = np.clip((position * (count - 1)).astype(np.intp), 0, count - 2)
    return lower, position * (count - 1) - lower


def _running(values: Array) -> Array:
    """Integrate a piecewise linear function along the last axis, from the first node to each; nodes are 1 apart."""
    steps = np.cumsum(0.5 * (values[..., 1:] + values[..., :-1]), axis=-1)
    return np.concatenate([np.zeros((*values.shape[:-1], 1)), steps], axis=-1)


def _invert_linear(start: Array, end: Array, area: Array) -> Array:
    """Return at which fraction of a cell the integral of a density, linear from `start` to `end`, reaches `area`."""
    slope = end - start
    root = np.sqrt(np.maximum(start * start + 2.0 * area * slope, 0.0))
    # The fraction is (root - start) / slope, written here in a form without cancellation.
    below = start + root
    return np.clip(np.where(below > 0.0, 2.0 * area / np.where(below > 0.0, below, 1.0), 0.0), 0.0, 1.0)


_MAGIC = b"tensor_file\0\x01\x00"
# The file gives the type of an array as a position in this tuple, counted from 1.
_TYPES = ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f2", "f4", "f8")
_ALIGNMENT_BYTES = 8
_MAX_FIELDS = 64
_MAX_AXES = 8


def encode_tensors(fields: Mapping[str, NDArray[Any]]) -> bytes:
    """Return the bytes of a tensor file with named arrays."""
    names = {name: name.encode() for name in fields}
    arrays = {name: np.asarray(array, array.dtype.newbyteorder("<"), order="C") for name, array in fields.items()}
    offset = len(_MAGIC) + 4 + sum(2 + len(names[name]) + 2 + 1 + 8 + 8 * arrays[name].ndim for name in fields)
    heads, bodies = [_MAGIC, struct.pack("<I", len(fields))], []
    for name, array in arrays.items():
        gap = -offset % _ALIGNMENT_BYTES
        offset += gap
        code = _TYPES.index(array.dtype.str[1:]) + 1
        heads += [struct.pack("<H", len(names[name])), names[name], struct.pack("<HBQ", array.ndim, code, offset)]
        heads.append(struct.pack(f"<{array.ndim}Q", *array.shape))
        bodies += [bytes(gap), array.tobytes()]
        offset += array.nbytes
    return b"".join(heads + bodies)


def parse_tensors(data: bytes) -> dict[str, NDArray[Any]]:
    """Return the arrays of a tensor file, read-only.

    Raises MeasurementFormatError if the bytes are of another kind, damaged or cut off.
    """
    if data[: len(_MAGIC)] != _MAGIC:
        raise MeasurementFormatError("The file is not a tensor file of version 1.0, as an RGL .bsdf file must be.")
    try:
        return _fields(data)
    # NumPy raises ValueError or OverflowError if an array is longer than the data.
    except (struct.error, ValueError, OverflowError):
        raise MeasurementFormatError("The tensor file is damaged or cut off: a field lies outside of it.") from None


def _fields(data: bytes) -> dict[str, NDArray[Any]]:
    place = len(_MAGIC)

    def take(code: str) -> tuple[Any, ...]:
        nonlocal place
        values = struct.unpack_from(f"<{code}", data, place)
        place += struct.calcsize(f"<{code}")
        return values

    (count,) = take("I")
    if count > _MAX_FIELDS:
        raise ValueError
    fields = {}
    for _ in range(count):
        (length,) = take("H")
        (raw,) = take(f"{length}s")
        axes, code, offset = take("HBQ")
        shape = take(f"{axes}Q")
        if axes > _MAX_AXES or not 1 <= code <= len(_TYPES):
            raise ValueError
        kind = np.dtype("<" + _TYPES[code - 1])
        fields[raw.decode()] = np.frombuffer(data, kind, prod(shape), offset).reshape(shape)
    return fields
