"""Search the lobes of a mixture: choose all lobes, fit them, exchange two, and drop useless lobes.

1. **Choice.** `dsbrdf.fitting.lobe_candidates` chooses lobes by normal equations, without a fit in between.
2. **Fit.** One nonlinear least-squares fit changes all lobes together, at first with kappa fixed.
3. **Exchange.** Twice, the least useful lobe is replaced by the candidate that explains most of the residual.
4. **Elimination**, if the number of lobes is free. The least useful lobe is dropped and the others are fitted again, as
   long as the validation error, on rows of theta_diff that no mixture was fitted to, hardly rises.

With few lobes, the result depends on the start. If their number is fixed and small, the first three steps are repeated
from several starts, and the best result is kept.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from dsbrdf.arrays import Mask
from dsbrdf.data.weighting import TINY
from dsbrdf.fitting.fit_data import FitData
from dsbrdf.fitting.least_squares import MixtureProblem, minimize
from dsbrdf.fitting.lobe_candidates import Candidates, normal_equations, solved_amplitudes
from dsbrdf.fitting.structure import Mixture, Structure, join_lobes

MAX_SEARCHED_LOBES = 9
"""Elimination starts from this number of lobes."""
TOLERATED_RISE = 0.005
"""A lobe is dropped if the validation error rises by a smaller fraction."""
NEGLIGIBLE_ERROR = 4e-6
"""A validation error below this fraction of the squared signal is negligible: differences of 0.2 % are invisible."""
NOISE_CORRELATION = 0.16
"""Neighbouring residuals with a smaller correlation count as noise.

Noise of single samples has 0; a mixture that misses the shape of a material leaves more than 0.3 as a rule.
"""
MAX_NOISE_RESIDUAL = 0.3
"""Residuals larger than this multiple of their root mean square are clipped, so that few samples do not dominate."""
MAX_SIMPLE_LOBES = 3
"""If the residual is noise, mixtures with at most this number of lobes about the normal are tried."""
MIN_COLUMNS_FOR_RINGS = 8
"""With fewer angles theta_half, a free search uses no rings, because any ring would explain the data."""
FIXED_KAPPA_ITERATIONS = 8
FIT_ITERATIONS = 20
SEARCH_TOLERANCE = 3e-3
"""An iteration that lowers the cost by a smaller fraction counts as stalled, because a refinement follows."""
EXCHANGES = 2
EXCHANGE_ITERATIONS = 8
MAX_RESTARTED_LOBES = 5
"""A search for a larger fixed number of lobes has a single start."""
SPARE_LOBES = 3
"""One start has this number of additional lobes, and drops them again."""
MIN_WIDE_START_WIDTH = float(np.radians(40.0))
"""A start for a single lobe has at least this half width [rad]; from narrower ones, it would fit only the highlight."""
HEAVY_TAIL_FACTOR = 0.3
"""Last starts multiply kappa of the best result by this factor, because fits seldom lower kappa far enough.

For a single lobe, the other results are such starts too.
"""


@dataclass(frozen=True)
class SearchStep:
    """Report a mixture of the search and its validation error."""

    n_lobes: int
    ring_lobes: int  # number of lobes with a center
    error: float  # weighted squared error on the rows held out, as a fraction of the squared signal there
    kept: bool  # whether the search went on with it


@dataclass(frozen=True)
class Wanted:
    """Hold the numbers of lobes, and of rings among them, as in `FitOptions`."""

    n_lobes: int | Literal["auto"]
    ring_lobes: int | Literal["auto"]

    def limited_to(self, data: FitData) -> "Wanted":
        """Forbid optional rings if data have so few angles theta_half that any ring would explain them."""
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
        """Return the kinds that one more lobe may have: False is about the normal, True a ring."""
        if self.ring_lobes == "auto":
            return (False, True) if False in rings else (False,)
        return (True,) if False in rings and sum(rings) < self.ring_lobes else (False,)

    def may_drop(self, rings: tuple[bool, ...]) -> list[bool]:
        """Tell for each lobe whether its removal keeps the fixed numbers of lobes."""
        spare = {False: rings.count(False) > 1, True: self.ring_lobes == "auto" or sum(rings) > self.ring_lobes}
        return [spare[is_ring] for is_ring in rings]


@dataclass(frozen=True)
class SearchData:
    """Hold the data that lobes are fitted to, and the validation data that determine their number."""

    fitted: FitData
    held_out: FitData


@dataclass(frozen=True, eq=False)
class _Task:
    """Hold the data that lobes are fitted to, the knots of their parameters, the candidates, and the numbers wanted."""

    data: FitData
    empty: Structure
    candidates: Candidates
    wanted: Wanted

    def fit(self, min_width: float = 0.0, **changes: int) -> Mixture:
        """Choose lobes with at least a half width [rad], with some numbers changed, and fit all unknowns."""
        return _fit(self.data, self._choose(replace(self.wanted, **changes), min_width))

    def _choose(self, wanted: Wanted, min_width: float) -> Mixture:
        """Choose candidates one after the other."""
        candidates, chosen, shape = self.candidates, list[int](), self.candidates.size.shape
        amplitudes, gram = np.zeros((*shape[:2], 0)), np.zeros((*shape[:2], 0, 0))
        mixed = np.zeros((*shape[:2], 0, shape[2]))
        for _ in range(wanted.max_lobes(self.data)):
            allowed = np.isin(candidates.is_ring, wanted.kinds_to_add(tuple(candidates.is_ring[chosen].tolist())))
            allowed &= candidates.width >= min_width
            allowed[chosen] = False
            chosen.append(candidates.best(gram, mixed, amplitudes, allowed))
            gram, right = normal_equations(self.data, candidates.curves[:, chosen])
            amplitudes = solved_amplitudes(gram, right, amplitudes)
            mixed = np.append(mixed, candidates.mixed(self.data, candidates.curves[:, chosen[-1:]]), axis=2)
        return candidates.start(self.data, self.empty, chosen, amplitudes)

    def exchange(self, mixture: Mixture) -> Mixture:
        """Put the candidate that explains most in the place of the least useful lobe, if that is better."""
        if not self.may_drop(mixture):
            return mixture
        fewer, candidates = self.drop_one(mixture), self.candidates
        problem = MixtureProblem(self.data, fewer.structure)
        curves, start = problem.curves(fewer.unknowns), problem.evaluate(fewer.unknowns).amplitude
        gram, right = normal_equations(self.data, curves)
        amplitudes = solved_amplitudes(gram, right, start)
        allowed = np.isin(candidates.is_ring, self.wanted.kinds_to_add(fewer.structure.rings))
        best = candidates.best(gram, candidates.mixed(self.data, curves), amplitudes, allowed)
        lobes = np.append(curves, candidates.curves[:, [best]], axis=1)
        amplitudes = solved_amplitudes(*normal_equations(self.data, lobes), amplitudes)
        added = candidates.start(self.data, self.empty, [best], amplitudes[..., -1:])
        is_ring = np.array(fewer.structure.rings + added.structure.rings)
        joined = (np.concatenate(parts, axis=-1) for parts in zip(fewer.lobes(), added.lobes(), strict=True))
        other = _minimize(self.data, join_lobes(self.empty, is_ring, joined), EXCHANGE_ITERATIONS)
        return min((mixture, other), key=lambda one: _error(self.data, one))

    def may_drop(self, mixture: Mixture) -> bool:
        """Tell whether the wanted numbers allow to drop any lobe."""
        return any(self.wanted.may_drop(mixture.structure.rings))

    def drop_one(self, mixture: Mixture) -> Mixture:
        """Drop the lobe without which the error is smallest after the amplitudes of the others are solved again."""
        k = mixture.structure.n_lobes
        curves = MixtureProblem(self.data, mixture.structure).curves(mixture.unknowns)
        gram, right = normal_equations(self.data, curves)
        ridge = 1e-6 * np.trace(gram, axis1=2, axis2=3)[..., None, None] / k + TINY
        inverse = np.linalg.inv(gram + ridge * np.eye(k))
        loss = (inverse @ right[..., None])[..., 0] ** 2 / np.diagonal(inverse, axis1=2, axis2=3)
        total = np.where(self.wanted.may_drop(mixture.structure.rings), loss.sum(axis=(0, 1)), np.inf)
        kept = np.delete(np.arange(k), total.argmin())
        is_ring = np.array(mixture.structure.rings)[kept]
        return join_lobes(self.empty, is_ring, (part[..., kept] for part in mixture.lobes()))

    def shrink(self, mixture: Mixture) -> Mixture:
        """Drop one lobe and fit the others again."""
        return _minimize(self.data, self.drop_one(mixture), EXCHANGE_ITERATIONS)


def search(
    data: SearchData,
    empty: Structure,
    wanted: Wanted,
    exact: Callable[[Mixture], SearchData],
    on_stage: Callable[[], None],
) -> tuple[Mixture, list[SearchStep]]:
    """Find the lobes of a mixture on the knots of an `empty` structure, and return it with the steps of the search.

    If only noise is left, the binning errors of a mixture over phi_diff matter; `exact` returns data without these
    errors. `on_stage` is called after each fit.
    """
    task = _Task(data.fitted, empty, Candidates.at(data.fitted, empty.family), wanted.limited_to(data.fitted))
    trials = _Trials(data.held_out, on_stage)
    if wanted.is_few:
        trials.add(mixture := _best_of_starts(task, data.held_out, on_stage))
        return mixture, trials.steps
    mixture = task.fit()
    is_free = wanted.n_lobes == "auto"
    if is_free and _correlation(task.data, mixture) < NOISE_CORRELATION:
        data = exact(mixture)
        task, trials = replace(task, data=data.fitted), _Trials(data.held_out, on_stage)
        mixture = _minimize(task.data, mixture, EXCHANGE_ITERATIONS)
        trials.add(mixture)
        if (simple := _simplest(task, exact, trials)) is not None:
            return simple, trials.steps
    else:
        for _ in range(EXCHANGES):
            mixture = task.exchange(mixture)
        trials.add(mixture)
    while is_free and task.may_drop(mixture):
        fewer = task.shrink(mixture)
        if not trials.add(fewer):
            break
        mixture = fewer
    return mixture, trials.steps


class _Trials:
    """Compare mixtures by their validation errors; none may be much worse than the best before it."""

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


def _simplest(task: _Task, exact: Callable[[Mixture], SearchData], trials: _Trials) -> Mixture | None:
    """Return the smallest mixture that is as good as the first trial, without rings if these are optional.

    The data of each trial are without the binning errors of the tried mixture.
    """
    n_rings, (first,) = 0 if task.wanted.ring_lobes == "auto" else task.wanted.ring_lobes, trials.steps
    for n_lobes in range(n_rings + 1, min(n_rings + MAX_SIMPLE_LOBES + 1, first.n_lobes)):
        mixture = task.fit(n_lobes=n_lobes, ring_lobes=n_rings)
        own = exact(mixture)
        mixture = _minimize(own.fitted, mixture, EXCHANGE_ITERATIONS)
        if trials.add(mixture, own.held_out):
            return mixture
    return None


def _best_of_starts(task: _Task, held_out: FitData, on_stage: Callable[[], None]) -> Mixture:
    """Fit a fixed number of lobes from several starts, and return the best on all rows, held out or not."""
    ends = []
    for start in _starts(task):
        on_stage()
        ends.append(task.exchange(start))

    def error(one: Mixture) -> float:
        return _error(task.data, one) + _error(held_out, one)

    for end in tuple(ends) if task.wanted.n_lobes == 1 else [min(ends, key=error)]:
        shift = np.where(end.structure.is_kappa(), np.log(HEAVY_TAIL_FACTOR), 0.0)
        ends.append(_fit(task.data, Mixture(end.structure, end.structure.limit(end.unknowns + shift))))
    return min(ends, key=error)


def _starts(task: _Task) -> Iterator[Mixture]:
    """Yield mixtures to compare: of the best candidates, with no or one ring lobe, and of more lobes than wanted.

    The last mixture begins with `SPARE_LOBES` more lobes, and its least useful lobes are dropped.
    """
    n_lobes = task.wanted.max_lobes(task.data)
    yield (first := task.fit())
    if n_lobes == 1:
        yield task.fit(min_width=MIN_WIDE_START_WIDTH)
    if task.wanted.ring_lobes == "auto":
        others = (n_rings for n_rings in range(min(2, n_lobes)) if n_rings != first.structure.n_rings)
        yield from (task.fit(ring_lobes=n_rings) for n_rings in others)
    more = task.fit(n_lobes=n_lobes + SPARE_LOBES)
    while more.structure.n_lobes > n_lobes:
        more = task.shrink(more)
    yield _minimize(task.data, more, FIT_ITERATIONS)


def _fit(data: FitData, start: Mixture) -> Mixture:
    """Fit all unknowns, at first with kappa fixed, because kappa and the width compensate each other."""
    start = _minimize(data, start, FIXED_KAPPA_ITERATIONS, fixed=start.structure.is_kappa())
    return _minimize(data, start, FIT_ITERATIONS)


def _correlation(data: FitData, mixture: Mixture) -> float:
    """Return the correlation of the weighted residuals of neighbouring bins of phi_diff, large ones clipped."""
    residual = MixtureProblem(data, mixture.structure).values(mixture.unknowns) - data.mean
    residual *= np.sqrt(data.weight)
    limit = MAX_NOISE_RESIDUAL * float(np.sqrt(np.mean(residual**2))) or 1.0
    residual = np.clip(residual / limit, -1.0, 1.0)
    both = (data.weight[..., 1:] > 0) & (data.weight[..., :-1] > 0)
    first, second = residual[..., 1:][both], residual[..., :-1][both]
    size = float(np.sqrt(np.sum(first**2) * np.sum(second**2)))
    return float(np.sum(first * second)) / size if size > 0.0 else 0.0


def _minimize(data: FitData, start: Mixture, iterations: int, fixed: Mask | None = None) -> Mixture:
    problem = MixtureProblem(data, start.structure)
    end = minimize(problem, start.unknowns, iterations=iterations, tolerance=SEARCH_TOLERANCE, fixed=fixed)
    return Mixture(start.structure, end.unknowns)


def _error(data: FitData, mixture: Mixture) -> float:
    residual = MixtureProblem(data, mixture.structure).values(mixture.unknowns) - data.mean
    return float(np.sum(data.weight * residual**2))
