"""The paper's procedure: Algorithm 1 on each of 18 slices of theta_diff, 5 degrees apart (Nishino 2009, section 6).

The lobes are matched across slices by sorting on kappa; kappa and gamma run linearly between slices; a delta term takes
what is left where theta_half < 1 degree.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dsbrdf.data.grid import CENTER_CUTOFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.reduction import Profiles
from dsbrdf.errors import FitError
from dsbrdf.fitting import em
from dsbrdf.fitting.metrics import OUTSIDE_CENTER
from dsbrdf.fitting.options import FitOptions
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.hemi_epd import lobe

Array = NDArray[np.float64]

PAPER_SLICES = np.radians(np.arange(0.0, 90.0, 5.0))
"""The 18 slices of the paper, 0 to 85 degrees [rad]."""
DEFAULT_LOBES = 3


def fit_slicewise(
    data: Profiles, options: FitOptions, progress: Callable[[float], None]
) -> tuple[DSBRDF, dict[str, list[Any]]]:
    """Fit all slices of all channels in one batch.

    Parameters
    ----------
    data : Profiles
    options : FitOptions
    progress : callable
        Called with the share of the work done at each iteration.

    Returns
    -------
    model : DSBRDF
    slices : dict
        As in `FitReport`.

    Raises
    ------
    FitError
        If the options leave no data to fit.
    """
    n_lobes = DEFAULT_LOBES if options.n_lobes == "auto" else options.n_lobes
    rows = np.searchsorted(THETA_DIFF, PAPER_SLICES - 1e-9)
    mask = 1.0 if options.mask is None else options.mask
    kept = OUTSIDE_CENTER & (THETA_HALF <= np.pi / 2 - mask * PAPER_SLICES[:, None] + 1e-9)
    weight = np.where(kept, data.weight[:, rows], 0.0)
    # A slice with fewer nodes than parameters has nothing to say about them.
    fitted = np.sum(weight > 0, axis=2) >= 2 * n_lobes
    if not fitted.any(axis=1).all():
        raise FitError(
            "the mask and the horizon cutoff leave no slice with enough valid samples to fit: "
            "raise the horizon cutoff or lower the mask or the number of lobes"
        )
    columns = np.flatnonzero(OUTSIDE_CENTER)
    largest_kappa = _largest_kappa(data, rows)[fitted]
    slices = em.fit_slices(
        THETA_HALF[columns],
        data.mean[:, rows][fitted][:, columns],
        weight[fitted][:, columns],
        n_lobes,
        iterations=options.em_iterations,
        robust=options.robust,
        largest_kappa=largest_kappa,
        on_iteration=lambda number: progress(number / options.em_iterations),
    )
    nearest = _nearest_fitted(fitted)
    kappa, gamma = _spread(slices.kappa, fitted, nearest), _spread(slices.gamma, fitted, nearest)
    delta = _delta(data, rows, kappa, gamma)
    model = DSBRDF(PAPER_SLICES, np.expm1(kappa), kappa, gamma, delta=delta, interpolation="linear")
    report = {
        "theta_diff": PAPER_SLICES.tolist(),
        "fitted": fitted.tolist(),
        "converged": _spread(slices.converged, fitted, nearest).tolist(),
        "iterations": _spread(slices.iterations, fitted, nearest).tolist(),
        "bounds_hit": _spread(_bounds_hit(slices, largest_kappa), fitted, nearest).tolist(),
    }
    return model, report


def _largest_kappa(data: Profiles, rows: NDArray[np.intp]) -> Array:
    """Kappa of a lobe that peaks at twice the largest value of the slice, shape (3, D); no bound without its centre.

    Below 1 degree the lobes are not fitted: without a bound one that falls steeply just outside can reach any height.
    """
    centre_seen = np.any(data.weight[:, rows][:, :, ~OUTSIDE_CENTER] > 0, axis=2)
    return np.where(centre_seen, np.log1p(2.0 * data.mean[:, rows].max(axis=2)), np.inf)


def _nearest_fitted(fitted: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Index, shape (3, D), of the fitted slice nearest to each slice of its channel; 0 if there is none."""
    index = np.arange(fitted.shape[1])
    distance = np.where(fitted[:, None, :], np.abs(index[:, None] - index), np.inf)
    return np.argmin(distance, axis=2)


def _spread(values: NDArray[Any], fitted: NDArray[np.bool_], nearest: NDArray[np.intp]) -> NDArray[Any]:
    """Values (fitted slices, ...) at all slices (3, D, ...): those without data take the nearest slice's."""
    full = np.zeros((*fitted.shape, *values.shape[1:]), values.dtype)
    full[fitted] = values
    return full[np.arange(len(fitted))[:, None], nearest]


def _delta(data: Profiles, rows: NDArray[np.intp], kappa: Array, gamma: Array) -> Array:
    """Mean residual where theta_half < 1 degree by solid angle, shape (3, D); without data that of the nearest slice.

    Never negative: a term that is taken away somewhere would make the model negative between the nodes.
    """
    center = np.flatnonzero(~OUTSIDE_CENTER)
    ends = np.concatenate([[0.0], 0.5 * (THETA_HALF[center][1:] + THETA_HALF[center][:-1]), [CENTER_CUTOFF]])
    weight = data.weight[:, rows][:, :, center] * np.diff(-np.cos(ends))
    lobes = lobe(THETA_HALF[center], kappa[..., None], gamma[..., None]).sum(axis=2)
    total = weight.sum(-1)
    residual = np.sum(weight * (data.mean[:, rows][:, :, center] - lobes), axis=-1) / np.where(total > 0, total, 1.0)
    return np.maximum(np.take_along_axis(residual, _nearest_fitted(total > 0), axis=1), 0.0)


def _bounds_hit(slices: em.SliceFits, largest_kappa: Array) -> NDArray[np.bool_]:
    """Whether any lobe of a slice stands at a bound; a vanishing or flat lobe at its lower bound is no fault."""
    low = (slices.kappa <= em.KAPPA_BOUNDS[0] * (1 + 1e-9)) | (slices.gamma <= em.GAMMA_BOUNDS[0] * (1 + 1e-9))
    highest = np.minimum(largest_kappa, em.KAPPA_BOUNDS[1])[:, None]
    high = (slices.kappa >= highest * (1 - 1e-9)) | (slices.gamma >= em.GAMMA_BOUNDS[1] * (1 - 1e-9))
    return np.any(low | high, axis=1)
