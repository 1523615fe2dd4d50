"""Evaluate the OpenPBR surface model 1.1 for opaque materials, a rough base under a clear coat.

    f = coat + (1 - A_coat) darkening (metalness metal + (1 - metalness) (specular + (1 - A_specular) diffuse)),

where each A is the directional albedo of the part named in its index.
The formulas are from the shaders in the MaterialX library, which most programs use: GGX with height-correlated masking,
Turquin's compensation of multiple scattering, Fresnel's equations for the dielectrics, the F82 tint for the metal, and
layers dimmed by a rational fit of the directional albedo of the layer above. Transmission, subsurface, fuzz, thin film,
anisotropy and roughness of the diffuse part are left out, because the fit in `dsbrdf.output.export.materialx` does not
use these features.

The amount by which a layer dims the layers below depends on the view direction (omega_out) only, so that OpenPBR is not
quite reciprocal.
"""

from dataclasses import dataclass

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.components.layers import Color
from dsbrdf.data.geometry import incident_cosines

_MIN_COSINE_OR_ALPHA = 1e-6  # Cosines and the roughness alpha are clipped at this minimum, because they are divisors.
_F82_COSINE = 1.0 / 7.0
# The directional albedo of GGX is F0 p1 / p3 + F90 p2 / p4, where p1 to p4 are polynomials in the cosine x and alpha y.
# Each column has the coefficients of one polynomial, for the terms 1, x, y, xy, xx, yy, xxy, xyy, xxyy.
_ALBEDO_COEFFICIENTS = np.array(
    [
        [0.1003, 0.9345, 1.0, 1.0],
        [-0.6303, -2.323, -1.765, 0.2281],
        [9.748, 2.229, 8.263, 15.94],
        [-2.038, -3.748, 11.53, -55.83],
        [29.34, 1.424, 28.96, 13.08],
        [-8.245, -0.7684, -7.507, 41.26],
        [-26.44, 1.436, -36.11, 54.9],
        [19.99, 0.2913, 15.86, 300.2],
        [-5.448, 0.6286, 33.37, -285.1],
    ]
)


@dataclass(frozen=True)
class OpenPBR:
    """Inputs of an OpenPBR surface; all inputs except the indices of refraction (ior) are from 0 to 1."""

    base_color: Color = (0.8, 0.8, 0.8)  # linear RGB of the diffuse part or of the metal
    base_metalness: float = 0.0
    specular_color: Color = (1.0, 1.0, 1.0)  # linear RGB of the highlight or of the metal's edge
    specular_roughness: float = 0.3
    specular_ior: float = 1.5
    coat_weight: float = 0.0
    coat_roughness: float = 0.0
    coat_ior: float = 1.6

    def evaluate(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return BRDF values (n, 3) [1/sr] at angles (n,) [rad]; 0 below the horizon."""
        cos_in, cos_out = incident_cosines(theta_half, theta_diff, phi_diff)
        above = ((cos_in > 0.0) & (cos_out > 0.0))[:, None]
        half = np.cos(theta_half)[:, None]
        others = (
            np.clip(cosine, _MIN_COSINE_OR_ALPHA, 1.0)[:, None] for cosine in (np.cos(theta_diff), cos_in, cos_out)
        )
        cosines = (half, *others)
        color, tint = np.array(self.base_color), np.array(self.specular_color)
        rough = _Facets.of(self._base_roughness**2, *cosines)
        highlight, passed = rough.dielectric(self._base_index, 1.0)
        dielectric = highlight * tint + passed * color / np.pi
        base = self._darkening * (
            self.base_metalness * rough.metal(color, tint) + (1.0 - self.base_metalness) * dielectric
        )
        coat, passed = _Facets.of(self.coat_roughness**2, *cosines).dielectric(self.coat_ior, self.coat_weight)
        return np.where(above, coat + passed * base, 0.0)

    @property
    def _base_roughness(self) -> float:
        """Roughness of the base as seen through the coat."""
        rougher = min(1.0, 2.0 * self.coat_roughness**4 + self.specular_roughness**4) ** 0.25
        return self.coat_weight * rougher + (1.0 - self.coat_weight) * self.specular_roughness

    @property
    def _base_index(self) -> float:
        """Index of refraction of the base relative to the coat, at least 1."""
        inside = self.coat_ior / self.specular_ior
        index = self.coat_weight * inside + (1.0 - self.coat_weight) * self.specular_ior
        return max(index, 1.0 / index)

    @property
    def _darkening(self) -> Array:
        """Fraction of the light from the base that remains after reflections inside the coat."""
        inner = 1.0 - (1.0 - _normal_reflectance(self.coat_ior)) / self.coat_ior**2
        dimmed = (1.0 - inner) / (1.0 - np.array(self.base_color) * inner)
        return np.asarray(self.coat_weight * dimmed + 1.0 - self.coat_weight)


@dataclass(frozen=True, eq=False)
class _Facets:
    """Rough boundary: cos(theta_diff), value without Fresnel term, and factors of F0 and F90 in its albedo."""

    diff: Array
    value: Array
    to_normal: Array
    to_grazing: Array

    @classmethod
    def of(cls, alpha: float, half: Array, diff: Array, incident: Array, view: Array) -> "_Facets":
        """Make GGX microfacets of the roughness `alpha` for pairs of directions with given cosines, each (n, 1)."""
        alpha = max(alpha, _MIN_COSINE_OR_ALPHA)
        square = alpha**2
        tangent2 = (1.0 - half**2) / square
        distribution = 1.0 / (np.pi * square * (tangent2 + half**2) ** 2)
        to_light = np.sqrt(square + (1.0 - square) * incident**2)
        to_view = np.sqrt(square + (1.0 - square) * view**2)
        value = 0.5 * distribution / (to_light * view + to_view * incident)
        of_alpha = np.array([1.0, alpha, square])
        constant, linear, quadratic = (
            of_alpha @ _ALBEDO_COEFFICIENTS[rows] for rows in ([0, 2, 5], [1, 3, 7], [4, 6, 8])
        )
        first, second, below, under = ((constant + view * (linear + view * quadratic)).T)[..., None]
        return cls(diff, value, np.clip(first / below, 0.0, 1.0), np.clip(second / under, 0.0, 1.0))

    def dielectric(self, index: float, weight: float) -> tuple[Array, Array]:
        """Return values (n, 1) of a dielectric boundary, and the fraction of light that passes it."""
        fresnel = _fresnel(self.diff, index)
        compensation = self._compensation(fresnel)
        albedo = (_normal_reflectance(index) * self.to_normal + self.to_grazing) * compensation
        return self.value * fresnel * compensation * weight, 1.0 - albedo * weight

    def metal(self, color: Array, tint: Array) -> Array:
        """Return values (n, 3) of a metal with a colour at normal incidence and a tint at 82 degrees."""
        at_82 = color + (1.0 - color) * (1.0 - _F82_COSINE) ** 5
        slope = at_82 * (1.0 - tint) / (_F82_COSINE * (1.0 - _F82_COSINE) ** 6)
        rest = 1.0 - self.diff
        fresnel = color + (1.0 - color) * rest**5 - slope * self.diff * rest**6
        return self.value * fresnel * self._compensation(fresnel)

    def _compensation(self, fresnel: Array) -> Array:
        """Return the factor by which light that is reflected more than once increases the values."""
        once = self.to_normal + self.to_grazing
        return 1.0 + fresnel * (1.0 - once) / once


def _normal_reflectance(index: float) -> float:
    return ((index - 1.0) / (index + 1.0)) ** 2


def _fresnel(cosine: Array, index: float) -> Array:
    g = np.sqrt(np.maximum(index**2 + cosine**2 - 1.0, 0.0))
    parallel = ((g + cosine) * cosine - 1.0) / ((g - cosine) * cosine + 1.0)
    return 0.5 * ((g - cosine) / (g + cosine)) ** 2 * (1.0 + parallel**2)
