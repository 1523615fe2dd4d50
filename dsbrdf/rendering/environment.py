"""Define the light on a sphere: distant lights, a built-in environment of sky, ground and window, or a panorama.

The viewer looks along -z; x is to the right and y up.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import label

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import spherical
from dsbrdf.errors import ImageFormatError
from dsbrdf.extras import require

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Weights of red, green and blue in the luminance of linear sRGB."""
MAX_RADIANCE = 1e10  # A brighter pixel is refused, because in sums with this pixel other pixels are lost by rounding.
_MAX_PICTURE_WIDTH_PX = 2048  # Wider panoramas are averaged to this width.
_MIN_LIGHT_RATIO = 16.0  # Small spots brighter than this multiple of the mean luminance become distant lights.
_MAX_LIGHT_SIZE_SR = np.radians(5.0) ** 2  # Larger bright spots stay in the panorama and do not become distant lights.
_MAX_LIGHTS = 8


@dataclass(frozen=True)
class Light:
    """Hold a distant light: the unit vector towards the light, and the RGB irradiance of a surface facing it."""

    direction: tuple[float, ...]
    irradiance: tuple[float, ...]


def _light(from_view: float, azimuth: float, irradiance: float) -> Light:
    """Make a white light at an angle to the viewer's direction and an azimuth from the x axis [degrees]."""
    return Light(tuple(spherical(*np.radians((from_view, azimuth))).tolist()), (irradiance,) * 3)


THREE_LIGHTS = (_light(40.0, 125.0, np.pi), _light(80.0, -20.0, 0.5 * np.pi), _light(140.0, 70.0, 0.5 * np.pi))
"""Key light from the upper left, fill light from the right, rim light from behind (theta_diff 20, 40, 70 degrees)."""
SUN = _light(55.0, 132.0, 3.0 * np.pi)
"""Sun of the built-in environment; it is a distant light, because it is narrower than any measurable lobe."""


def _axes(towards: Array) -> Array:
    """Return a frame of unit vectors (3, 3), in rows: to the right, up, and along the given direction."""
    towards = towards / np.sqrt(towards @ towards)
    across = np.cross(towards, (0.0, 1.0, 0.0))
    across /= np.linalg.norm(across)
    return np.array([across, np.cross(across, towards), towards])


# The widths of edges, in radians or slopes, exceed the spacing of the map of directions, so that it resolves edges.
_ZENITH_COLOR = np.array([0.25, 0.45, 0.9])
_HORIZON_COLOR = np.array([0.9, 0.95, 1.0])
_GROUND_COLOR = np.array([0.22, 0.19, 0.16])
_HORIZON_WIDTH = 0.02
_WINDOW_COLOR = np.array([3.0, 3.0, 3.0])
_WINDOW_AXES = _axes(np.array([0.87, 0.13, 0.5]))
_WINDOW_HALF_SIZE = np.array([0.35, 0.5])
_WINDOW_EDGE_WIDTH = 0.02


def environment_radiance(direction: Array) -> Array:
    """Return the linear RGB radiance (..., 3) of sky, ground and window of the built-in environment.

    The directions (..., 3) are unit vectors towards the light; y is up.
    """
    up = direction[..., 1]
    sky = _HORIZON_COLOR + (_ZENITH_COLOR - _HORIZON_COLOR) * np.clip(up, 0.0, 1.0)[..., np.newaxis] ** 0.6
    above = _logistic(up / _HORIZON_WIDTH)
    radiance = above * sky + (1.0 - above) * _GROUND_COLOR
    # The window is a rectangle in a plane at distance 1, whose normal points to the sphere.
    across, upward, along = np.moveaxis(direction @ _WINDOW_AXES.T, -1, 0)
    ahead = np.maximum(along, 1e-3)
    window = np.where(along > 0.0, 1.0, 0.0)[..., np.newaxis]
    for position, half in zip((across / ahead, upward / ahead), _WINDOW_HALF_SIZE, strict=True):
        window = window * _logistic((half - np.abs(position)) / _WINDOW_EDGE_WIDTH)
    return radiance + window * _WINDOW_COLOR


def _logistic(x: Array) -> Array:
    """Return a smooth step from 0 to 1, with an additional last axis for the channels."""
    return (0.5 + 0.5 * np.tanh(0.5 * x))[..., np.newaxis]


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
        column = (turn / (2.0 * np.pi) + 0.5) * width - 0.5
        above, left = row.astype(np.intp), np.floor(column).astype(np.intp)
        down, right = (row - above)[..., np.newaxis], (column - left)[..., np.newaxis]
        below = np.minimum(above + 1, height - 1)
        upper, lower = (
            (1.0 - right) * self.pixels[at, left % width] + right * self.pixels[at, (left + 1) % width]
            for at in (above, below)
        )
        return np.asarray((1.0 - down) * upper + down * lower)


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
        direction = np.stack(
            [np.sin(up[row]) * np.sin(turn[column]), np.cos(up[row]), -np.sin(up[row]) * np.cos(turn[column])]
        )
        middle = direction @ (share @ LUMINANCE)
        middle /= np.linalg.norm(middle)
        lights.append(Light(tuple(middle.tolist()), tuple(share.sum(axis=0).tolist())))
        image[row, column] -= taken
    return image, tuple(lights)
