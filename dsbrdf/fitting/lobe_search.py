"""Search the lobes of a mixture: choose all lobes, fit the lobes, and drop useless lobes.

1. **Choice.** `dsbrdf.fitting.lobe_candidates` chooses all lobes by normal equations, without nonlinear fits. At first
   it chooses too many lobes, and then the least useful lobes are left out.
2. **Fit.** One nonlinear least-squares fit changes all lobes together, at first only the amplitudes, then with kappa
   fixed. If all unknowns changed at once, the first steps would be so long that tiny changes of the data decided how
   the fit ends.
3. **Elimination.** If the number of lobes is free, and the residuals are noise or negligible, the least useful lobe is
   dropped and the other lobes are fitted again, as long as the validation error hardly rises: the error on rows of
   theta_diff that no mixture was fitted to. Otherwise all lobes are kept: with and without a lobe, the errors are often
   equal up to 5 %, so tiny changes of the data would decide, and psnr would move by up to 5 dB.

A mixture of few lobes depends on the start of its fit. If the number of lobes is fixed and small, the first two steps
are repeated from several starts. In each mixture, the least useful lobe is replaced by the candidate that explains most
of the residual, if the error falls. The best mixture is kept.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from dsbrdf.arrays import Array, Mask
from dsbrdf.data.reduction import TINY
from dsbrdf.fitting.fit_data import FitData
from dsbrdf.fitting.least_squares import minimize
from dsbrdf.fitting.lobe_candidates import Candidates, fit_amplitudes, normal_equations, solved_amplitudes
from dsbrdf.fitting.mixture import Mixture, Structure, join_lobes
from dsbrdf.fitting.mixture_problem import MixtureProblem

MAX_SEARCHED_LOBES = 9
"""If the number of lobes is free, the search chooses this number of lobes and then drops useless lobes."""
TOLERATED_RISE = 0.005
"""A lobe is dropped if the validation error without the lobe is larger by a smaller fraction than this."""
NEGLIGIBLE_ERROR = 4e-6
"""A validation error below this fraction of the squared signal is negligible: differences of 0.2 % are invisible."""
NOISE_CORRELATION = 0.16
"""If the residuals of neighbouring samples have a smaller correlation, the residuals count as noise.

Independent noise has no correlation; residuals of a mixture that misses the shape of a material have a correlation
above 0.3 as a rule.
"""
MAX_NOISE_RESIDUAL = 0.3
"""Residuals larger than this multiple of their root mean square are clipped, so that few samples do not dominate."""
MAX_SIMPLE_LOBES = 3
"""If the residuals are noise, mixtures with at most this number of lobes about the normal are tried."""
MIN_COLUMNS_FOR_RINGS = 8
"""With data at fewer angles theta_half, optional ring lobes are not used, because any ring would explain the data."""
FIXED_KAPPA_ITERATIONS = 8
FIT_ITERATIONS = 28
SEARCH_TOLERANCE = 3e-3
"""An iteration of the search counts as stalled if it lowers the cost by a smaller fraction; a refinement follows."""
EXCHANGE_ITERATIONS = 8
SEARCH_PRIOR = (3e-7, 3e-8)
"""Costs of squared log kappa and squared elongation during the search, relative to the squared data.

Without this prior, nearly flat directions of the cost let equal materials end in different mixtures.
"""
N_EXTRA_CHOICES = 3
"""The choice takes this number of lobes too many, and then leaves out the least useful lobes."""
MAX_RESTARTED_LOBES = 5
"""If a larger number of lobes is fixed, the search has a single start."""
SPARE_LOBES = 3
"""One start of a search has this number of additional lobes, which are dropped again."""
MIN_WIDE_START_WIDTH = float(np.radians(40.0))
"""A single lobe also starts from at least this half width [rad]; from a narrow start, it may fit only a highlight."""
HEAVY_TAIL_FACTOR = 0.3
"""The last start is the best mixture with kappa times this factor, because fits seldom lower kappa far enough.

A single lobe is started again from the mixtures of all starts, not only from the best mixture.
"""


@dataclass(frozen=True)
class SearchStep:
    """Report a mixture that the search tried, and the validation error of the mixture."""

    n_lobes: int
    ring_lobes: int  # number of lobes with a center other than 0
    error: float  # weighted squared error on the rows held out, as a fraction of the squared values there
    kept: bool  # whether the search continued with this mixture


@dataclass(frozen=True)
class Wanted:
    """The number of all lobes and the number of ring lobes that a user wants, as in `FitOptions`."""

    n_lobes: int | Literal["auto"]
    ring_lobes: int | Literal["auto"]

    def limited_to(self, data: FitData) -> "Wanted":
        """Forbid optional ring lobes if there are so few angles theta_half that any ring would explain the data."""
        few = data.theta_half.shape[-1] < MIN_COLUMNS_FOR_RINGS
        return replace(self, ring_lobes=0) if few and self.ring_lobes == "auto" else self

    @property
    def is_few(self) -> bool:
        """Whether the number of lobes is fixed and so small that one start does not find the best mixture."""
        return self.n_lobes != "auto" and self.n_lobes <= MAX_RESTARTED_LOBES

    def max_lobes(self, data: FitData) -> int:
        """Return the number of lobes to choose first, which the number of angles theta_half bounds."""
        return min(MAX_SEARCHED_LOBES, data.theta_half.shape[-1] + 1) if self.n_lobes == "auto" else self.n_lobes

    def kinds_to_add(self, rings: tuple[bool, ...]) -> tuple[bool, ...]:
        """Return whether one more lobe may be a lobe about the normal (False in the tuple) or a ring (True)."""
        if self.ring_lobes == "auto":
            return (False, True) if False in rings else (False,)
        return (True,) if False in rings and sum(rings) < self.ring_lobes else (False,)

    def may_drop(self, rings: tuple[bool, ...]) -> list[bool]:
        """Tell for each lobe whether its removal keeps the fixed numbers of lobes."""
        spare = {False: rings.count(False) > 1, True: self.ring_lobes == "auto" or sum(rings) > self.ring_lobes}
        return [spare[is_ring] for is_ring in rings]


@dataclass(frozen=True)
class SearchData:
    """The data that lobes are fitted to, and the validation data that determine the number of lobes."""

    fitted: FitData
    held_out: FitData


@dataclass(frozen=True, eq=False)
class _Task:
    """The input of a search: data, the knots of parameters, candidates for lobes, and the wanted numbers."""

    data: FitData
    empty: Structure
    candidates: Candidates
    wanted: Wanted

    def fit(self, min_width: float = 0.0, **changes: int) -> Mixture:
        """Choose lobes and fit all unknowns; `min_width` is a minimum half width [rad].

        `changes` replace the wanted numbers of lobes.
        """
        start = self._choose(replace(self.wanted, **changes), min_width)
        if not self.wanted.is_few:
            start = fit_amplitudes(self.data, start)
        return _fit(self.data, start)

    def _choose(self, wanted: Wanted, min_width: float) -> Mixture:
        """Choose one candidate after the other, and leave out the least useful of them at the end."""
        candidates, chosen, shape = self.candidates, list[int](), self.candidates.size.shape
        amplitudes, gram = np.zeros((*shape[:2], 0)), np.zeros((*shape[:2], 0, 0))
        mixed = np.zeros((*shape[:2], 0, shape[2]))
        n_lobes = wanted.max_lobes(self.data)
        for _ in range(n_lobes if wanted.is_few else n_lobes + N_EXTRA_CHOICES):
            allowed = np.isin(candidates.is_ring, wanted.kinds_to_add(tuple(candidates.is_ring[chosen].tolist())))
            allowed &= candidates.width >= min_width
            allowed[chosen] = False
            chosen.append(candidates.best(gram, mixed, amplitudes, allowed))
            mixed = np.append(mixed, candidates.mixed(self.data, candidates.curves[:, chosen[-1:]]), axis=2)
            gram = mixed[..., chosen]
            amplitudes = solved_amplitudes(gram, candidates.right[..., chosen], amplitudes)
        while len(chosen) > n_lobes:
            dropped = _least_useful(gram, amplitudes, wanted.may_drop(tuple(candidates.is_ring[chosen].tolist())))
            del chosen[dropped]
            gram = np.delete(np.delete(gram, dropped, axis=2), dropped, axis=3)
            amplitudes = solved_amplitudes(gram, candidates.right[..., chosen])
        return candidates.start(self.data, self.empty, chosen, amplitudes)

    def exchange(self, mixture: Mixture) -> Mixture:
        """Replace the least useful lobe by the candidate that explains most of the residual, if the error falls."""
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
        """Tell whether the wanted numbers of lobes allow to drop any lobe of a mixture."""
        return any(self.wanted.may_drop(mixture.structure.rings))

    def drop_one(self, mixture: Mixture) -> Mixture:
        """Drop the lobe whose loss raises the error least, if the amplitudes of the other lobes are solved again."""
        rings = mixture.structure.rings
        curves = MixtureProblem(self.data, mixture.structure).curves(mixture.unknowns)
        gram, right = normal_equations(self.data, curves)
        dropped = _least_useful(gram, solved_amplitudes(gram, right), self.wanted.may_drop(rings))
        kept = np.delete(np.arange(len(rings)), dropped)
        return join_lobes(self.empty, np.array(rings)[kept], (part[..., kept] for part in mixture.lobes()))

    def shrink(self, mixture: Mixture) -> Mixture:
        """Drop the least useful lobe and fit the other lobes again."""
        return _minimize(self.data, self.drop_one(mixture), EXCHANGE_ITERATIONS)


def _least_useful(gram: Array, amplitudes: Array, may_drop: list[bool]) -> int:
    """Return the index of the lobe whose loss raises the error least, if the other amplitudes adjust to the loss."""
    k = len(may_drop)
    ridge = 1e-6 * np.trace(gram, axis1=2, axis2=3)[..., None, None] / k + TINY
    inverse = np.linalg.inv(gram + ridge * np.eye(k))
    loss = np.sum(amplitudes**2 / np.diagonal(inverse, axis1=2, axis2=3), axis=(0, 1))
    return int(np.where(may_drop, loss, np.inf).argmin())


def search(
    data: SearchData,
    empty: Structure,
    wanted: Wanted,
    exact: Callable[[Mixture], SearchData],
    on_stage: Callable[[], None],
) -> tuple[Mixture, list[SearchStep]]:
    """Search lobes with the knots of an `empty` structure; return the mixture and the steps of the search.

    If the residuals are only noise, errors from the bins of phi_diff matter; `exact` returns data without these errors.
    `on_stage` is called after each fit.
    """
    task = _Task(data.fitted, empty, Candidates.at(data.fitted, empty.family), wanted.limited_to(data.fitted))
    trials = _Trials(data.held_out, on_stage)
    if wanted.is_few:
        trials.add(mixture := _best_of_starts(task, data.held_out, on_stage))
        return mixture, trials.steps
    mixture = task.fit()
    is_free = wanted.n_lobes == "auto"
    is_noise = is_free and _correlation(task.data, mixture) < NOISE_CORRELATION
    if is_noise:
        data = exact(mixture)
        task, trials = replace(task, data=data.fitted), _Trials(data.held_out, on_stage)
        mixture = _minimize(task.data, mixture, EXCHANGE_ITERATIONS)
        trials.add(mixture)
        if (simple := _simplest(task, exact, trials)) is not None:
            return simple, trials.steps
    else:
        trials.add(mixture)
    is_free &= is_noise or trials.steps[0].error < NEGLIGIBLE_ERROR
    while is_free and task.may_drop(mixture) and trials.add(fewer := task.shrink(mixture)):
        mixture = fewer
    return mixture, trials.steps


class _Trials:
    """Compare mixtures by validation errors: a good mixture is hardly worse than the best mixture tried before."""

    def __init__(self, held_out: FitData, on_trial: Callable[[], None]) -> None:
        self.steps: list[SearchStep] = []
        self._held_out, self._on_trial, self._limit = held_out, on_trial, np.inf

    def add(self, mixture: Mixture, held_out: FitData | None = None) -> bool:
        """Add a mixture, and tell whether the mixture is good enough on the validation data.

        `held_out` replaces the usual validation data.
        """
        self._on_trial()
        held_out = held_out or self._held_out
        error = _error(held_out, mixture) / held_out.signal
        kept = error <= self._limit
        self.steps.append(SearchStep(mixture.structure.n_lobes, mixture.structure.n_rings, error, kept))
        self._limit = min(self._limit, (1.0 + TOLERATED_RISE) * error + NEGLIGIBLE_ERROR)
        return kept


def _simplest(task: _Task, exact: Callable[[Mixture], SearchData], trials: _Trials) -> Mixture | None:
    """Return the smallest mixture that is as good as the first trial, or None; optional ring lobes are not used.

    Every mixture is fitted to data from which errors of the bins of phi_diff are removed.
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
    """Fit a fixed number of lobes from several starts; return the mixture with the smallest error on all rows."""
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
    """Yield mixtures from different starts, which are compared afterwards.

    The first mixture has the lobes that explain most; other mixtures have no ring lobe or one ring lobe. The last
    mixture begins with `SPARE_LOBES` additional lobes, and the least useful lobes are dropped.
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
    """Return the correlation of the weighted, clipped residuals of neighbouring bins of phi_diff."""
    residual = MixtureProblem(data, mixture.structure).values(mixture.unknowns) - data.mean
    residual *= np.sqrt(data.weight)
    limit = MAX_NOISE_RESIDUAL * float(np.sqrt(np.mean(residual**2))) or 1.0
    residual = np.clip(residual / limit, -1.0, 1.0)
    both = (data.weight[..., 1:] > 0) & (data.weight[..., :-1] > 0)
    first, second = residual[..., 1:][both], residual[..., :-1][both]
    size = float(np.sqrt(np.sum(first**2) * np.sum(second**2)))
    return float(np.sum(first * second)) / size if size > 0.0 else 0.0


def _minimize(data: FitData, start: Mixture, iterations: int, fixed: Mask | None = None) -> Mixture:
    problem = MixtureProblem(data, start.structure, prior=SEARCH_PRIOR)
    end = minimize(problem, start.unknowns, iterations=iterations, tolerance=SEARCH_TOLERANCE, fixed=fixed)
    return Mixture(start.structure, end.unknowns)


def _error(data: FitData, mixture: Mixture) -> float:
    residual = MixtureProblem(data, mixture.structure).values(mixture.unknowns) - data.mean
    return float(np.sum(data.weight * residual**2))
