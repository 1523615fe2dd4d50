"""Materials of others whose specular and diffuse light is known: plugins of Mitsuba 3, formulas of the literature.

A part is a function of unit vectors omega_in, omega_out (n, 3) that returns values (n, 3) in 1/sr, as everywhere
without the cosine. Formulas are for isotropic surfaces and for directions above the horizon.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from dsbrdf.arrays import Array
from tests.support.renderers import mitsuba_variant, surface_at

Part = Callable[[Array, Array], Array]
Color = tuple[float, float, float]

BLACK: Color = (0.0, 0.0, 0.0)
_AT_A_TIME = 500_000  # directions: more need much memory at once
_LEAST_COSINE = 1e-9


def rgb(color: Color) -> dict[str, Any]:
    return {"type": "rgb", "value": list(color)}


def plugin(description: dict[str, Any], component: int | None = None) -> Part:
    """Return a BSDF of Mitsuba, or one component of it by its number there."""
    loaded = cache(lambda: mitsuba_variant("llvm_ad_rgb").load_dict(description))

    def values(omega_in: Array, omega_out: Array) -> Array:
        mi = mitsuba_variant("llvm_ad_rgb")
        bsdf, context = loaded(), mi.BSDFContext()
        if component is not None:
            context.component = component
        out = np.empty_like(omega_in)
        for piece in (slice(start, start + _AT_A_TIME) for start in range(0, len(out), _AT_A_TIME)):
            surface = surface_at(mi, omega_in[piece].T.astype(np.float32))
            away = mi.Vector3f(omega_out[piece].T.astype(np.float32))
            out[piece] = np.array(bsdf.eval(context, surface, away)).T
        return out / np.maximum(omega_out[:, 2:], _LEAST_COSINE)

    return values


def scaled(part: Part, factor: float) -> Part:
    return lambda i, o: factor * part(i, o)


def difference(whole: Part, rest: Part) -> Part:
    """What a part adds to the rest; rounding of single precision below 0 is cut off."""
    return lambda i, o: np.maximum(whole(i, o) - rest(i, o), 0.0)


def conductor(alpha: float, material: str = "none", distribution: str = "ggx", color: Color = (1.0, 1.0, 1.0)) -> Part:
    """A rough conductor; of the material "none", a rough mirror of the colour at every angle."""
    kind = {"type": "roughconductor", "material": material, "distribution": distribution, "alpha": alpha}
    return plugin(kind | {"specular_reflectance": rgb(color)})


def dielectric_coat(alpha: float, ior: float = 1.5, distribution: str = "ggx") -> Part:
    return plastic(alpha, BLACK, ior, distribution)[0]


def plastic(
    alpha: float, color: Color, ior: float = 1.5, distribution: str = "ggx", nonlinear: bool = False
) -> tuple[Part, Part]:
    kind = {"type": "roughplastic", "alpha": alpha, "int_ior": ior, "distribution": distribution}
    kind |= {"nonlinear": nonlinear, "diffuse_reflectance": rgb(color)}
    return plugin(kind, 0), plugin(kind, 1)


def principled(color: Color, roughness: float, metallic: float = 0.0, **others: float) -> Part:
    kind = {"type": "principled", "base_color": rgb(color), "roughness": roughness, "metallic": metallic}
    return plugin(kind | others)


def principled_diffuse(color: Color, roughness: float, metallic: float = 0.0) -> Part:
    """The diffuse part of the principled BSDF: what a colour adds to black, as far as the surface is no metal."""
    dielectric, black = principled(color, roughness), principled(BLACK, roughness)
    return scaled(difference(dielectric, black), 1.0 - metallic)


def lambert(color: Color) -> Part:
    return plugin({"type": "diffuse", "reflectance": rgb(color)})


def dielectric_transmittance(cosine: Array, ior: float) -> Array:
    """Fresnel's transmittance (n, 1) of unpolarised light into a dielectric."""
    inside = np.sqrt(1.0 - (1.0 - cosine**2) / ior**2)
    parallel = (ior * cosine - inside) / (ior * cosine + inside)
    perpendicular = (cosine - ior * inside) / (cosine + ior * inside)
    return np.asarray((1.0 - 0.5 * (parallel**2 + perpendicular**2))[:, np.newaxis])


def under_coat(part: Part, ior: float = 1.5) -> Part:
    """A part under a clear coat that light passes on its way in and out."""
    return lambda i, o: part(i, o) * dielectric_transmittance(i[:, 2], ior) * dielectric_transmittance(o[:, 2], ior)


def half_vector(i: Array, o: Array) -> tuple[Array, Array, Array]:
    """Cosines of theta_half and theta_diff (n,), and the length of omega_in + omega_out (n,)."""
    total = i + o
    length = np.linalg.norm(total, axis=1)
    return np.clip(total[:, 2] / length, 0.0, 1.0), np.clip(length / 2.0, 0.0, 1.0), length


def cos_azimuth(i: Array, o: Array) -> Array:
    across = np.hypot(i[:, 0], i[:, 1]) * np.hypot(o[:, 0], o[:, 1])
    return np.clip((i[:, 0] * o[:, 0] + i[:, 1] * o[:, 1]) / np.maximum(across, 1e-15), -1.0, 1.0)


def oren_nayar(sigma_deg: float, color: Color) -> Part:
    """Oren and Nayar 1994, equations 28 to 30, with light between the facets; sigma is the spread of their slopes."""
    s2, rho = np.radians(sigma_deg) ** 2, np.array(color)

    def values(i: Array, o: Array) -> Array:
        thetas = np.arccos(np.clip(np.stack([i[:, 2], o[:, 2]]), 0.0, 1.0))
        alpha, beta, cos_phi = thetas.max(axis=0), thetas.min(axis=0), cos_azimuth(i, o)
        sine = np.sin(alpha) - np.where(cos_phi < 0.0, (2.0 * beta / np.pi) ** 3, 0.0)
        c1 = 1.0 - 0.5 * s2 / (s2 + 0.33)
        c2 = 0.45 * s2 / (s2 + 0.09) * sine
        c3 = 0.125 * s2 / (s2 + 0.09) * (4.0 * alpha * beta / np.pi**2) ** 2
        once = c1 + cos_phi * c2 * np.tan(beta) + (1.0 - np.abs(cos_phi)) * c3 * np.tan((alpha + beta) / 2.0)
        twice = 0.17 * s2 / (s2 + 0.13) * (1.0 - cos_phi * (2.0 * beta / np.pi) ** 2)
        return np.maximum(rho * once[:, np.newaxis] + rho**2 * twice[:, np.newaxis], 0.0) / np.pi

    return values


def charlie_sheen(alpha: float, color: Color) -> Part:
    """Estevez and Kulla 2017, equations 2 to 4: an inverted Gaussian with its own shadowing."""
    smooth, rough = (25.3245, 3.32435, 0.16801, -1.27393, -4.85967), (21.5473, 3.82987, 0.19823, -1.97760, -4.32054)
    share = (1.0 - alpha) ** 2
    a, b, c, d, e = share * np.array(smooth) + (1.0 - share) * np.array(rough)

    def fall(cosine: Array | float) -> Array:
        return np.asarray(a / (1.0 + b * np.asarray(cosine) ** c) + d * np.asarray(cosine) + e)

    def shadow(cosine: Array) -> Array:
        return np.exp(np.where(cosine < 0.5, fall(cosine), 2.0 * fall(0.5) - fall(1.0 - cosine)))

    def values(i: Array, o: Array) -> Array:
        sine = np.sqrt(1.0 - half_vector(i, o)[0] ** 2)
        slopes = (2.0 + 1.0 / alpha) * sine ** (1.0 / alpha) / (2.0 * np.pi)
        seen = 1.0 / ((1.0 + shadow(i[:, 2]) + shadow(o[:, 2])) * 4.0 * i[:, 2] * o[:, 2])
        return (slopes * seen)[:, np.newaxis] * np.array(color)

    return values


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
        mirror = conductor(self.alpha, distribution=self.distribution)
        return np.asarray(self.specular_values(*pair)[0] / mirror(*pair)[0])


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
    return Material((conductor(alpha, "none", kind, strength),), (ground,), alpha, kind)


def car_paint(coat_alpha: float, alpha: float, flakes: Color, ground: Color, ior: float = 1.5) -> Material:
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
