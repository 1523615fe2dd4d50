"""Render a lit unit sphere of one material, and compare two images by exposure, tone curve, PSNR and SSIM.

The sphere is seen along -z in parallel projection, x to the right and y up. Images (height, width, 3) have linear RGB
radiance, which `displayed` converts to values of a screen.

The direction to the viewer is (0, 0, 1) at every pixel. The angles at which the material is evaluated depend only on
lighting and size and are cached, so that an image needs one call of ``evaluate`` and sparse matrix products.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy import sparse
from scipy.ndimage import gaussian_filter

from dsbrdf.arrays import Array, Evaluate, Indices, Mask
from dsbrdf.data.geometry import spherical
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.synthetic import Reflectance
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.rendering.environment import EnvironmentMap, Light, averaged, environment_rings, map_directions, map_shape


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


# Edges of lights and of the horizon are blurred by more than a pixel of the environment map, which could not show
# sharper ones. Their widths are in radians, or in slopes (tangents of the angle).
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


_EXPOSURE_QUANTILE = 0.99  # An exposure scales this quantile of the pixels to 1.
# The window of SSIM has 11 x 11 pixels (Wang, Bovik, Sheikh and Simoncelli 2004).
_SSIM_SIGMA_PX = 1.5
_SSIM_RADIUS_PX = 5
_C1, _C2 = 0.01**2, 0.03**2


def exposure(image: Array, mask: Mask) -> float:
    """Return the factor that scales the 99th percentile of the masked values of all channels to 1, or 1 if all are 0.

    The image usually shows a measurement; images that are compared with this image are scaled by the factor as well.
    """
    bright = float(np.quantile(image[mask], _EXPOSURE_QUANTILE))
    return 1.0 / bright if bright > 0.0 else 1.0


def displayed(image: Array, factor: float = 1.0) -> Array:
    """Convert radiance (..., 3) to values of a screen: multiply by `factor`, clip to [0, 1], apply the sRGB curve."""
    linear = np.clip(image * factor, 0.0, 1.0)
    curve = 1.055 * np.maximum(linear, 0.0031308) ** (1.0 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, curve)


def psnr(reference: Array, image: Array, mask: Mask) -> float:
    """Return the peak signal-to-noise ratio [dB] of two displayed images with peak 1; infinite for equal images.

    The squared error is averaged over the pixels of the mask and the three channels.
    """
    error = float(np.mean((reference[mask] - image[mask]) ** 2))
    return float("inf") if error == 0.0 else float(-10.0 * np.log10(error))


def ssim(reference: Array, image: Array, mask: Mask) -> float:
    """Return the structural similarity (Wang and others 2004) of two displayed images; 1 for equal images.

    Means, variances and covariance are weighted by a Gaussian window of 11 x 11 pixels, sigma 1.5, in each channel,
    with the constants 0.01**2 and 0.03**2. The result is the mean over all windows whose centre is in the mask. An
    image is continued in black beyond its border.
    """
    mean_a, mean_b = _windowed(reference), _windowed(image)
    variances = _windowed(reference**2) + _windowed(image**2) - mean_a**2 - mean_b**2
    covariance = _windowed(reference * image) - mean_a * mean_b
    likeness = (2.0 * mean_a * mean_b + _C1) * (2.0 * covariance + _C2)
    likeness /= (mean_a**2 + mean_b**2 + _C1) * (variances + _C2)
    return float(np.mean(likeness[mask]))


def _windowed(image: Array) -> Array:
    sigma, radius = (_SSIM_SIGMA_PX, _SSIM_SIGMA_PX, 0.0), (_SSIM_RADIUS_PX, _SSIM_RADIUS_PX, 0)
    return np.asarray(gaussian_filter(image, sigma, mode="constant", radius=radius))


LIGHTINGS = ("three_lights", "environment")
SIZES = (8, 1024)
"""Smallest and largest number of pixels along a side."""
_VIEW_DIRECTION = np.array([0.0, 0.0, 1.0])
_MAX_PIXELS_PER_NODE = 4  # A finer panorama is averaged to this number of pixels per node of the map, along each axis.


Source = Measurement | Reflectance | Evaluate


def render_sphere(source: Source, *, lighting: str | EnvironmentMap = "three_lights", size: int = 128) -> Array:
    """Render a picture of a lit sphere.

    Parameters
    ----------
    source : Measurement, FitResult, model or callable
        The material: a measurement, which is interpolated; an object with the method
        ``evaluate(theta_half, theta_diff, phi_diff) -> (..., 3)``, such as a model, the result of a fit or a component;
        or a function with these arguments.
    lighting : {"three_lights", "environment"} or EnvironmentMap
        Three distant lights, a sky with sun, ground and window, or an environment from `read_environment`.
    size : int
        Number of pixels along a side, 8 to 1024; the sphere touches the border.

    Returns
    -------
    ndarray, shape (size, size, 3)
        Linear RGB radiance, with the first row at the top; 0 beside the sphere. The functions
        `dsbrdf.rendering.sphere.exposure` and `displayed` convert it to values of a screen.

    Raises
    ------
    InvalidArgumentError
        If the lighting is unknown, the size is out of range, or the source is none of the above.
    """
    if not isinstance(lighting, EnvironmentMap) and lighting not in LIGHTINGS:
        raise InvalidArgumentError(f"lighting must be one of {', '.join(LIGHTINGS)}, not {lighting!r}")
    if not (isinstance(size, (int, np.integer)) and SIZES[0] <= size <= SIZES[1]):
        raise InvalidArgumentError(f"size must be a whole number from {SIZES[0]} to {SIZES[1]} pixels, not {size}")
    evaluate = _evaluator(source)
    image = np.zeros((size, size, 3))
    _, mask = sphere_normals(size)
    lights: tuple[Light, ...] = THREE_LIGHTS
    around: Array | None = None
    if isinstance(lighting, EnvironmentMap):
        lights, around = lighting.lights, _map_of_picture(size, lighting)
    elif lighting == "environment":
        lights, around = (SUN,), _map_of_sky(size)
    if lights:
        angles, gather = _lit(size, lights)
        values = evaluate(*angles)
        image[mask] = np.stack([part @ values[:, channel] for channel, part in enumerate(gather)], axis=-1)
    if around is not None:
        image[mask] += _rings(size)(evaluate, around)
    return image


def sphere_likeness(reference: Array, image: Array) -> tuple[float, float]:
    """Return PSNR [dB] and SSIM of two displayed spheres of `render_sphere`; PSNR is infinite for equal spheres.

    Both spheres are scaled by the exposure of the reference and displayed, see `dsbrdf.rendering.sphere`. Pixels
    beside the spheres do not count.
    """
    _, mask = sphere_normals(len(reference))
    factor = exposure(reference, mask)
    seen, compared = displayed(reference, factor), displayed(image, factor)
    return psnr(seen, compared, mask), ssim(seen, compared, mask)


@lru_cache(maxsize=8)
def sphere_normals(size: int) -> tuple[Array, Mask]:
    """Return the normals (N, 3) at the pixels of the sphere, row by row, and the mask (size, size) of these pixels."""
    across = (np.arange(size) + 0.5) * 2.0 / size - 1.0
    x, y = np.meshgrid(across, -across)
    square = x * x + y * y
    mask = square < 1.0
    normals = np.stack([x[mask], y[mask], np.sqrt(1.0 - square[mask])], axis=-1)
    normals.flags.writeable = mask.flags.writeable = False
    return normals, mask


def _evaluator(source: Source) -> Evaluate:
    if isinstance(source, Measurement):
        return source.interpolated.evaluate
    evaluate = getattr(source, "evaluate", source)
    if not callable(evaluate):
        kind = type(source).__name__
        raise InvalidArgumentError(f"only a measurement, a model or a function can be rendered, not {kind}")
    return evaluate


@lru_cache(maxsize=4)
def _lit(size: int, lights: tuple[Light, ...]) -> tuple[tuple[Array, Array, Array], list[sparse.csr_array]]:
    """Return the angles at which distant lights need values of the material, and matrices from values to pixels."""
    normals, _ = sphere_normals(size)
    parts = [_light_angles(normals, light) for light in lights]
    pixel = np.concatenate([lit for lit, _, _ in parts])
    angles = np.concatenate([of_light for _, of_light, _ in parts], axis=1)
    irradiance = np.concatenate([received for _, _, received in parts])
    point = np.arange(pixel.size)
    gather = [sparse.csr_array((irradiance[:, c], (pixel, point)), (len(normals), point.size)) for c in range(3)]
    return (angles[0], angles[1], angles[2]), gather


def _light_angles(normals: Array, light: Light) -> tuple[Indices, Array, Array]:
    """Return the indices (n,) of the pixels that a light reaches, and the angles (3, n) and irradiance (n, 3) there.

    The directions to light and viewer are constant over the sphere, and so are their half vector and theta_diff. In
    polar coordinates about the half vector, theta_half is the polar angle of the normal, and phi_diff its azimuth from
    the plane of light and viewer.
    """
    direction = np.array(light.direction)
    cosine = normals @ direction
    lit = np.flatnonzero(cosine > 0.0)
    half = (direction + _VIEW_DIRECTION) / np.linalg.norm(direction + _VIEW_DIRECTION)
    cos_diff = float(direction @ half)
    across = np.cross(_VIEW_DIRECTION, half) if cos_diff < 1.0 - 1e-12 else np.array([1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    # The first axis points towards the light; phi_diff is 0 where the normal is tilted in the opposite direction.
    frame = np.stack([np.cross(across, half), across, half])
    along, aside, height = frame @ normals[lit].T
    theta_half, phi_diff = np.arctan2(np.hypot(along, aside), height), np.arctan2(aside, -along)
    theta_diff = np.full(lit.size, np.arccos(min(cos_diff, 1.0)))
    return lit, np.stack([theta_half, theta_diff, phi_diff]), cosine[lit, np.newaxis] * np.array(light.irradiance)


@lru_cache(maxsize=2)
def _rings(size: int) -> Callable[[Evaluate, Array], Array]:
    return environment_rings(sphere_normals(size)[0], size)


@lru_cache(maxsize=2)
def _map_of_sky(size: int) -> Array:
    """Return the radiance of the built-in environment at the nodes of the map of directions, (3, rows, columns)."""
    return np.moveaxis(environment_radiance(map_directions(size)), -1, 0)


@lru_cache(maxsize=2)
def _map_of_picture(size: int, environment: EnvironmentMap) -> Array:
    """Return the mean radiance of a panorama around each node of the map of directions, (3, rows, columns)."""
    columns = map_shape(size)[1]
    picture = replace(environment, pixels=averaged(environment.pixels, _MAX_PIXELS_PER_NODE * columns))
    fine = -(-picture.pixels.shape[1] // columns)
    total, weight = np.zeros((*map_shape(size), 3)), np.zeros((*map_shape(size), 1))
    for down, right in (np.indices((fine, fine)).reshape(2, -1).T + 0.5) / fine - 0.5:
        directions = map_directions(size, (down, right))
        solid_angle = np.hypot(directions[..., 0], directions[..., 1])[..., np.newaxis] + 1e-12
        total += solid_angle * picture.radiance(directions)
        weight += solid_angle
    return np.moveaxis(total / weight, -1, 0)
