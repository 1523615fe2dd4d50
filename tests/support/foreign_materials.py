"""A catalogue of materials of others whose specular and diffuse light is known."""

from dataclasses import dataclass

import numpy as np

from dsbrdf.arrays import Array
from tests.support.foreign_bsdfs import (
    Color,
    Part,
    charlie_sheen,
    conductor,
    dielectric_coat,
    difference,
    lambert,
    oren_nayar,
    plastic,
    principled,
    principled_diffuse,
    under_coat,
)

UP = np.array([[0.0, 0.0, 1.0]])
TO_LIGHT_AT_70 = np.array([[np.sin(np.radians(70.0)), 0.0, np.cos(np.radians(70.0))]])


@dataclass(frozen=True, eq=False)
class Material:
    """What a surface reflects: its specular and its diffuse parts; sheen is diffuse, a coat is specular.

    Where the specular light is that of one layer of microfacets, `alpha` is their roughness.
    """

    specular: tuple[Part, ...] = ()
    diffuse: tuple[Part, ...] = ()
    alpha: float | None = None
    distribution: str = "ggx"

    def specular_values(self, omega_in: Array, omega_out: Array) -> Array:
        return _sum(self.specular, omega_in, omega_out)

    def diffuse_values(self, omega_in: Array, omega_out: Array) -> Array:
        return _sum(self.diffuse, omega_in, omega_out)

    @property
    def f0(self) -> Array | None:
        """Reflectance of the layer at normal incidence, RGB, shape (3,); None where there is not one layer."""
        if self.alpha is None:  # GGX's distribution and Beckmann's are 1 / (pi alpha**2) at the normal
            return None
        return np.asarray(self.specular_values(UP, UP)[0] * 4.0 * np.pi * self.alpha**2)

    @property
    def f70(self) -> Array | None:
        """Reflectance of the layer at 70 degrees, RGB, shape (3,), by a rough mirror of its roughness."""
        if self.alpha is None:
            return None
        pair = TO_LIGHT_AT_70, TO_LIGHT_AT_70 * [-1.0, -1.0, 1.0]
        return np.asarray(
            self.specular_values(*pair)[0] / conductor(self.alpha, distribution=self.distribution)(*pair)[0]
        )


def _sum(parts: tuple[Part, ...], omega_in: Array, omega_out: Array) -> Array:
    return sum((part(omega_in, omega_out) for part in parts), np.zeros_like(omega_in))


def plastic_material(alpha: float, color: Color, ior: float = 1.5, kind: str = "ggx", mixed: bool = False) -> Material:
    coat, ground = plastic(alpha, color, ior, kind, nonlinear=mixed)
    return Material((coat,), (ground,), alpha, kind)


def metal(alpha: float, name: str, kind: str = "ggx") -> Material:
    return Material((conductor(alpha, name, kind),), (), alpha, kind)


def coated_metal(coat_alpha: float, alpha: float, name: str, ior: float = 1.5) -> Material:
    return Material((dielectric_coat(coat_alpha, ior), under_coat(conductor(alpha, name), ior)))


def highlight(alpha: float, strength: Color, ground: Part, kind: str = "ggx") -> Material:
    """A rough mirror of any strength over a diffuse ground."""
    return Material((conductor(alpha, "none", kind, strength),), (ground,), alpha, kind)


def car_paint(coat_alpha: float, alpha: float, flakes: Color, ground: Color, ior: float = 1.5) -> Material:
    """A clear coat over flakes and a ground."""
    below = under_coat(conductor(alpha, color=flakes), ior)
    return Material((dielectric_coat(coat_alpha, ior), below), (under_coat(lambert(ground), ior),))


def principled_material(
    color: Color, roughness: float, metallic: float = 0.0, clearcoat: float = 0.0, sheen: float = 0.0, **others: float
) -> Material:
    """The principled BSDF: its main lobe and its clear coat, its diffuse part and its sheen."""
    plain = principled(color, roughness, metallic, **others)
    body = principled_diffuse(color, roughness, metallic)
    specular = [difference(plain, body) if metallic < 1.0 else plain]
    diffuse = [body] if metallic < 1.0 else []
    if clearcoat:
        coated = principled(color, roughness, metallic, **others, clearcoat=clearcoat, clearcoat_gloss=0.95)
        specular.append(difference(coated, plain))
    if sheen:
        diffuse.append(difference(principled(color, roughness, metallic, **others, sheen=sheen), plain))
    return Material(tuple(specular), tuple(diffuse), None if clearcoat else roughness**2)


GREEN = (0.10, 0.45, 0.15)
BLUE = (0.06, 0.12, 0.42)
ORANGE = (0.72, 0.27, 0.05)
WHITE = (0.88, 0.87, 0.84)
PINK = (0.60, 0.28, 0.33)

CATALOGUE = {
    "plastic_green_03": plastic_material(0.03, GREEN),
    "plastic_orange_25_beckmann": plastic_material(0.25, ORANGE, ior=1.55, kind="beckmann"),
    "plastic_white_50": plastic_material(0.50, WHITE),
    "silver_15_beckmann": metal(0.15, "Ag", "beckmann"),
    "nickel_25": metal(0.25, "Ni_palik"),
    "coat_on_copper": coated_metal(0.05, 0.28, "Cu"),
    "coloured_highlight": highlight(0.22, (0.14, 0.09, 0.04), lambert(BLUE), "beckmann"),
    "charlie_sheen": Material((), (charlie_sheen(0.4, (0.45, 0.25, 0.15)), lambert((0.06, 0.04, 0.03)))),
    "oren_nayar_25": Material((), (oren_nayar(25.0, PINK),)),
    "principled_quarter_metal": principled_material((0.55, 0.50, 0.60), 0.5, metallic=0.25),
    "car_paint_blue": car_paint(0.012, 0.22, (0.10, 0.16, 0.30), (0.01, 0.02, 0.06)),
}
