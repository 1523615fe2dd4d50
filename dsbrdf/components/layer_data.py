"""Values of a model at a thousand pairs of directions, weighted for telling its layers apart.

A pair counts by what a lit sphere shows of it, and errors are relative to f**1.4: the wide, faint range decides what is
diffuse. A share of the plain weight keeps the heights of highlights.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from dsbrdf.arrays import Array, Mask
from dsbrdf.components.layer_fit import LayerData
from dsbrdf.components.points import Points
from dsbrdf.data.grid import DEFAULT_HORIZON_CUTOFF
from dsbrdf.data.weighting import center_share, interval_ends, seen_weight, trust
from dsbrdf.model.reflectance import ReflectanceModel

_ROWS = np.radians([0.0, 10, 20, 30, 40, 48, 55, 61, 66, 70, 73, 76, 79, 82, 85, 88])
_COLUMNS = np.radians(np.concatenate([[0.0], np.geomspace(0.1, 2.0, 8), np.linspace(1.73, 9.27, 20) ** 2]))
_AZIMUTHS = np.radians([15.0, 45.0, 75.0])
LAYER_POWER = 1.4
"""Errors of layers count relative to f to this power: the wide, faint range decides what is diffuse."""
PLAIN_SHARE = 0.3
"""Weight of the plain error, which keeps the heights of highlights, in units of the other's."""
_BRIGHTEST = 1e100  # what is far beyond any material must have a square all the same
_LEAST_COSINE = 1e-3  # to the normal


class _Grid(NamedTuple):
    """Angles (R, N, P) of the pairs, what they count, and those above the horizon as a list."""

    angles: tuple[Array, Array, Array]  # theta_half, theta_diff and phi_diff (n,) of pairs above the horizon
    points: Points
    above: Mask  # (R, N, P)
    lit: Array
    plain: Array


def layer_data(model: ReflectanceModel) -> LayerData | None:
    """Values of a model, or None if it has no light."""
    grid = _grid()
    mean = np.zeros((3, *grid.above.shape))
    mean[:, grid.above] = np.minimum(model.evaluate_unmasked(*grid.angles).T, _BRIGHTEST)
    if not mean.any():
        return None
    over_phi = np.sum(grid.lit * mean, axis=3) / np.maximum(grid.lit.sum(axis=2), 1e-300)
    typical = float(np.sum(grid.lit * mean) / (3.0 * grid.lit.sum()))
    seen = seen_weight(grid.lit, over_phi[..., np.newaxis], typical, LAYER_POWER)
    weight = seen / np.sum(seen * mean**2) + PLAIN_SHARE / np.sum(grid.plain * mean**2) * grid.plain
    return LayerData.of(grid.points, mean[:, grid.above], weight[:, grid.above])


@cache
def _grid() -> _Grid:
    theta_half, theta_diff, phi_diff = np.broadcast_arrays(
        _COLUMNS[:, np.newaxis], _ROWS[:, np.newaxis, np.newaxis], _AZIMUTHS
    )
    level = np.cos(theta_diff) * np.cos(theta_half)
    swing = np.sin(theta_diff) * np.sin(theta_half) * np.cos(phi_diff)
    lowest = np.maximum(level - swing, 0.0)
    trusted = trust(lowest, DEFAULT_HORIZON_CUTOFF) * np.diff(interval_ends(_ROWS))[:, np.newaxis, np.newaxis]
    solid_angle = -np.diff(np.cos(interval_ends(_COLUMNS)))[:, np.newaxis] * (np.sin(2.0 * theta_diff) + 0.1)
    center = center_share(_COLUMNS) * np.gradient(np.sqrt(_COLUMNS))
    above = lowest > _LEAST_COSINE
    angles = theta_half[above], theta_diff[above], phi_diff[above]
    return _Grid(
        angles, Points.at(*angles), above, trusted * lowest * (level + swing) * solid_angle, trusted * center[:, None]
    )
