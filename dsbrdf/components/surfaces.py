"""State the rough surfaces that describe a highlight, and how far the layers of a component are from its values.

A parameter with too large a misfit is None. The 90 % range of a parameter combines three errors of its logarithm as
independent: the spread over probable structures of layers, the uncertainty of the fit, and the misfit, which counts as
an error with 90 % probability.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, stdtr

from dsbrdf.arrays import Array
from dsbrdf.components.layer_data import MODEL_ERROR, Points
from dsbrdf.components.layer_fit import FittedStructure
from dsbrdf.components.layers import GRAZING_ANGLE, Color, LayeredModel, RetroLayer, SpecularLayer, tail_norm
from dsbrdf.components.shares import Range, RgbRange, SurfaceSpread, light_rules

MAX_PEAK_MISFIT = 0.25  # A component whose peak value differs more from its layers has no F0 (relative error).
MAX_COLOR_MISFIT = 0.15  # A component whose colour differs more from its layers has no F0 (relative error).
MAX_WIDTH_MISFIT = 0.3  # A component whose half width differs more from its layers has no alpha (relative error).
MAX_ALBEDO_MISFIT = 0.12  # A component whose albedo differs more from its layers has no F0 (relative error).
_N_COMPARED_ALBEDOS = 2  # The error of the albedo at the third angle of `light_rules` widens ranges only.
_PEAK_THETA_DIFF = np.radians([0.0, 15.0, 30.0, 45.0])
_WIDTH_THETA_DIFF = np.radians(15.0)
_WIDTH_THETA_HALF = np.radians(np.geomspace(0.05, 70.0, 90))
PROFILE: tuple[Array, Array, Array] = (
    np.concatenate([np.zeros(_PEAK_THETA_DIFF.size), _WIDTH_THETA_HALF]),
    np.concatenate([_PEAK_THETA_DIFF, np.full(_WIDTH_THETA_HALF.size, _WIDTH_THETA_DIFF)]),
    np.full(_PEAK_THETA_DIFF.size + _WIDTH_THETA_HALF.size, np.pi / 2),
)
"""Angles theta_half, theta_diff and phi_diff [rad] at which layers are compared with a component's peak and width."""
_PROFILE_POINTS = Points.at(*PROFILE)


@dataclass(frozen=True, eq=False)
class OwnValues:
    """Hold the values of one component.

    Attributes
    ----------
    grid : Array
        Values at the pairs of directions of `dsbrdf.components.layer_data`, (3, N) [1/sr].
    profile : Array
        Values at the angles of `PROFILE`, (3, n) [1/sr].
    albedo : Array
        Directional albedo at the angles of `light_rules`, (3, 3).
    """

    grid: Array
    profile: Array
    albedo: Array


@dataclass(frozen=True)
class Misfit:
    """Measure how far the layers fitted to a component are from the values of the component.

    Attributes
    ----------
    peak : float or None
        Ratio (larger to smaller, minus 1) of the mean values of component and layers at theta_half = 0 and theta_diff
        from 0 to 45 degrees; None for a diffuse part.
    color : float
        Largest difference between component and layers in a channel of the peak, relative to the largest channel; for a
        diffuse part, in a channel of the albedo.
    half_width : float or None
        Ratio (larger to smaller, minus 1) of the angles theta_half at which component and layers fall to half of the
        peak; None for a diffuse part.
    albedo : float
        Largest error of the layers' albedo in any channel at 0 or 45 degrees, relative to the largest albedo.
    """

    peak: float | None
    color: float
    half_width: float | None
    albedo: float

    @classmethod
    def of(cls, own: OwnValues, albedo: Array, model: LayeredModel, *, is_diffuse: bool) -> "Misfit":
        """Compare layers, and their albedo at the angles of `light_rules` (3, 3), with the values of a component."""
        ours, theirs = albedo[:_N_COMPARED_ALBEDOS], own.albedo[:_N_COMPARED_ALBEDOS]
        of_albedo = float(np.abs(ours - theirs).max() / theirs.max())
        if is_diffuse:
            return cls(None, _color_difference(theirs[0], ours[0]), None, of_albedo)
        profiles = model.layer_values(_PROFILE_POINTS).sum(axis=0), own.profile
        peaks = [values[:, : _PEAK_THETA_DIFF.size].mean(axis=1) for values in profiles]
        widths = [_half_width(values[:, _PEAK_THETA_DIFF.size :].sum(axis=0)) for values in profiles]
        return cls(_factor(*(peak.sum() for peak in peaks)), _color_difference(*peaks), _factor(*widths), of_albedo)

    @property
    def withholds_roughness(self) -> bool:
        """Whether the misfit is so large that no roughness describes the component."""
        return self.half_width is not None and self.half_width > MAX_WIDTH_MISFIT

    @property
    def withholds_reflectance(self) -> bool:
        """Whether the misfit is so large that no reflectance describes the component."""
        is_high = self.peak is not None and self.peak > MAX_PEAK_MISFIT
        return is_high or self.color > MAX_COLOR_MISFIT or self.albedo > MAX_ALBEDO_MISFIT

    @property
    def in_words(self) -> Sequence[str]:
        """Words about each misfit that is beyond its threshold, such as "its albedo by 20%"."""
        factors = (("peak", self.peak, MAX_PEAK_MISFIT), ("half width", self.half_width, MAX_WIDTH_MISFIT))
        words = [
            f"its {name} by a factor of {1.0 + off:.2f}"
            for name, off, most in factors
            if off is not None and off > most
        ]
        if self.color > MAX_COLOR_MISFIT:
            words.append(f"its colour by {self.color:.0%} of the brightest channel")
        if self.albedo > MAX_ALBEDO_MISFIT:
            words.append(f"its albedo by {self.albedo:.0%}")
        return words


def albedo_of(model: LayeredModel) -> Array:
    """Return the directional albedo of layers at the angles of `light_rules`, (3, 3)."""
    return np.array([model.layer_values(rule.points).sum(axis=0) @ rule.weight for rule in light_rules()])


def _factor(first: float, second: float) -> float:
    """Return the ratio of the larger to the smaller of two positive numbers, less 1."""
    return float(max(first, second) / max(min(first, second), 1e-300) - 1.0)


def _color_difference(first: Array, second: Array) -> float:
    return float(np.abs(first / max(first.max(), 1e-300) - second / max(second.max(), 1e-300)).max())


def _half_width(values: Array) -> float:
    """Return theta_half at which values at `_WIDTH_THETA_HALF` fall to half of the first value [rad]."""
    below = np.flatnonzero(values < 0.5 * values[0])
    if not below.size:
        return float(_WIDTH_THETA_HALF[-1])
    last = int(below[0])
    return float(np.interp(-0.5 * values[0], -values[last - 1 : last + 1], _WIDTH_THETA_HALF[last - 1 : last + 1]))


_RANGE_HALF_WIDTH_SIGMAS = 1.645  # Within this number of standard deviations are 90 % of a Gaussian.
_MIN_SLOPE_FREEDOM = 1.5  # With 1 degree of freedom or fewer, the mean slope would be infinite.
MAX_RANGE_FACTOR = 2.0
"""If an end of the range of F70 differs from F70 by more than this factor, F70 is None."""


@dataclass(frozen=True)
class Surface:
    """Describe a rough surface of a component; a parameter that the values do not determine is None.

    Attributes
    ----------
    alpha, tail_exponent : float or None
        Roughness, and the exponent of the tails: 2 is GGX, and a larger exponent makes a shorter tail.
    f0, f70 : tuple of float or None
        Reflectance at normal incidence, and at 70 degrees to the facets, RGB.
    alpha_range, f0_range, f70_range : tuple or None
        Intervals with 90 % probability.
    """

    alpha: float | None
    tail_exponent: float | None
    f0: Color | None
    f70: Color | None
    alpha_range: Range | None
    f0_range: RgbRange | None
    f70_range: RgbRange | None


def surfaces_of(
    best: FittedStructure, misfit: Misfit, light_at_70: Array, spread: SurfaceSpread
) -> tuple[Surface, ...]:
    """Return the surfaces of fitted layers, the brightest first; parameters with too large a misfit are None.

    `light_at_70` (3,) is the ratio of the layers' albedo at 70 degrees to the component's albedo.
    """
    covariance = 2.0 * np.linalg.inv(best.normal_equations)
    of_width, of_light = (
        float(np.log1p(off)) / _RANGE_HALF_WIDTH_SIGMAS
        for off in (misfit.half_width or 0.0, max(misfit.albedo, misfit.color))
    )
    of_light_at_70 = np.log(light_at_70) / _RANGE_HALF_WIDTH_SIGMAS
    found = []
    for layer, part in zip(best.model.layers, best.structure.slices, strict=True):
        if not isinstance(layer, SpecularLayer):
            continue
        own = covariance[part, part]
        alpha = alpha_range = f0 = f0_range = f70 = f70_range = None
        if not misfit.withholds_roughness:
            alpha, alpha_range = layer.alpha, _around(layer.alpha, own[6, 6] + spread.alpha**2 + of_width**2)
        if not misfit.withholds_reflectance:
            f0, f0_range = layer.f0, _around_rgb(layer.f0, np.diag(own)[:3] + spread.f0**2 + of_light**2)
            slopes = layer.reflectance_slopes(GRAZING_ANGLE)
            fitted = np.sum(slopes @ own * slopes, axis=1) + MODEL_ERROR**2
            masking = _masking_ratio(layer)
            of_masking = np.log(masking) / _RANGE_HALF_WIDTH_SIGMAS
            red, green, blue = (masking * np.array(layer.reflectance_at(GRAZING_ANGLE))).tolist()
            f70 = red, green, blue
            f70_range = _around_rgb(f70, fitted + spread.f70**2 + of_light_at_70**2 + of_masking**2)
            if any(high > MAX_RANGE_FACTOR**2 * low for low, high in f70_range):
                f70 = f70_range = None
        tail_exponent = None if alpha is None else layer.tail_exponent
        found.append((sum(layer.f0), Surface(alpha, tail_exponent, f0, f70, alpha_range, f0_range, f70_range)))
    return tuple(surface for _, surface in sorted(found, key=lambda pair: -pair[0]))


def _masking_ratio(layer: SpecularLayer) -> float:
    """Return the ratio of GGX's masking, which the layer uses, to Smith's masking of its own distribution of slopes.

    Slopes along one axis have Student's t distribution with 2 tau - 2 degrees of freedom and the scale alpha / sqrt(2).
    """
    own, of_ggx = (
        _smith_lambda(layer.alpha, max(2.0 * exponent - 2.0, _MIN_SLOPE_FREEDOM))
        for exponent in (layer.tail_exponent, 2.0)
    )
    return (1.0 + 2.0 * own) / (1.0 + 2.0 * of_ggx)


def _smith_lambda(alpha: float, freedom: float) -> float:
    """Return Smith's integral over slopes steeper than a direction at `GRAZING_ANGLE`, for Student's t distribution."""
    least = np.sqrt(2.0) / (alpha * np.tan(GRAZING_ANGLE))
    log_norm = gammaln(0.5 * freedom + 0.5) - gammaln(0.5 * freedom) - 0.5 * np.log(freedom * np.pi)
    density = np.exp(log_norm - 0.5 * (freedom + 1.0) * np.log1p(least**2 / freedom))
    mean = density * (freedom + least**2) / (freedom - 1.0)
    return float(mean / least - stdtr(freedom, -least))


def _around(value: float, variance: float) -> Range:
    """Return the 90 % range of a positive value from the variance of its logarithm."""
    factor = float(np.exp(_RANGE_HALF_WIDTH_SIGMAS * np.sqrt(variance)))
    return value / factor, value * factor


def _around_rgb(color: Color, variance: Array) -> RgbRange:
    red, green, blue = (_around(*pair) for pair in zip(color, variance.tolist(), strict=True))
    return red, green, blue


def half_width_of(layers: Sequence[SpecularLayer | RetroLayer]) -> float | None:
    """Return theta_half at which slopes of some layers together are half as frequent as the slope 0 [rad]."""
    if not layers:
        return None
    if len(layers) == 1 or not all(isinstance(layer, SpecularLayer) for layer in layers):
        return max(layers, key=lambda layer: sum(layer.reflectance)).half_width
    low, high = (edge(layer.half_width for layer in layers) for edge in (min, max))
    tangent = np.tan(np.linspace(low, high, 256))
    slopes = np.sum([_slope_density(layer, tangent) for layer in layers], axis=0)
    middle = np.sum([_slope_density(layer, np.zeros(1)) for layer in layers])
    return float(np.interp(-0.5 * middle, -slopes, np.arctan(tangent)))


def _slope_density(layer: SpecularLayer | RetroLayer, tangent: Array) -> Array:
    """Return the frequency of slopes with some tangents (n,), multiplied by the mean reflectance of the layer."""
    exponent = layer.tail_exponent if isinstance(layer, SpecularLayer) else 2.0
    norm = tail_norm(exponent)[0]
    return np.asarray(
        np.mean(layer.reflectance) / layer.alpha**2 * (1.0 + tangent**2 / (norm * layer.alpha**2)) ** -exponent
    )
