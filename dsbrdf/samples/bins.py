"""Prepare scattered samples for the fit.

A prediction from the samples (`dsbrdf.samples.prediction`) fills a table over theta_diff, theta_half and phi_diff,
which is fitted like a measured table. The last fit adds each sample at its own angles, except that theta_diff is moved
to the nearest whole degree. All samples together weigh as much as the whole table. A node of the table near a sample
weighs less than other nodes, because the sample replaces it.
"""

import numpy as np

from dsbrdf.arrays import Array, Indices
from dsbrdf.data.geometry import above_horizon, half_difference
from dsbrdf.data.grid import PHI_DIFF, QUARTER, THETA_DIFF, THETA_HALF
from dsbrdf.data.reduction import N_BINS, SAMPLES_IN_BIN, FoldedProfiles, Profiles
from dsbrdf.fitting.fit_data import FitData
from dsbrdf.fitting.global_method import FIT_COLUMNS, FIT_ROWS, USED_COLUMNS, USED_ROWS, fit_weights
from dsbrdf.fitting.options import FitOptions
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.samples.prediction import SamplePrediction
from dsbrdf.samples.scattered_samples import ScatteredSamples

# A node of the table gets half weight if its uncertainty equals this relative error, the smallest that lobes reach.
_MODEL_ERROR = 0.015
# A node of the table keeps at least this fraction of its weight, however near to samples or uncertain the node is.
_MIN_NODE_WEIGHT = 1e-3
# The value of a sample changes by at most this factor when the sample moves to the nearest whole degree of theta_diff.
_MAX_MOVE_RATIO = 16.0


def predicted_profiles(samples: ScatteredSamples, prediction: SamplePrediction, options: FitOptions) -> Profiles:
    """Return the table that is predicted from samples, at the theta_diff and theta_half that a fit uses."""
    cells = np.stack([axis.ravel() for axis in np.meshgrid(USED_ROWS, USED_COLUMNS, np.arange(N_BINS), indexing="ij")])
    count = _nodes_in_cells(cells)
    cells, count = cells[:, count.any(axis=1)], count[count.any(axis=1)]
    total = count.sum(axis=1)
    squared_cosine = count @ np.cos(PHI_DIFF[:QUARTER]) ** 2 / total
    angles = THETA_HALF[cells[1]], THETA_DIFF[cells[0]], np.arccos(np.sqrt(squared_cosine))
    shape = (THETA_DIFF.size, THETA_HALF.size, N_BINS)
    weight, mean, cos2_phi = np.zeros((3, *shape)), np.zeros((3, *shape)), np.zeros(shape)
    weight[:, *cells], mean[:, *cells], cos2_phi[*cells] = (
        total,
        prediction.evaluate_unmasked(*angles).T,
        squared_cosine,
    )
    over_phi = weight.sum(axis=3)
    level = np.sum(weight * mean, axis=3) / np.where(over_phi > 0.0, over_phi, 1.0)
    within = np.sum(weight * (mean - level[..., np.newaxis]) ** 2, axis=3)
    made = (options.horizon_cutoff, "plain", options.robust)
    folded = FoldedProfiles(mean, weight, cos2_phi)
    return Profiles(level, over_phi, within, folded, *made, samples.name, samples.sha256)


def sample_rows(
    samples: ScatteredSamples, table: Profiles, options: FitOptions, prediction: SamplePrediction, model: DSBRDF
) -> FitData:
    """Return the data of a fit: the samples, moved to whole degrees of theta_diff, and the table predicted from them.

    When a sample moves, its value is multiplied by the ratio of the model's values at the new and the old theta_diff.
    Samples are weighted relative to each other like nodes of the table.
    """
    weight, folded = fit_weights(table, options), table.folded
    cells = np.stack(np.nonzero(folded.weight[0])).astype(np.intp)
    cells = cells[:, np.isin(cells[0], FIT_ROWS) & np.isin(cells[1], FIT_COLUMNS)]
    predicted, counted = folded.mean[:, *cells], weight[:, *cells]
    each = weight / np.where(folded.weight > 0.0, folded.weight, 1.0)
    theta_half, theta_diff, phi_diff = half_difference(samples.omega_in, samples.omega_out)
    at_sample = each[:, *_cells(theta_half, theta_diff, phi_diff)] * samples.weight
    row = _nearest(THETA_DIFF, theta_diff)
    there, here = (model.evaluate_unmasked(theta_half, angle, phi_diff) for angle in (THETA_DIFF[row], theta_diff))
    values = samples.values * np.clip(there / np.maximum(here, 1e-300), 1.0 / _MAX_MOVE_RATIO, _MAX_MOVE_RATIO)
    sample_weight = np.sum(counted * predicted**2) / max(float(np.sum(at_sample * values.T**2)), 1e-300)
    nodes = THETA_HALF[cells[1]], THETA_DIFF[cells[0]], np.arccos(np.sqrt(folded.cos2_phi[*cells]))
    spread, remote = prediction.spread(*nodes), prediction.remoteness(*nodes, samples)
    counted = counted * np.maximum(remote * _MODEL_ERROR**2 / (_MODEL_ERROR**2 + spread**2), _MIN_NODE_WEIGHT)
    return FitData.from_samples(
        np.concatenate([values, predicted.T]),
        np.concatenate([sample_weight * at_sample.T, counted.T]),
        np.concatenate([row, cells[0]]),
        np.concatenate([theta_half, nodes[0]]),
        np.concatenate([phi_diff, nodes[2]]),
    )


def _cells(theta_half: Array, theta_diff: Array, phi_diff: Array) -> Indices:
    """Return the indices of theta_diff, theta_half and bin of phi_diff in the table for each sample, shape (3, n)."""
    row = FIT_ROWS[_nearest(THETA_DIFF[FIT_ROWS], theta_diff)]
    column = FIT_COLUMNS[_nearest(np.sqrt(THETA_HALF[FIT_COLUMNS]), np.sqrt(theta_half))]
    turned = np.degrees(phi_diff) % 180.0
    folded_phi = np.minimum(turned, 180.0 - turned)
    bin_of = np.rint(folded_phi).astype(np.intp) // 10
    return np.stack([row, column, bin_of])


def _nearest(axis: Array, angles: Array) -> Indices:
    """Return, for each of `angles`, the index of the nearest angle of the ascending `axis`."""
    return np.searchsorted(0.5 * (axis[1:] + axis[:-1]), angles)


def _nodes_in_cells(cells: Indices) -> Array:
    """Return the weight of each phi_diff from 0 to 90 degrees in each cell, (cells, 91); 0 below the horizon."""
    row, column, bin_of = cells
    above = above_horizon(THETA_HALF[column, np.newaxis], THETA_DIFF[row, np.newaxis], PHI_DIFF[:QUARTER])
    return np.asarray(SAMPLES_IN_BIN.T[bin_of] * above)
