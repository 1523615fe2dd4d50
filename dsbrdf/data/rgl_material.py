"""Read RGL ``.bsdf`` files of isotropic materials: bytes -> values at any directions -> `Measurement`.

The file is a tensor file. For each angle theta_i of the first direction to the normal, the file has a warp ``vndf`` of
the unit square, and values ``rgb`` on a regular grid over the square of the warp's uniform samples. The half vector is
a point (u, v) of the unit square, and the warp maps a uniform sample (x, y) to this point. Then

    f cos(theta_out) = rgb(x, y) ndf(u, v) / (4 sigma(theta_i)),
    theta_half = pi/2 u**2,    azimuth of the half vector from the first direction = (2 v - 1) pi

where f is the BRDF, ``ndf`` the density of microfacet normals and sigma their projected area (Dupuy and Jakob 2018,
section 4). Tables are interpolated linearly between two theta_i, as in Mitsuba 3.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dsbrdf.arrays import Array
from dsbrdf.data.files import known_kind
from dsbrdf.data.geometry import check_directions, directions, random_directions
from dsbrdf.data.grid import GRID_SHAPE, PHI_DIFF, THETA_DIFF, THETA_HALF, nodes_above_horizon
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.rgl_file import Warp, bilinear, parse_tensors
from dsbrdf.errors import MeasurementFormatError

_AXES = {"theta_i": 1, "phi_i": 1, "ndf": 2, "sigma": 2, "vndf": 4, "rgb": 5}
# Larger files are refused, because the files of the RGL database have at most 100 MB.
_MAX_FILE_BYTES = 1 << 28
_POINTS_PER_BLOCK = 32768
# Reciprocity is tested at this number of random pairs of directions, at most 75 degrees from the normal.
_RECIPROCITY_PAIRS = 4000
_MIN_RECIPROCITY_COSINE = float(np.cos(np.radians(75.0)))


@dataclass(frozen=True, eq=False)
class RglMaterial:
    """Hold the tables of an isotropic material of the RGL database."""

    theta_i: Array  # angles of the first direction to the normal, increasing [rad]
    ndf: Array  # (H, W)
    sigma: Array  # (H, W)
    vndf: Warp  # one warp for each angle theta_i
    rgb: Array  # table of values in RGB for each theta_i, axes (theta_i, channel, row, column)
    name: str

    def evaluate_directions(self, omega_in: Array, omega_out: Array) -> Array:
        """Return RGB values (n, 3) [1/sr] for pairs of unit vectors (n, 3); 0 if a direction is not above the horizon.

        The direction omega_in is the first direction of the file.
        """
        first = check_directions("omega_in", omega_in, below_horizon=True)
        second = check_directions("omega_out", omega_out, below_horizon=True)
        above = np.flatnonzero((first[:, 2] > 0.0) & (second[:, 2] > 0.0))
        values = np.zeros((len(first), 3))
        for start in range(0, above.size, _POINTS_PER_BLOCK):
            block = above[start : start + _POINTS_PER_BLOCK]
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
        first, second = random_directions(
            generator, generator.uniform(_MIN_RECIPROCITY_COSINE, 1.0, (2, _RECIPROCITY_PAIRS))
        )
        near = first[::4] * [-1.0, -1.0, 1.0] + generator.normal(0.0, 0.05, first[::4].shape)
        second[::4] = near / np.linalg.norm(near, axis=1)[:, np.newaxis]
        one, other = (self.evaluate_directions(*pair).mean(axis=1) for pair in ((first, second), (second, first)))
        light = one + other > 0.0
        return float(np.median(2.0 * np.abs(one - other)[light] / (one + other)[light]))

    def _values(self, first: Array, second: Array) -> Array:
        half = first + second
        theta_i = np.arctan2(np.hypot(first[:, 0], first[:, 1]), first[:, 2])
        theta_half = np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2])
        azimuth = np.arctan2(half[:, 1], half[:, 0]) - np.arctan2(first[:, 1], first[:, 0])
        u, v = np.sqrt(theta_half * 2.0 / np.pi), (azimuth / (2.0 * np.pi) + 0.5) % 1.0
        last = self.theta_i.size - 1
        at = np.interp(theta_i, self.theta_i, np.arange(last + 1.0))
        lower = np.minimum(at.astype(np.intp), max(last - 1, 0))
        share = at - lower
        x, y = self.vndf.invert(lower, share, u, v)
        upper = np.minimum(lower + 1, last)
        rgb = np.stack(
            [
                (1.0 - share) * bilinear(self.rgb[:, channel], x, y, lower)
                + share * bilinear(self.rgb[:, channel], x, y, upper)
                for channel in range(3)
            ],
            axis=-1,
        )
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
    if not data.startswith(b"tensor_file") and (kind := known_kind(data[:16])) is not None:
        raise MeasurementFormatError(f"The data is {kind}; a material of the RGL database is a .bsdf file.")
    fields = parse_tensors(data)
    _check(fields)
    tables = {key: np.asarray(fields[key], dtype=np.float64) for key in ("theta_i", "ndf", "sigma")}
    rgb = np.asarray(fields["rgb"][0], dtype=np.float64)
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
    count = fields["phi_i"].size
    if count > 2:
        raise MeasurementFormatError(
            f"The material is anisotropic: it has {count} azimuths of the first direction; this model is isotropic."
        )
    angles, (_, n_angles, *square), (_, n_rgb, channels, *grid) = (
        np.asarray(fields["theta_i"], dtype=np.float64),
        fields["vndf"].shape,
        fields["rgb"].shape,
    )
    smallest = min(*square, *grid, *fields["ndf"].shape, *fields["sigma"].shape)
    if not angles.size == n_angles == n_rgb or channels != 3 or smallest < 2:
        raise MeasurementFormatError("The fields of the .bsdf file have inconsistent shapes: the file is damaged.")
    if angles[0] < -1e-6 or angles[-1] > np.pi / 2 + 1e-6 or (np.diff(angles) <= 0.0).any():
        raise MeasurementFormatError("The theta_i of the .bsdf file must ascend from 0 to at most 90 degrees.")
    if fields["vndf"].min() < 0.0 or not fields["vndf"].any(axis=(2, 3)).all() or fields["sigma"].min() <= 0.0:
        raise MeasurementFormatError("The vndf or the sigma of the .bsdf file is not positive: it is damaged.")
    if not (fields["rgb"] > 0.0).any():
        raise MeasurementFormatError("Every value of the .bsdf file is zero; a measurement has positive values.")
