"""Render a lit unit sphere of one material, seen along -z in parallel projection, x to the right and y up.

The direction to the viewer is (0, 0, 1) at every pixel. The angles at which the material is evaluated depend only on
lighting and size and are cached, so that an image needs one call of ``evaluate`` and sparse matrix products.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy import sparse

from dsbrdf.arrays import Array, Evaluate, Indices, Mask
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.synthetic import Reflectance
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.rendering.environment import SUN, THREE_LIGHTS, EnvironmentMap, Light, averaged, environment_radiance
from dsbrdf.rendering.environment_rings import environment_rings, map_directions, map_shape
from dsbrdf.rendering.image_metrics import displayed, exposure, psnr, ssim

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
        `dsbrdf.rendering.image_metrics.exposure` and `displayed` convert it to values of a screen.

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

    Both spheres are scaled by the exposure of the reference and displayed, see `dsbrdf.rendering.image_metrics`. Pixels
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
