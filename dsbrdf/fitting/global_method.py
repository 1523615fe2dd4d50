"""The default fit: one least-squares problem over the whole measurement.

Where the paper fits slices one by one and then interpolates, this fits all rows of theta_diff at once with the
parameters at the knots as unknowns: the data between the knots count, and the lobes keep their identity from knot to
knot and from channel to channel.  search -> refine -> align the channels -> delta.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from dsbrdf.data.grid import THETA_DIFF, THETA_HALF
from dsbrdf.data.reduction import Profiles
from dsbrdf.errors import FitError
from dsbrdf.fitting.em import GAMMA_BOUNDS, KAPPA_BOUNDS, huber_weights
from dsbrdf.fitting.knot_placement import place_knots
from dsbrdf.fitting.least_squares import FitData, ProfileProblem, Refined, minimize
from dsbrdf.fitting.lobe_selection import Structure, find_structure
from dsbrdf.fitting.metrics import OUTSIDE_CENTER, on_grid
from dsbrdf.fitting.options import FitOptions
from dsbrdf.model.decomposition import lobe_extents, weighted_median
from dsbrdf.model.dsbrdf import DSBRDF

Array = NDArray[np.float64]

N_KNOTS = 14
"""Knots placed by default; cubic interpolation needs a quarter fewer than the paper's 18 slices."""
CENTER_SHARE = 1e-4
"""What theta_half < 1 degree counts in a row, beside the rest."""
CENTER_GAP = float(np.radians(2.0))
"""Where no other node lies within this of the normal, those below 1 degree are all there is of a spike [rad]."""
TOLERANCE = 1e-5
MAX_ITERATIONS = 150
_ROBUST_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class GlobalFit:
    """Model and what the report says of it, see `dsbrdf.FitReport`."""

    model: DSBRDF
    slices: dict[str, list[Any]]
    selection: list[dict[str, Any]]
    rings: list[dict[str, Any]]


def fit_global(
    data: Profiles, options: FitOptions, progress: Callable[[float], None], lap: Callable[[str], None]
) -> GlobalFit:
    """Fit all rows at once.

    Parameters
    ----------
    data : Profiles
    options : FitOptions
    progress : callable
        Called with the share of the work done.
    lap : callable
        Called with the name of each step that has ended.

    Returns
    -------
    GlobalFit

    Raises
    ------
    FitError
        If the options leave no data to fit.
    """
    used = _select(data, options)
    knots = _knots(used, options)
    structure = find_structure(used, knots, options.n_lobes, options.ring_lobes, _Ticker(progress, 0.5, 24).tick)
    lap("search")
    rows = np.flatnonzero(used.weight.sum(axis=(0, 2)) > 0)
    refined = _refine(used, knots, rows, structure, options, lambda share: progress(0.5 + 0.5 * share))
    model = _align(_model(knots, structure, refined.unknowns))
    model = _with_delta(model, data)
    lap("refine")
    count = knots.size
    slices = {
        "theta_diff": THETA_DIFF[knots].tolist(),
        "fitted": (used.weight[:, knots].sum(axis=2) > 0).tolist(),
        "converged": np.repeat(refined.converged[:, None], count, axis=1).tolist(),
        "iterations": np.repeat(refined.iterations[:, None], count, axis=1).tolist(),
        "bounds_hit": _bounds_hit(model).tolist(),
    }
    return GlobalFit(model, slices, structure.selection, structure.rings)


def _select(data: Profiles, options: FitOptions) -> FitData:
    """Mask what is masked, and keep theta_half < 1 degree from deciding.

    Values there are unreliable for shiny materials (Nishino 2009, section 6), but without them nothing tells a spike
    from one that is a thousand times as high.  So they count, together, `CENTER_SHARE` of the row's signal; fully, if
    nothing else is measured within `CENTER_GAP`.
    """
    mask = 0.0 if options.mask is None else options.mask
    kept = THETA_HALF <= np.pi / 2 - mask * THETA_DIFF[:, None] + 1e-9
    weight = np.where(kept, data.weight, 0.0)
    if not (weight[:, :, OUTSIDE_CENTER] > 0).any():
        raise FitError("the mask and the horizon cutoff leave no valid samples: raise the cutoff or lower the mask")
    signal = weight * data.mean**2
    inside, outside = signal[:, :, ~OUTSIDE_CENTER].sum(axis=2), signal[:, :, OUTSIDE_CENTER].sum(axis=2)
    share = np.minimum(CENTER_SHARE * outside / np.where(inside > 0, inside, np.inf), 1.0)
    if (weight[:, :, OUTSIDE_CENTER & (THETA_HALF < CENTER_GAP)] > 0).any():
        weight[:, :, ~OUTSIDE_CENTER] *= share[:, :, None]
    within = np.where(kept & OUTSIDE_CENTER, data.within, 0.0)
    return FitData(data.mean, weight, within, np.where(weight > 0, data.mean, 0.0).max(axis=2))


def _knots(used: FitData, options: FitOptions) -> NDArray[np.intp]:
    if options.knots is None:
        return place_knots(used.mean, used.weight, N_KNOTS)
    return np.round(np.degrees(options.knots)).astype(np.intp)


def _refine(
    used: FitData,
    knots: NDArray[np.intp],
    rows: NDArray[np.intp],
    structure: Structure,
    options: FitOptions,
    progress: Callable[[float], None],
) -> Refined:
    """Least squares over all rows; with outliers weighted down, for some rounds."""
    lobes, unknowns = structure.mixture.lobes, structure.mixture.unknowns
    rounds = _ROBUST_ROUNDS if options.robust else 1
    for number in range(rounds):
        problem = ProfileProblem(used, knots, rows)
        if number > 0:
            shape = problem.mean.shape
            residual = problem.residuals(lobes, unknowns) / np.where(problem.root > 0, problem.root, np.inf)
            trust = huber_weights(residual.reshape(-1, shape[2]), problem.weight.reshape(-1, shape[2])).reshape(shape)
            weight = used.weight.copy()
            weight[:, rows] *= trust
            problem = ProfileProblem(replace(used, weight=weight), knots, rows)
        refined = minimize(
            problem,
            lobes,
            unknowns,
            tolerance=TOLERANCE,
            iterations=MAX_ITERATIONS,
            on_iteration=lambda i, n=number: progress((n + i / MAX_ITERATIONS) / rounds),  # type: ignore[misc]
        )
        unknowns = refined.unknowns
    return refined


def _model(knots: NDArray[np.intp], structure: Structure, unknowns: Array) -> DSBRDF:
    lobes = structure.mixture.lobes
    log_kappa, log_gamma, rings = lobes.split(unknowns)
    center = np.concatenate([np.zeros((*rings.shape[:2], lobes.centered)), rings], axis=2)
    delta = np.zeros(rings.shape[:2])
    return DSBRDF(THETA_DIFF[knots], np.exp(log_kappa), np.exp(log_gamma), center, delta, "cubic")


def _align(model: DSBRDF) -> DSBRDF:
    """Order the lobes from narrow to wide, rings last, and match them between channels by their extent."""
    extent, power = lobe_extents(model)
    rings = np.any(model.center > 0, axis=(0, 1))
    typical = np.array(
        [[weighted_median(extent[c, :, k], power[c, :, k]) for k in range(model.n_lobes)] for c in range(3)]
    )
    reference = int(np.argmax(power.sum(axis=(1, 2))))
    order = np.lexsort((typical[reference], rings))
    columns = []
    for channel in range(3):
        ratio = np.abs(np.log(typical[channel][:, None] / typical[reference][order]))
        unlike = rings[:, None] != rings[order]
        chosen, place = linear_sum_assignment(np.where(unlike, 1e6, ratio))
        columns.append(chosen[np.argsort(place)])
    index = np.array(columns)[:, None, :]
    kappa, gamma, center = (np.take_along_axis(p, index, axis=2) for p in (model.kappa, model.gamma, model.center))
    return DSBRDF(model.theta_diff, kappa, gamma, center, model.delta, model.interpolation)


def _with_delta(model: DSBRDF, data: Profiles) -> DSBRDF:
    """Add the delta term: least squares of what is left where theta_half < 1 degree, over all rows.

    It never takes away more than the lobes put there, so that the model stays positive.
    """
    weight = data.weight[:, :, ~OUTSIDE_CENTER]
    values = on_grid(model)[:, :, ~OUTSIDE_CENTER]
    total = weight.sum(axis=2)
    residual = np.einsum("crn,crn->cr", weight, data.mean[:, :, ~OUTSIDE_CENTER] - values)
    basis = np.array([np.interp(THETA_DIFF, model.theta_diff, unit) for unit in np.eye(model.theta_diff.size)])
    normal = np.einsum("dr,cr,er->cde", basis, total, basis)
    ridge = 1e-9 * np.maximum(total.sum(axis=1), 1.0)[:, None, None] * np.eye(model.theta_diff.size)
    delta = np.linalg.solve(normal + ridge, (residual @ basis.T)[..., None])[..., 0]
    lowest = np.array([values[c][:, :].min(axis=1) for c in range(3)])
    at_knots = np.searchsorted(THETA_DIFF, model.theta_diff - 1e-9)
    delta = np.maximum(delta, -lowest[:, at_knots])
    return DSBRDF(model.theta_diff, model.kappa, model.gamma, model.center, delta, model.interpolation)


def _bounds_hit(model: DSBRDF) -> NDArray[np.bool_]:
    """Whether any lobe of a knot stands at a bound of kappa or gamma, shape (3, D)."""
    low = (model.kappa <= KAPPA_BOUNDS[0] * (1 + 1e-9)) | (model.gamma <= GAMMA_BOUNDS[0] * (1 + 1e-9))
    high = (model.kappa >= KAPPA_BOUNDS[1] * (1 - 1e-9)) | (model.gamma >= GAMMA_BOUNDS[1] * (1 - 1e-9))
    return np.any(low | high, axis=2)


class _Ticker:
    """Progress of a search whose length is known roughly: each tick takes its share of what is left."""

    def __init__(self, progress: Callable[[float], None], end: float, expected: int) -> None:
        self._progress, self._end, self._expected, self._done = progress, end, expected, 0

    def tick(self) -> None:
        self._done += 1
        self._progress(self._end * min(self._done / self._expected, 1.0))
