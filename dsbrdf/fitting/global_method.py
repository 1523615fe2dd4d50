"""Fit the whole measurement as one least-squares problem, the default fit.

The paper fits one slice of theta_diff after the other and interpolates. This method fits all rows of theta_diff at
once, up to the horizon. The unknowns are the control values of the parameters, so a lobe keeps its identity over all
theta_diff and channels. Lobes are searched on few rows of theta_diff and columns of theta_half, and refined on most
rows and columns.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter

from dsbrdf.arrays import Array, Indices, Mask
from dsbrdf.data.faults import clip_levels, horizon_disagreement
from dsbrdf.data.geometry import PHI_DIFF, THETA_DIFF, THETA_HALF, above_horizon
from dsbrdf.data.reduction import (
    DARK_VALUE_FRACTION,
    N_BINS,
    OUTLIER_FACTOR,
    SAMPLES_IN_BIN,
    TINY,
    Profiles,
    bin_weights,
)
from dsbrdf.errors import FitError
from dsbrdf.fitting.fit_data import FitData
from dsbrdf.fitting.least_squares import COST_TOLERANCE, Solution, minimize
from dsbrdf.fitting.lobe_search import SearchData, Wanted, search
from dsbrdf.fitting.mixture import KAPPA_BOUNDS, REACH_BOUNDS, Mixture, Structure, change_knots, mixture_model
from dsbrdf.fitting.mixture_problem import MixtureProblem
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.report import FoundModel, KnotReport
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.lobes import half_width, width_of_reach

AMPLITUDE_KNOTS = np.radians([0.0, 30.0, 55.0, 68.0, 75.0, 81.0, 89.0])
SHAPE_KNOTS = np.radians([0.0, 40.0, 65.0, 79.0, 89.0])
ELONGATION_KNOTS = np.radians([0.0, 60.0, 89.0])
"""Knots in theta_diff [rad]; knots are dense towards grazing angles, where reflectance changes fastest."""
CONSTANT_KNOT = np.zeros(1)
KNOTS = {
    "full": (AMPLITUDE_KNOTS, SHAPE_KNOTS, ELONGATION_KNOTS),
    "parametric": (np.radians([0.0, 70.0, 89.0]), CONSTANT_KNOT, CONSTANT_KNOT),
}
"""Knots of amplitudes, shapes and elongations [rad] for each variation; a single knot is a constant."""
SEARCH_KNOTS = KNOTS | {"full": (AMPLITUDE_KNOTS, np.radians([0.0, 55.0, 79.0, 89.0]), ELONGATION_KNOTS)}
FINE_KNOTS = (
    np.radians([0.0, 25.0, 50.0, 65.0, 72.0, 77.0, 81.0, 89.0]),
    np.radians([0.0, 30.0, 55.0, 70.0, 79.0, 89.0]),
    ELONGATION_KNOTS,
)
"""Knots [rad] where a small number of lobes is fixed, because few lobes need more flexible parameters."""
MAX_ITERATIONS = 300
COARSE_ITERATIONS = 10
"""Maximum iterations of the fit to a few bins of phi_diff; the fit to more bins would undo further iterations."""
REFINE_TOLERANCE = 2e-3
"""Refinement ends after two iterations in a row that lower the cost by a smaller fraction.

With half of it, a refinement takes half as long again, and errors are 1.6 % smaller.
"""
REFINE_ROUNDS = 2
ROBUST_REFINE_ROUNDS = 3
EXPECTED_SEARCH_STAGES = 5
SEARCH_ROWS = np.array([0, 10, 20, 30, 40, 48, 55, 61, 66, 70, 73, 76, 79, 82, 85, 88])
FIT_ROWS = np.concatenate([np.arange(0, 60, 6), [60, 64, 68], np.arange(70, 81), [82, 84, 86, 88, 89]])
SEARCH_COLUMNS = np.unique(np.concatenate([[0, 1, 3, 5, 7], np.arange(9, 32), np.arange(32, 90, 5)]))
HELD_OUT_ROWS = np.array([5, 15, 25, 35, 44, 52, 58, 64, 68, 72, 74, 78, 81, 84, 87])
HELD_OUT_COLUMNS = np.concatenate([np.arange(10, 32, 2), np.arange(34, 90, 5)])
FIT_COLUMNS = np.unique(np.concatenate([np.arange(30), np.arange(30, 90, 3), [89]]))
USED_ROWS = np.unique(np.concatenate([FIT_ROWS, SEARCH_ROWS, HELD_OUT_ROWS]))
USED_COLUMNS = np.unique(np.concatenate([FIT_COLUMNS, SEARCH_COLUMNS, HELD_OUT_COLUMNS]))
"""Rows and columns of a table that the fit uses.

The rows include every degree of theta_diff from 70 to 80, because reflectance is largest there and the usual horizon
cutoff is 80 degrees.
"""
SEARCH_BINS = (0, 3, 5, 8, 9)
"""Indices of the bins of phi_diff that the search uses; fewer, wider bins would be too wide for elongated lobes."""
REFINE_BINS = (0, 2, 4, 6, 8, 9)
"""Indices of the bins of phi_diff that the refinement uses; all ten take longer and lower the median excess by 2 %."""
NEIGHBOUR_COLUMNS = 5
CLIPPED_WEIGHT = 1e-4
"""Factor for the weight of a clipped value below the mixture, so that the height of the highlight is not arbitrary."""
MIN_OUTLIER_RESIDUAL = 1e-2
"""A sample with a smaller relative residual is never an outlier."""
MIN_LINES = 8
"""If fewer rows or columns with data would be selected, all rows or columns with data are used."""
MAX_WEIGHT_FOR_GAPS = 2.0
"""Maximum factor for the weight of a column that represents columns without data."""
MIN_SAMPLES = 3
SAMPLE_SMOOTHING = (1e-7, 3e-6, 1e-6)
"""Weights like `SMOOTHING` in fits of scattered samples; they are larger, because samples leave gaps."""
MIN_TABLE_LIKE_SAMPLES = 20_000
"""With fewer scattered samples, the smoothing of parameters is stronger in inverse proportion to their number."""
MIN_BINS_IN_COLUMN = 5
"""A column of theta_half with fewer filled bins per knot is no reason to allow lobes as narrow as its spacing."""
MIN_BINS_BETWEEN_KNOTS = 120
"""A knot is left out if fewer bins with data precede it: parameters between the knots would be undetermined."""


def fit_global(
    data: Profiles,
    options: FitOptions,
    progress: Callable[[float], None],
    on_stage: Callable[[str], None],
) -> tuple[FoundModel, Mixture]:
    """Fit all rows of theta_diff at once; return the model and the mixture of lobes from which it is made.

    `on_stage` is called with the name of each stage that has ended. Raises FitError if the options leave no data to
    fit.
    """
    weight = fit_weights(data, options)
    coarse, clip = _structure(weight, SEARCH_KNOTS[options.variation], options), clip_levels(data.folded)
    unclipped = np.where(data.folded.mean < clip, weight, CLIPPED_WEIGHT * weight)
    searched = tuple(
        _select(data, unclipped, *lines) for lines in ((SEARCH_ROWS, SEARCH_COLUMNS), (HELD_OUT_ROWS, HELD_OUT_COLUMNS))
    )
    stages, wanted = itertools.count(1), Wanted(options.n_lobes, options.ring_lobes)
    mixture, steps = search(
        _search_data(*searched),
        coarse,
        wanted,
        lambda tried: _search_data(*(_exact(part, tried) for part in searched)),
        lambda: progress(0.5 * min(next(stages) / EXPECTED_SEARCH_STAGES, 1.0)),
    )
    knots = FINE_KNOTS if wanted.is_few and options.variation == "full" else KNOTS[options.variation]
    fine = _structure(weight, knots, options, options.knots)
    mixture = change_knots(mixture, replace(fine, rings=mixture.structure.rings))
    on_stage("search")
    selected = _select(data, weight, FIT_ROWS, FIT_COLUMNS)
    solution = _refine(selected, clip, mixture, options, lambda fraction: progress(0.5 + 0.5 * fraction))
    on_stage("refine")
    found, mixture = _found(mixture.structure, solution, weight.sum(axis=(2, 3)) > 0)
    return replace(found, search=tuple(steps)), mixture


def refine_at_samples(data: FitData, mixture: Mixture) -> tuple[FoundModel, Mixture]:
    """Refit a mixture that was fitted to bins, to values at the exact angles of the samples.

    The data have a row for each whole degree of theta_diff that has samples.
    """
    structure = mixture.structure
    # Fewer samples determine less, so parameters must be smoother over theta_diff.
    pull = max(1.0, MIN_TABLE_LIKE_SAMPLES / np.count_nonzero(data.weight[0]))
    amplitude, shape, elongation = (pull * smoothing for smoothing in SAMPLE_SMOOTHING)
    problem = MixtureProblem(data.single(), structure, (amplitude, shape, elongation))
    solution = minimize(problem, mixture.unknowns, iterations=MAX_ITERATIONS)
    has_data = np.isin(THETA_DIFF, data.theta_diff)
    return _found(structure, solution, np.broadcast_to(has_data, (3, has_data.size)))


def _found(structure: Structure, solution: Solution, has_data: Mask) -> tuple[FoundModel, Mixture]:
    """Return the model of a solution and its report; `has_data` marks the rows with data in each channel.

    The lobes of the model are ordered from narrow to wide, with ring lobes last.
    """
    mixture = Mixture(structure, solution.unknowns)
    shape, k = structure.lobe_shapes(solution.unknowns), structure.n_lobes
    widths = half_width(np.exp(shape[:, :k]), np.exp(shape[:, k : 2 * k]), structure.family)
    order = np.lexsort((np.median(widths, axis=0), np.array(structure.rings)))
    model = mixture_model(mixture).select(tuple(order.tolist()), with_delta=False)
    knots = model.theta_diff
    nearest = np.clip(np.round(np.degrees(knots)).astype(np.intp), 0, THETA_DIFF.size - 1)
    outcome = solution.converged, solution.iterations, _bounds_hit(model)
    return FoundModel(model, KnotReport.from_arrays(knots, has_data[:, nearest], *outcome)), mixture


def fit_weights(data: Profiles, options: FitOptions) -> Array:
    """Return the weights of all bins of the profiles in a fit; masked bins have the weight 0."""
    kept = (THETA_HALF <= np.pi / 2 - options.resolved_mask * THETA_DIFF[:, None] + 1e-9)[..., None]
    unmasked = replace(data.folded, weight=np.where(kept, data.folded.weight, 0.0))
    _, trust = horizon_disagreement(unmasked, options.horizon_cutoff)
    trusted = replace(data.folded, weight=data.folded.weight * trust)
    weight = np.where(kept, bin_weights(trusted, options.resolved_weighting, options.horizon_cutoff), 0.0)
    if np.count_nonzero(weight) < MIN_SAMPLES or not np.sum(weight * data.folded.mean) > 0.0:
        raise FitError("the mask and the horizon cutoff leave no valid samples: raise the cutoff or lower the mask")
    return weight


def _search_data(fitted: FitData, held_out: FitData) -> SearchData:
    """Take the few bins of phi_diff that the search uses, in the fitted data and in the validation data."""
    thinned = fitted.take_bins(SEARCH_BINS), held_out.take_bins(SEARCH_BINS)
    fitted, held_out = thinned if thinned[0].signal > 0.0 else (fitted, held_out)
    return SearchData(fitted.single(), (held_out if held_out.signal > 0.0 else fitted).single())


def _apart(angles: Array, axis: Array, filled: Indices, fewest: int) -> list[float]:
    """Keep the first angle [rad], and each angle with at least `fewest` filled bins since the last kept angle."""
    kept = [float(angles[0])]
    for angle in angles[1:].tolist():
        if filled[(axis >= kept[-1]) & (axis < angle)].sum() >= fewest:
            kept.append(angle)
    return kept


def _structure(
    weight: Array, groups: tuple[Array, ...], options: FitOptions, amplitude_knots: tuple[float, ...] | None = None
) -> Structure:
    """Return a structure without lobes on those knots [rad] between which there are enough data.

    Knots that the user has chosen are always kept.
    """
    filled = np.count_nonzero((weight > 0).any(axis=0), axis=2)
    rows, columns = filled.sum(axis=1), filled.sum(axis=0)
    first, last = THETA_DIFF[np.flatnonzero(rows)[[0, -1]]]

    def chosen(knots: Array, asked: tuple[float, ...] | None = None) -> Array:
        if asked is not None:
            knots = np.asarray(asked)
        elif knots.size == 1:
            return knots
        else:
            kept = _apart(knots[:-1], THETA_DIFF, rows, MIN_BINS_BETWEEN_KNOTS)
            if len(kept) > 1 and rows[THETA_DIFF >= kept[-1]].sum() < MIN_BINS_BETWEEN_KNOTS:
                kept.pop()
            knots = np.array([*kept, knots[-1]])
        return np.unique(np.concatenate([[first], knots[(knots > first) & (knots < last)], [last]]))

    amplitude, shape, elongation = chosen(groups[0], amplitude_knots), chosen(groups[1]), chosen(groups[2])
    theta_half = _apart(THETA_HALF[columns > 0], THETA_HALF, columns, MIN_BINS_IN_COLUMN * amplitude.size)
    return Structure((), (amplitude, shape, elongation), options.lobe, np.array(theta_half))


def _select(data: Profiles, weight: Array, rows: Indices, columns: Indices) -> FitData:
    """Take those rows and columns with data that are nearest to the wanted rows and columns, or all if there are few.

    The weight of a column is multiplied by the number of columns that the column represents. Otherwise columns close
    to the mirror direction, all of which are taken, would weigh more than their visible area. A column represents its
    neighbours without data too, so that the fit hardly changes if a column is missing.
    """
    measured = np.any(weight, axis=(0, 3))
    chosen = []
    for axis, wanted in ((1, rows), (0, columns)):
        present = np.flatnonzero(measured.any(axis=axis))
        nearest = np.unique(present[np.abs(wanted[:, None] - present).argmin(axis=1)])
        chosen.append(nearest if nearest.size >= min(MIN_LINES, present.size) else present)
    rows, columns = chosen
    n_represented = np.ones(1)
    if columns.size > 1:
        with_data, all_columns = (np.gradient(at.astype(float)) for at in (np.searchsorted(present, columns), columns))
        n_represented = np.minimum(all_columns, MAX_WEIGHT_FOR_GAPS * with_data)
    selected = FitData.select(data.folded, weight, rows, columns)
    return replace(selected, weight=selected.weight * n_represented[:, None])


def _refine(
    data: FitData, clip: Array, mixture: Mixture, options: FitOptions, progress: Callable[[float], None]
) -> Solution:
    """Fit a few bins of phi_diff, then more bins exactly, with outliers weighted down on request.

    Values from `clip` (3, 1, 1, 1) on are lower bounds: they have hardly any weight where the latest mixture exceeds
    them.
    """
    is_few = Wanted(options.n_lobes, options.ring_lobes).is_few
    tolerance = COST_TOLERANCE if is_few else REFINE_TOLERANCE  # With few lobes, iterations are cheap.
    rounds = ROBUST_REFINE_ROUNDS if options.robust else REFINE_ROUNDS
    unknowns, weight, iterations, bounded = mixture.unknowns, data.weight, 0, data.mean >= clip
    for number in range(rounds):
        if bounded.any():
            values = MixtureProblem(data, mixture.structure).values(unknowns)
            data = replace(data, weight=np.where(bounded & (values > data.mean), CLIPPED_WEIGHT, 1.0) * weight)
        chosen = data.take_bins(SEARCH_BINS)
        if number > 0:
            latest, trusted = Mixture(mixture.structure, unknowns), data
            if options.robust:
                values = MixtureProblem(data.single(), mixture.structure).values(unknowns)
                trusted = replace(data, weight=data.weight * _trust(values, _exact(data, latest)))
            chosen = _exact(trusted, latest, REFINE_BINS)
        problem = MixtureProblem(chosen.single(), mixture.structure)
        done = number / rounds
        solution = minimize(
            problem,
            unknowns,
            iterations=min(MAX_ITERATIONS, COARSE_ITERATIONS) if number == 0 else MAX_ITERATIONS - iterations,
            tolerance=tolerance,
            on_iteration=lambda i, done=done: progress(done + i / MAX_ITERATIONS / rounds),  # type: ignore[misc]
        )
        unknowns, iterations = solution.unknowns, iterations + solution.iterations
    return replace(solution, iterations=iterations)


def _trust(values: Array, data: FitData) -> Array:
    """Return factors for the weights of the data, from 0 for outliers to 1.

    A mixture that misses a peak has large residuals in neighbouring columns, but an outlier is alone. Therefore a
    sample is judged by the difference between its relative residual and the median residual of its neighbours over
    theta_half.
    """
    filled = data.weight > 0.0
    level = np.sum(data.weight * values, axis=(2, 3), keepdims=True)
    level /= np.sum(data.weight, axis=(2, 3), keepdims=True) + TINY
    relative = np.where(filled, (data.mean - values) / (values + DARK_VALUE_FRACTION * level + 1e-12), 0.0)
    alone = np.abs(relative - median_filter(relative, (1, 1, NEIGHBOUR_COLUMNS, 1), mode="nearest"))
    usual = np.zeros(level.shape)
    for channel, row in np.argwhere(filled.any(axis=(2, 3))):
        usual[channel, row] = np.quantile(alone[channel, row][filled[channel, row]], 0.75)
    return np.clip(2.0 - alone / (OUTLIER_FACTOR * usual + MIN_OUTLIER_RESIDUAL), 0.0, 1.0)


def _exact(data: FitData, mixture: Mixture, bins: Sequence[int] = range(N_BINS)) -> FitData:
    """Take some bins of phi_diff, and subtract the errors that averaging a mixture over these bins causes."""
    taken = data.take_bins(bins)
    taken.mean[...] -= _lost_in_bins(MixtureProblem(taken.single(), mixture.structure), mixture.unknowns, bins)
    return taken


def _lost_in_bins(problem: MixtureProblem, unknowns: Array, bins: Sequence[int]) -> Array:
    """Return the mean of a mixture over each bin's samples, minus its value at the mean cos(phi_diff)**2.

    The difference matters for elongated lobes, which change fast within a bin.
    """
    data, samples = problem.data, SAMPLES_IN_BIN[:, bins]
    nodes = np.flatnonzero(samples.any(axis=1))
    samples, phi_diff = samples[nodes], PHI_DIFF[nodes]
    theta_half, theta_diff = data.theta_half[:, None], data.theta_diff[:, None, None]
    count = above_horizon(theta_half, theta_diff, phi_diff) * samples.sum(axis=1)
    cos2_phi = np.broadcast_to(np.cos(phi_diff) ** 2, count.shape).astype(data.cos2_phi.dtype)
    values = MixtureProblem(replace(data, cos2_phi=cos2_phi), problem.structure).values(unknowns)
    total = count @ (samples > 0)
    mean = (values * count) @ (samples > 0) / np.maximum(total, 1.0)
    return np.where(total > 0, mean - problem.values(unknowns), 0.0)


def _bounds_hit(model: DSBRDF) -> bool:
    """Tell whether a lobe is as narrow, or its kappa as large, as the bounds allow."""
    narrowest = width_of_reach(np.array(REACH_BOUNDS[0]), model.lobe) * (1 + 1e-9)
    width = half_width(model.kappa, model.gamma, model.lobe)
    return bool(np.any(model.kappa >= KAPPA_BOUNDS[1] * (1 - 1e-9)) or np.any(width <= narrowest))
