"""Describe a component by the parameters of layers fitted to its own values.

The decomposition uses strong priors on usual materials to assign light to components. Parameters are then estimated
from a component's own values: layers of any colour, with weak priors, are fitted to these values. A highlight has up
to two surfaces, and a diffuse part has a diffuse layer with or without sheen. The misfit is the distance of these
layers from the component; a parameter with too large a misfit is None.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.components.layer_data import component_data, peak_half_width, renderer_data
from dsbrdf.components.layer_fit import FittedStructure, fit_structures, refined
from dsbrdf.components.layers import (
    Color,
    DiffuseLayer,
    LayeredModel,
    RetroLayer,
    SheenLayer,
    SpecularLayer,
    tail_norm,
)
from dsbrdf.components.points import Points
from dsbrdf.components.ranges import Range, RgbRange, SurfaceSpread
from dsbrdf.components.shares import light_rules
from dsbrdf.components.structures import OWN_PRIORS, LayerStructure

MAX_PEAK_MISFIT = 0.25  # Beyond this misfit, reflectance is withheld.
MAX_COLOR_MISFIT = 0.15  # Beyond this misfit, reflectance is withheld.
MAX_WIDTH_MISFIT = 0.3  # Beyond this misfit, roughness is withheld.
MAX_ALBEDO_MISFIT = 0.12  # Beyond this misfit, reflectance is withheld.
_SECOND_SURFACE_COST = 40.0  # A second surface is kept only if it lowers the cost by more.
_MIN_ALPHA_RATIO = 1.3  # Two surfaces with a smaller ratio of roughness count as one surface.
_RANGE_HALF_WIDTH_SIGMAS = 1.645  # This half width in standard deviations holds 90 % of a Gaussian.
_MAX_START_HALF_WIDTH = np.radians(35.0)
_PEAK_THETA_DIFF = np.radians([0.0, 15.0, 30.0, 45.0])
_WIDTH_THETA_DIFF = np.radians(15.0)
_WIDTH_THETA_HALF = np.radians(np.geomspace(0.05, 70.0, 90))
PROFILE: tuple[Array, Array, Array] = (
    np.concatenate([np.zeros(_PEAK_THETA_DIFF.size), _WIDTH_THETA_HALF]),
    np.concatenate([_PEAK_THETA_DIFF, np.full(_WIDTH_THETA_HALF.size, _WIDTH_THETA_DIFF)]),
    np.full(_PEAK_THETA_DIFF.size + _WIDTH_THETA_HALF.size, np.pi / 2),
)
"""theta_half, theta_diff and phi_diff at which a highlight's peak and half width are compared [rad]."""
_PROFILE_POINTS = Points.at(*PROFILE)


@dataclass(frozen=True)
class Misfit:
    """Measure the distance of a component's own layers from its values.

    Attributes
    ----------
    peak : float or None
        Ratio minus 1 of the mean values at theta_half = 0, theta_diff 0 to 45 degrees; None for a diffuse part.
    color : float
        Largest difference of a channel of the peak (of the albedo if diffuse), relative to the largest channel.
    half_width : float or None
        Ratio minus 1 of the angles theta_half at half of the peak; None for a diffuse part.
    albedo : float
        Largest error of the layers' albedo in any channel at 0 or 45 degrees, relative to the largest albedo.
    """

    peak: float | None
    color: float
    half_width: float | None
    albedo: float


@dataclass(frozen=True)
class Surface:
    """Describe a rough surface of a component; a parameter with too large a misfit is None.

    Attributes
    ----------
    alpha, tail_exponent : float or None
        Roughness, and exponent of the tails: 2 is GGX, more is a shorter tail.
    f0 : tuple of float or None
        Reflectance at normal incidence, RGB.
    f90 : float or None
        Reflectance at grazing incidence, extrapolated from smaller angles; None if it would be above 1.
    alpha_range, f0_range : tuple or None
        Intervals with 90 % probability.
    """

    alpha: float | None
    tail_exponent: float | None
    f0: Color | None
    f90: float | None
    alpha_range: Range | None
    f0_range: RgbRange | None


@dataclass(frozen=True)
class Description:
    """Hold a component's own layers, its surfaces (the brightest first), and the misfit of the layers."""

    layers: LayeredModel
    surfaces: tuple[Surface, ...]
    misfit: Misfit

    @property
    def half_width(self) -> float | None:
        """Angle theta_half at which the slopes of all surfaces are half as frequent as at 0; None if withheld [rad]."""
        if self.misfit.half_width is None or self.misfit.half_width > MAX_WIDTH_MISFIT:
            return None
        return _half_width([layer for layer in self.layers.layers if isinstance(layer, (SpecularLayer, RetroLayer))])

    def remarks(self, label: str) -> tuple[str, ...]:
        """Return sentences about withheld parameters."""
        label = label.replace("_", " ")
        return (*self._misfit_remark(label), *self._grazing_remark(label))

    def _misfit_remark(self, label: str) -> Iterator[str]:
        misses, withheld = _misses(self.misfit), _withheld(self.misfit)
        names = [name for name, is_withheld in zip(("alpha", "F0"), withheld, strict=True) if is_withheld]
        if self.surfaces and names:
            missed = f"{', '.join(misses[:-1])} and {misses[-1]}" if len(misses) > 1 else misses[0]
            yield f"No {' or '.join(names)} describes the {label}: the nearest surfaces miss {missed}."

    def _grazing_remark(self, label: str) -> Iterator[str]:
        if any(surface.f0 is not None and surface.f90 is None for surface in self.surfaces):
            yield f"F90 of the {label} is unknown: extrapolated to grazing incidence, its reflectance would exceed 1."


@dataclass(frozen=True, eq=False)
class OwnValues:
    """Hold the values of one component.

    Attributes
    ----------
    grid : Array
        At the pairs of directions of `dsbrdf.components.layer_data`, (3, N) [1/sr].
    profile : Array
        At `PROFILE`, (3, n) [1/sr].
    albedo : Array
        Directional albedo at the first two angles of `light_rules`, (2, 3).
    """

    grid: Array
    profile: Array
    albedo: Array


def describe(
    own: OwnValues, spread: SurfaceSpread, *, is_diffuse: bool, has_retro: bool = False, has_ground: bool = False
) -> Description:
    """Fit layers to the values of a component; a highlight may contain retro-reflection or a diffuse layer."""
    data = component_data(own.grid, has_peak=not is_diffuse)
    if data is None:
        return Description(LayeredModel(()), (), Misfit(None, 0.0, None, 0.0))
    structures = (
        _DIFFUSE_STRUCTURES
        if is_diffuse
        else _highlights(peak_half_width(own.grid), has_retro=has_retro, has_ground=has_ground)
    )
    best = fit_structures(data, structures, quick=True)[0]
    misfit = _misfit(own, best.model, is_diffuse=is_diffuse)
    if not _are_distinct(best.model):
        alone = fit_structures(data, structures[:1], quick=True)[0]
        of_one = _misfit(own, alone.model, is_diffuse=is_diffuse)
        if not any(_withheld(of_one)):
            best, misfit = alone, of_one
    return Description(best.model, () if is_diffuse else _surfaces(best, misfit, spread), misfit)


def renderer_layers(values: Array, descriptions: Sequence[Description]) -> LayeredModel:
    """Fit the layers of all components once more, together, to the values (3, N) of the whole material."""
    layers = tuple(layer for one in descriptions for layer in one.layers.layers)
    data = renderer_data(values)
    if data is None or not layers:
        return LayeredModel(())
    structure = LayerStructure("all", tuple(OWN_PRIORS[type(layer)] for layer in layers))
    return refined(data, structure, np.concatenate([layer.unknowns for layer in layers])).model


_SURFACE_PRIOR = OWN_PRIORS[SpecularLayer]
_GROUND_PRIOR = OWN_PRIORS[DiffuseLayer]
_DIFFUSE_STRUCTURES = (
    LayerStructure("ground", (_GROUND_PRIOR,)),
    LayerStructure("ground and sheen", (_GROUND_PRIOR, OWN_PRIORS[SheenLayer]), 2.0),
)


def _highlights(half_width: float, *, has_retro: bool, has_ground: bool) -> tuple[LayerStructure, ...]:
    """Return structures of one or two surfaces that start near a half width [rad], with other layers if requested."""
    width = float(np.degrees(half_width))
    widest = float(np.degrees(_MAX_START_HALF_WIDTH))
    pairs = ((0.7 * width, min(3.0 * width, widest)), (width, min(6.0 * width, widest)))
    found = [
        LayerStructure("surface", (_SURFACE_PRIOR,), 0.0, ((width,),)),
        LayerStructure("two surfaces", (_SURFACE_PRIOR, _SURFACE_PRIOR), _SECOND_SURFACE_COST, pairs),
    ]
    if has_ground:
        layers = _SURFACE_PRIOR, _SURFACE_PRIOR, _GROUND_PRIOR
        found.append(LayerStructure("two surfaces and ground", layers, 2.0 * _SECOND_SURFACE_COST, pairs[:1]))
    if has_retro:
        retro = OWN_PRIORS[RetroLayer]
        found.append(LayerStructure("retro-reflection", (retro,)))
        found.append(
            LayerStructure("retro-reflection and surface", (retro, _SURFACE_PRIOR), _SECOND_SURFACE_COST, ((width,),))
        )
    return tuple(found)


def _are_distinct(model: LayeredModel) -> bool:
    """Tell whether all surfaces differ in roughness."""
    alphas = [layer.alpha for layer in model.layers if isinstance(layer, SpecularLayer)]
    return len(alphas) < 2 or max(alphas) > _MIN_ALPHA_RATIO * min(alphas)


def _misfit(own: OwnValues, model: LayeredModel, *, is_diffuse: bool) -> Misfit:
    albedo = np.array(
        [model.layer_values(rule.points).sum(axis=0) @ rule.weight for rule in light_rules()[: len(own.albedo)]]
    )
    of_albedo = float(np.abs(albedo - own.albedo).max() / own.albedo.max())
    if is_diffuse:
        return Misfit(None, _color_difference(own.albedo[0], albedo[0]), None, of_albedo)
    profile = model.layer_values(_PROFILE_POINTS).sum(axis=0)
    ours, theirs = (values[:, : _PEAK_THETA_DIFF.size].mean(axis=1) for values in (profile, own.profile))
    widths = [_width_of_profile(values[:, _PEAK_THETA_DIFF.size :].sum(axis=0)) for values in (profile, own.profile)]
    return Misfit(_factor(ours.sum(), theirs.sum()), _color_difference(ours, theirs), _factor(*widths), of_albedo)


def _factor(first: float, second: float) -> float:
    """Return the ratio of the larger to the smaller of two positive numbers, less 1."""
    return float(max(first, second) / max(min(first, second), 1e-300) - 1.0)


def _color_difference(first: Array, second: Array) -> float:
    return float(np.abs(first / max(first.max(), 1e-300) - second / max(second.max(), 1e-300)).max())


def _width_of_profile(values: Array) -> float:
    """Return theta_half at which values at `_WIDTH_THETA_HALF` fall to half of the first value [rad]."""
    below = np.flatnonzero(values < 0.5 * values[0])
    if not below.size:
        return float(_WIDTH_THETA_HALF[-1])
    last = int(below[0])
    return float(np.interp(-0.5 * values[0], -values[last - 1 : last + 1], _WIDTH_THETA_HALF[last - 1 : last + 1]))


def _half_width(layers: Sequence[SpecularLayer | RetroLayer]) -> float | None:
    """Return theta_half at which the slopes of some layers together are half as frequent as at 0 [rad]."""
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
    """Return the frequency of slopes with a tangent (n,) times the mean reflectance."""
    exponent = layer.tail_exponent if isinstance(layer, SpecularLayer) else 2.0
    norm = tail_norm(exponent)[0]
    return np.asarray(
        np.mean(layer.reflectance) / layer.alpha**2 * (1.0 + tangent**2 / (norm * layer.alpha**2)) ** -exponent
    )


def _withheld(misfit: Misfit) -> tuple[bool, bool]:
    """Return whether the misfit withholds roughness, and whether it withholds reflectance."""
    is_high = misfit.peak is not None and misfit.peak > MAX_PEAK_MISFIT
    is_wide = misfit.half_width is not None and misfit.half_width > MAX_WIDTH_MISFIT
    return is_wide, is_high or misfit.color > MAX_COLOR_MISFIT or misfit.albedo > MAX_ALBEDO_MISFIT


def _misses(misfit: Misfit) -> list[str]:
    """Return the misfits beyond their thresholds in words."""
    factors = (("peak", misfit.peak, MAX_PEAK_MISFIT), ("half width", misfit.half_width, MAX_WIDTH_MISFIT))
    words = [
        f"its {name} by a factor of {1.0 + off:.2f}" for name, off, most in factors if off is not None and off > most
    ]
    if misfit.color > MAX_COLOR_MISFIT:
        words.append(f"its colour by {misfit.color:.0%} of the brightest channel")
    if misfit.albedo > MAX_ALBEDO_MISFIT:
        words.append(f"its albedo by {misfit.albedo:.0%}")
    return words


def _surfaces(best: FittedStructure, misfit: Misfit, spread: SurfaceSpread) -> tuple[Surface, ...]:
    """Return the surfaces of a fit with their ranges, the brightest first; the misfit may withhold parameters.

    A range combines the spread over probable structures, the uncertainty of the fit and the misfit, as independent
    errors; the misfit counts as an error that is not exceeded with 90 % probability.
    """
    variance = 2.0 * np.diag(np.linalg.inv(best.normal_equations))
    no_alpha, no_f0 = _withheld(misfit)
    of_width, of_light = (
        float(np.log1p(off)) / _RANGE_HALF_WIDTH_SIGMAS
        for off in (misfit.half_width or 0.0, max(misfit.albedo, misfit.color))
    )
    found = []
    for layer, part in zip(best.model.layers, best.structure.slices, strict=True):
        if not isinstance(layer, SpecularLayer):
            continue
        own = variance[part]
        alpha = _around(layer.alpha, float(np.sqrt(own[6] + spread.alpha**2 + of_width**2)))
        red, green, blue = (
            _around(value, float(np.sqrt(fitted + split**2 + of_light**2)))
            for value, fitted, split in zip(layer.f0, own[:3], spread.f0, strict=True)
        )
        surface = Surface(
            None if no_alpha else layer.alpha,
            None if no_alpha else layer.tail_exponent,
            None if no_f0 else layer.f0,
            None if no_f0 or layer.grazing_reflectance > 1.0 else layer.grazing_reflectance,
            None if no_alpha else alpha,
            None if no_f0 else (red, green, blue),
        )
        found.append((sum(layer.f0), surface))
    return tuple(surface for _, surface in sorted(found, key=lambda pair: -pair[0]))


def _around(value: float, deviation: float) -> Range:
    """Return the 90 % range of a positive value from the standard deviation of its logarithm."""
    factor = float(np.exp(_RANGE_HALF_WIDTH_SIGMAS * deviation))
    return value / factor, value * factor
