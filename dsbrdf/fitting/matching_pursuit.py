"""Growing a mixture lobe by lobe, by matching pursuit, as long as the next lobe is worth its numbers.

A new lobe is looked for where the current mixture leaves the largest residual: lobes of many widths, centers and
elongations are projected on it, and the one that explains most is fitted together with all the others for some
iterations.  Lobes about the normal and ring lobes compete on the same terms.  All channels get the same new lobe.

Whether it pays is decided on rows of theta_diff that no mixture was fitted to: a lobe that follows noise does not lower
the error there.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dsbrdf.data.grid import THETA_DIFF, THETA_HALF
from dsbrdf.fitting.least_squares import FitData, MixtureProblem, Structure, minimize
from dsbrdf.model.hemi_epd import half_width
from dsbrdf.model.lobes import SMALLEST_COSINE, lobe_values, stretch
from dsbrdf.model.splines import roughness

Array = NDArray[np.float64]

MAX_LOBES = 7
"""Most lobes of a mixture whose number is found."""
PAYS = 0.05
"""Share of the error on the rows held out by which a lobe has to lower it."""
NEGLIGIBLE = 1e-6
"""... and share of the weighted squared signal: errors below 0.1 % are nobody's material."""
_DEGREE = np.pi / 180.0
_WIDTHS = (0.4, 0.8, 1.5, 2.5, 4.0, 6.0, 10.0, 16.0, 25.0, 40.0, 60.0)
_RING_WIDTHS = (0.4, 0.8, 1.5, 3.0, 6.0, 10.0, 16.0, 25.0, 40.0)
_RING_CENTERS = (1.0, 2.0, 4.0, 8.0, 15.0, 25.0, 40.0, 60.0, 85.0)
_CUSP_WIDTHS = (0.7, 1.5, 3.0, 6.0, 9.0)
_CUSP_CENTER = -1.5  # half widths
_ELONGATIONS = (0.0, 1.0)
_START_ELONGATION = 0.5  # of the candidate's
_START_KAPPA = 1.0
_FAINTEST_START = 0.02  # of the lobe's typical amplitude: one that starts too faint has no derivative to grow by
_START_SMOOTHING = 3e-2
_ITERATIONS, _TOLERANCE = 12, 1e-3
_PATIENCE = 2  # lobes that do not pay before the next one may: two can need each other


@dataclass(frozen=True, eq=False)
class Mixture:
    """A structure and its unknowns."""

    structure: Structure
    unknowns: Array


@dataclass(frozen=True)
class GrowthStep:
    """One lobe tried.

    Attributes
    ----------
    n_lobes, ring_lobes : int
        Lobes about the normal, and ring lobes, with it.
    error : float
        Weighted squared error on the rows held out, as a share of the squared signal there.
    pays : bool
        Whether it was kept.
    """

    n_lobes: int
    ring_lobes: int
    error: float
    pays: bool


@dataclass(frozen=True)
class _Candidate:
    width: float
    center: float
    elongation: float

    @property
    def is_ring(self) -> bool:
        return self.center != 0.0

    @property
    def gamma(self) -> float:
        """Shape of a lobe of kappa 1 that has the half width: log-cosines scale with 1 / gamma."""
        return float(np.log(np.cos(half_width(_START_KAPPA, 1.0))) / np.log(np.cos(self.width)))


def grow(
    fitted: FitData,
    held_out: FitData,
    empty: Structure,
    n_lobes: int | Literal["auto"],
    ring_lobes: int | Literal["auto"],
    on_try: Callable[[], None],
) -> tuple[Mixture, list[GrowthStep]]:
    """Grow a mixture.

    Parameters
    ----------
    fitted, held_out : FitData
        The samples that mixtures are fitted to, and those that judge them.
    empty : Structure
        Without lobes: the knots and the family.
    n_lobes, ring_lobes : int or "auto"
        As in `FitOptions`.
    on_try : callable
        Called before each fit.

    Returns
    -------
    mixture : Mixture
    steps : list of GrowthStep
    """
    curves = {}
    for candidate in _candidates():
        curves[candidate] = _curve(fitted, candidate, empty.family)
    mixture, steps = Mixture(empty, np.zeros(0)), list[GrowthStep]()
    best, error, signal, failures = mixture, held_out.signal, held_out.signal, 0
    while mixture.structure.n_lobes < MAX_LOBES or _is_short(mixture.structure, n_lobes, ring_lobes):
        rings = mixture.structure.n_rings
        wanted = _kinds_wanted(mixture.structure.n_lobes - rings, rings, n_lobes, ring_lobes)
        if not wanted:
            break
        allowed = {candidate: curve for candidate, curve in curves.items() if candidate.is_ring in wanted}
        must = _is_short(mixture.structure, n_lobes, ring_lobes)
        mixture = _add_best(fitted, mixture, allowed, on_try)
        new_error = _error(held_out, mixture)
        pays = must or error - new_error > PAYS * error + NEGLIGIBLE * signal
        count = mixture.structure
        steps.append(GrowthStep(count.n_lobes - count.n_rings, count.n_rings, new_error / signal, pays))
        if pays:
            best, error, failures = mixture, min(error, new_error), 0
        else:
            failures += 1
            if failures > _PATIENCE:
                break
    return best, steps


def _kinds_wanted(
    n_lobes: int, n_rings: int, wanted: int | Literal["auto"], wanted_rings: int | Literal["auto"]
) -> set[bool]:
    """Which kinds the next lobe may be: False about the normal, True a ring.  The first is about the normal."""
    kinds = set()
    if wanted == "auto" or n_lobes < wanted:
        kinds.add(False)
    if (n_lobes or wanted == 0) and (wanted_rings == "auto" or n_rings < wanted_rings):
        kinds.add(True)
    return kinds


def _is_short(structure: Structure, wanted: int | Literal["auto"], wanted_rings: int | Literal["auto"]) -> bool:
    """Whether lobes that were asked for are still missing, or there is none at all."""
    centered = structure.n_lobes - structure.n_rings
    missing = (wanted != "auto" and centered < wanted) or (wanted_rings != "auto" and structure.n_rings < wanted_rings)
    return missing or structure.n_lobes == 0


def _candidates() -> list[_Candidate]:
    shapes = [(width, 0.0) for width in _WIDTHS]
    shapes += [(width, _CUSP_CENTER * width) for width in _CUSP_WIDTHS]
    # Not narrower than the steps of the grid at the center.
    shapes += [(w, c) for c in _RING_CENTERS for w in _RING_WIDTHS if w >= max(0.12 * c, 0.3 * min(c, 5.0))]
    return [_Candidate(w * _DEGREE, c * _DEGREE, e) for e in _ELONGATIONS for w, c in shapes]


def _curve(data: FitData, candidate: _Candidate, family: str) -> Array:
    """Values of a candidate, shape (R, N * 9)."""
    squared = np.tan(THETA_HALF[data.columns])[:, None] ** 2
    log_cos = np.log(np.maximum(np.cos(THETA_DIFF[data.rows]), SMALLEST_COSINE))[:, None, None]
    at = stretch(squared, data.cos2_phi, log_cos, np.array(candidate.elongation)).squared_tangent
    center = np.array(candidate.center) if candidate.is_ring else None
    values = lobe_values(at, np.array(_START_KAPPA), np.array(candidate.gamma), center, family)
    return np.ascontiguousarray(values.reshape(len(data.rows), -1))


def _add_best(data: FitData, mixture: Mixture, curves: dict[_Candidate, Array], on_try: Callable[[], None]) -> Mixture:
    residual = data.mean
    if mixture.structure.n_lobes:
        residual = residual - MixtureProblem(data, mixture.structure).values(mixture.unknowns)
    gain, amplitude = _project(data, residual, np.stack(list(curves.values())))
    candidates = list(curves)
    # Where several do equally well, as on a single column, the widest assumes least.
    best = max(np.flatnonzero(gain >= (1.0 - 1e-9) * gain.max()).tolist(), key=lambda i: candidates[i].width)
    on_try()
    start = _append(data, mixture, candidates[best], amplitude[:, :, best])
    problem = MixtureProblem(data, start.structure)
    solution = minimize(problem, start.unknowns, tolerance=_TOLERANCE, iterations=_ITERATIONS)
    return Mixture(start.structure, solution.unknowns)


def _project(data: FitData, residual: Array, curves: Array) -> tuple[Array, Array]:
    """Gain (n,) of each curve alone, and its amplitude in each channel and row (3, R, n), zero or positive."""
    n_rows = len(data.rows)
    by_row = np.ascontiguousarray(curves.transpose(1, 0, 2))
    squares = by_row**2
    gain, amplitude = np.zeros(len(curves)), np.zeros((3, n_rows, len(curves)))
    for channel in range(3):
        weight = data.weight[channel].reshape(n_rows, -1, 1)
        along = (by_row @ (weight * residual[channel].reshape(n_rows, -1, 1)))[..., 0]
        size = (squares @ weight)[..., 0]
        size = np.where(size > 0.0, size, np.inf)
        amplitude[channel] = np.maximum(along, 0.0) / size
        gain += np.sum(amplitude[channel] ** 2 * np.where(np.isfinite(size), size, 0.0), axis=0)
    return gain, amplitude


def _append(data: FitData, mixture: Mixture, candidate: _Candidate, amplitude: Array) -> Mixture:
    """Add a lobe with the amplitude that the residual asks for, (3, R); rings come last."""
    old = mixture.structure
    place = old.n_lobes if candidate.is_ring else old.n_lobes - old.n_rings
    rings = (*old.rings[:place], candidate.is_ring, *old.rings[place:])
    structure = replace(old, rings=rings)
    basis = MixtureProblem(data, replace(structure, rings=())).bases[0]
    level = np.sqrt(np.mean(amplitude**2, axis=1, keepdims=True))
    target = np.log(np.maximum(amplitude, _FAINTEST_START * level + 1e-9))
    ridge = _START_SMOOTHING * roughness(basis.shape[1]) + 1e-9 * np.eye(basis.shape[1])
    control = np.linalg.solve(basis.T @ basis + ridge, basis.T @ target.T)  # (D, 3)
    unknowns = np.zeros(structure.n_unknowns)
    amplitudes, shapes, elongations = structure.split(unknowns)
    k = structure.n_lobes
    others = [lobe for lobe in range(k) if lobe != place]
    heights = amplitudes.reshape(-1, 3, k)
    heights[:, :, place] = control
    if others:
        old_amplitudes, old_shapes, old_elongations = old.split(mixture.unknowns)
        n = old.n_lobes
        heights[:, :, others] = old_amplitudes.reshape(-1, 3, n)
        shapes[:, others], shapes[:, [k + lobe for lobe in others]] = old_shapes[:, :n], old_shapes[:, n : 2 * n]
        shapes[:, 2 * k : 2 * k + old.n_rings] = old_shapes[:, 2 * n :]
        elongations[:, others] = old_elongations
    shapes[:, place], shapes[:, k + place] = np.log(_START_KAPPA), np.log(candidate.gamma)
    elongations[:, place] = _START_ELONGATION * candidate.elongation
    if candidate.is_ring:
        shapes[:, -1] = candidate.center
    return Mixture(structure, unknowns)


def _error(data: FitData, mixture: Mixture) -> float:
    residual = MixtureProblem(data, mixture.structure).values(mixture.unknowns) - data.mean
    return float(np.sum(data.weight * residual**2))
