"""Growing a mixture lobe by lobe, by matching pursuit, as long as the next lobe is worth its numbers.

After a single lobe come those of the `first_lobes`: one highlight and one diffuse lobe. For the next one, lobes of many
widths, centers and elongations, about the normal or rings, are projected on the residual, with the amplitudes of the
others free to answer (orthogonal matching pursuit), and the one that explains most is fitted together with all others;
while lobes are few, the best near the normal and the best far from it are both tried.

Whether a lobe pays is decided on rows of theta_diff that no mixture was fitted to: one that follows noise does not
lower the error there. Growth ends at once where the residual looks like noise, that is where neighbouring samples of
phi_diff deviate independently. A mixture of lobes about the normal that gets there is taken instead of one with rings.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from dsbrdf.arrays import Array, Mask
from dsbrdf.data.weighting import TINY
from dsbrdf.fitting.first_lobes import FAINTEST_START, START_ELONGATION, fit_first_lobes
from dsbrdf.fitting.least_squares import TOLERANCE, FitData, MixtureProblem, minimize
from dsbrdf.fitting.structure import Mixture, Structure, change_knots
from dsbrdf.model.lobes import gamma_of_half_width, lobe_values, log_cosine, reach_of_width, width_of_reach
from dsbrdf.model.splines import smooth_control_values

MAX_GROWN_LOBES = 7
"""Most lobes of a mixture whose number is found."""
PAYS = 0.01
"""Share of the error on the rows held out by which a lobe has to lower it."""
NEGLIGIBLE = 4e-6
"""... and share of the weighted squared signal: errors below 0.2 % are nobody's material."""
NOISE_CORRELATION = 0.16
"""Correlation of neighbouring residuals below which they count as noise: 0 for noise of single samples, above 0.3 as a
rule where a mixture misses the shape of a material."""
_DEGREE = np.pi / 180.0
_WIDTHS = (0.4, 0.8, 1.5, 2.5, 4.0, 6.0, 10.0, 16.0, 25.0, 40.0, 60.0)
_RING_WIDTHS = (0.4, 0.8, 1.5, 3.0, 6.0, 10.0, 16.0, 25.0, 40.0)
_RING_CENTERS = (1.0, 2.0, 4.0, 8.0, 15.0, 25.0, 40.0, 60.0, 85.0)
_CUSP_WIDTHS = (0.7, 1.5, 3.0, 6.0, 9.0)
_CUSP_CENTER = -1.5  # half widths
_ELONGATIONS = (0.0, 1.0)
_START_KAPPA = 1.0
_FEWEST_COLUMNS = 8  # with data, that tell a highlight from what is about it
_BETTER = 0.9  # of the squared error with the first lobes
_FIRST_TWO, _LAST_TWO = 2, 5  # numbers of lobes between which a near and a far one are tried
_FAR = 20.0 * _DEGREE
_RIDGE = 1e-3
_FIXED_ITERATIONS, _ITERATIONS = 8, 9
_MOST_PLAIN_LOBES = 3  # that are tried in the place of rings
_LARGEST_RESIDUAL = 0.3  # in units of the root mean square: few samples must not decide what noise is
_NEARLY_NOISE = 0.9  # correlation below which a mixture is fitted on before it is judged
_LAST_ITERATIONS, _LAST_TOLERANCE = 20, 2e-2
_PATIENCE = 2  # lobes that do not pay before the next one may: two can need each other


@dataclass(frozen=True)
class GrowthStep:
    """One lobe tried."""

    n_lobes: int  # all lobes, with it
    ring_lobes: int  # those of them that have a center of their own
    error: float  # weighted squared error on the rows held out, as a share of the squared signal there
    pays: bool  # whether it was kept


@dataclass(frozen=True)
class _Candidate:
    width: float
    center: float
    elongation: float

    @property
    def is_ring(self) -> bool:
        return self.center != 0.0


def grow(
    fitted: FitData,
    held_out: FitData,
    empty: Structure,
    n_lobes: int | Literal["auto"],
    ring_lobes: int | Literal["auto"],
    on_try: Callable[[], None],
) -> tuple[Mixture, list[GrowthStep]]:
    """Grow a mixture from an `empty` structure on the data `fitted`, judged by those `held_out`.

    Numbers of lobes are as in `FitOptions`. Returns it with the lobes that were tried; `on_try` is called before each.
    """
    dictionary = _Dictionary.at(fitted, empty.family)
    mixture, steps, only_noise = Mixture(empty, np.zeros(0)), list[GrowthStep](), False
    best, error, signal, failures = mixture, held_out.signal, held_out.signal, 0
    while not only_noise and failures <= _PATIENCE and (kinds := _kinds_wanted(mixture.structure, n_lobes, ring_lobes)):
        on_try()
        must = n_lobes != "auto" or (ring_lobes != "auto" and mixture.structure.n_rings < ring_lobes) or not steps
        least = 0.0 if must else PAYS * error + NEGLIGIBLE * signal
        mixture = _with_next_lobe(fitted, held_out, mixture, dictionary, kinds, error - least)
        if n_lobes == ring_lobes == "auto":
            mixture, only_noise = _prefer_plain(fitted, mixture)
        new_error, structure = _error(held_out, mixture), mixture.structure
        pays = must or error - new_error > least
        steps.append(GrowthStep(structure.n_lobes, structure.n_rings, new_error / signal, pays))
        only_noise = only_noise and pays
        if pays:
            best, error, failures = mixture, min(error, new_error), 0
        else:
            failures += 1
    return best, steps


def _with_next_lobe(
    fitted: FitData, held_out: FitData, mixture: Mixture, dictionary: "_Dictionary", kinds: set[bool], goal: float
) -> Mixture:
    """Add a lobe and fit all; in the place of a single lobe, the first lobes unless two others are better."""
    starts = _starts(fitted, mixture, dictionary, kinds)
    found, start = min(((_fit(fitted, start), start) for start in starts), key=lambda pair: _error(fitted, pair[0]))
    if _error(held_out, found) > goal:
        found = min((found, _minimize(fitted, start, _ITERATIONS)), key=partial(_error, held_out))
    few_columns = fitted.theta_half.shape[-1] < _FEWEST_COLUMNS
    if mixture.structure.rings != (False,) or few_columns or False not in kinds:
        return found
    readable = _fit(fitted, _first_lobes(fitted, mixture.structure))
    return found if _error(fitted, found) < _BETTER * _error(fitted, readable) else readable


def _fit(data: FitData, start: Mixture) -> Mixture:
    """Fit from kappa = 1 at the same half widths, held at first.

    The old lobes have adapted to the lack of the new one, above all in kappa, which trades against gamma.
    """
    structure = start.structure
    unknowns = np.where(structure.is_kappa(), np.log(_START_KAPPA), start.unknowns)
    start = _minimize(data, Mixture(structure, unknowns), _FIXED_ITERATIONS, fixed=structure.is_kappa())
    return _minimize(data, start, _ITERATIONS)


def _first_lobes(data: FitData, like: Structure) -> Mixture:
    """The first lobes, on the knots and of the family of a structure."""
    first = fit_first_lobes(data)
    old, unknowns = replace(first.structure, bounds_of=(), theta_half=like.theta_half), first.unknowns
    if like.family != old.family:
        amplitude, shape, elongation = old.split(unknowns)
        k = old.n_lobes
        width, kappa = width_of_reach(np.exp(shape[:, k:]), old.family), np.full((len(shape), k), _START_KAPPA)
        old = replace(old, family=like.family)
        gamma = gamma_of_half_width(width, kappa, old.family)
        unknowns = old.join(amplitude, np.log(np.concatenate([kappa, gamma], axis=1)), elongation)
    return change_knots(Mixture(old, unknowns), replace(like, rings=old.rings))


def _kinds_wanted(
    structure: Structure, wanted: int | Literal["auto"], wanted_rings: int | Literal["auto"]
) -> set[bool]:
    """Kinds that the next lobe may have: True is a ring, False a lobe about the normal. A full mixture has none."""
    room = (MAX_GROWN_LOBES if wanted == "auto" else wanted) - structure.n_lobes
    missing_rings = room if wanted_rings == "auto" else wanted_rings - structure.n_rings
    kinds = {True} if missing_rings > 0 and structure.n_lobes else set[bool]()
    if room > (0 if wanted_rings == "auto" else missing_rings):
        kinds.add(False)
    return kinds


def _candidates() -> list[_Candidate]:
    shapes = [(width, 0.0) for width in _WIDTHS]
    shapes += [(width, _CUSP_CENTER * width) for width in _CUSP_WIDTHS]
    # Not narrower than the steps of the grid at the center.
    shapes += [(w, c) for c in _RING_CENTERS for w in _RING_WIDTHS if w >= max(0.12 * c, 0.3 * min(c, 5.0))]
    return [_Candidate(w * _DEGREE, c * _DEGREE, e) for e in _ELONGATIONS for w, c in shapes]


@dataclass(frozen=True, eq=False)
class _Dictionary:
    """All candidates, their values (R, n, N * P) and the squares of these."""

    candidates: list[_Candidate]
    curves: Array
    squares: Array

    @classmethod
    def at(cls, data: FitData, family: str) -> "_Dictionary":
        candidates = _candidates()
        along, across = data.squared_tangents
        curves = np.empty((len(along), len(candidates), along.shape[2]))
        kappa = np.array(_START_KAPPA)
        for n, one in enumerate(candidates):
            ratio = np.exp(one.elongation * log_cosine(data.theta_diff)[:, None])
            center = np.array(one.center) if one.is_ring else None
            gamma = gamma_of_half_width(np.array(one.width), kappa, family)
            curves[:, n] = lobe_values(along[:, 0] / ratio + across[:, 0] * ratio, kappa, gamma, center, family)
        return cls(candidates, curves, curves**2)


def _starts(data: FitData, mixture: Mixture, dictionary: _Dictionary, kinds: set[bool]) -> list[Mixture]:
    """Return mixtures with one more lobe, not yet fitted: the candidate that explains most of the residual.

    With a few lobes there are two of them, the best candidate near the mirror direction and the best one far from it.
    """
    k, candidates = mixture.structure.n_lobes, dictionary.candidates
    gain, amplitude = _project(data, mixture, dictionary)
    allowed = np.array([one.is_ring in kinds for one in candidates])
    far = np.array([abs(one.center) + one.width > _FAR for one in candidates])
    starts = []
    for group in (allowed & ~far, allowed & far) if _FIRST_TWO <= k < _LAST_TWO else (allowed,):
        if group.any():
            gains = np.where(group, gain, -1.0)
            # Where several do equally well, as on a single column, the widest assumes least.
            equal = np.flatnonzero(gains >= (1.0 - 1e-9) * gains.max()).tolist()
            best = max(equal, key=lambda i: candidates[i].width)
            starts.append(_append(data, mixture, candidates[best], amplitude[best]))
    return starts


def _minimize(
    data: FitData,
    start: Mixture,
    iterations: int,
    tolerance: float = TOLERANCE,
    fixed: Mask | None = None,
) -> Mixture:
    problem = MixtureProblem(data, start.structure)
    found = minimize(problem, start.unknowns, tolerance=tolerance, iterations=iterations, fixed=fixed)
    return Mixture(start.structure, found.unknowns)


def _prefer_plain(data: FitData, mixture: Mixture) -> tuple[Mixture, bool]:
    """Replace ring lobes by lobes about the normal where these leave only noise; tell whether the residual is noise."""
    if mixture.structure.n_rings and mixture.structure.n_lobes <= _MOST_PLAIN_LOBES:
        plain, only_noise = _settle(data, _fit(data, _about_normal(mixture)))
        if only_noise:
            return plain, True
    return _settle(data, mixture)


def _settle(data: FitData, mixture: Mixture) -> tuple[Mixture, bool]:
    """Fit on where the residual is nearly noise, and tell whether it is."""
    if _correlation(data, mixture) > _NEARLY_NOISE:
        return mixture, False
    mixture = _minimize(data, mixture, _LAST_ITERATIONS, tolerance=_LAST_TOLERANCE)
    return mixture, _correlation(data, mixture) < NOISE_CORRELATION


def _about_normal(mixture: Mixture) -> Mixture:
    """Replace each ring lobe by one about the normal that reaches as far; every kappa is that of a new lobe."""
    old = mixture.structure
    amplitude, shape, elongation = old.split(mixture.unknowns)
    k, plain = old.n_lobes, old.n_lobes - old.n_rings
    center = old.lobe_shapes(mixture.unknowns)[:, 2 * k :]
    width = width_of_reach(np.exp(shape[:, k + plain : 2 * k]), old.family)
    width = np.clip(width + center, 0.3 * width, 1.5)
    shape = shape[:, : 2 * k].copy()
    shape[:, :k] = np.log(_START_KAPPA)
    shape[:, k + plain :] = np.log(reach_of_width(width, old.family))
    parts = amplitude, shape, elongation
    return Mixture(replace(old, rings=(False,) * k), np.concatenate([part.ravel() for part in parts]))


def _correlation(data: FitData, mixture: Mixture) -> float:
    """Correlation of the weighted residuals of neighbouring bins of phi_diff, large ones clipped."""
    residual = _residual(data, mixture) * np.sqrt(data.weight)
    limit = _LARGEST_RESIDUAL * float(np.sqrt(np.mean(residual**2))) or 1.0
    residual = np.clip(residual / limit, -1.0, 1.0)
    both = (data.weight[..., 1:] > 0) & (data.weight[..., :-1] > 0)
    first, second = residual[..., 1:][both], residual[..., :-1][both]
    size = float(np.sqrt(np.sum(first**2) * np.sum(second**2)))
    return float(np.sum(first * second)) / size if size > 0.0 else 0.0


def _project(data: FitData, mixture: Mixture, dictionary: _Dictionary) -> tuple[Array, Array]:
    """What each candidate would explain of the residual, beside the lobes of the mixture: the gain (n,).

    There the amplitudes of these answer to it, row by row; beside it the amplitude (n, 3, R), where they stay.
    """
    (mean, weight), k = data.rows, mixture.structure.n_lobes
    root, others, residual = np.sqrt(weight), np.zeros((len(mean), 0, mean.shape[2])), mean
    if k:
        problem = MixtureProblem(data, mixture.structure)
        others = problem.curves(mixture.unknowns)
        residual = mean - problem.values(mixture.unknowns).transpose(1, 0, 2, 3).reshape(mean.shape)
    sizes = dictionary.squares @ weight.transpose(0, 2, 1)
    alongs = dictionary.curves @ (weight * residual).transpose(0, 2, 1)
    amplitude, gain = np.maximum(alongs, 0.0) / np.where(sizes > 0.0, sizes, np.inf), np.zeros(sizes.shape[1])
    for channel in range(3):
        known = others * root[:, channel, None]
        norm = np.linalg.norm(known, axis=2, keepdims=True) + TINY
        known /= norm
        target = known @ (root * residual)[:, channel, :, None]
        known_new = (known * root[:, channel, None]) @ dictionary.curves.transpose(0, 2, 1)
        square = known @ known.transpose(0, 2, 1) + _RIDGE * np.eye(k)
        answer = np.linalg.solve(square, np.concatenate([known_new, target], axis=2))
        size = sizes[..., channel]
        along = alongs[..., channel] - np.sum(known_new * answer[..., -1:], axis=1)
        left = np.maximum(size - np.sum(known_new * answer[..., :-1], axis=1), _RIDGE**2 * size + TINY)
        gain += np.sum(np.maximum(along, 0.0) ** 2 / left, axis=0)
    return gain, amplitude.transpose(1, 2, 0)


def _append(data: FitData, mixture: Mixture, candidate: _Candidate, amplitude: Array) -> Mixture:
    """Add a lobe with the amplitude that the residual asks for, (3, R); rings come last."""
    old = mixture.structure
    place = old.n_lobes if candidate.is_ring else old.n_lobes - old.n_rings
    rings = (*old.rings[:place], candidate.is_ring, *old.rings[place:])
    structure = replace(old, rings=rings)
    basis = MixtureProblem(data, replace(structure, rings=())).bases[0]
    level = np.sqrt(np.mean(amplitude**2, axis=1, keepdims=True))
    target = np.log(np.maximum(amplitude, FAINTEST_START * level + 1e-9))
    amplitudes, shapes, elongations = old.split(mixture.unknowns)
    n, reach = old.n_lobes, reach_of_width(np.array(candidate.width), old.family)
    heights = amplitudes.reshape(len(amplitudes), 3, n)
    heights = np.insert(heights, place, smooth_control_values(basis, target.T), axis=2)
    kappas = np.insert(shapes[:, :n], place, np.log(_START_KAPPA), axis=1)
    reaches = np.insert(shapes[:, n : 2 * n], place, np.log(reach), axis=1)
    centers = np.full((len(shapes), int(candidate.is_ring)), candidate.center)
    elongations = np.insert(elongations, place, START_ELONGATION * candidate.elongation, axis=1)
    parts = (heights, np.hstack([kappas, reaches, shapes[:, 2 * n :], centers]), elongations)
    return Mixture(structure, np.concatenate([part.ravel() for part in parts]))


def _residual(data: FitData, mixture: Mixture) -> Array:
    return MixtureProblem(data, mixture.structure).values(mixture.unknowns) - data.mean


def _error(data: FitData, mixture: Mixture) -> float:
    return float(np.sum(data.weight * _residual(data, mixture) ** 2))
