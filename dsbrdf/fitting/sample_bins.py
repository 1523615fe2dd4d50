"""Scattered samples as folded profiles: what the fit works on, without a table in between.

A sample is put into the nearest of the rows and columns of the grid that the fit uses, and into its bin of phi_diff.
There the model has another value than where the sample was taken.  Once there is a model, the sample is multiplied by
the ratio of the two, so that what was lost by moving it comes back with each fit.
"""

import numpy as np
from numpy.typing import NDArray

from dsbrdf.data.geometry import above_horizon, half_difference
from dsbrdf.data.grid import PHI_DIFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.reduction import IN_BIN, N_BINS, FoldedProfiles, Profiles
from dsbrdf.data.scattered_samples import ScatteredSamples
from dsbrdf.fitting.global_method import FIT_COLUMNS, FIT_ROWS
from dsbrdf.fitting.metrics import Metrics
from dsbrdf.fitting.options import FitOptions
from dsbrdf.model.dsbrdf import DSBRDF

__all__ = ["sample_profiles", "scattered_metrics"]

Array = NDArray[np.float64]

_LARGEST_RATIO = 16.0  # a model that differs by more between a sample and its bin is not to be trusted with moving it
_QUARTER = PHI_DIFF.size // 2 + 1


def sample_profiles(samples: ScatteredSamples, options: FitOptions, model: DSBRDF | None = None) -> Profiles:
    """Put samples into bins.

    Parameters
    ----------
    samples : ScatteredSamples
    options : FitOptions
        Of the fit; they are noted in the result.
    model : DSBRDF, optional
        A fit of the samples, by which they are moved to their bins.

    Returns
    -------
    Profiles
    """
    theta_half, theta_diff, phi_diff = half_difference(samples.omega_in, samples.omega_out)
    row = FIT_ROWS[_nearest(THETA_DIFF[FIT_ROWS], theta_diff)]
    column = FIT_COLUMNS[_nearest(np.sqrt(THETA_HALF[FIT_COLUMNS]), np.sqrt(theta_half))]
    turned = np.degrees(phi_diff) % 180.0
    folded_phi = np.minimum(turned, 180.0 - turned)
    bin_of = np.minimum(np.rint(folded_phi).astype(np.intp) * N_BINS // 90, N_BINS - 1)
    cells, cell = np.unique(np.stack([row, column, bin_of]), axis=1, return_inverse=True)
    values = samples.values
    if model is not None:
        at_sample = model.evaluate_unmasked(theta_half, theta_diff, phi_diff)
        ratio = _mean_in_cells(model, cells)[cell] / np.maximum(at_sample, 1e-300)
        values = values * np.clip(ratio, 1.0 / _LARGEST_RATIO, _LARGEST_RATIO)
    shape = (THETA_DIFF.size, THETA_HALF.size, N_BINS)
    weight, mean = np.zeros((3, *shape)), np.zeros((3, *shape))
    total = np.bincount(cell, samples.weight)
    for channel in range(3):
        weight[channel][*cells] = total
        mean[channel][*cells] = np.bincount(cell, samples.weight * values[:, channel]) / total
    cos2_phi = np.zeros(shape)
    cos2_phi[*cells] = _cos2_in_cells(cells)
    return _profiles(samples, options, FoldedProfiles(mean, weight, cos2_phi))


def scattered_metrics(model: DSBRDF, samples: ScatteredSamples) -> Metrics:
    """Errors of a model on samples: relative_rms and male, weighted; the others need a whole measurement."""
    fitted = model.evaluate_directions(samples.omega_in, samples.omega_out)
    cosine, weight = samples.omega_in[:, 2:], samples.weight[:, np.newaxis]
    error, signal = np.sum(weight * (samples.values - fitted) ** 2), np.sum(weight * samples.values**2)
    log_error = np.abs(np.log1p(samples.values * cosine) - np.log1p(fitted * cosine))
    return Metrics(
        relative_rms=float(np.sqrt(error / signal)),
        male=float(np.average(log_error.mean(axis=1), weights=samples.weight)),
    )


def _profiles(samples: ScatteredSamples, options: FitOptions, folded: FoldedProfiles) -> Profiles:
    total = folded.weight.sum(axis=3)
    mean = np.sum(folded.weight * folded.mean, axis=3) / np.where(total > 0.0, total, 1.0)
    within = np.sum(folded.weight * (folded.mean - mean[..., np.newaxis]) ** 2, axis=3)
    made = (options.horizon_cutoff, "plain", options.robust)
    return Profiles(mean, total, within, folded, *made, samples.name, samples.sha256)


def _nearest(axis: Array, angles: Array) -> NDArray[np.intp]:
    """Index of the nearest of ascending angles."""
    return np.searchsorted(0.5 * (axis[1:] + axis[:-1]), angles)


def _nodes_in_cells(cells: NDArray[np.intp]) -> tuple[NDArray[np.intp], Array]:
    """Nodes of phi_diff, from 0 to 90 degrees, and what each counts in each cell, shape (cells, 91).

    Those above the horizon count, as in a measurement on the grid, or all where none is.
    """
    row, column, bin_of = cells
    members = IN_BIN[:_QUARTER].T[bin_of] * np.where(np.arange(_QUARTER) % (_QUARTER - 1) == 0, 1.0, 2.0)
    above = above_horizon(THETA_HALF[column, np.newaxis], THETA_DIFF[row, np.newaxis], PHI_DIFF[:_QUARTER])
    counted = members * above
    return np.arange(_QUARTER), np.where(counted.any(axis=1, keepdims=True), counted, members)


def _cos2_in_cells(cells: NDArray[np.intp]) -> Array:
    nodes, count = _nodes_in_cells(cells)
    return np.asarray(count @ np.cos(PHI_DIFF[nodes]) ** 2 / count.sum(axis=1))


def _mean_in_cells(model: DSBRDF, cells: NDArray[np.intp]) -> Array:
    """Mean of the model over the nodes of each cell, shape (cells, 3)."""
    nodes, count = _nodes_in_cells(cells)
    at, node = np.nonzero(count)
    row, column, _ = cells[:, at]
    values = model.evaluate_unmasked(THETA_HALF[column], THETA_DIFF[row], PHI_DIFF[nodes[node]])
    weighted = values * count[at, node, np.newaxis]
    sums = np.stack([np.bincount(at, weighted[:, channel], len(count)) for channel in range(3)], axis=1)
    return np.asarray(sums / count.sum(axis=1, keepdims=True))
