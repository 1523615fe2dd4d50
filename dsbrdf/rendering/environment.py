"""What shines on a sphere: distant lights, a sky with a window above a ground, or a picture that the user gives.

The view looks along -z; x is to the right and y up.
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
"""What red, green and blue in linear sRGB count."""
MAX_RADIANCE = 1e10  # Differences of brighter pixels lose the light of the others.
_WIDEST = 2048  # pixels of a picture; finer ones are averaged
_BRIGHT = 16.0  # times the mean: brighter spots are taken for distant lights,
_SMALL = np.radians(5.0) ** 2  # if they are not larger than this [sr]
_MOST_LIGHTS = 8


@dataclass(frozen=True)
class Light:
    """A distant light: unit vector towards it, and RGB irradiance of a surface that faces it."""

    direction: tuple[float, ...]
    irradiance: tuple[float, ...]


def _light(from_view: float, azimuth: float, irradiance: float) -> Light:
    """White light at an angle from the view, in the direction of an azimuth from the right [degrees]."""
    return Light(tuple(spherical(*np.radians((from_view, azimuth))).tolist()), (irradiance,) * 3)


THREE_LIGHTS = (_light(40.0, 125.0, np.pi), _light(80.0, -20.0, 0.5 * np.pi), _light(140.0, 70.0, 0.5 * np.pi))
"""Key light from the upper left, fill light from the right, rim light from behind: theta_diff 20, 40 and 70 degrees."""
SUN = _light(55.0, 132.0, 3.0 * np.pi)
"""Of the environment: as narrow as the sun is, beside any lobe that can be measured, it is a distant light."""


def _axes(towards: Array) -> Array:
    """Unit vectors to the right, up and along a direction that is looked in, in rows."""
    towards = towards / np.sqrt(towards @ towards)
    across = np.cross(towards, (0.0, 1.0, 0.0))
    across /= np.linalg.norm(across)
    return np.array([across, np.cross(across, towards), towards])


# Nothing here is narrower than the nodes of the integral are apart: widths and edges are in radians or slopes.
_ZENITH, _HORIZON, _GROUND = np.array([0.25, 0.45, 0.9]), np.array([0.9, 0.95, 1.0]), np.array([0.22, 0.19, 0.16])
_HORIZON_WIDTH = 0.02
_WINDOW, _WINDOW_AXES = np.array([3.0, 3.0, 3.0]), _axes(np.array([0.87, 0.13, 0.5]))
_WINDOW_HALF_SIZE, _WINDOW_EDGE = np.array([0.35, 0.5]), 0.02


def environment_radiance(direction: Array) -> Array:
    """Linear RGB radiance (..., 3) of the environment without its sun: a sky above a ground, and a window.

    The directions (..., 3) are unit vectors towards the light; y is up.
    """
    up = direction[..., 1]
    sky = _HORIZON + (_ZENITH - _HORIZON) * np.clip(up, 0.0, 1.0)[..., np.newaxis] ** 0.6
    above = _logistic(up / _HORIZON_WIDTH)
    radiance = above * sky + (1.0 - above) * _GROUND
    # The window is a rectangle on the plane at distance 1, at right angles to its direction.
    across, upward, along = np.moveaxis(direction @ _WINDOW_AXES.T, -1, 0)
    ahead = np.maximum(along, 1e-3)
    window = np.where(along > 0.0, 1.0, 0.0)[..., np.newaxis]
    for position, half in zip((across / ahead, upward / ahead), _WINDOW_HALF_SIZE, strict=True):
        window = window * _logistic((half - np.abs(position)) / _WINDOW_EDGE)
    return radiance + window * _WINDOW


def _logistic(x: Array) -> Array:
    """Soft step from 0 to 1, with an axis for the channels."""
    return (0.5 + 0.5 * np.tanh(0.5 * x))[..., np.newaxis]


@dataclass(frozen=True, eq=False, repr=False)
class EnvironmentMap:
    """Light from all around, as a picture shows it; made by `from_pixels` or `read_environment`.

    Attributes
    ----------
    pixels : ndarray, shape (height, width, 3)
        Linear RGB radiance, without what the lights hold; see `from_pixels` for the directions.
    lights : tuple of Light
        The brightest spots.
    """

    pixels: Array
    lights: tuple[Light, ...]

    def __repr__(self) -> str:
        height, width, _ = self.pixels.shape
        lights = "1 light" if len(self.lights) == 1 else f"{len(self.lights)} lights"
        return f"<EnvironmentMap: {width} x {height} pixels, {lights}>"

    @classmethod
    def from_pixels(cls, pixels: ArrayLike) -> EnvironmentMap:
        """Return the environment that a panorama shows.

        Parameters
        ----------
        pixels : array_like, shape (height, 2 height, 3)
            Linear RGB radiance in latitude and longitude: the first row is straight up, and the middle column is what
            the view looks at behind the sphere, so that the sphere mirrors the columns near the left and right edges.
            Small spots brighter than 16 times the mean, such as the sun, are taken out of it as distant lights.

        Raises
        ------
        ImageFormatError
            If the shape is another, a value is negative or above 1e10, or the picture is black.
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
        return cls(*_without_lights(averaged(image, _WIDEST)))

    def radiance(self, direction: Array) -> Array:
        """Radiance (..., 3) from unit vectors (..., 3), between the pixels' centres."""
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
        If the file is no such picture, or not one of 360 by 180 degrees; one sentence.
    MissingExtraError
        If the extra ``exr`` is not installed.
    OSError
        If the file cannot be read.
    """
    with Path(path).open("rb") as file:
        if file.read(4) != b"v/1\x01":
            raise ImageFormatError("A panorama must be an OpenEXR picture; save it as .exr.")
    require("exr", "OpenEXR", purpose="OpenEXR pictures")
    import OpenEXR  # type: ignore[import-not-found]  # ships no types

    try:
        with OpenEXR.File(str(path)) as picture:
            channels = {name: np.asarray(channel.pixels) for name, channel in picture.channels().items()}
    except Exception:  # the library raises several kinds, ill-documented
        raise ImageFormatError("The OpenEXR picture is damaged or cut off.") from None
    pixels = channels.get("RGB", channels.get("RGBA"))
    if pixels is None:
        raise ImageFormatError(f"The OpenEXR picture has the channels {', '.join(sorted(channels))}, not R, G and B.")
    return EnvironmentMap.from_pixels(np.maximum(pixels[..., :3].astype(np.float64), 0.0))


def averaged(image: Array, width: int) -> Array:
    """Return a picture with at most so many columns, of mean radiance over larger pixels."""
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
    """Cut small bright spots down to the level of what surrounds them at most; they become distant lights."""
    height, width, _ = image.shape
    up, turn = (np.arange(height) + 0.5) * np.pi / height, ((np.arange(width) + 0.5) / width - 0.5) * 2.0 * np.pi
    area = (np.sin(up) * np.pi / height * 2.0 * np.pi / width)[:, np.newaxis] * np.ones(width)
    luminance = image @ LUMINANCE
    level = _BRIGHT * float(np.average(luminance, weights=area))
    spots, count = label(luminance > level)
    if not count:
        return image, ()
    surplus = np.maximum(1.0 - level / np.maximum(luminance, 1e-300), 0.0)
    numbers = np.arange(1, count + 1)
    sizes = np.bincount(spots.ravel(), area.ravel())[1:]
    power = np.bincount(spots.ravel(), (area * surplus * luminance).ravel())[1:]
    small = numbers[sizes <= _SMALL]
    image, lights = image.copy(), []
    for number in small[np.argsort(power[small - 1])[::-1][:_MOST_LIGHTS]]:
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
