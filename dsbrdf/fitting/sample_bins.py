"""Scattered samples as what the fit works on, without a table in between.

For the search a sample is put into the nearest of the rows and columns of the grid that the fit uses, and into its bin
of phi_diff. Once there is a model, the sample is multiplied by the ratio of its values there and where the sample was
taken. The last fits take each sample where it is, but for its theta_diff, which is moved by less than a degree.
"""

import numpy as np

from dsbrdf.arrays import Array, Indices
from dsbrdf.data.geometry import above_horizon, half_difference
from dsbrdf.data.grid import PHI_DIFF, QUARTER, THETA_DIFF, THETA_HALF
from dsbrdf.data.reduction import N_BINS, SAMPLES_IN_BIN, FoldedProfiles, Profiles
from dsbrdf.data.scattered_samples import ScatteredSamples
from dsbrdf.fitting.global_method import FIT_COLUMNS, FIT_ROWS, fit_weights, weight_per_sample
from dsbrdf.fitting.least_squares import FitData
from dsbrdf.fitting.metrics import Metrics
from dsbrdf.fitting.options import FitOptions
from dsbrdf.model.dsbrdf import DSBRDF

_LARGEST_RATIO = 16.0  # a model that differs by more between a sample and its bin is not to be trusted with moving it


def sample_profiles(samples: ScatteredSamples, options: FitOptions, model: DSBRDF | None = None) -> Profiles:
    """Put samples into bins, moved there by a model that was fitted to them, if there is one."""
    angles = half_difference(samples.omega_in, samples.omega_out)
    cells, cell = np.unique(_cells(*angles), axis=1, return_inverse=True)
    values = samples.values
    if model is not None:
        values = values * _ratio(_mean_in_cells(model, cells)[cell], model.evaluate_unmasked(*angles))
    shape = (THETA_DIFF.size, THETA_HALF.size, N_BINS)
    weight, mean = np.zeros((3, *shape)), np.zeros((3, *shape))
    total = np.bincount(cell, samples.weight)
    for channel in range(3):
        weight[channel][*cells] = total
        mean[channel][*cells] = np.bincount(cell, samples.weight * values[:, channel]) / total
    cos2_phi = np.zeros(shape)
    count = _nodes_in_cells(cells)
    cos2_phi[*cells] = count @ np.cos(PHI_DIFF[:QUARTER]) ** 2 / count.sum(axis=1)
    over_phi = weight.sum(axis=3)
    level = np.sum(weight * mean, axis=3) / np.where(over_phi > 0.0, over_phi, 1.0)
    within = np.sum(weight * (mean - level[..., np.newaxis]) ** 2, axis=3)
    made = (options.horizon_cutoff, "plain", options.robust)
    folded = FoldedProfiles(mean, weight, cos2_phi)
    return Profiles(level, over_phi, within, folded, *made, samples.name, samples.sha256)


def sample_rows(samples: ScatteredSamples, binned: Profiles, options: FitOptions, model: DSBRDF) -> FitData:
    """Put samples into rows of whole degrees of theta_diff, each at its own theta_half and phi_diff.

    They are moved to their rows by a model that was fitted to them, and get the weights of the same samples in bins.
    """
    angles = half_difference(samples.omega_in, samples.omega_out)
    weight = weight_per_sample(binned, fit_weights(binned, options))[:, *_cells(*angles)] * samples.weight
    theta_half, theta_diff, phi_diff = angles
    row = _nearest(THETA_DIFF, theta_diff)
    at_row = model.evaluate_unmasked(theta_half, THETA_DIFF[row], phi_diff)
    values = samples.values * _ratio(at_row, model.evaluate_unmasked(*angles))
    return FitData.from_samples(values, weight.T, row, theta_half, phi_diff)


def scattered_metrics(model: DSBRDF, samples: ScatteredSamples, horizon_cutoff: float | None = None) -> Metrics:
    """Errors of a model on samples: relative_rms within the cutoff, male over all; others need a whole measurement."""
    fitted = model.evaluate_directions(samples.omega_in, samples.omega_out)
    cosine, weight = samples.omega_in[:, 2:], samples.weight[:, np.newaxis]
    lowest = np.minimum(samples.omega_in[:, 2:], samples.omega_out[:, 2:])
    within = weight * (lowest >= np.cos(np.pi / 2 if horizon_cutoff is None else horizon_cutoff))
    error, signal = np.sum(within * (samples.values - fitted) ** 2), np.sum(within * samples.values**2)
    log_error = np.abs(np.log1p(samples.values * cosine) - np.log1p(fitted * cosine))
    return Metrics(
        relative_rms=float(np.sqrt(error / signal)) if signal > 0.0 else None,
        male=float(np.average(log_error.mean(axis=1), weights=samples.weight)),
    )


def _cells(theta_half: Array, theta_diff: Array, phi_diff: Array) -> Indices:
    """Row, column and bin of phi_diff of each sample, shape (3, n)."""
    row = FIT_ROWS[_nearest(THETA_DIFF[FIT_ROWS], theta_diff)]
    column = FIT_COLUMNS[_nearest(np.sqrt(THETA_HALF[FIT_COLUMNS]), np.sqrt(theta_half))]
    turned = np.degrees(phi_diff) % 180.0
    folded_phi = np.minimum(turned, 180.0 - turned)
    bin_of = np.minimum(np.rint(folded_phi).astype(np.intp) * N_BINS // 90, N_BINS - 1)
    return np.stack([row, column, bin_of])


def _ratio(there: Array, here: Array) -> Array:
    return np.clip(there / np.maximum(here, 1e-300), 1.0 / _LARGEST_RATIO, _LARGEST_RATIO)


def _nearest(axis: Array, angles: Array) -> Indices:
    """Index of the nearest of ascending angles."""
    return np.searchsorted(0.5 * (axis[1:] + axis[:-1]), angles)


def _nodes_in_cells(cells: Indices) -> Array:
    """What each node of phi_diff, from 0 to 90 degrees, counts in each cell, shape (cells, 91).

    Those above the horizon count, as in a measurement on the grid, or all where none is.
    """
    row, column, bin_of = cells
    members = SAMPLES_IN_BIN.T[bin_of]
    above = above_horizon(THETA_HALF[column, np.newaxis], THETA_DIFF[row, np.newaxis], PHI_DIFF[:QUARTER])
    counted = members * above
    return np.where(counted.any(axis=1, keepdims=True), counted, members)


def _mean_in_cells(model: DSBRDF, cells: Indices) -> Array:
    """Mean of the model over the nodes of each cell, shape (cells, 3)."""
    count = _nodes_in_cells(cells)
    at, node = np.nonzero(count)
    row, column, _ = cells[:, at]
    values = model.evaluate_unmasked(THETA_HALF[column], THETA_DIFF[row], PHI_DIFF[node])
    weighted = values * count[at, node, np.newaxis]
    sums = np.stack([np.bincount(at, weighted[:, channel], len(count)) for channel in range(3)], axis=1)
    return np.asarray(sums / count.sum(axis=1, keepdims=True))
