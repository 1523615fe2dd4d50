"""Define the light of panoramas, and integrate it for every pixel of a sphere.

The viewer looks along -z; x is to the right and y up. The radiance of a sphere's pixel in an environment is an integral
over half vectors, whose nodes are dense near theta_half = 0, where narrow lobes are:

    radiance(normal) = integral f(omega_in, view) L(omega_in) cos(theta_in) d omega_in,
    d omega_in = 4 cos(theta_diff) d omega_half.

Normals with equal angles to the direction of the viewer form a ring of the sphere. Because the material is isotropic,
f is evaluated for one normal of each ring. Its weighted values are added to a map of directions omega_in, in polar
coordinates about the direction of the viewer, and the radiance of the whole ring is the circular correlation of this
map with the environment.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.fft import irfft, rfft
from scipy.ndimage import label

from dsbrdf.arrays import Array, Evaluate, Indices
from dsbrdf.data.geometry import half_difference, spherical
from dsbrdf.errors import ImageFormatError
from dsbrdf.extras import require
from dsbrdf.model.albedo import last_azimuth

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Weights of red, green and blue in the luminance of linear sRGB."""
MAX_RADIANCE = 1e10  # A brighter pixel is refused, because in sums with this pixel other pixels are lost by rounding.
_MAX_PICTURE_WIDTH_PX = 2048  # Wider panoramas are averaged to this width.
_MIN_LIGHT_RATIO = 16.0  # Small spots brighter than this multiple of the mean luminance become distant lights.
_MAX_LIGHT_SIZE_SR = np.radians(5.0) ** 2  # Larger bright spots stay in the panorama and do not become distant lights.
_MAX_LIGHTS = 8
_NODE_SPACING = np.radians(3.5)
"""Angle between neighbouring half vectors [rad]; the PSNR of images, relative to images from finer nodes, is 57 dB."""
_MIN_AZIMUTHS = 8
_RINGS_PER_PASS = 16  # Rings are rendered in groups of this size, whose maps fit in the processor's cache.


@dataclass(frozen=True)
class Light:
    """Distant light: the unit vector towards the light, and the RGB irradiance of a surface facing it."""

    direction: tuple[float, ...]
    irradiance: tuple[float, ...]


@dataclass(frozen=True, eq=False, repr=False)
class EnvironmentMap:
    """Light a sphere by a panorama; use `from_pixels` or `read_environment` to make one.

    Attributes
    ----------
    pixels : ndarray, shape (height, width, 3)
        Linear RGB radiance, without the distant lights; see `from_pixels` for the directions.
    lights : tuple of Light
        The brightest spots, as distant lights.
    """

    pixels: Array
    lights: tuple[Light, ...]

    def __repr__(self) -> str:
        height, width, _ = self.pixels.shape
        lights = "1 light" if len(self.lights) == 1 else f"{len(self.lights)} lights"
        return f"<EnvironmentMap: {width} x {height} pixels, {lights}>"

    @classmethod
    def from_pixels(cls, pixels: ArrayLike) -> EnvironmentMap:
        """Make an environment from the pixels of a panorama.

        Parameters
        ----------
        pixels : array_like, shape (height, 2 height, 3)
            Linear RGB radiance in latitude and longitude. The first row is straight up. The middle column lies behind
            the sphere, in the direction in which the viewer looks. Small spots brighter than 16 times the mean, such as
            the sun, are converted to distant lights.

        Raises
        ------
        ImageFormatError
            If the shape is wrong, a value is negative or above 1e10, or all pixels are black.
        """
        image = np.asarray(pixels, dtype=np.float64)
        if image.ndim != 3 or image.shape[2] != 3 or not 0 < 2 * image.shape[0] == image.shape[1]:
            raise ImageFormatError(
                "A picture of an environment shows 360 by 180 degrees in RGB and is twice as wide as high, "
                f"unlike one of the shape {image.shape}."
            )
        if not ((image >= 0.0) & (image <= MAX_RADIANCE)).all():
            raise ImageFormatError(f"A picture of an environment has values from 0 to {MAX_RADIANCE:g}.")
        if not image.any():
            raise ImageFormatError("The picture of an environment is black.")
        return cls(*_without_lights(averaged(image, _MAX_PICTURE_WIDTH_PX)))

    def radiance(self, direction: Array) -> Array:
        """Return the radiance (..., 3) from directions (..., 3), unit vectors, interpolated between pixel centres."""
        height, width, _ = self.pixels.shape
        up = np.arccos(np.clip(direction[..., 1], -1.0, 1.0))
        turn = np.arctan2(direction[..., 0], -direction[..., 2])
        row = np.clip(up * height / np.pi - 0.5, 0.0, height - 1.0)
        cells, shares = _bilinear(row, (turn / (2.0 * np.pi) + 0.5) * width - 0.5, (height, width))
        return np.sum(shares[..., np.newaxis] * self.pixels.reshape(-1, 3)[cells], axis=0)


def read_environment(path: str | os.PathLike[str]) -> EnvironmentMap:
    """Read a panorama of an environment for `render_sphere`; negative values become 0.

    Parameters
    ----------
    path : path-like
        An OpenEXR ``.exr`` file.

    Raises
    ------
    ImageFormatError
        If the file is not an OpenEXR picture, or not twice as wide as high.
    MissingExtraError
        If the extra ``exr`` is not installed.
    OSError
        If the file cannot be read.
    """
    with Path(path).open("rb") as file:
        if file.read(4) != b"v/1\x01":
            raise ImageFormatError("A panorama must be an OpenEXR picture; save it as .exr.")
    require("exr", "OpenEXR", purpose="OpenEXR pictures")
    import OpenEXR  # type: ignore[import-not-found]  # OpenEXR has no type annotations.

    try:
        with OpenEXR.File(str(path)) as picture:
            channels = {name: np.asarray(channel.pixels) for name, channel in picture.channels().items()}
    except Exception:  # OpenEXR raises several undocumented exceptions.
        raise ImageFormatError("The OpenEXR picture is damaged or cut off.") from None
    pixels = channels.get("RGB", channels.get("RGBA"))
    if pixels is None:
        raise ImageFormatError(f"The OpenEXR picture has the channels {', '.join(sorted(channels))}, not R, G and B.")
    return EnvironmentMap.from_pixels(np.maximum(pixels[..., :3].astype(np.float64), 0.0))


def averaged(image: Array, width: int) -> Array:
    """Reduce a panorama to at most `width` columns; each new pixel has the mean radiance of its area."""
    if image.shape[1] <= width:
        return image
    for axis, count in ((0, width // 2), (1, width)):
        old = image.shape[axis]
        running = np.cumsum(np.insert(image, 0, 0.0, axis=axis), axis=axis)
        edges = np.linspace(0.0, old, count + 1)
        lower = np.minimum(edges.astype(np.intp), old - 1)
        share = np.expand_dims(edges - lower, [other for other in range(3) if other != axis])
        at_edges = (1.0 - share) * running.take(lower, axis) + share * running.take(lower + 1, axis)
        image = np.maximum(np.diff(at_edges, axis=axis), 0.0) * (count / old)
    return image


def _without_lights(image: Array) -> tuple[Array, tuple[Light, ...]]:
    """Convert small bright spots into distant lights, and lower the pixels of the spots to the threshold luminance."""
    height, width, _ = image.shape
    up, turn = (np.arange(height) + 0.5) * np.pi / height, ((np.arange(width) + 0.5) / width - 0.5) * 2.0 * np.pi
    area = (np.sin(up) * np.pi / height * 2.0 * np.pi / width)[:, np.newaxis] * np.ones(width)
    luminance = image @ LUMINANCE
    level = _MIN_LIGHT_RATIO * float(np.average(luminance, weights=area))
    spots, count = label(luminance > level)
    if not count:
        return image, ()
    surplus = np.maximum(1.0 - level / np.maximum(luminance, 1e-300), 0.0)
    numbers = np.arange(1, count + 1)
    sizes = np.bincount(spots.ravel(), area.ravel())[1:]
    power = np.bincount(spots.ravel(), (area * surplus * luminance).ravel())[1:]
    small = numbers[sizes <= _MAX_LIGHT_SIZE_SR]
    image, lights = image.copy(), []
    for number in small[np.argsort(power[small - 1])[::-1][:_MAX_LIGHTS]]:
        row, column = np.nonzero(spots == number)
        taken = image[row, column] * surplus[row, column, np.newaxis]
        share = area[row, column, np.newaxis] * taken
        sine = np.sin(up[row])
        direction = np.stack([sine * np.sin(turn[column]), np.cos(up[row]), -sine * np.cos(turn[column])])
        middle = direction @ (share @ LUMINANCE)
        middle /= np.linalg.norm(middle)
        lights.append(Light(tuple(middle.tolist()), tuple(share.sum(axis=0).tolist())))
        image[row, column] -= taken
    return image, tuple(lights)


def map_shape(size: int) -> tuple[int, int]:
    """Return the numbers of polar angles and of azimuths in the map of directions, for an image size."""
    azimuths = 128 if size <= 64 else 256
    return azimuths // 2 + 1, azimuths


def map_directions(size: int, shift: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Return the directions of the nodes of the map (polar angles, azimuths, 3), shifted by fractions of a spacing."""
    polar_angles, azimuths = map_shape(size)
    polar = ((np.arange(polar_angles) + shift[0]) * np.pi / (polar_angles - 1))[:, np.newaxis]
    azimuth = (np.arange(azimuths) + shift[1]) * 2.0 * np.pi / azimuths
    return spherical(polar, azimuth)


def environment_rings(normals: Array, size: int) -> Callable[[Evaluate, Array], Array]:
    """Prepare the rendering of a sphere whose pixels have the normals (pixels, 3), with z > 0.

    An image with `size` pixels along a side has 3/4 `size` rings. The returned function takes the function that
    evaluates a material, and the radiance (3, polar angles, azimuths) of an environment at the nodes of the map of
    directions. The returned function computes the radiance of the pixels (pixels, 3).
    """
    shape = map_shape(size)
    tilt = np.arctan2(np.hypot(normals[:, 0], normals[:, 1]), normals[:, 2])
    rings = np.linspace(0.0, tilt.max(), 3 * size // 4)
    nodes = [_ring_nodes(theta) for theta in rings]
    theta_half, theta_diff, phi_diff = np.concatenate([node[:3] for node in nodes], axis=1)
    groups = range(0, rings.size, _RINGS_PER_PASS)
    spreads = [_spread(nodes[start : start + _RINGS_PER_PASS], shape) for start in groups]
    position = tilt / rings[-1] * (rings.size - 1), np.arctan2(normals[:, 1], normals[:, 0]) * shape[1] / (2.0 * np.pi)
    to_pixels = _gathering(*_bilinear(*position, (rings.size, shape[1])), rings.size * shape[1])

    def radiance(evaluate: Evaluate, environment: Array) -> Array:
        values = evaluate(theta_half, theta_diff, phi_diff)
        series = rfft(environment, axis=-1)
        turned: list[Array] = []
        start = 0
        for spread in spreads:
            stop = start + spread.shape[1]
            channels = []
            for channel, harmonics in enumerate(series):
                maps = (spread @ values[start:stop, channel]).reshape(-1, *environment.shape[1:])
                products = np.einsum("rpm,pm->rm", rfft(maps, axis=-1), harmonics.conj()).conj()
                channels.append(irfft(products, environment.shape[2], axis=-1))
            turned.append(np.stack(channels, axis=-1))
            start = stop
        return np.asarray(to_pixels @ np.concatenate(turned).reshape(-1, 3))

    return radiance


def _spread(nodes: list[Array], shape: tuple[int, int]) -> sparse.csc_array:
    """Return the matrix that adds values at the nodes of some rings to the map of directions of each ring.

    The matrix has the shape (rings * polar angles * azimuths, nodes).
    """
    ring = np.repeat(np.arange(len(nodes)), [node.shape[1] for node in nodes])
    _, theta_diff, _, azimuth, weight = np.concatenate(nodes, axis=1)
    # The polar angle of omega_in about the direction of the viewer is twice theta_diff.
    cells, shares = _bilinear(2.0 * theta_diff * (shape[0] - 1) / np.pi, azimuth * shape[1] / (2.0 * np.pi), shape)
    return _gathering(cells + ring * shape[0] * shape[1], shares * weight, len(nodes) * shape[0] * shape[1]).T


def _gathering(cells: Indices, shares: Array, count: int) -> sparse.csr_array:
    """Return a matrix (N, count) whose row n has the weights ``shares[:, n]`` in the columns ``cells[:, n]``."""
    each, points = cells.shape
    starts = np.arange(points + 1) * each
    return sparse.csr_array((shares.T.ravel(), cells.T.ravel(), starts), (points, count))


def _ring_nodes(tilt: float) -> Array:
    """Return the nodes (5, n) of the integral for the normal (sin(tilt), 0, cos(tilt)).

    The rows are theta_half, theta_diff, phi_diff, the azimuth of omega_in about the direction of the viewer, and the
    weight, which includes cos(theta_in) and the solid angle.
    """
    largest = 0.5 * (np.pi / 2 + tilt)  # Beyond this theta_half, omega_in is below the horizon at every azimuth.
    count = int(np.ceil(2.0 * largest / _NODE_SPACING))
    s = (np.arange(count) + 0.5) / count
    theta_half, step = largest * s * s, largest * 2.0 * s / count  # Because of the square, nodes are dense near 0.
    last = last_azimuth(theta_half, tilt)
    number = np.maximum(np.ceil(2.0 * last * np.sin(theta_half) / _NODE_SPACING), _MIN_AZIMUTHS).astype(np.intp)
    row = np.repeat(np.arange(count), number)
    within = np.arange(row.size) - np.repeat(np.cumsum(number) - number, number)
    around = last[row] * (2.0 * (within + 0.5) / number[row] - 1.0)
    theta_half, area = theta_half[row], (step * np.sin(theta_half) * 2.0 * last / number)[row]

    sin_tilt, cos_tilt = np.sin(tilt), np.cos(tilt)
    # The frame has the normal as z axis and the direction of the viewer in the half plane y = 0, x >= 0.
    half = spherical(theta_half, around)
    omega_out = np.array([sin_tilt, 0.0, cos_tilt])
    cos_diff = half @ omega_out
    omega_in = 2.0 * cos_diff[:, np.newaxis] * half - omega_out
    _, theta_diff, phi_diff = half_difference(omega_in, omega_out)
    # Return to the frame of the viewer, in which the normal is tilted towards the x axis.
    world_x = sin_tilt * omega_in[:, 2] - cos_tilt * omega_in[:, 0]
    azimuth = np.arctan2(-omega_in[:, 1], world_x)
    weight = 4.0 * cos_diff * np.maximum(omega_in[:, 2], 0.0) * area
    return np.stack([theta_half, theta_diff, phi_diff, azimuth, weight])


def _bilinear(row: Array, column: Array, shape: tuple[int, int]) -> tuple[Indices, Array]:
    """Return flat indices and weights (4, ...) of the four nodes around each point (...); the columns are periodic."""
    low, left = row.astype(np.intp), np.floor(column).astype(np.intp)
    down, right = row - low, column - left
    cells = [np.minimum(low + i, shape[0] - 1) * shape[1] + (left + j) % shape[1] for i in (0, 1) for j in (0, 1)]
    shares = [(down if i else 1.0 - down) * (right if j else 1.0 - right) for i in (0, 1) for j in (0, 1)]
    return np.array(cells), np.array(shares)
