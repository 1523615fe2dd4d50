"""A measurement with fewer rows of theta_half, and the table that is interpolated linearly between them.

What the table predicts on a row of theta_half has the shape (3, 90 theta_diff, 180 phi_diff). Beyond the first and the
last kept value of a line of theta_half, that value is held; a line without any is 0.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dsbrdf import Measurement
from dsbrdf.arrays import Array
from dsbrdf.data import DEFAULT_HORIZON_CUTOFF, GRID_SHAPE, THETA_HALF
from dsbrdf.data.reduction import used_samples
from dsbrdf.fitting import OUTSIDE_CENTER

__all__ = [
    "RowPredictor",
    "guided_table_error",
    "interpolated_rows",
    "means_over_phi",
    "relative_rms",
    "table_error",
    "thinned",
    "used_nodes",
]

RowPredictor = Callable[[int], Array]

_COORDINATES = (THETA_HALF, np.arange(float(GRID_SHAPE[0])))  # the angle, or its index: its square root


def used_nodes(measurement: Measurement, i: int, horizon_cutoff: float | None) -> NDArray[np.bool_]:
    """Nodes of the theta_half row ``i`` that count in every channel, shape (90 theta_diff, 180 phi_diff)."""
    return np.asarray(used_samples(measurement, horizon_cutoff)[i])


def thinned(measurement: Measurement, factor: int) -> Measurement:
    """Return the measurement with only every ``factor``-th row of theta_half valid, the first included."""
    kept = np.arange(GRID_SHAPE[0]) % factor == 0
    return replace(measurement, valid=measurement.valid & kept[:, None, None])


def means_over_phi(measurement: Measurement) -> Measurement:
    """Return the measurement averaged over phi_diff: over the nodes that the metrics use, or else all valid ones."""
    stored = measurement.stored.copy()
    for i in np.flatnonzero(measurement.valid.any(axis=(1, 2))).tolist():
        valid, used = measurement.valid[i], used_nodes(measurement, i, DEFAULT_HORIZON_CUTOFF)
        chosen = np.where(used.any(axis=1, keepdims=True), used, valid)
        stored[:, i] = (np.sum(stored[:, i] * chosen, axis=2) / np.maximum(chosen.sum(axis=1), 1))[:, :, None]
    return replace(measurement, stored=stored)


def interpolated_rows(measurement: Measurement, coordinate: Array) -> RowPredictor:
    """Interpolate the valid nodes linearly along theta_half, in a coordinate of its rows, shape (90,)."""
    count = GRID_SHAPE[0]
    valid = measurement.valid.reshape(count, -1)
    number = np.broadcast_to(np.arange(count)[:, None], valid.shape)
    before = np.maximum.accumulate(np.where(valid, number, -1), axis=0)
    after = np.minimum.accumulate(np.where(valid, number, count)[::-1], axis=0)[::-1]
    empty, line = ~valid.any(axis=0), np.arange(valid.shape[1])
    table = measurement.stored.reshape(3, count, -1)

    def row(i: int) -> Array:
        low = np.where(before[i] >= 0, before[i], after[i])
        high = np.where(after[i] < count, after[i], low)
        low, high = np.where(empty, 0, low), np.where(empty, 0, high)
        span = coordinate[high] - coordinate[low]
        share = np.where(span > 0, (coordinate[i] - coordinate[low]) / np.where(span > 0, span, 1.0), 0.0)
        values = (1.0 - share) * table[:, low, line] + share * table[:, high, line]
        return np.where(empty, 0.0, values * measurement.scale[:, None]).reshape(3, *GRID_SHAPE[1:])

    return row


def table_error(full: Measurement, sparse: Measurement) -> float:
    """relative_rms on the full data of the sparse table, linear in theta_half or in its index, the better one."""
    return min(relative_rms(full, interpolated_rows(sparse, coordinate)) for coordinate in _COORDINATES)


def guided_table_error(full: Measurement, sparse: Measurement, model: Array) -> float:
    """relative_rms on the full data of a model's values (3, 90, 90, 180) and the sparse table of what they leave."""
    left = replace(sparse, stored=np.where(sparse.valid, sparse.values - model, 0.0), scale=np.ones(3))

    def error(coordinate: Array) -> float:
        rows = interpolated_rows(left, coordinate)
        return relative_rms(full, lambda i: model[:, i] + rows(i))

    return min(error(coordinate) for coordinate in _COORDINATES)


def relative_rms(measurement: Measurement, predict: RowPredictor) -> float:
    """relative_rms as in `dsbrdf.fitting.metrics`, of values that may depend on phi_diff."""
    error = power = 0.0
    for i in np.flatnonzero(OUTSIDE_CENTER).tolist():
        used = used_nodes(measurement, i, DEFAULT_HORIZON_CUTOFF)
        if not used.any():
            continue
        values = measurement.values_at(i)[:, used]
        error += float(np.sum((values - predict(i)[:, used]) ** 2))
        power += float(np.sum(values**2))
    return float(np.sqrt(error / power))
