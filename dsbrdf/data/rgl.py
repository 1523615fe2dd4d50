"""Read and write the ``.bsdf`` files of the RGL material database: tensor files and warps, with values in RGB.

A tensor file stores named arrays one after the other, with little-endian numbers:

    "tensor_file" 0x00, version 1 0 (two bytes), number of fields (uint32), and for each field
    length of the name (uint16), name, number of axes (uint16), type (uint8), offset of the data (uint64),
    length of each axis (uint64); the data follow.

A warp maps uniform samples of the unit square to points of the square with a given density. One coordinate of a sample
gives the row of the point, by the marginal density; the other gives the column, by the conditional density of the row.
The density is a table with bilinear interpolation.

For each angle theta_i of the first direction to the normal, the file of a material has a warp ``vndf`` of
the unit square, and values ``rgb`` on a regular grid over the square of the warp's uniform samples. The half vector is
a point (u, v) of the unit square, and the warp maps a uniform sample (x, y) to this point. Then

    f cos(theta_out) = rgb(x, y) ndf(u, v) / (4 sigma(theta_i)),
    theta_half = pi/2 u**2,    azimuth of the half vector from the first direction = (2 v - 1) pi

where f is the BRDF, ``ndf`` the density of microfacet normals and sigma their projected area (Dupuy and Jakob 2018,
section 4). Tables are interpolated linearly between two theta_i, as in Mitsuba 3.
"""

import os
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dsbrdf.arrays import Array, Indices
from dsbrdf.data.files import known_kind
from dsbrdf.data.geometry import (
    GRID_SHAPE,
    PHI_DIFF,
    THETA_DIFF,
    THETA_HALF,
    check_directions,
    directions,
    nodes_above_horizon,
    random_directions,
)
from dsbrdf.data.measurement import Measurement
from dsbrdf.errors import MeasurementFormatError


@dataclass(frozen=True, eq=False)
class Warp:
    """One warp, or a stack of warps for increasing values of a parameter, interpolated linearly in between."""

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
        node = row * width + column

        def mixed(tables: Array, place: Indices) -> Array:
            size = tables[0].size
            below, above = (np.take(tables, at * size + place) for at in (lower, upper))
            return np.asarray((1.0 - share) * below + share * above)

        left, right = (
            (1.0 - down) * mixed(self.density, node + j) + down * mixed(self.density, node + width + j) for j in (0, 1)
        )
        before = (1.0 - down) * mixed(self.conditional, node) + down * mixed(self.conditional, node + width)
        ends = [mixed(self.conditional, (row + step) * width - 1) for step in (1, 2)]
        whole = (1.0 - down) * ends[0] + down * ends[1]
        within = across * (left + 0.5 * across * (right - left)) / (width - 1)
        columns = np.where(whole > 0.0, (before + within) / np.where(whole > 0.0, whole, 1.0), 0.0)
        rows = mixed(self.marginal, row) + down * (ends[0] + 0.5 * down * (ends[1] - ends[0])) / (height - 1)
        return np.clip(columns, 0.0, 1.0), np.clip(rows, 0.0, 1.0)


def bilinear(table: Array, x: Array, y: Array, of: Indices | None = None) -> Array:
    """Interpolate a table (rows, columns) at points (x, y) of the unit square; x varies along a row.

    With ``of``, the table is a stack of tables of colours (stack, rows, columns, 3), and the point with index n is
    interpolated in the table ``of[n]``.
    """
    height, width = table.shape[-2:] if of is None else table.shape[1:3]
    (row, down), (column, across) = _cell(y, height), _cell(x, width)
    node = row * width + column
    flat: Array = table.reshape(-1) if of is None else table.reshape(-1, 3)
    if of is not None:
        node, down, across = node + of * (height * width), down[:, None], across[:, None]
    corners = (np.take(flat, node + step, axis=0) for step in (0, 1, width, width + 1))
    upper, lower = ((1.0 - across) * left + across * right for left, right in zip(corners, corners, strict=True))
    return np.asarray((1.0 - down) * upper + down * lower)


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
# The types of arrays by their numbers in the file.
_TYPES = dict(enumerate(("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f2", "f4", "f8"), 1))
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
        code = next(code for code, kind in _TYPES.items() if kind == array.dtype.str[1:])
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
    place, fields = len(_MAGIC), {}

    def take(code: str, most: float = np.inf) -> tuple[Any, ...]:
        """Return the next numbers, the first of which is at most `most`."""
        nonlocal place
        values = struct.unpack_from(f"<{code}", data, place)
        place += struct.calcsize(f"<{code}")
        if most < np.inf and values[0] > most:
            raise ValueError
        return values

    try:
        for _ in range(*take("I", _MAX_FIELDS)):
            (raw,) = take(f"{take('H')[0]}s")
            axes, code, offset = take("HBQ", _MAX_AXES)
            shape = take(f"{axes}Q")
            kind = np.dtype(f"<{_TYPES[code]}")
            fields[raw.decode()] = np.frombuffer(data, kind, prod(shape), offset).reshape(shape)
    # NumPy raises ValueError or OverflowError if an array is longer than the data.
    except (struct.error, ValueError, OverflowError, KeyError):
        raise MeasurementFormatError("The tensor file is damaged or cut off: a field lies outside of it.") from None
    return fields


_AXES = {"theta_i": 1, "phi_i": 1, "ndf": 2, "sigma": 2, "vndf": 4, "rgb": 5}
# Larger files are refused, because the files of the RGL database have at most 100 MB.
_MAX_FILE_BYTES = 1 << 28
_POINTS_PER_BLOCK = 32768
# Reciprocity is tested at this number of random pairs of directions, at most 75 degrees from the normal.
_RECIPROCITY_PAIRS = 4000
_MIN_RECIPROCITY_COSINE = float(np.cos(np.radians(75.0)))


@dataclass(frozen=True, eq=False)
class RglMaterial:
    """The tables of an isotropic material of the RGL database."""

    theta_i: Array  # angles of the first direction to the normal, increasing [rad]
    ndf: Array  # (H, W)
    sigma: Array  # (H, W)
    vndf: Warp  # one warp for each angle theta_i
    rgb: Array  # table of values in RGB for each theta_i, axes (theta_i, row, column, channel)
    name: str

    def evaluate_directions(self, omega_in: Array, omega_out: Array) -> Array:
        """Return RGB values (n, 3) [1/sr] for pairs of unit vectors (n, 3); 0 if a direction is not above the horizon.

        The direction omega_in is the first direction of the file.
        """
        first = check_directions("omega_in", omega_in, below_horizon=True)
        second = check_directions("omega_out", omega_out, below_horizon=True)
        above = np.flatnonzero((first[:, 2] > 0.0) & (second[:, 2] > 0.0))
        values = np.zeros((len(first), 3))
        for block in np.split(above, range(_POINTS_PER_BLOCK, above.size, _POINTS_PER_BLOCK)):
            values[block] = self._values(first[block], second[block])
        return values

    def evaluate(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return RGB values (..., 3) at angles (...) [rad]; adding pi to phi_diff swaps the two directions."""
        first, second = directions(theta_half, theta_diff, phi_diff)
        return self.evaluate_directions(first.reshape(-1, 3), second.reshape(-1, 3)).reshape(first.shape)

    def non_reciprocity(self) -> float:
        """Return the median relative difference between f(omega_in, omega_out) and f(omega_out, omega_in).

        Directions are drawn uniformly, up to 75 degrees from the normal. In every fourth pair, the second direction is
        near the mirror direction of the first.
        """
        generator = np.random.default_rng(0)
        cosines = generator.uniform(_MIN_RECIPROCITY_COSINE, 1.0, (2, _RECIPROCITY_PAIRS))
        first, second = random_directions(generator, cosines)
        near = first[::4] * [-1.0, -1.0, 1.0] + generator.normal(0.0, 0.05, first[::4].shape)
        second[::4] = near / np.linalg.norm(near, axis=1)[:, np.newaxis]
        one, other = (self.evaluate_directions(*pair).mean(axis=1) for pair in ((first, second), (second, first)))
        light = one + other > 0.0
        return float(np.median(2.0 * np.abs(one - other)[light] / (one + other)[light]))

    def _values(self, first: Array, second: Array) -> Array:
        half = first + second
        theta_i, theta_half = (np.arctan2(np.hypot(one[:, 0], one[:, 1]), one[:, 2]) for one in (first, half))
        azimuth = np.arctan2(half[:, 1], half[:, 0]) - np.arctan2(first[:, 1], first[:, 0])
        u, v = np.sqrt(theta_half * 2.0 / np.pi), (azimuth / (2.0 * np.pi) + 0.5) % 1.0
        last = self.theta_i.size - 1
        at = np.interp(theta_i, self.theta_i, np.arange(last + 1.0))
        lower = np.minimum(at.astype(np.intp), max(last - 1, 0))
        share = at - lower
        x, y = self.vndf.invert(lower, share, u, v)
        below, above = (bilinear(self.rgb, x, y, at) for at in (lower, np.minimum(lower + 1, last)))
        rgb = (1.0 - share)[:, None] * below + share[:, None] * above
        sigma = bilinear(self.sigma, np.sqrt(theta_i * 2.0 / np.pi), np.full_like(u, 0.5))
        factor = bilinear(self.ndf, u, v) / (4.0 * sigma * second[:, 2])
        return np.maximum(rgb * factor[:, np.newaxis], 0.0)

    def measurement(self) -> Measurement:
        """Return the values at the nodes of the MERL grid.

        A value is the mean over both orders of the two directions, so that the result is reciprocal. An order whose
        first direction is further from the normal than the last ``theta_i`` has no value. A node is invalid if neither
        order has a value.
        """
        above = np.argwhere(nodes_above_horizon())
        values, valid = np.full((3, *GRID_SHAPE), -1.0), np.zeros(GRID_SHAPE, dtype=np.bool_)
        lowest = np.cos(self.theta_i[-1]) - 1e-6
        for start in range(0, len(above), _POINTS_PER_BLOCK):
            i, j, k = nodes = tuple(above[start : start + _POINTS_PER_BLOCK].T)
            pair = directions(THETA_HALF[i], THETA_DIFF[j], PHI_DIFF[k])
            total, count = np.zeros((i.size, 3)), np.zeros(i.size)
            for first, second in (pair, pair[::-1]):
                inside = first[:, 2] >= lowest
                total[inside] += self._values(first[inside], second[inside])
                count += inside
            values[:, *nodes] = (total / np.maximum(count, 1.0)[:, np.newaxis]).T
            valid[nodes] = count > 0
        return Measurement.from_values(values, valid, self.name)


def read_rgl(path: str | os.PathLike[str]) -> RglMaterial:
    """Read an RGL ``.bsdf`` file of an isotropic material in RGB; the file's stem becomes the material's name.

    Raises MeasurementFormatError if the file is damaged, anisotropic, spectral or of another kind.
    """
    source = Path(path)
    with source.open("rb") as file:
        data = file.read(_MAX_FILE_BYTES + 1)
    if len(data) > _MAX_FILE_BYTES:
        raise MeasurementFormatError(f"The file is longer than {_MAX_FILE_BYTES} bytes, unlike any isotropic material.")
    return parse_rgl(data, source.stem)


def parse_rgl(data: bytes, name: str = "measurement") -> RglMaterial:
    """Return the material in the bytes of a ``.bsdf`` file; raise MeasurementFormatError as `read_rgl` does."""
    if not data.startswith(b"tensor_file") and (kind := known_kind(data[:64])) is not None:
        raise MeasurementFormatError(f"The data is {kind}.")
    fields = parse_tensors(data)
    _check(fields)
    tables = {key: np.asarray(fields[key], dtype=np.float64) for key in ("theta_i", "ndf", "sigma")}
    rgb = np.ascontiguousarray(np.moveaxis(fields["rgb"][0], 1, -1), dtype=np.float64)
    return RglMaterial(**tables, vndf=Warp.of(fields["vndf"][0]), rgb=rgb, name=name)


def _check(fields: Mapping[str, NDArray[Any]]) -> None:
    """Raise MeasurementFormatError unless the arrays are an isotropic material in RGB."""
    if "rgb" not in fields and "spectra" in fields:
        raise MeasurementFormatError("The .bsdf file has spectra; use the file of the same material that ends in _rgb.")
    for name, axes in _AXES.items():
        if name not in fields:
            raise MeasurementFormatError(f"The .bsdf file lacks the field {name!r}, which every material has.")
        array = fields[name]
        if array.ndim != axes or array.dtype.kind != "f" or 0 in array.shape:
            raise MeasurementFormatError(f"The field {name!r} of the .bsdf file is not an array with {axes} axes.")
        if not np.isfinite(array).all():
            raise MeasurementFormatError(f"The field {name!r} of the .bsdf file has values that are NaN or infinite.")
    if (count := fields["phi_i"].size) > 2:
        raise MeasurementFormatError(
            f"The material is anisotropic: it has {count} azimuths of the first direction; this model is isotropic."
        )
    angles = np.asarray(fields["theta_i"], dtype=np.float64)
    (_, n_angles, *square), (_, n_rgb, channels, *grid) = fields["vndf"].shape, fields["rgb"].shape
    smallest = min(*square, *grid, *fields["ndf"].shape, *fields["sigma"].shape)
    if not angles.size == n_angles == n_rgb or channels != 3 or smallest < 2:
        raise MeasurementFormatError("The fields of the .bsdf file have inconsistent shapes: the file is damaged.")
    if angles[0] < -1e-6 or angles[-1] > np.pi / 2 + 1e-6 or (np.diff(angles) <= 0.0).any():
        raise MeasurementFormatError("The theta_i of the .bsdf file must ascend from 0 to at most 90 degrees.")
    if fields["vndf"].min() < 0.0 or not fields["vndf"].any(axis=(2, 3)).all() or fields["sigma"].min() <= 0.0:
        raise MeasurementFormatError("The vndf or the sigma of the .bsdf file is not positive: it is damaged.")
    if not (fields["rgb"] > 0.0).any():
        raise MeasurementFormatError("Every value of the .bsdf file is zero; a measurement has positive values.")
