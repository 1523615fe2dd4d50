"""Measure how far the layers that describe a component are from its values, and withhold misleading parameters."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.components.layers import LayeredModel
from dsbrdf.components.points import Points
from dsbrdf.components.shares import light_rules

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
