"""Weigh a model's values at two thousand pairs of directions, to separate its layers or to describe a component.

To separate layers, the weight of a pair is its visibility on a lit sphere, and errors are relative to f**1.4: the wide,
faint range decides on the diffuse part. Plain errors have some weight too, to keep the heights of highlights.

To describe one component, errors are relative to f. Those of a highlight's upper nine tenths count relative to its own
values, and so do those of the light in four bands of theta_diff, which make up its albedo.
"""

import itertools
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from dsbrdf.arrays import Array, Mask
from dsbrdf.components.layer_fit import LayerData
from dsbrdf.components.points import Points
from dsbrdf.data.grid import DEFAULT_HORIZON_CUTOFF
from dsbrdf.data.weighting import center_share, interval_ends, seen_weight, trust
from dsbrdf.model.reflectance import ReflectanceModel

# Axes of the grid of pairs [rad].
_THETA_DIFF = np.radians([0.0, 10, 20, 30, 40, 48, 55, 61, 66, 70, 73, 76, 79, 82, 85, 88])
_THETA_HALF = np.radians(np.concatenate([[0.0], np.geomspace(0.1, 2.0, 8), np.linspace(1.73, 9.27, 20) ** 2]))
_PHI_DIFF = np.radians([20.0, 70.0])
LAYER_POWER = 1.4
"""Errors of layers count relative to f to this power."""
PLAIN_ERROR_WEIGHT = 0.3
"""Weight of plain errors, as a fraction of the weight of relative errors."""
_OWN_POWER = 1.0  # Power of f for the errors of one component.
_N_OWN_SAMPLES = 500.0  # With so many independent samples, a component's values outweigh the prior.
_OWN_MODEL_ERROR = 0.08  # A second surface must explain a larger relative error.
_PEAK_ERROR_WEIGHT = 1.5  # Weight of errors at a highlight's peak, as a fraction of all other weight.
_RENDERED_PEAK_ERROR_WEIGHT = 0.5  # Weight of peak errors if all components are fitted together.
_FULL_WEIGHT_THETA_DIFF = np.radians(50.0)  # At a larger theta_diff, the weight of a peak falls.
_MIN_LOG_SCALE_THETA_HALF = np.radians(0.05)  # Below this angle, the scale of theta_half is linear.
_BAND_WEIGHT = 6.0  # Weight of the errors of the light in bands, as a fraction of all other weight.
_RENDERED_BAND_WEIGHT = 1.0  # Weight of band errors if all components are fitted together.
_BAND_EDGES = np.radians([0.0, 15.0, 35.0, 52.0, 68.0])  # edges of the bands of theta_diff [rad]
_MIN_BAND_LIGHT = 0.05  # Errors of a darker band are relative to this fraction of the mean band's light.
_MAX_VALUE = 1e100  # Its square still fits in double precision.
_MIN_COSINE = 1e-3  # Pairs of directions with a smaller cosine to the normal are left out.


class _Grid(NamedTuple):
    """Hold R x C x P pairs of directions, and the N pairs above the horizon.

    Attributes
    ----------
    angles : tuple of Array
        theta_half, theta_diff and phi_diff (N,) [rad].
    points : Points
        The N pairs.
    above : Mask
        Whether a pair is above the horizon (R, C, P).
    lit, plain : Array
        Weight of a pair in a lit sphere, and its plain weight, (R, C, P).
    """

    angles: tuple[Array, Array, Array]
    points: Points
    above: Mask
    lit: Array
    plain: Array


def grid_values(model: ReflectanceModel) -> Array:
    """Return the values (3, N) of a model at the pairs of directions [1/sr]."""
    return np.minimum(model.evaluate_unmasked(*_grid().angles).T, _MAX_VALUE)


def grid_points() -> Points:
    """Return the N pairs of directions."""
    return _grid().points


def material_data(values: Array) -> LayerData | None:
    """Weigh the values (3, N) of a whole material; None if it has no light."""
    if not values.any():
        return None
    grid, mean = _grid(), _on_grid(values)
    seen = _seen(mean, LAYER_POWER)
    weight = seen / np.sum(seen * mean**2) + PLAIN_ERROR_WEIGHT / np.sum(grid.plain * mean**2) * grid.plain
    return LayerData.of(grid.points, values, weight[:, grid.above])


def component_data(values: Array, *, has_peak: bool) -> LayerData | None:
    """Weigh the values (3, N) of a component, with or without a highlight's peak; None if it has no light."""
    if not values.any():
        return None
    grid, mean = _grid(), _on_grid(values)
    seen = _seen(mean, _OWN_POWER)
    weight = seen / np.sum(seen * mean**2)
    if has_peak:
        peak = _peak_weight(mean.mean(axis=0))
        weight = weight + _PEAK_ERROR_WEIGHT / np.sum(peak * mean**2) * peak
    data = LayerData.of(grid.points, values, weight[:, grid.above])
    sums = _band_sums(values, data.root_weight, _BAND_WEIGHT)
    return replace(data, n_samples=_N_OWN_SAMPLES, model_error=_OWN_MODEL_ERROR, sums=sums)


def renderer_data(values: Array) -> LayerData | None:
    """Weigh the values (3, N) of a whole material as lit spheres and highlights show them; None if it has no light."""
    if not values.any():
        return None
    grid, mean = _grid(), _on_grid(values)
    weight = _seen(mean, LAYER_POWER)
    peak = _peak_weight(mean.mean(axis=0))
    weight = weight / np.sum(weight * mean**2) + _RENDERED_PEAK_ERROR_WEIGHT / np.sum(peak * mean**2) * peak
    data = LayerData.of(grid.points, values, weight[:, grid.above])
    return replace(data, n_samples=_N_OWN_SAMPLES, sums=_band_sums(values, data.root_weight, _RENDERED_BAND_WEIGHT))


def peak_half_width(values: Array) -> float:
    """Return theta_half at which values (3, N) have half their height at small angles theta_diff [rad]."""
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


def _seen(mean: Array, power: float) -> Array:
    """Return weights (3, R, C, P) by visibility on a lit sphere."""
    lit = _grid().lit
    over_phi = np.sum(lit * mean, axis=3) / np.maximum(lit.sum(axis=2), 1e-300)
    typical = float(np.sum(lit * mean) / (3.0 * lit.sum()))
    return seen_weight(lit, over_phi[..., np.newaxis], typical, power)


def _peak_weight(mean: Array) -> Array:
    """Return weights (R, C, P) of relative errors in a highlight's peak, even on a logarithmic scale of theta_half."""
    top = mean.max(axis=1, keepdims=True)
    inside = np.clip((mean / np.maximum(top, 1e-300) - 0.1) / 0.3, 0.0, 1.0)
    rows = np.minimum(np.cos(_THETA_DIFF) / np.cos(_FULL_WEIGHT_THETA_DIFF), 1.0) ** 8
    columns = np.gradient(np.log(_THETA_HALF + _MIN_LOG_SCALE_THETA_HALF))
    weight = rows[:, np.newaxis, np.newaxis] * columns[:, np.newaxis] * inside / np.maximum(mean, 1e-100) ** 2
    return np.where(_grid().above, weight, 0.0)


def _band_sums(values: Array, root_weight: Array, band_weight: float) -> Array:
    """Return the weights (3, B, N) that turn weighted residuals into relative errors of the light in bands."""
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
    trusted = trust(lowest, DEFAULT_HORIZON_CUTOFF) * np.diff(interval_ends(_THETA_DIFF))[:, np.newaxis, np.newaxis]
    solid_angle = -np.diff(np.cos(interval_ends(_THETA_HALF)))[:, np.newaxis] * (np.sin(2.0 * theta_diff) + 0.1)
    center = center_share(_THETA_HALF) * np.gradient(np.sqrt(_THETA_HALF))
    above = lowest > _MIN_COSINE
    angles = theta_half[above], theta_diff[above], phi_diff[above]
    return _Grid(
        angles, Points.at(*angles), above, trusted * lowest * (level + swing) * solid_angle, trusted * center[:, None]
    )
