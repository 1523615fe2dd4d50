"""Fit a model by the paper's procedure: Algorithm 1 on each of 18 slices of theta_diff (Nishino 2009, section 6).

The slices are 5 degrees apart. In each slice, lobes are sorted by kappa. The first lobes of all slices are one lobe of
the model, the second lobes are another lobe, and so on; kappa and gamma of a lobe are linear in theta_diff between
slices. Where theta_half < 1 degree, the mean difference between data and lobes is added to the model. If the number of
lobes is "auto", Williams' test chooses the number.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dsbrdf.arrays import Array, Indices, Mask
from dsbrdf.data.grid import CENTER_CUTOFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.reduction import Profiles
from dsbrdf.data.weighting import interval_ends
from dsbrdf.errors import FitError
from dsbrdf.fitting.metrics import OUTSIDE_CENTER
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.report import FoundModel, KnotReport, SelectionStep
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.paper import em
from dsbrdf.paper.lobe_selection import MAX_AUTOMATIC_LOBES, choose_n_lobes

PAPER_SLICES = np.radians(np.arange(0.0, 90.0, 5.0))
"""Angles theta_diff of the 18 slices of the paper, 0 to 85 degrees [rad]."""
_ANGLES = THETA_HALF[OUTSIDE_CENTER]
# Fraction of the progress at which the number of lobes has been chosen.
_SELECTION_PROGRESS = 0.8


def fit_slicewise(data: Profiles, options: FitOptions, progress: Callable[[float], None]) -> FoundModel:
    """Fit all slices of all channels in one batch; if the number of lobes is "auto", once for each possible number.

    `progress` is called with the completed fraction. Raises FitError if the options leave no data to fit.
    """
    rows = np.searchsorted(THETA_DIFF, PAPER_SLICES - 1e-9)
    kept = (THETA_HALF <= np.pi / 2 - options.resolved_mask * PAPER_SLICES[:, None] + 1e-9)[:, OUTSIDE_CENTER]
    mean, weight, within = (part[:, rows][:, :, OUTSIDE_CENTER] for part in (data.mean, data.weight, data.within))
    weight, within = np.where(kept, weight, 0.0), np.where(kept, within, 0.0)
    largest_kappa, n_nodes = _largest_kappa(data, rows), np.count_nonzero(weight, axis=2)

    def fit(chosen: Mask, n_lobes: int, done: float, share: float) -> em.SliceFits:
        """Run Algorithm 1 on slices in the mask (channels, slices); the progress rises from `done` by `share`."""
        return em.fit_slices(
            _ANGLES,
            mean[chosen],
            weight[chosen],
            n_lobes,
            iterations=options.em_iterations,
            robust=options.robust,
            largest_kappa=largest_kappa[chosen],
            on_iteration=lambda number: progress(done + share * (number / options.em_iterations)),
        )

    n_lobes, selection, done = options.n_lobes, tuple[SelectionStep, ...](), 0.0
    if n_lobes == "auto":
        compared = _compared(n_nodes)
        n_lobes, done, share = 1, _SELECTION_PROGRESS, _SELECTION_PROGRESS / MAX_AUTOMATIC_LOBES
        if compared.any():
            n_lobes, selection = choose_n_lobes(
                _ANGLES,
                mean[compared],
                weight[compared],
                within[compared],
                lambda number: fit(compared, number, (number - 1) * share, share),
            )
    # A slice with fewer nodes than parameters is not fitted, because its data do not determine the parameters.
    fitted = n_nodes >= 2 * n_lobes
    if not fitted.any(axis=1).all():
        raise FitError(
            "the mask and the horizon cutoff leave no slice with enough valid samples to fit: "
            "raise the horizon cutoff or lower the mask or the number of lobes"
        )
    slices = fit(fitted, n_lobes, done, 1.0 - done)
    nearest = _nearest_fitted(fitted)
    kappa, gamma = _spread(slices.kappa, fitted, nearest), _spread(slices.gamma, fitted, nearest)
    delta = _delta(data, rows, kappa, gamma)
    model = DSBRDF(PAPER_SLICES, np.expm1(kappa), kappa, gamma, delta=delta, interpolation="linear")
    bounds_hit = _bounds_hit(slices, largest_kappa[fitted])
    found = (_spread(part, fitted, nearest) for part in (slices.converged, slices.iterations, bounds_hit))
    return FoundModel(model, KnotReport.from_arrays(PAPER_SLICES, fitted, *found), selection=selection)


def _compared(n_nodes: Indices) -> Mask:
    """Return the mask of the slices on which numbers of lobes are compared, given the number of nodes of each slice.

    These slices have enough nodes for the largest number of lobes; if a channel has no such slice, at least two nodes.
    """
    enough = n_nodes >= 2 * MAX_AUTOMATIC_LOBES
    return enough if enough.any(axis=1).all() else n_nodes >= 2


def _largest_kappa(data: Profiles, rows: Indices) -> Array:
    """Return the kappa of a lobe whose height is twice the largest value of a slice, (channels, slices).

    Fits of a slice use this kappa as an upper bound. Data at theta_half below 1 degree are not fitted, so that without
    a bound a steep lobe could have any height there. A slice without data at theta_half below 1 degree has no bound of
    kappa.
    """
    centre_seen = np.any(data.weight[:, rows][:, :, ~OUTSIDE_CENTER] > 0, axis=2)
    return np.where(centre_seen, np.log1p(2.0 * data.mean[:, rows].max(axis=2)), np.inf)


def _nearest_fitted(fitted: Mask) -> Indices:
    """Return for each slice the index of the nearest fitted slice, or 0 if its channel has none, (channels, slices)."""
    index = np.arange(fitted.shape[1])
    distance = np.where(fitted[:, None, :], np.abs(index[:, None] - index), np.inf)
    return np.argmin(distance, axis=2)


def _spread(values: NDArray[Any], fitted: Mask, nearest: Indices) -> NDArray[Any]:
    """Copy values of fitted slices to all slices (channels, slices, ...); the nearest fitted slice fills a gap."""
    full = np.zeros((*fitted.shape, *values.shape[1:]), values.dtype)
    full[fitted] = values
    return full[np.arange(len(fitted))[:, None], nearest]


def _delta(data: Profiles, rows: Indices, kappa: Array, gamma: Array) -> Array:
    """Return the mean residual of each slice where theta_half < 1 degree, weighted by solid angle, (channels, slices).

    A negative mean residual becomes 0, because subtracting it could make the model negative between nodes. A slice
    without such data has the mean residual of the nearest slice.
    """
    center = np.flatnonzero(~OUTSIDE_CENTER)
    solid_angle = np.diff(-np.cos(interval_ends(THETA_HALF[center], CENTER_CUTOFF)))
    weight = data.weight[:, rows][:, :, center] * solid_angle
    # The logarithm of the cosine is computed from the sine, because the cosine loses the digits of small angles.
    log_cos = 0.5 * np.log1p(-(np.sin(THETA_HALF[center]) ** 2))
    lobes = np.expm1(kappa[..., None] * np.exp(gamma[..., None] * log_cos)).sum(axis=2)
    total = weight.sum(-1)
    residual = np.sum(weight * (data.mean[:, rows][:, :, center] - lobes), axis=-1) / np.where(total > 0, total, 1.0)
    return np.maximum(np.take_along_axis(residual, _nearest_fitted(total > 0), axis=1), 0.0)


def _bounds_hit(slices: em.SliceFits, largest_kappa: Array) -> Mask:
    """Return for each slice whether kappa or gamma of any lobe is at a bound."""
    low = (slices.kappa <= em.EM_KAPPA_BOUNDS[0] * (1 + 1e-9)) | (slices.gamma <= em.EM_GAMMA_BOUNDS[0] * (1 + 1e-9))
    highest = np.minimum(largest_kappa, em.EM_KAPPA_BOUNDS[1])[:, None]
    high = (slices.kappa >= highest * (1 - 1e-9)) | (slices.gamma >= em.EM_GAMMA_BOUNDS[1] * (1 - 1e-9))
    return np.any(low | high, axis=1)
