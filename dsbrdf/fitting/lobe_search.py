"""Search the lobes of a mixture: choose all lobes, fit them, exchange some, and drop useless lobes.

1. **Choice.** Orthogonal matching pursuit (Pati, Rezaiifar, Krishnaprasad 1993) over a dictionary of lobes of many
   widths, centers and elongations: the candidate that explains most of the residual joins those chosen, and the
   amplitudes of all are solved for anew, row by row and channel by channel, none negative (non-negative variants:
   Bruckstein, Elad, Zibulevsky 2008). It needs normal equations alone and no nonlinear fit between two choices.
2. **Fit.** One nonlinear least-squares fit of all lobes together, at first with kappa held.
3. **Exchange.** The lobe that would be missed least makes way for the candidate that explains most of what is left.
4. **Elimination**, if the number of lobes is not fixed: the lobe that would be missed least is dropped and the others
   are fitted on, as long as the error on rows of theta_diff that no mixture was fitted to hardly rises.

If the number is fixed and small, the first three steps are gone through from several starts and the best end is kept:
few lobes hardly leave the place where they start.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from dsbrdf.arrays import Array, Indices, Mask
from dsbrdf.data.weighting import TINY
from dsbrdf.fitting.least_squares import FitData, MixtureProblem, minimize
from dsbrdf.fitting.structure import Mixture, Structure
from dsbrdf.model.lobes import gamma_of_half_width, lobe_values, log_cosine, reach_of_width
from dsbrdf.model.splines import smooth_control_values

MAX_SEARCHED_LOBES = 9
"""Elimination starts from this number of lobes."""
TOLERATED_RISE = 0.01
"""A lobe is dropped if the validation error rises by a smaller fraction."""
NEGLIGIBLE_ERROR = 4e-6
"""A smaller fraction of the weighted squared signal is no error: differences of 0.2 % are invisible."""
NOISE_CORRELATION = 0.16
"""Neighbouring residuals with a smaller correlation count as noise.

Noise of single samples has 0; where a mixture misses the shape of a material it is above 0.3 as a rule.
"""
MAX_NOISE_RESIDUAL = 0.3
"""Larger residuals, relative to the root mean square, are clipped, so that few samples do not dominate."""
MAX_SIMPLE_LOBES = 3
"""If the residual is noise, mixtures with at most this number of lobes about the normal are tried."""
MIN_COLUMNS_FOR_RINGS = 8
"""With fewer angles theta_half, a free search uses no rings, because any ring would explain the data."""
WIDTHS_DEG = (0.4, 0.8, 1.5, 2.5, 4.0, 6.0, 10.0, 16.0, 25.0, 40.0, 60.0)
RING_WIDTHS_DEG = (0.4, 0.8, 1.5, 3.0, 6.0, 10.0, 16.0, 25.0, 40.0)
RING_CENTERS_DEG = (1.0, 2.0, 4.0, 8.0, 15.0, 25.0, 40.0, 60.0, 85.0)
CUSP_WIDTHS_DEG = (0.7, 1.5, 3.0, 6.0, 9.0)
CUSP_CENTER_HALF_WIDTHS = -1.5
ELONGATIONS = (0.0, 1.0, 3.0)
"""The lobes of the dictionary."""
START_KAPPA = 1.0
START_ELONGATION = 0.5
"""A fit starts at this fraction of a candidate's elongation: it corrects too round a lobe more easily."""
MIN_START_HEIGHT = 0.02
"""Fraction of a typical amplitude that a lobe has at least at the start: a fainter one has no derivatives to follow."""
CHOICE_RIDGE = 1e-3
"""Fraction of the candidates' squares added to normal equations: candidates that are nearly alike share their gain."""
EQUAL_GAIN = 1e-4
"""Candidates with a smaller relative difference of gains explain the data equally well."""
HEIGHT_SWEEPS = 30
FIXED_KAPPA_ITERATIONS = 8
FIT_ITERATIONS = 20
SEARCH_TOLERANCE = 3e-3
"""An iteration that lowers the cost by a smaller fraction counts as stalled: the refinement goes on anyway."""
EXCHANGES = 2
EXCHANGE_ITERATIONS = 8
MAX_RESTARTED_LOBES = 5
"""A search for a larger fixed number of lobes has a single start."""
SPARE_LOBES = 3
"""Number of lobes that one of these starts has in the beginning, and drops."""
HEAVY_TAIL_FACTOR = 0.3
"""Factor on kappa of the best end, for a last start: from rounder lobes kappa seldom falls far enough."""


@dataclass(frozen=True)
class SearchStep:
    """Report a mixture of the search and its validation error."""

    n_lobes: int
    ring_lobes: int  # number of lobes with a center
    error: float  # weighted squared error on the rows held out, as a fraction of the squared signal there
    kept: bool  # whether the search went on with it


@dataclass(frozen=True)
class Wanted:
    """Numbers of lobes, and of rings among them, as in `FitOptions`."""

    n_lobes: int | Literal["auto"]
    ring_lobes: int | Literal["auto"]

    def limited_to(self, data: FitData) -> "Wanted":
        """Leave out rings, unless asked for, where data have so few angles theta_half that any ring explains them."""
        few = data.theta_half.shape[-1] < MIN_COLUMNS_FOR_RINGS
        return replace(self, ring_lobes=0) if few and self.ring_lobes == "auto" else self

    @property
    def is_few(self) -> bool:
        """Whether the number of lobes is fixed and so small that one start does not find the best."""
        return self.n_lobes != "auto" and self.n_lobes <= MAX_RESTARTED_LOBES

    def max_lobes(self, data: FitData) -> int:
        """Return the number of lobes to choose first; few angles theta_half cannot separate many lobes."""
        return min(MAX_SEARCHED_LOBES, data.theta_half.shape[-1] + 1) if self.n_lobes == "auto" else self.n_lobes

    def kinds_to_add(self, rings: tuple[bool, ...]) -> tuple[bool, ...]:
        """Kinds that one more lobe may be of: a lobe about the normal is False, a ring True."""
        if self.ring_lobes == "auto":
            return (False, True) if False in rings else (False,)
        return (True,) if False in rings and sum(rings) < self.ring_lobes else (False,)

    def may_drop(self, rings: tuple[bool, ...]) -> list[bool]:
        """Tell for each lobe whether its removal keeps the fixed numbers of lobes."""
        spare = {False: rings.count(False) > 1, True: self.ring_lobes == "auto" or sum(rings) > self.ring_lobes}
        return [spare[is_ring] for is_ring in rings]


@dataclass(frozen=True, eq=False)
class _Dictionary:
    """C candidates: half widths, centers [rad], elongations (C,), and values at the data (R, C, n)."""

    width: Array
    center: Array
    elongation: Array
    curves: Array

    @classmethod
    def at(cls, data: FitData, family: str) -> "_Dictionary":
        shapes = [(width, 0.0) for width in WIDTHS_DEG]
        shapes += [(width, CUSP_CENTER_HALF_WIDTHS * width) for width in CUSP_WIDTHS_DEG]
        # Not narrower than the steps of the grid at the center.
        shapes += [(w, c) for c in RING_CENTERS_DEG for w in RING_WIDTHS_DEG if w >= max(0.12 * c, 0.3 * min(c, 5.0))]
        width, center = np.radians(shapes).T
        along, across = data.squared_tangents
        stretch = np.array(ELONGATIONS) * log_cosine(data.theta_diff)[:, None]
        ratio = np.exp(stretch)[:, :, None].astype(along.dtype)
        squared = along / ratio + across * ratio
        kappa = np.array(START_KAPPA)
        gamma = gamma_of_half_width(width, kappa, family).astype(along.dtype)
        kappa = kappa.astype(along.dtype)
        curves = np.empty((len(along), len(ELONGATIONS), len(shapes), along.shape[2]), along.dtype)
        for n in range(len(shapes)):
            at = None if center[n] == 0.0 else center[n]
            curves[:, :, n] = lobe_values(squared, kappa, gamma[n], at, family)
        count = len(ELONGATIONS)
        elongation = np.repeat(ELONGATIONS, len(shapes))
        flat = curves.reshape(len(along), -1, along.shape[2])
        return cls(np.tile(width, count), np.tile(center, count), elongation, flat)

    @property
    def is_ring(self) -> Mask:
        """Mask of the candidates with a center."""
        return self.center != 0.0


@dataclass(frozen=True)
class SearchData:
    """Hold the data that lobes are fitted to, and the validation data that determine their number."""

    fitted: FitData
    held_out: FitData


def search(
    data: SearchData,
    empty: Structure,
    wanted: Wanted,
    exact: Callable[[Mixture], SearchData],
    on_stage: Callable[[], None],
) -> tuple[Mixture, list[SearchStep]]:
    """Find the lobes of a mixture on the knots of an `empty` structure.

    Where only noise is left, errors matter that the bins of phi_diff make of a mixture: `exact` returns data without.
    Returns the mixture with the steps of the search; `on_stage` is called after each fit.
    """
    fitted, wanted = data.fitted, wanted.limited_to(data.fitted)
    dictionary = _Dictionary.at(fitted, empty.family)
    if wanted.is_few:
        trials = _Trials(data.held_out, on_stage)
        trials.add(mixture := _best_of_starts(data, empty, dictionary, wanted, on_stage))
        return mixture, trials.steps
    mixture = _fit(fitted, _choose(fitted, empty, dictionary, wanted))
    is_auto = wanted.n_lobes == "auto"
    if is_auto and _correlation(fitted, mixture) < NOISE_CORRELATION:
        data = exact(mixture)
        fitted, trials = data.fitted, _Trials(data.held_out, on_stage)
        mixture = _minimize(fitted, mixture, EXCHANGE_ITERATIONS)
        trials.add(mixture)
        if (simple := _simplest(fitted, empty, dictionary, wanted, exact, trials)) is not None:
            return simple, trials.steps
    else:
        trials = _Trials(data.held_out, on_stage)
        mixture = _exchange_some(fitted, mixture, dictionary, wanted, on_stage)
        trials.add(mixture)
    while is_auto and any(wanted.may_drop(mixture.structure.rings)):
        fewer = _minimize(fitted, _without_least(fitted, mixture, wanted), EXCHANGE_ITERATIONS)
        if not trials.add(fewer):
            break
        mixture = fewer
    return mixture, trials.steps


class _Trials:
    """Mixtures compared by their errors on the rows held out; none may be much worse than the best before it."""

    def __init__(self, held_out: FitData, on_trial: Callable[[], None]) -> None:
        self.steps: list[SearchStep] = []
        self._held_out, self._on_trial, self._limit = held_out, on_trial, np.inf

    def add(self, mixture: Mixture, held_out: FitData | None = None) -> bool:
        """Add a mixture, and tell whether it is good enough, on the usual or its own validation data."""
        self._on_trial()
        held_out = held_out or self._held_out
        error = _error(held_out, mixture) / held_out.signal
        kept = error <= self._limit
        self.steps.append(SearchStep(mixture.structure.n_lobes, mixture.structure.n_rings, error, kept))
        self._limit = min(self._limit, (1.0 + TOLERATED_RISE) * error + NEGLIGIBLE_ERROR)
        return kept


def _simplest(
    data: FitData,
    empty: Structure,
    dictionary: _Dictionary,
    wanted: Wanted,
    exact: Callable[[Mixture], SearchData],
    trials: _Trials,
) -> Mixture | None:
    """Smallest mixture that is as good as the first trial, all of its lobes about the normal if rings are optional.

    Each is judged on data without the errors that the bins make of itself.
    """
    n_rings, (first,) = 0 if wanted.ring_lobes == "auto" else wanted.ring_lobes, trials.steps
    for n_lobes in range(n_rings + 1, min(n_rings + MAX_SIMPLE_LOBES + 1, first.n_lobes)):
        mixture = _fit(data, _choose(data, empty, dictionary, Wanted(n_lobes, n_rings)))
        own = exact(mixture)
        mixture = _minimize(own.fitted, mixture, EXCHANGE_ITERATIONS)
        if trials.add(mixture, own.held_out):
            return mixture
    return None


def _best_of_starts(
    data: SearchData, empty: Structure, dictionary: _Dictionary, wanted: Wanted, on_stage: Callable[[], None]
) -> Mixture:
    """Fit a fixed number of lobes from several starts, and return the best on all rows, held out or not."""
    fitted = data.fitted
    starts = _starts(fitted, empty, dictionary, wanted)
    ends = [_exchange_some(fitted, start, dictionary, wanted, on_stage) for start in starts]

    def error(one: Mixture) -> float:
        return _error(fitted, one) + _error(data.held_out, one)

    best = min(ends, key=error)
    shift = np.where(best.structure.is_kappa(), np.log(HEAVY_TAIL_FACTOR), 0.0)
    heavy = Mixture(best.structure, best.structure.limit(best.unknowns + shift))
    return min((best, _fit(fitted, heavy)), key=error)


def _starts(data: FitData, empty: Structure, dictionary: _Dictionary, wanted: Wanted) -> Iterator[Mixture]:
    """Fit lobes as they are chosen, with no ring or one if rings are optional, and those left of some more."""
    n_lobes = wanted.max_lobes(data)
    yield (first := _fit(data, _choose(data, empty, dictionary, wanted)))
    if wanted.ring_lobes == "auto":
        others = (n_rings for n_rings in range(min(2, n_lobes)) if n_rings != first.structure.n_rings)
        yield from (_fit(data, _choose(data, empty, dictionary, Wanted(n_lobes, n_rings))) for n_rings in others)
    more = _fit(data, _choose(data, empty, dictionary, replace(wanted, n_lobes=n_lobes + SPARE_LOBES)))
    while more.structure.n_lobes > n_lobes:
        more = _minimize(data, _without_least(data, more, wanted), EXCHANGE_ITERATIONS)
    yield _minimize(data, more, FIT_ITERATIONS)


def _fit(data: FitData, start: Mixture) -> Mixture:
    """Fit all unknowns, at first with kappa held: it trades against the width."""
    start = _minimize(data, start, FIXED_KAPPA_ITERATIONS, fixed=start.structure.is_kappa())
    return _minimize(data, start, FIT_ITERATIONS)


def _correlation(data: FitData, mixture: Mixture) -> float:
    """Correlation of the weighted residuals of neighbouring bins of phi_diff, large ones clipped."""
    residual = MixtureProblem(data, mixture.structure).values(mixture.unknowns) - data.mean
    residual *= np.sqrt(data.weight)
    limit = MAX_NOISE_RESIDUAL * float(np.sqrt(np.mean(residual**2))) or 1.0
    residual = np.clip(residual / limit, -1.0, 1.0)
    both = (data.weight[..., 1:] > 0) & (data.weight[..., :-1] > 0)
    first, second = residual[..., 1:][both], residual[..., :-1][both]
    size = float(np.sqrt(np.sum(first**2) * np.sum(second**2)))
    return float(np.sum(first * second)) / size if size > 0.0 else 0.0


def _choose(data: FitData, empty: Structure, dictionary: _Dictionary, wanted: Wanted) -> Mixture:
    """Choose candidates one after the other, the amplitudes of all free each time."""
    (mean, weight), curves, is_ring = data.rows, dictionary.curves, dictionary.is_ring
    right = (weight * mean) @ curves.transpose(0, 2, 1)
    size = weight @ np.square(curves).transpose(0, 2, 1)
    gram, heights = np.empty((*right.shape[:2], 0, right.shape[2])), np.empty((*right.shape[:2], 0))
    chosen: list[int] = []
    for _ in range(wanted.max_lobes(data)):
        own = gram[..., chosen]
        gain = _gains(right - np.einsum("rhsc,rhs->rhc", gram, heights), size, gram, own)
        kinds = wanted.kinds_to_add(tuple(is_ring[chosen].tolist()))
        gain[~np.isin(is_ring, kinds)] = -1.0
        gain[chosen] = -1.0
        best = _widest_of_best(gain, dictionary)
        chosen.append(best)
        row = (weight * curves[:, best, None]) @ curves.transpose(0, 2, 1)
        gram = np.concatenate([gram, row[:, :, None]], axis=2)
        heights = _heights(gram[..., chosen], right[..., chosen], np.pad(heights, ((0, 0), (0, 0), (0, 1))))
    order = np.argsort(is_ring[chosen], kind="stable")
    return _start(data, empty, dictionary, np.array(chosen)[order], heights[..., order])


def _gains(residual: Array, size: Array, gram: Array, own: Array) -> Array:
    """Squared error that each candidate explains beside the K chosen ones, whose amplitudes answer to it, (C,).

    The residual's products with the candidates, and the candidates' with themselves, have the shape (R, 3, C); `gram`
    has those of chosen ones with candidates (R, 3, K, C), `own` with one another.
    """
    left, count = size, own.shape[-1]
    if count:
        ridge = (CHOICE_RIDGE * np.trace(own, axis1=2, axis2=3)[..., None, None] / count + TINY) * np.eye(count)
        left = size - np.sum(gram * np.linalg.solve(own + ridge, gram), axis=2)
    gain = np.maximum(residual, 0.0) ** 2 / np.maximum(left, CHOICE_RIDGE * size + TINY)
    return np.asarray(gain.sum(axis=(0, 1)))


def _widest_of_best(gain: Array, dictionary: _Dictionary) -> int:
    """Index of the widest candidate of those that do equally well: it assumes least."""
    equal = np.flatnonzero((gain >= (1.0 - EQUAL_GAIN) * gain.max()) & (gain >= 0.0))
    return int(equal[dictionary.width[equal].argmax()])


def _heights(gram: Array, right: Array, start: Array) -> Array:
    """Amplitudes, none negative, that solve normal equations: gram (R, 3, K, K), right (R, 3, K).

    Coordinate descent: an exact step in one amplitude after the other.
    """
    heights = start.copy()
    for _ in range(HEIGHT_SWEEPS):
        for k in range(right.shape[-1]):
            slope = right[..., k] - np.einsum("rhk,rhk->rh", gram[..., k, :], heights)
            heights[..., k] = np.maximum(heights[..., k] + slope / (gram[..., k, k] + TINY), 0.0)
    return heights


def _start(data: FitData, empty: Structure, dictionary: _Dictionary, chosen: Indices, heights: Array) -> Mixture:
    """Mixture of chosen candidates, rings last, with the amplitudes (R, 3, K)."""
    k, rings = chosen.size, dictionary.is_ring[chosen]
    structure = replace(empty, rings=tuple(rings.tolist()))
    unknowns = np.zeros(structure.n_unknowns)
    amplitude, shape, elongation = structure.split(unknowns)
    amplitude[...] = _log_amplitudes(data, structure, heights)
    shape[:, :k] = np.log(START_KAPPA)
    shape[:, k : 2 * k] = np.log(reach_of_width(dictionary.width[chosen], structure.family))
    shape[:, 2 * k :] = dictionary.center[chosen[rings]]
    elongation[...] = START_ELONGATION * dictionary.elongation[chosen]
    return Mixture(structure, structure.limit(unknowns))


def _log_amplitudes(data: FitData, structure: Structure, heights: Array) -> Array:
    """Control values of log amplitudes, channel by channel, near heights (R, 3, K)."""
    typical = np.sqrt(np.mean(heights**2, axis=(0, 1)))
    typical = np.maximum(typical, MIN_START_HEIGHT * typical.max() + TINY)
    logs = np.log(np.maximum(heights, MIN_START_HEIGHT * typical))
    return smooth_control_values(structure.bases(data.theta_diff)[0], logs.reshape(len(logs), -1))


def _exchange_some(
    data: FitData, mixture: Mixture, dictionary: _Dictionary, wanted: Wanted, on_stage: Callable[[], None]
) -> Mixture:
    """Exchange lobes one after the other."""
    for _ in range(EXCHANGES):
        on_stage()
        mixture = _exchange(data, mixture, dictionary, wanted)
    return mixture


def _exchange(data: FitData, mixture: Mixture, dictionary: _Dictionary, wanted: Wanted) -> Mixture:
    """Put the candidate that explains most in the place of the lobe that is missed least, if that is better."""
    if not any(wanted.may_drop(mixture.structure.rings)):
        return mixture
    other = _with_best(data, _without_least(data, mixture, wanted), dictionary, wanted)
    other = _minimize(data, other, EXCHANGE_ITERATIONS)
    return min((mixture, other), key=lambda one: _error(data, one))


def _without_least(data: FitData, mixture: Mixture, wanted: Wanted) -> Mixture:
    """Drop the lobe whose loss costs least, the amplitudes of the others answering."""
    structure, (mean, weight) = mixture.structure, data.rows
    k, curves = structure.n_lobes, MixtureProblem(data, structure).curves(mixture.unknowns)
    weighted = curves[:, None] * weight[:, :, None]
    gram, right = weighted @ curves.transpose(0, 2, 1)[:, None], (weighted @ mean[..., None])[..., 0]
    ridge = 1e-6 * np.trace(gram, axis1=2, axis2=3)[..., None, None] / k + TINY
    inverse = np.linalg.inv(gram + ridge * np.eye(k))
    loss = (inverse @ right[..., None])[..., 0] ** 2 / np.diagonal(inverse, axis1=2, axis2=3)
    total = np.where(wanted.may_drop(structure.rings), loss.sum(axis=(0, 1)), np.inf)
    keep = np.delete(np.arange(k), total.argmin())
    return _take(mixture, keep)


def _take(mixture: Mixture, keep: Indices) -> Mixture:
    """Keep some of the lobes."""
    structure = mixture.structure
    k, rings = structure.n_lobes, np.array(structure.rings)
    amplitude, shape, elongation = structure.split(mixture.unknowns)
    centers = 2 * k + np.cumsum(rings)[keep[rings[keep]]] - 1
    columns = np.concatenate([keep, k + keep, centers])
    heights = amplitude.reshape(len(amplitude), 3, k)[:, :, keep]
    parts = heights, shape[:, columns], elongation[:, keep]
    fewer = replace(structure, rings=tuple(rings[keep].tolist()))
    return Mixture(fewer, np.concatenate([part.ravel() for part in parts]))


def _with_best(data: FitData, mixture: Mixture, dictionary: _Dictionary, wanted: Wanted) -> Mixture:
    """Add the candidate that explains most of the residual."""
    problem, (mean, weight) = MixtureProblem(data, mixture.structure), data.rows
    curves, transposed = problem.curves(mixture.unknowns), dictionary.curves.transpose(0, 2, 1)
    residual = mean - problem.values(mixture.unknowns).transpose(1, 0, 2, 3).reshape(mean.shape)
    weighted = curves[:, None] * weight[:, :, None]
    gram, own = weighted @ transposed[:, None], weighted @ curves.transpose(0, 2, 1)[:, None]
    size = weight @ np.square(transposed)
    right = (weight * residual) @ transposed
    target = weighted @ residual[..., None]
    ridge = CHOICE_RIDGE * np.trace(own, axis1=2, axis2=3)[..., None, None] / len(own[0, 0]) * np.eye(own.shape[-1])
    answered = right - np.sum(gram * np.linalg.solve(own + ridge + TINY * np.eye(own.shape[-1]), target), axis=2)
    gain = _gains(answered, size, gram, own)
    gain[~np.isin(dictionary.is_ring, wanted.kinds_to_add(mixture.structure.rings))] = -1.0
    best = _widest_of_best(gain, dictionary)
    height = np.maximum(right[..., best], 0.0) / (size[..., best] + TINY)
    added = _start(data, replace(mixture.structure, rings=()), dictionary, np.array([best]), height[..., None])
    return _join(mixture, added)


def _join(mixture: Mixture, added: Mixture) -> Mixture:
    """Add a mixture of one lobe to another; rings come last."""
    old, is_ring = mixture.structure, added.structure.n_rings == 1
    place, k = (old.n_lobes if is_ring else old.n_lobes - old.n_rings), old.n_lobes
    (amplitudes, shapes, elongations), new = old.split(mixture.unknowns), added.structure.split(added.unknowns)
    heights = np.insert(amplitudes.reshape(len(amplitudes), 3, k), place, new[0], axis=2)
    kappas = np.insert(shapes[:, :k], place, new[1][:, 0], axis=1)
    reaches = np.insert(shapes[:, k : 2 * k], place, new[1][:, 1], axis=1)
    shape = np.hstack([kappas, reaches, shapes[:, 2 * k :], new[1][:, 2:]])
    parts = heights, shape, np.insert(elongations, place, new[2][:, 0], axis=1)
    structure = replace(old, rings=(*old.rings[:place], is_ring, *old.rings[place:]))
    return Mixture(structure, np.concatenate([part.ravel() for part in parts]))


def _minimize(data: FitData, start: Mixture, iterations: int, fixed: Mask | None = None) -> Mixture:
    problem = MixtureProblem(data, start.structure)
    end = minimize(problem, start.unknowns, iterations=iterations, tolerance=SEARCH_TOLERANCE, fixed=fixed)
    return Mixture(start.structure, end.unknowns)


def _error(data: FitData, mixture: Mixture) -> float:
    residual = MixtureProblem(data, mixture.structure).values(mixture.unknowns) - data.mean
    return float(np.sum(data.weight * residual**2))
