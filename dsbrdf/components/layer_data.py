"""Weigh a model's values at 668 pairs of directions, to separate its layers or to describe a component.

Where layers are separated, the weight of a pair is its visibility on a lit sphere. Squared errors of values f are
divided by f**1.4, because the many small values determine the diffuse part. Absolute errors have some weight too, which
preserves the peaks of highlights. Both weights fall where a direction is more than 70 degrees from the normal.

Where one component is described, squared errors of values f are divided by f. Additional weight is on relative errors
where a highlight is above a tenth of its peak, and on relative errors of the light in four bands of theta_diff, because
the sum of this light is the albedo. Where layers are fitted for a renderer, relative errors of the directional albedo
have weight too.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from dsbrdf.arrays import Array, Evaluate, Mask
from dsbrdf.components.points import LightRule, Points
from dsbrdf.data.reduction import center_share, interval_ends, seen_weight, trust

N_SAMPLES = 50.0
"""The values of a whole material count as this many independent samples."""
MODEL_ERROR = 0.005
"""A quarter of the right layers of published models have a smaller relative error; it is c in a structure's cost."""
# Angles of the grid of pairs of directions [rad].
_THETA_DIFF = np.radians([0.0, 10, 20, 30, 40, 48, 55, 61, 66, 70, 73, 76, 79, 82, 85, 88])
_THETA_HALF = np.radians(np.concatenate([[0.0], np.geomspace(0.1, 2.0, 8), np.linspace(1.73, 9.27, 20) ** 2]))
_PHI_DIFF = np.radians([20.0, 70.0])
_ACCURATE_CUTOFF = np.radians(70.0)
"""The weight of a pair falls if one direction is farther from the normal, where fits have several times the error."""
LAYER_POWER = 1.4
"""Where layers are separated, squared errors are divided by this power of the values."""
PLAIN_ERROR_WEIGHT = 0.3
"""Weight of absolute errors, as a fraction of the weight of relative errors."""
_OWN_POWER = 1.0  # Where one component is described, squared errors are divided by this power of the values.
_N_OWN_SAMPLES = 500.0  # Values of a component count as so many independent samples, to outweigh the prior.
_OWN_MODEL_ERROR = 0.08  # Smaller relative errors hardly lower the cost, so they cause no second surface.
_PEAK_ERROR_WEIGHT = 1.5  # Weight of errors at a highlight's peak, as a fraction of all other weight.
_FULL_WEIGHT_THETA_DIFF = np.radians(50.0)  # At a larger theta_diff, the weight of errors at a highlight's peak falls.
_AROUND_PEAK = int(np.searchsorted(_THETA_HALF, np.radians(60.0)))  # index of 60 degrees, outside of any peak
_MIN_PEAK_HEIGHT = 0.05  # The height of a peak above its surroundings counts as at least this fraction of its top.
_RENDERED_TRUST_POWER = 0.09  # The weight near the horizon is raised to this power in fits for renderers.
_MIN_LOG_SCALE_THETA_HALF = np.radians(0.05)  # At smaller angles, the logarithmic scale of theta_half becomes linear.
_BAND_WEIGHT = 6.0  # Weight of the errors of the light in bands, as a fraction of all other weight.
_RENDERED_BAND_WEIGHT = 1.0  # Weight of band errors where layers of all components are fitted for a renderer.
_RENDERED_ALBEDO_WEIGHT = 4.0  # Weight of the errors of the directional albedo in these fits.
_NODE_WEIGHT = 1e-6  # Root weight of a node of a quadrature, as a fraction of the largest root weight.
_BAND_EDGES = np.radians([0.0, 15.0, 35.0, 52.0, 68.0])  # edges of the bands of theta_diff [rad]
_MIN_BAND_LIGHT = 0.05  # Errors of a darker band are relative to this fraction of the mean light of all bands.
_MAX_VALUE = 1e100  # Larger values of a model are clipped, because their squares would overflow.
_MIN_COSINE = 1e-3  # Pairs of directions with a smaller cosine to the normal are left out.


@dataclass(frozen=True, eq=False)
class LayerData:
    """RGB values at points and the weights of their errors; weights times squared values sum to 1.

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
    def of(cls, points: Points, values: Array, weight: Array, model_error: float = MODEL_ERROR) -> LayerData:
        """Make data of values (3, N) and their weights (3, N); at least one value must be positive."""
        root = np.sqrt(weight / np.sum(weight * values**2))
        return cls(points, root, values * root, model_error=model_error)

    def thinned(self, step: int) -> LayerData:
        """Return the data at every pair of directions with an index divisible by `step`, for a rough fit."""
        root, weighted = self.root_weight[:, ::step], self.weighted[:, ::step]
        scale = 1.0 / max(float(np.linalg.norm(weighted)), 1e-300)
        return replace(
            self,
            points=Points(*(np.ascontiguousarray(quantity[..., ::step]) for quantity in self.points)),
            root_weight=scale * root,
            weighted=scale * weighted,
            sums=None if self.sums is None else step / scale * self.sums[:, :, ::step],
        )

    def squared_error(self, values: Array) -> float:
        """Return the weighted squared error of layers with the values (3, N), relative to the data."""
        residual = values * self.root_weight - self.weighted
        error = float(np.vdot(residual, residual))
        return error if self.sums is None else error + float(np.sum((self.sums @ residual[..., np.newaxis]) ** 2))


class _Grid(NamedTuple):
    """A grid of pairs of directions, of which N pairs are above the horizon.

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


def renderer_data(evaluate: Evaluate, rules: Sequence[LightRule]) -> LayerData | None:
    """Weigh the values of a whole material by visibility on a lit sphere; return None if all values are 0.

    Relative errors of the directional albedo, one for each quadrature in `rules`, have additional weight.
    """
    values = grid_values(evaluate)
    if not values.any():
        return None
    seen = _seen(_on_grid(values), _grid().rendered, LAYER_POWER)
    data = _described_data(values, seen, _PEAK_ERROR_WEIGHT, _RENDERED_BAND_WEIGHT)
    for rule in rules:
        data = _with_albedo(data, evaluate(*rule.angles).T, rule, _RENDERED_ALBEDO_WEIGHT / (3.0 * len(rules)))
    return data


def _with_albedo(data: LayerData, values: Array, rule: LightRule, weight: float) -> LayerData:
    """Add the relative errors of a directional albedo, from the values (3, n) at the nodes of its quadrature."""
    if data.sums is None:
        return data
    albedo = float((values @ rule.weight).max())
    # Single errors at the nodes hardly weigh; only their sum does.
    root = np.full(values.shape, _NODE_WEIGHT * data.root_weight.max())
    sums = np.pad(data.sums, ((0, 0), (0, 1), (0, rule.weight.size)))
    sums[:, -1, -rule.weight.size :] = np.sqrt(weight) * rule.weight / (max(albedo, 1e-100) * root)
    return replace(
        data,
        points=Points(*(np.concatenate(pair, axis=-1) for pair in zip(data.points, rule.points, strict=True))),
        root_weight=np.hstack([data.root_weight, root]),
        weighted=np.hstack([data.weighted, values * root]),
        sums=sums,
    )


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
    return half_of_peak(_on_grid(values)[:, _THETA_DIFF < _FULL_WEIGHT_THETA_DIFF].mean(axis=(0, 1, 3)), _THETA_HALF)


def half_of_peak(values: Array, angles: Array) -> float:
    """Return the angle at which values (n,) at increasing angles fall to half of the first value, or the last angle."""
    below = np.flatnonzero(values < 0.5 * values[0])
    if not below.size:
        return float(angles[-1])
    around = slice(below[0] - 1, below[0] + 1)
    return float(np.interp(-0.5 * values[0], -values[around], angles[around]))


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
    trusted = trust(lowest, _ACCURATE_CUTOFF)
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
