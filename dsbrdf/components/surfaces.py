"""State the rough surfaces that describe a highlight, and how far the layers of a component are from its values.

A parameter with too large a misfit is None. The 90 % range of a parameter combines several errors of its logarithm as
independent: the spread over probable structures of layers, the light that may belong to another component, the
uncertainty of the fit, the error of the fitted layers, and the misfit, which counts as an error with 90 % probability.
Where two surfaces describe a component, some light of each may belong to the other.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, stdtr

from dsbrdf.arrays import Array
from dsbrdf.components.layer_data import MODEL_ERROR, half_of_peak
from dsbrdf.components.layer_fit import FittedStructure
from dsbrdf.components.layers import (
    ALPHA_INDEX,
    GRAZING_ANGLE,
    Color,
    LayeredModel,
    RetroLayer,
    SpecularLayer,
    tail_norm,
)
from dsbrdf.components.points import Points, light_rules
from dsbrdf.components.shares import RANGE_HALF_WIDTH_SIGMAS, Range, RgbRange, SurfaceSpread

MAX_PEAK_MISFIT = 0.25  # A component whose peak value differs more from its layers has no F0 (relative error).
MAX_COLOR_MISFIT = 0.15  # A component whose colour differs more from its layers has no F0 (relative error).
MAX_WIDTH_MISFIT = 0.3  # A component has no alpha if the half width of its layers is wrong by a larger fraction.
MAX_ALBEDO_MISFIT = 0.12  # A component whose albedo differs more from its layers has no F0 (relative error).
_MAX_LOG_FACTOR = 200.0  # A factor between a value and an end of its range is at most e to this power, and so finite.
_N_COMPARED_ALBEDOS = 2  # The error of the albedo at the third angle of `light_rules` widens ranges only.
_PEAK_THETA_DIFF = np.radians([0.0, 15.0, 30.0, 45.0])
_WIDTH_THETA_DIFF = np.radians(15.0)
WIDTH_THETA_HALF = np.radians(np.geomspace(0.05, 70.0, 90))
PROFILE: tuple[Array, Array, Array] = (
    np.concatenate([np.zeros(_PEAK_THETA_DIFF.size), WIDTH_THETA_HALF]),
    np.concatenate([_PEAK_THETA_DIFF, np.full(WIDTH_THETA_HALF.size, _WIDTH_THETA_DIFF)]),
    np.full(_PEAK_THETA_DIFF.size + WIDTH_THETA_HALF.size, np.pi / 2),
)
"""Angles theta_half, theta_diff and phi_diff [rad] at which layers are compared with a component's peak and width."""
_PROFILE_POINTS = Points.at(*PROFILE)


@dataclass(frozen=True, eq=False)
class OwnValues:
    """The values of one component.

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
        wide = [values[:, _PEAK_THETA_DIFF.size :].sum(axis=0) for values in profiles]
        widths = [half_of_peak(values, WIDTH_THETA_HALF) for values in wide]
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


_MIN_SLOPE_FREEDOM = 1.5  # With 1 degree of freedom or fewer, the mean slope would be infinite.
MIN_ALPHA_RATIO = 1.3
"""Two surfaces with a smaller ratio of roughness count as one surface."""
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
    best: FittedStructure, misfit: Misfit, own: OwnValues, albedo: Array, spread: SurfaceSpread
) -> tuple[Surface, ...]:
    """Return the surfaces of fitted layers, the brightest first; parameters with too large a misfit are None.

    `own` has the values of the component, and `albedo` (3, 3) is the layers' albedo at the angles of `light_rules`. Two
    layers of nearly one roughness are stated as one surface.
    """
    peak = best.model.layer_values(_PROFILE_POINTS).sum(axis=0)[:, 0]
    of_peak, of_light_at_70 = (
        np.log(np.maximum(layers, 1e-300) / np.maximum(values, 1e-300)) / RANGE_HALF_WIDTH_SIGMAS
        for layers, values in ((peak, own.profile[:, 0]), (albedo[-1], own.albedo[-1]))
    )
    of_width, of_light = (
        float(np.log1p(off)) / RANGE_HALF_WIDTH_SIGMAS
        for off in (misfit.half_width or 0.0, max(misfit.albedo, misfit.color))
    )
    # A surface's reflectance is its peak times the square of its width, so it misses twice what its width misses.
    of_fit = MODEL_ERROR**2 + (2.0 * best.error) ** 2 + (2.0 * of_width) ** 2
    of_alpha = MODEL_ERROR**2 + spread.alpha**2 + of_width**2
    of_f0 = of_fit + of_light**2 + spread.f0**2 + of_peak**2
    of_f70 = of_fit + of_light**2 + spread.f70**2 + of_light_at_70**2
    covariance = 2.0 * np.linalg.inv(best.normal_equations)
    unknowns = np.arange(best.unknowns.size)
    layers = [
        (layer, unknowns[part])
        for layer, part in zip(best.model.layers, best.structure.slices, strict=True)
        if isinstance(layer, SpecularLayer)
    ]
    alphas = [layer.alpha for layer, _ in layers]
    groups = [layers] if alphas and max(alphas) < MIN_ALPHA_RATIO * min(alphas) else [[one] for one in layers]
    found = []
    for group in groups:
        places = np.concatenate([own_places for _, own_places in group])
        together = [layer for layer, _ in group]
        shared = [_variance_of_shared_light(together[0], other) for other, _ in layers if other not in together]
        ratio, light = np.sum([(0.0, 0.0), *shared], axis=0).tolist()
        variances = of_alpha + ratio, of_f0 + light, of_f70 + light
        surface = _surface(together, covariance[places[:, np.newaxis], places], *variances, misfit)
        found.append((sum(sum(layer.f0) for layer in together), surface))
    return tuple(surface for _, surface in sorted(found, key=lambda pair: -pair[0]))


def _variance_of_shared_light(surface: SpecularLayer, other: SpecularLayer) -> tuple[float, float]:
    """Return variances of log alpha and log F0 of a surface, because light of another surface may belong to it.

    The doubtful fraction of the other's light is the overlap of both distributions of slopes, 1 for an equal roughness.
    """
    ratio = other.alpha / surface.alpha
    doubtful = (2.0 * ratio / (1.0 + ratio**2)) ** 2 * sum(other.f0) / sum(surface.f0)
    alpha, light = (np.array([np.log(ratio) * doubtful / (1.0 + doubtful), np.log1p(doubtful)]) ** 2).tolist()
    return alpha / RANGE_HALF_WIDTH_SIGMAS**2, light / RANGE_HALF_WIDTH_SIGMAS**2


def _surface(
    layers: Sequence[SpecularLayer], covariance: Array, of_alpha: float, of_f0: Array, of_f70: Array, misfit: Misfit
) -> Surface:
    """Describe the layers of a highlight as one surface.

    `covariance` belongs to the layers' unknowns. The next arguments are further variances of the logarithms of alpha,
    F0 and F70; a large misfit withholds parameters.
    """
    alpha = alpha_range = tail_exponent = f0 = f0_range = f70 = f70_range = None
    f0_sum, variance = _reflectance(layers, covariance, 0.0)
    if not misfit.withholds_roughness:
        weight = np.array([np.mean(layer.f0 / f0_sum) for layer in layers])
        alpha = float(np.exp(weight @ np.log([layer.alpha for layer in layers]) / weight.sum()))
        tail_exponent = layers[int(weight.argmax())].tail_exponent
        places = ALPHA_INDEX + layers[0].unknowns.size * np.arange(len(layers))
        alpha_range = _around(alpha, float(weight @ covariance[np.ix_(places, places)] @ weight) + of_alpha)
    if not misfit.withholds_reflectance:
        f0, f0_range = _stated(f0_sum, variance + of_f0)
        masking = np.array([_masking_ratio(layer) for layer in layers])
        f70_sum, variance = _reflectance(layers, covariance, GRAZING_ANGLE, masking)
        of_masking = np.log(masking.max()) / RANGE_HALF_WIDTH_SIGMAS
        f70, f70_range = _stated(f70_sum, variance + of_f70 + of_masking**2)
        if any(high > MAX_RANGE_FACTOR**2 * low for low, high in f70_range):
            f70 = f70_range = None
    return Surface(alpha, tail_exponent, f0, f70, alpha_range, f0_range, f70_range)


def _reflectance(
    layers: Sequence[SpecularLayer], covariance: Array, theta_diff: float, factors: Array | float = 1.0
) -> tuple[Array, Array]:
    """Return the sum of the layers' reflectance times some factors, RGB, and the variance of its logarithm."""
    each = np.array([layer.reflectance_at(theta_diff) for layer in layers]) * np.reshape(factors, (-1, 1))
    total = each.sum(axis=0)
    parts = zip(layers, each / total, strict=True)
    slopes = np.hstack([part[:, np.newaxis] * layer.reflectance_slopes(theta_diff) for layer, part in parts])
    return total, np.sum(slopes @ covariance * slopes, axis=1)


def _stated(color: Array, variance: Array) -> tuple[Color, RgbRange]:
    """Return a colour and its 90 % ranges from the variance of its logarithm."""
    red, green, blue = color.tolist()
    low, middle, high = (_around(*pair) for pair in zip(color.tolist(), variance.tolist(), strict=True))
    return (red, green, blue), (low, middle, high)


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
    factor = float(np.exp(min(RANGE_HALF_WIDTH_SIGMAS * np.sqrt(variance), _MAX_LOG_FACTOR)))
    return value / factor, value * factor


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
