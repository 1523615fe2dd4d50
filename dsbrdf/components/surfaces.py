"""State the rough surfaces that describe a highlight: roughness and reflectance, with their 90 % ranges.

The range of a parameter combines three errors of its logarithm as independent: the spread over probable structures of
layers, the uncertainty of the fit, and the misfit, which counts as an error with 90 % probability.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, stdtr

from dsbrdf.arrays import Array
from dsbrdf.components.layer_descent import MODEL_ERROR, FittedStructure
from dsbrdf.components.layers import GRAZING_ANGLE, Color, RetroLayer, SpecularLayer, tail_norm
from dsbrdf.components.misfit import Misfit
from dsbrdf.components.ranges import Range, RgbRange, SurfaceSpread

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
