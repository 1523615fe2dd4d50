"""Kinds of materials of others that a split finds difficult, one of each: what scatters light several ways."""

from collections.abc import Callable
from functools import cache

import numpy as np

from dsbrdf.arrays import Array
from tests.support.foreign_materials import (
    UP,
    Color,
    Material,
    Part,
    charlie_sheen,
    conductor,
    dielectric_coat,
    lambert,
    plastic,
    under_coat,
)

GOLD: Color = (0.95, 0.72, 0.30)


def directional_rule(theta_out: float) -> tuple[Array, Array, Array]:
    """Directions (n, 3) of the light and of the eye, and weights (n,) of an integral over the light's cosine [sr].

    A midpoint rule in half vectors, dense about the mirror direction; half of the azimuths stand for all.
    """
    rings, azimuths = 300, 60
    u = (np.arange(rings) + 0.5) / rings
    half, azimuth = np.meshgrid(np.pi / 2 * u**3, (np.arange(azimuths) + 0.5) / azimuths * np.pi, indexing="ij")
    area = np.sin(half) * (np.pi / 2 * 3.0 * u**2 / rings)[:, np.newaxis] * (2.0 * np.pi / azimuths)
    normal = np.stack([np.sin(half) * np.cos(azimuth), np.sin(half) * np.sin(azimuth), np.cos(half)], axis=-1)
    eye = np.array([np.sin(theta_out), 0.0, np.cos(theta_out)])
    cos_diff = normal @ eye
    light = 2.0 * cos_diff[..., np.newaxis] * normal - eye
    lit = (cos_diff > 0.0) & (light[..., 2] > 1e-6)
    return light[lit], np.broadcast_to(eye, light.shape)[lit], (4.0 * cos_diff * light[..., 2] * area)[lit]


def both(*parts: Part) -> Part:
    return lambda i, o: np.sum([part(i, o) for part in parts], axis=0)


def faded(part: Part, factor: Color) -> Part:
    return lambda i, o: np.array(factor) * part(i, o)


def retro(alpha: float, color: Color) -> Part:
    mirror = conductor(alpha, color=color)
    return lambda i, o: mirror(i, o * [-1.0, -1.0, 1.0])


def dyed(part: Part, density: Color) -> Part:
    """A part under an absorbing film, which light passes on its way in and out."""
    return lambda i, o: part(i, o) * np.exp(-np.array(density) * (1.0 / i[:, 2:] + 1.0 / o[:, 2:]))


def refracted(part: Part, ior: float = 1.5) -> Part:
    """A part under a smooth coat that refracts the light on its way in and out."""

    def inside(omega: Array) -> Array:
        along = omega[:, :2] / ior
        return np.column_stack([along, np.sqrt(1.0 - np.sum(along**2, axis=1))])

    return under_coat(lambda i, o: part(inside(i), inside(o)) / ior**2, ior)


@cache
def lost_light(alpha: float) -> tuple[Array, Array]:
    """Cosines, and the light that GGX without absorption loses between its facets there."""
    cosines = np.linspace(0.02, 1.0, 25) ** 1.5
    mirror = conductor(alpha)
    rules = [directional_rule(float(np.arccos(min(cosine, 1.0)))) for cosine in cosines]
    return cosines, np.array([1.0 - float(weight @ mirror(light, eye)[:, 0]) for light, eye, weight in rules])


def compensation(alpha: float, f0: Color) -> Part:
    """Kulla and Conty 2017: light that leaves rough facets after several reflections."""
    reflectance = np.array(f0) + (1.0 - np.array(f0)) / 21.0

    def values(i: Array, o: Array) -> Array:
        cosines, lost = lost_light(alpha)
        fine = np.linspace(0.0, 1.0, 400)
        mean = 2.0 * np.trapezoid(np.interp(fine, cosines, lost) * fine, fine)
        color = reflectance**2 * (1.0 - mean) / (1.0 - reflectance * mean)
        shape = np.interp(i[:, 2], cosines, lost) * np.interp(o[:, 2], cosines, lost) / (np.pi * mean)
        return shape[:, np.newaxis] * color

    return values


def compensated_metal(alpha: float, name: str) -> Material:
    once = conductor(alpha, name)
    f0 = once(UP, UP)[0] * 4.0 * np.pi * alpha**2
    red, green, blue = f0.tolist()
    return Material((once, compensation(alpha, (red, green, blue))))


def two_roughnesses(narrow: float, wide: float, color: Color, fraction: float) -> Material:
    first, second = (conductor(alpha, color=color) for alpha in (narrow, wide))
    return Material((faded(first, (fraction,) * 3), faded(second, (1.0 - fraction,) * 3)))


def plastic_with(
    alpha: float, color: Color, *, diffuse: tuple[Part, ...] = (), specular: tuple[Part, ...] = ()
) -> Material:
    coat, ground = plastic(alpha, color)
    return Material((coat, *specular), (ground, *diffuse))


def two_flakes(coat: float, fine: float, coarse: float, color: Color, ground: Color) -> Material:
    flakes = both(conductor(fine, color=color), conductor(coarse, color=color))
    return Material((dielectric_coat(coat), under_coat(flakes)), (under_coat(lambert(ground)),))


def refracted_flakes(coat: float, alpha: float, color: Color, ground: Color) -> Material:
    return Material((dielectric_coat(coat), refracted(conductor(alpha, color=color))), (under_coat(lambert(ground)),))


def anodised(alpha: float, density: Color, coat: float) -> Material:
    return Material((dielectric_coat(coat, 1.65), under_coat(dyed(conductor(alpha, "Al"), density), 1.65)))


KINDS: dict[str, Callable[[], Material]] = {
    "interreflecting_metal": lambda: compensated_metal(0.2, "Au"),
    "metal_of_two_roughnesses": lambda: two_roughnesses(0.05, 0.25, GOLD, 0.5),
    "sheen_beside_a_highlight": lambda: plastic_with(
        0.15, (0.3, 0.05, 0.08), diffuse=(charlie_sheen(0.3, (0.3, 0.25, 0.25)),)
    ),
    "flakes_of_two_scales": lambda: two_flakes(0.01, 0.12, 0.4, (0.15, 0.15, 0.16), (0.02, 0.02, 0.02)),
    "refracted_flakes": lambda: refracted_flakes(0.015, 0.2, (0.3, 0.2, 0.1), (0.1, 0.06, 0.03)),
    "retro_reflection_beside_plastic": lambda: plastic_with(
        0.1, (0.4, 0.4, 0.4), specular=(retro(0.1, (0.15, 0.15, 0.15)),)
    ),
    "tinted_highlight": lambda: anodised(0.15, (0.05, 0.5, 0.6), 0.15),
}
