"""Model physical layers with few parameters: surfaces that reflect light, and diffuse layers that scatter light.

Let u = 1 - cos(theta_diff), let cos_in and cos_out be the cosines of both directions to the normal, and let s(cos) be
the Fresnel reflectance of glass, from 0 at normal to 1 at grazing incidence. A **specular layer** is a surface of
microfacets (Cook and Torrance 1982), whose reflectance rises as that of glass or by the law of Schlick (1994),

    f = (F0 (1 - S) + F90 S) exp(q1 u + q2 u**2) D V T**t,    S = (1 - m) s(cos(theta_diff)) + m u**5,
    D = 1 / (pi alpha**2) (1 + tan(theta_half)**2 / (g alpha**2))**-tau / cos(theta_half)**4.

D is Student's t distribution of slopes with the exponent tau, normalised by g = tau - 1: tau = 2 is GGX (Walter 2007),
and a large tau is Beckmann's distribution, both with their usual alpha. V is GGX's Smith masking divided by 4 cos_in
cos_out; b = 0 is its height-correlated form, and b = 1 its separable form. T is the fraction of light that passes a
clear coat both ways; t is 1 for a layer below a coat, and otherwise 0. A coat of index n = 1.5 also refracts the light,
by Snell's law. Let below_in and below_out be n times the cosines of both refracted directions to the normal. Then
tan(theta_half)**2 is multiplied by the power r of ((cos_in + cos_out) / (below_in + below_out))**2, f by the power r of
cos_in cos_out / (below_in below_out), and alpha by n**-r: alpha remains the roughness that is seen at normal incidence.
r is 1 for a smooth coat, and 0 without refraction. A **turning layer** is a specular layer times exp(a
sin(theta_half)**2 + b u), where the channels of a and of b sum to 0. A **diffuse layer** is

    f = rho / pi exp(p . X),

where rho is the colour and p are six exponents. The six terms X are the logarithm of (1 - s(cos_in)) (1 - s(cos_out)),
the fraction of light that passes glass both ways; Burley's retro-reflection (2012); s; log(2 / (cos_in + cos_out));
sin(theta_half)**2; and the angular term of Oren and Nayar (1994). **Sheen**, light that fibres reflect at grazing
angles, is ``f = c u**a sin(theta_half)**b``, with u = 1 - cos(theta_diff) as above. A **retro layer** reflects like a
GGX surface about the direction back to the light.

In a fit, the unknowns of a layer are the logarithms of the three channels of its colour, then its other parameters.
Positive parameters are replaced by their logarithms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.components.points import COAT_F0, COAT_INDEX, Points, fresnel_rise, grid_points
from dsbrdf.model.reflectance import RenderableModel

Color: TypeAlias = tuple[float, float, float]
# These are two orthonormal differences between the channels of a log colour.
CONTRASTS = np.array([[3.0, -3.0, 0.0], [1.0, 1.0, -2.0]]) / np.sqrt([[18.0], [6.0]])
N_TURNS = 4  # The colours a and b of a turning layer have both contrasts as unknowns.
ALPHA_INDEX = 7  # Log alpha has this index among the unknowns of a specular layer.
GRAZING_ANGLE = float(np.radians(70.0))
"""Grazing reflectance is stated at this theta_diff [rad], because many measurements are wrong at larger angles."""


class Linearized(NamedTuple):
    """The values of a layer at N points, and the derivatives of the values in the layer's unknowns."""

    values: Array  # values at the points, (3, N) [1/sr]
    own: Array  # derivative of the values of a channel in the logarithm of its colour, (3, N) [1/sr]
    relative: Callable[[], Array]  # returns derivatives of log values in the last P unknowns, (P, N) or (3, P, N)
    others: tuple[Array, ...] = ()  # derivatives in the unknowns between them, each (N,) or (3, N) [1/sr]


@dataclass(frozen=True)
class SpecularLayer:
    """Reflect light from a rough surface, by the equation of a specular layer in the module's docstring.

    Attributes
    ----------
    f0 : tuple of float
        Reflectance of the facets at normal incidence, RGB.
    f90 : float
        Reflectance of the facets at grazing incidence, before it is multiplied by exp(q1 + q2).
    alpha, tail_exponent : float
        Roughness, and the exponent tau of the tails: 2 is GGX, and a smaller exponent makes a longer tail.
    rise : tuple of float
        Exponents q1 and q2, by which the reflectance of a metal deviates from the law of a dielectric.
    masking, under_coat, refraction : float
        Exponents b of the masking, t of the light that passes a coat, and r of the refraction by a coat.
    schlick : float
        Part m of the rise of the reflectance that follows Schlick's law; the rest is that of glass.
    """

    f0: Color
    f90: float
    alpha: float
    tail_exponent: float
    rise: tuple[float, float]
    masking: float
    under_coat: float = 0.0
    refraction: float = 0.0
    schlick: float = 0.0

    @classmethod
    def from_unknowns(cls, unknowns: Array) -> SpecularLayer:
        """Make a layer from the array (12,) of its unknowns."""
        red, green, blue, f90, alpha, tail_exponent = np.exp(unknowns[[0, 1, 2, 3, 7, 8]]).tolist()
        schlick, q1, q2, masking, under_coat, refraction = unknowns[[4, 5, 6, 9, 10, 11]].tolist()
        return cls((red, green, blue), f90, alpha, tail_exponent, (q1, q2), masking, under_coat, refraction, schlick)

    @property
    def reflectance(self) -> Array:
        """F0 reduced by the light that a coat above the layer does not let pass, RGB, shape (3,)."""
        return np.array(self.f0) * (1.0 - COAT_F0) ** (2.0 * self.under_coat)

    def reflectance_at(self, theta_diff: float) -> Color:
        """Return the reflectance of the facets at an angle of incidence [rad], RGB."""
        u, f0, (risen, _) = 1.0 - np.cos(theta_diff), np.array(self.f0), self._rise_at(theta_diff)
        red, green, blue = ((f0 + (self.f90 - f0) * risen) * np.exp(self.rise[0] * u + self.rise[1] * u**2)).tolist()
        return red, green, blue

    def reflectance_slopes(self, theta_diff: float) -> Array:
        """Return the derivatives of the logarithm of `reflectance_at` in the layer's unknowns, (channels, 12)."""
        u, f0, (risen, to_schlick) = 1.0 - np.cos(theta_diff), np.array(self.f0), self._rise_at(theta_diff)
        total = f0 + (self.f90 - f0) * risen
        of_color, others = np.diag(f0 * (1.0 - risen) / total), np.tile([u, u**2, 0.0, 0.0, 0.0, 0.0, 0.0], (3, 1))
        return np.column_stack([of_color, self.f90 * risen / total, (self.f90 - f0) * to_schlick / total, others])

    def _rise_at(self, theta_diff: float) -> tuple[float, float]:
        """Return S in the equation of a specular layer, and its derivative in m."""
        cosine, glass = float(np.cos(theta_diff)), float(fresnel_rise(np.cos(theta_diff)))
        return glass + self.schlick * ((1.0 - cosine) ** 5 - glass), (1.0 - cosine) ** 5 - glass

    @property
    def half_width(self) -> float:
        """Angle theta_half at which slopes of the facets are half as frequent as the slope 0 [rad]."""
        falling = 2.0 ** (1.0 / self.tail_exponent) - 1.0
        return float(np.arctan(self.alpha * np.sqrt(tail_norm(self.tail_exponent)[0] * falling)))

    @property
    def unknowns(self) -> Array:
        """Array (12,) of the unknowns of the layer."""
        logs = np.log([*self.f0, self.f90, self.alpha, self.tail_exponent])
        return np.array(
            [*logs[:4], self.schlick, *self.rise, *logs[4:], self.masking, self.under_coat, self.refraction]
        )

    @classmethod
    def linearize(cls, points: Points, unknowns: Array) -> Linearized:
        """Return the values of a layer at points, and the derivatives of the values in its unknowns."""
        surface = _Surface(points, float(np.exp(unknowns[7])), float(np.exp(unknowns[8])), float(unknowns[11]))
        (schlick, masking), f0, f90 = unknowns[[4, 9]], np.exp(unknowns[:3, np.newaxis]), np.exp(unknowns[3])
        shape = np.exp(surface.log_shape(masking) + unknowns[5:7] @ points.rise + unknowns[10] * points.passed)
        risen = points.fresnel + schlick * points.to_schlick
        own, grazing = f0 * (shape * (1.0 - risen)), f90 * shape * risen

        def relative() -> Array:
            *of_shape, by_refraction = surface.derivatives(masking)
            return np.array([*points.rise, *of_shape, points.passed, by_refraction])

        return Linearized(own + grazing, own, relative, (grazing, (f90 - f0) * (shape * points.to_schlick)))


@dataclass(frozen=True)
class TurningLayer(SpecularLayer):
    """Reflect light from a rough surface whose colour turns with the angles, as of interference pigments.

    Attributes
    ----------
    turn : tuple of tuple of float
        Colours a and b in the module's equation of a turning layer, RGB.
    """

    turn: tuple[Color, Color] = field(kw_only=True)

    @classmethod
    def from_unknowns(cls, unknowns: Array) -> TurningLayer:
        """Make a layer from the array (16,) of its unknowns."""
        first, second = ((red, green, blue) for red, green, blue in (unknowns[12:].reshape(2, 2) @ CONTRASTS).tolist())
        return cls(**vars(SpecularLayer.from_unknowns(unknowns[:12])), turn=(first, second))

    @property
    def unknowns(self) -> Array:
        """Array (16,) of the unknowns of the layer."""
        return np.concatenate([super().unknowns, (np.array(self.turn) @ CONTRASTS.T).ravel()])

    @classmethod
    def linearize(cls, points: Points, unknowns: Array) -> Linearized:
        """Return the values of a layer at points, and the derivatives of the values in its unknowns."""
        plain = SpecularLayer.linearize(points, unknowns[:12])
        turns = np.concatenate([CONTRASTS[:, :, np.newaxis] * angle for angle in (points.ground[4], points.rise[0])])
        factor = np.exp(np.tensordot(unknowns[12:], turns, 1))

        def relative() -> Array:
            of_all = plain.relative()
            return np.concatenate([np.broadcast_to(of_all, (3, *of_all.shape)), turns.swapaxes(0, 1)], axis=1)

        others = tuple(other * factor for other in plain.others)
        return Linearized(plain.values * factor, plain.own * factor, relative, others)


class _Surface:
    """Evaluate the logarithm of D V, the distribution times the masking of a specular layer, and its derivatives."""

    def __init__(self, points: Points, alpha: float, tail_exponent: float, refraction: float = 0.0) -> None:
        self._points, self._exponent, self._refraction = points, tail_exponent, refraction
        self._square = square = (alpha / COAT_INDEX**refraction) ** 2
        self._seen = np.sqrt(1.0 - (1.0 - square) * points.squared_sines)
        self._together = np.sum(points.cosines[::-1] * self._seen, axis=0)
        self._apart = points.cosines + self._seen
        self._by_masking = np.log(2.0 * self._together / (self._apart[0] * self._apart[1]))
        self._norm, self._norm_slope = tail_norm(tail_exponent)
        self._squared_tangent = points.squared_tangent * np.exp(refraction * points.below_coat[0])
        self._slope = self._squared_tangent / (self._norm * square)
        self._tail = np.log1p(self._slope)

    def log_shape(self, masking: float) -> Array:
        norm = 1.0 / (2.0 * np.pi * self._square)
        tails = 2.0 * np.log1p(self._squared_tangent) - self._exponent * self._tail
        refracted = self._refraction * self._points.below_coat[1]
        return np.asarray(tails + np.log(norm / self._together) + masking * self._by_masking + refracted)

    def derivatives(self, masking: float) -> tuple[Array, Array, Array, Array]:
        """Return the derivatives of `log_shape` in log alpha, log tau, and the exponents of masking and refraction."""
        points, pulled = self._points, self._exponent * self._slope / (1.0 + self._slope)
        by_seen = self._square * points.squared_sines / self._seen
        together = -np.sum(points.cosines[::-1] * by_seen, axis=0) / self._together
        apart = -(by_seen / self._apart).sum(axis=0)
        by_alpha = 2.0 * (pulled - 1.0) + together + masking * (apart - together)
        by_tail = self._exponent * (self._norm_slope / self._norm * pulled - self._tail)
        by_tangent = 2.0 * self._squared_tangent / (1.0 + self._squared_tangent) - pulled
        by_refraction = by_tangent * points.below_coat[0] + points.below_coat[1] - np.log(COAT_INDEX) * by_alpha
        return by_alpha, by_tail, self._by_masking, by_refraction


def tail_norm(tail_exponent: float) -> tuple[float, float]:
    """Return the norm g of the distribution of slopes and its derivative; g is a smooth, positive form of tau - 1."""
    x = 8.0 * (tail_exponent - 1.125)
    return float(0.125 + np.logaddexp(0.0, x) / 8.0), float(1.0 / (1.0 + np.exp(-x)))


@dataclass(frozen=True)
class DiffuseLayer:
    """Scatter light diffusely, with the colour rho and the exponents p in the module's equation of a diffuse layer."""

    albedo: Color
    exponents: tuple[float, float, float, float, float, float]

    @classmethod
    def from_unknowns(cls, unknowns: Array) -> DiffuseLayer:
        """Make a layer from the array (9,) of its unknowns."""
        red, green, blue = np.exp(unknowns[:3]).tolist()
        first, second, third, fourth, fifth, sixth = unknowns[3:].tolist()
        return cls((red, green, blue), (first, second, third, fourth, fifth, sixth))

    @property
    def unknowns(self) -> Array:
        """Array (9,) of the unknowns of the layer."""
        return np.array([*np.log(self.albedo), *self.exponents])

    @classmethod
    def linearize(cls, points: Points, unknowns: Array) -> Linearized:
        """Return the values of a layer at points, and the derivatives of the values in its unknowns."""
        return _powers(points.ground, unknowns, 1.0 / np.pi)


@dataclass(frozen=True)
class SheenLayer:
    """Reflect light of fibres at grazing angles; colour c and powers a and b belong to the module's sheen equation."""

    color: Color
    powers: tuple[float, float]

    @classmethod
    def from_unknowns(cls, unknowns: Array) -> SheenLayer:
        """Make a layer from the array (5,) of its unknowns."""
        red, green, blue = np.exp(unknowns[:3]).tolist()
        first, second = unknowns[3:].tolist()
        return cls((red, green, blue), (first, second))

    @property
    def unknowns(self) -> Array:
        """Array (5,) of the unknowns of the layer."""
        return np.array([*np.log(self.color), *self.powers])

    @classmethod
    def linearize(cls, points: Points, unknowns: Array) -> Linearized:
        """Return the values of a layer at points, and the derivatives of the values in its unknowns."""
        return _powers(points.fibres, unknowns, 1.0)


def _powers(features: Array, unknowns: Array, scale: float) -> Linearized:
    values = np.exp(unknowns[:3])[:, np.newaxis] * (scale * np.exp(unknowns[3:] @ features))
    return Linearized(values, values, lambda: features)


@dataclass(frozen=True)
class RetroLayer:
    """Reflect light back towards its source, with a colour and a roughness about this direction."""

    color: Color
    alpha: float

    @classmethod
    def from_unknowns(cls, unknowns: Array) -> RetroLayer:
        """Make a layer from the array (4,) of its unknowns."""
        red, green, blue, alpha = np.exp(unknowns).tolist()
        return cls((red, green, blue), alpha)

    @property
    def reflectance(self) -> Array:
        """The colour of the layer as an array, RGB, shape (3,)."""
        return np.array(self.color)

    @property
    def half_width(self) -> float:
        """Half width of the reflection about the direction back to the light [rad], see `SpecularLayer.half_width`."""
        return float(np.arctan(self.alpha * np.sqrt(np.sqrt(2.0) - 1.0)))

    @property
    def unknowns(self) -> Array:
        """Array (4,) of the unknowns of the layer."""
        return np.log([*self.color, self.alpha])

    @classmethod
    def linearize(cls, points: Points, unknowns: Array) -> Linearized:
        """Return the values of a layer at points, and the derivatives of the values in its unknowns."""
        surface = _Surface(points._replace(squared_tangent=points.squared_retro), float(np.exp(unknowns[3])), 2.0)
        values = np.exp(unknowns[:3])[:, np.newaxis] * np.exp(surface.log_shape(0.0))
        return Linearized(values, values, lambda: surface.derivatives(0.0)[0][np.newaxis])


Layer: TypeAlias = SpecularLayer | TurningLayer | DiffuseLayer | SheenLayer | RetroLayer


@dataclass(frozen=True)
class LayeredModel(RenderableModel):
    """Sum some layers: evaluate, sample and render a material with about 30 parameters."""

    layers: tuple[Layer, ...]

    def __repr__(self) -> str:
        return f"<LayeredModel: {len(self.layers)} layers, {self.n_numbers} numbers>"

    @property
    def n_numbers(self) -> int:
        """Number of parameters of all layers."""
        return sum(layer.unknowns.size for layer in self.layers)

    def layer_values(self, points: Points) -> Array:
        """Return the values (layers, 3, N) of each layer [1/sr]."""
        values = [one.linearize(points, one.unknowns).values for one in self.layers]
        return np.array(values).reshape(len(self.layers), 3, points.fresnel.size)

    def evaluate_unmasked(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return values (n, 3) [1/sr] at angles (n,) that are not checked, also for directions below the horizon."""
        return self.layer_values(Points.at(theta_half, theta_diff, phi_diff)).sum(axis=0).T

    def evaluate_grid(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Iterator[Array]:
        """Yield for each theta_diff the values (3, H, P) [1/sr] at all pairs of theta_half (H,) and phi_diff (P,)."""
        for points in grid_points(theta_half, theta_diff, phi_diff):
            yield self.layer_values(points).sum(axis=0).reshape(3, theta_half.size, phi_diff.size)
