"""Compute what layers need at pairs of directions, and weigh a model's values at 668 pairs for the fits of layers.

Where layers are separated, the weight of a pair is its visibility on a lit sphere. Squared errors of values f are
divided by f**1.4, because the many small values determine the diffuse part. Absolute errors have some weight too, which
preserves the peaks of highlights.

Where one component is described, squared errors of values f are divided by f. Additional weight is on relative errors
where a highlight is above a tenth of its peak, and on relative errors of the light in four bands of theta_diff, because
the sum of this light is the albedo.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from dsbrdf.arrays import Array, Evaluate, Mask
from dsbrdf.data.geometry import DEFAULT_HORIZON_CUTOFF
from dsbrdf.data.reduction import center_share, interval_ends, seen_weight, trust

COAT_F0 = 0.04
"""Reflectance at normal incidence of the clear coat above a layer."""
MIN_COSINE = 0.02
"""Smaller cosines to the normal are clipped, because masking is steep near the horizon, where nothing is measured."""
MAX_TAN2 = 1e4
"""Larger values of tan(theta_half)**2 are clipped, because the tangent of 90 degrees is infinite."""
MIN_RISE = 1e-3
"""Smaller values of 1 - cos(theta_diff) are clipped for sheen, which uses their logarithm."""
MIN_SINE = 3e-2
"""Smaller values of sin(theta_half) are clipped for sheen, which uses the logarithm of sin(theta_half)."""


class Points(NamedTuple):
    """Hold the quantities that layers need at N pairs of directions, as arrays (N,) or stacks of such arrays."""

    squared_tangent: Array  # tan(theta_half)**2
    log_squared_secant: Array
    cos_in: Array
    cos_out: Array
    fresnel: Array  # reflectance of glass at theta_diff, from 0 (normal) to 1 (grazing)
    passed: Array  # logarithm of the fraction of light that passes a clear coat both ways
    rise: Array  # u = 1 - cos(theta_diff), and u**2
    ground: Array  # the six terms of a diffuse layer, see `dsbrdf.components.layers`
    fibres: Array  # logarithms of 1 - cos(theta_diff) and of sin(theta_half), for sheen
    squared_retro: Array  # tan(theta_half)**2 after omega_in is turned by 180 degrees about the normal

    @classmethod
    def at(cls, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Points:
        """Compute the quantities that layers need at angles (N,) [rad]."""
        cos_half, sin_half, cos_diff = np.cos(theta_half), np.sin(theta_half), np.cos(theta_diff)
        level, swing = cos_diff * cos_half, np.sin(theta_diff) * sin_half * np.cos(phi_diff)
        cos_in, cos_out = np.maximum(level - swing, MIN_COSINE), np.maximum(level + swing, MIN_COSINE)
        squared_tangent = np.minimum((sin_half / np.maximum(cos_half, 1e-9)) ** 2, MAX_TAN2)
        rise = 1.0 - np.maximum(cos_diff, 0.0)
        to_in, to_out, fresnel = map(fresnel_rise, (cos_in, cos_out, 1.0 - rise))
        # This equals sin(theta_in) sin(theta_out) cos(phi_in - phi_out), from which the term of Oren and Nayar is made.
        along = 2.0 * cos_diff**2 - 1.0 - cos_in * cos_out
        passed = np.log((1.0 - to_in) * (1.0 - to_out))
        ground = (
            passed,
            cos_diff**2 * (to_in + to_out),
            fresnel,
            np.log(2.0 / (cos_in + cos_out)),
            sin_half**2,
            np.where(along > 0.0, along / np.maximum(cos_in, cos_out), along),
        )
        return cls(
            squared_tangent=squared_tangent,
            log_squared_secant=np.log1p(squared_tangent),
            cos_in=cos_in,
            cos_out=cos_out,
            fresnel=fresnel,
            passed=passed + 2.0 * np.log(1.0 - COAT_F0),
            rise=np.stack([rise, rise**2]),
            ground=np.stack(ground),
            fibres=np.log(np.stack([np.maximum(rise, MIN_RISE), np.maximum(sin_half, MIN_SINE)])),
            squared_retro=np.maximum(4.0 * np.sin(theta_diff) ** 2 - (cos_in - cos_out) ** 2, 0.0)
            / (cos_in + cos_out) ** 2,
        )


def grid_points(theta_half: Array, theta_diff: Array, phi_diff: Array) -> Iterator[Points]:
    """Yield for each theta_half the points at all pairs of theta_diff (D,) and phi_diff (P,), phi_diff fastest."""
    diff, phi = (angle.ravel() for angle in np.meshgrid(theta_diff, phi_diff, indexing="ij"))
    for angle in theta_half:
        yield Points.at(np.full(diff.size, angle), diff, phi)


def fresnel_rise(cosine: Array) -> Array:
    """Return the reflectance of glass (index 1.5), scaled to 0 at normal incidence and to 1 at grazing incidence."""
    refracted = np.sqrt(1.25 + cosine**2)  # This is the cosine of the refracted direction times the refractive index.
    across = (refracted - cosine) / (refracted + cosine)
    ratio = (cosine * (refracted + cosine) - 1.0) / (cosine * (refracted - cosine) + 1.0)
    return np.asarray(np.maximum(0.5 * across**2 * (1.0 + ratio**2) - COAT_F0, 0.0) / (1.0 - COAT_F0))


N_SAMPLES = 50.0
"""The values of a whole material count as this many independent samples."""
MODEL_ERROR = 0.02
"""Relative error that even the best layers of a material have; it is c in the cost of a structure."""
# Angles of the grid of pairs of directions [rad].
_THETA_DIFF = np.radians([0.0, 10, 20, 30, 40, 48, 55, 61, 66, 70, 73, 76, 79, 82, 85, 88])
_THETA_HALF = np.radians(np.concatenate([[0.0], np.geomspace(0.1, 2.0, 8), np.linspace(1.73, 9.27, 20) ** 2]))
_PHI_DIFF = np.radians([20.0, 70.0])
LAYER_POWER = 1.4
"""Where layers are separated, squared errors are divided by this power of the values."""
PLAIN_ERROR_WEIGHT = 0.3
"""Weight of absolute errors, as a fraction of the weight of relative errors."""
_OWN_POWER = 1.0  # Where one component is described, squared errors are divided by this power of the values.
_N_OWN_SAMPLES = 500.0  # Values of a component count as so many independent samples, to outweigh the prior.
_OWN_MODEL_ERROR = 0.08  # Smaller relative errors hardly lower the cost, so they cause no second surface.
_PEAK_ERROR_WEIGHT = 1.5  # Weight of errors at a highlight's peak, as a fraction of all other weight.
_RENDERED_PEAK_ERROR_WEIGHT = 0.5  # Weight of peak errors where layers of all components are fitted for a renderer.
_FULL_WEIGHT_THETA_DIFF = np.radians(50.0)  # At a larger theta_diff, the weight of errors at a highlight's peak falls.
_AROUND_PEAK = int(np.searchsorted(_THETA_HALF, np.radians(60.0)))  # index of 60 degrees, outside of any peak
_MIN_PEAK_HEIGHT = 0.05  # The height of a peak above its surroundings counts as at least this fraction of its top.
_RENDERED_TRUST_POWER = 0.09  # The weight near the horizon is raised to this power in fits for renderers.
_MIN_LOG_SCALE_THETA_HALF = np.radians(0.05)  # At smaller angles, the logarithmic scale of theta_half becomes linear.
_BAND_WEIGHT = 6.0  # Weight of the errors of the light in bands, as a fraction of all other weight.
_RENDERED_BAND_WEIGHT = 2.0  # Weight of band errors where layers of all components are fitted for a renderer.
_BAND_EDGES = np.radians([0.0, 15.0, 35.0, 52.0, 68.0])  # edges of the bands of theta_diff [rad]
_MIN_BAND_LIGHT = 0.05  # Errors of a darker band are relative to this fraction of the mean light of all bands.
_MAX_VALUE = 1e100  # Larger values of a model are clipped, because their squares would overflow.
_MIN_COSINE = 1e-3  # Pairs of directions with a smaller cosine to the normal are left out.


@dataclass(frozen=True, eq=False)
class LayerData:
    """Hold RGB values at points and the weights of their errors; weights times squared values sum to 1.

    Attributes
    ----------
    points : Points
        N pairs of directions.
    root_weight, weighted : Array
        Square roots of the weights, and the values times these roots, (3, N).
    n_samples : float
        Number of independent samples that the values count as.
    model_error : float
        Relative error that even the best layers have.
    sums : Array or None
        Weights of B sums over the weighted residuals, (3, B, N); the squared sums are added to the error.
    """

    points: Points
    root_weight: Array
    weighted: Array
    n_samples: float = N_SAMPLES
    model_error: float = MODEL_ERROR
    sums: Array | None = None

    @classmethod
    def of(cls, points: Points, values: Array, weight: Array) -> LayerData:
        """Make data of values (3, N) and their weights (3, N); at least one value must be positive."""
        root = np.sqrt(weight / np.sum(weight * values**2))
        return cls(points, root, values * root)

    def thinned(self, step: int) -> LayerData:
        """Return the data at every pair of directions with an index divisible by `step`, for a rough fit."""
        root, weighted = self.root_weight[:, ::step], self.weighted[:, ::step]
        scale = 1.0 / max(float(np.linalg.norm(weighted)), 1e-300)
        return replace(
            self,
            points=Points(*(quantity[..., ::step] for quantity in self.points)),
            root_weight=scale * root,
            weighted=scale * weighted,
            sums=None if self.sums is None else step / scale * self.sums[:, :, ::step],
        )

    def squared_error(self, values: Array) -> float:
        """Return the weighted squared error of layers with the values (3, N), relative to the data."""
        residual = values * self.root_weight - self.weighted
        error = float(np.sum(residual**2))
        return error if self.sums is None else error + float(np.sum((self.sums @ residual[..., np.newaxis]) ** 2))


class _Grid(NamedTuple):
    """Hold a grid of pairs of directions, of which N pairs are above the horizon.

    Attributes
    ----------
    angles : tuple of Array
        theta_half, theta_diff and phi_diff (N,) [rad].
    points : Points
        The N pairs above the horizon.
    above : Mask
        Whether each pair is above the horizon, (theta_diff, theta_half, phi_diff).
    lit, plain : Array
        Weights of relative and of absolute errors, with the axes of `above`; both are small near the horizon.
    rendered : Array
        Weight of relative errors in fits for renderers, where the rim of a sphere counts, with the axes of `above`.
    """

    angles: tuple[Array, Array, Array]
    points: Points
    above: Mask
    lit: Array
    plain: Array
    rendered: Array


def grid_values(evaluate: Evaluate) -> Array:
    """Return the values (3, N) of a material at the pairs of directions [1/sr]."""
    return np.minimum(evaluate(*_grid().angles).T, _MAX_VALUE)


def data_points() -> Points:
    """Return the N pairs of directions of the grid that are above the horizon."""
    return _grid().points


def material_data(values: Array) -> LayerData | None:
    """Weigh the values (3, N) of a whole material; return None if all values are 0."""
    if not values.any():
        return None
    grid, mean = _grid(), _on_grid(values)
    seen = _seen(mean, grid.lit, LAYER_POWER)
    weight = seen / np.sum(seen * mean**2) + PLAIN_ERROR_WEIGHT / np.sum(grid.plain * mean**2) * grid.plain
    return LayerData.of(grid.points, values, weight[:, grid.above])


def component_data(values: Array, *, has_peak: bool) -> LayerData | None:
    """Weigh the values (3, N) of a component, with or without errors at a peak; return None if all values are 0."""
    if not values.any():
        return None
    seen = _seen(_on_grid(values), _grid().lit, _OWN_POWER)
    data = _described_data(values, seen, _PEAK_ERROR_WEIGHT if has_peak else 0.0, _BAND_WEIGHT)
    return replace(data, model_error=_OWN_MODEL_ERROR)


def renderer_data(values: Array) -> LayerData | None:
    """Weigh the values (3, N) of a whole material by visibility on a lit sphere; return None if all values are 0."""
    if not values.any():
        return None
    seen = _seen(_on_grid(values), _grid().rendered, LAYER_POWER)
    return _described_data(values, seen, _RENDERED_PEAK_ERROR_WEIGHT, _RENDERED_BAND_WEIGHT)


def _described_data(values: Array, seen: Array, peak_weight: float, band_weight: float) -> LayerData:
    """Weigh values by the weights `seen`, and add errors of the peak and of the light in bands of theta_diff."""
    grid, mean = _grid(), _on_grid(values)
    weight = seen / np.sum(seen * mean**2)
    if peak_weight:
        peak = _peak_weight(mean.mean(axis=0))
        weight = weight + peak_weight / np.sum(peak * mean**2) * peak
    data = LayerData.of(grid.points, values, weight[:, grid.above])
    return replace(data, n_samples=_N_OWN_SAMPLES, sums=_band_sums(values, data.root_weight, band_weight))


def peak_half_width(values: Array) -> float:
    """Return theta_half at which values (3, N), averaged over small theta_diff, fall to half of their peak [rad]."""
    row = _on_grid(values)[:, _THETA_DIFF < _FULL_WEIGHT_THETA_DIFF].mean(axis=(0, 1, 3))
    below = np.flatnonzero(row < 0.5 * row[0])
    if not below.size:
        return float(_THETA_HALF[-1])
    last = int(below[0])
    return float(np.interp(-0.5 * row[0], -row[last - 1 : last + 1], _THETA_HALF[last - 1 : last + 1]))


def _on_grid(values: Array) -> Array:
    grid = _grid()
    mean = np.zeros((3, *grid.above.shape))
    mean[:, grid.above] = values
    return mean


def _seen(mean: Array, lit: Array, power: float) -> Array:
    """Return weights by the visibility of each pair on a lit sphere, divided by a power of the values."""
    over_phi = np.sum(lit * mean, axis=3) / np.maximum(lit.sum(axis=2), 1e-300)
    typical = float(np.sum(lit * mean) / (3.0 * lit.sum()))
    return seen_weight(lit, over_phi[..., np.newaxis], typical, power)


def _peak_weight(mean: Array) -> Array:
    """Return the weights of errors in a highlight's peak, which are uniform on a logarithmic scale of theta_half.

    Errors are relative to the difference between the values and their surroundings, at theta_half = 60 degrees.
    """
    top, around = mean.max(axis=1, keepdims=True), mean[:, _AROUND_PEAK : _AROUND_PEAK + 1]
    height = np.maximum(top - around, np.maximum(_MIN_PEAK_HEIGHT * top, 1e-100))
    fraction = (mean - around) / height
    inside = np.clip((fraction - 0.1) / 0.3, 0.0, 1.0) / np.maximum(fraction, 0.2) ** 2
    rows = np.minimum(np.cos(_THETA_DIFF) / np.cos(_FULL_WEIGHT_THETA_DIFF), 1.0) ** 8
    columns = np.gradient(np.log(_THETA_HALF + _MIN_LOG_SCALE_THETA_HALF))
    weight = rows[:, np.newaxis, np.newaxis] * columns[:, np.newaxis] * inside / height**2
    return np.where(_grid().above, weight, 0.0)


def _band_sums(values: Array, root_weight: Array, band_weight: float) -> Array:
    """Return the weights (3, bands, N) that turn weighted residuals into relative errors of the light in each band."""
    grid = _grid()
    theta_diff = grid.angles[1]
    bands = [(low <= theta_diff) & (theta_diff < high) for low, high in itertools.pairwise(_BAND_EDGES)]
    lit = grid.lit[grid.above] * np.array(bands)
    light = (lit @ values.T).mean(axis=1, keepdims=True)
    scale = np.sqrt(3.0 * len(bands)) * np.maximum(light, _MIN_BAND_LIGHT * light.mean())
    return np.asarray(np.sqrt(band_weight) * lit / scale / np.maximum(root_weight[:, np.newaxis], 1e-100))


@cache
def _grid() -> _Grid:
    theta_half, theta_diff, phi_diff = np.broadcast_arrays(
        _THETA_HALF[:, np.newaxis], _THETA_DIFF[:, np.newaxis, np.newaxis], _PHI_DIFF
    )
    level = np.cos(theta_diff) * np.cos(theta_half)
    swing = np.sin(theta_diff) * np.sin(theta_half) * np.cos(phi_diff)
    lowest = np.maximum(level - swing, 0.0)
    trusted = trust(lowest, DEFAULT_HORIZON_CUTOFF)
    interval = np.diff(interval_ends(_THETA_DIFF))[:, np.newaxis, np.newaxis]
    solid_angle = -np.diff(np.cos(interval_ends(_THETA_HALF)))[:, np.newaxis] * (np.sin(2.0 * theta_diff) + 0.1)
    lit = lowest * (level + swing) * solid_angle * interval
    center = center_share(_THETA_HALF) * np.gradient(np.sqrt(_THETA_HALF))
    above = lowest > _MIN_COSINE
    angles = theta_half[above], theta_diff[above], phi_diff[above]
    return _Grid(
        angles=angles,
        points=Points.at(*angles),
        above=above,
        lit=trusted * lit,
        plain=trusted * interval * center[:, np.newaxis],
        rendered=trusted**_RENDERED_TRUST_POWER * lit,
    )
