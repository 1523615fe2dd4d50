"""Growing a mixture lobe by lobe, by matching pursuit.

A new lobe is looked for where the current mixture leaves the largest residual: lobes of many widths (and, for ring
lobes, centers) are projected on it, the most promising few are fitted together with all the others for some
iterations, and the best is kept.  All channels get the same new lobe, so that lobes mean the same in every channel.

Compared with starting from Algorithm 1 at the knots this ends in better optima and costs less, because each number
of lobes continues from the one before.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dsbrdf.fitting.em import KAPPA_BOUNDS
from dsbrdf.fitting.least_squares import Lobes, ProfileProblem, minimize
from dsbrdf.model.hemi_epd import half_width

Array = NDArray[np.float64]

_HALF_WIDTHS = np.radians([0.7, 1.2, 2.0, 3.5, 6.0, 10.0, 16.0, 25.0, 40.0, 60.0])
_RING_HALF_WIDTHS = np.radians([0.3, 0.7, 1.2, 2.0, 3.5, 6.0, 10.0, 16.0, 25.0, 40.0])
_RING_CENTERS = np.radians([1.0, 2.0, 4.0, 8.0, 15.0, 25.0, 40.0, 60.0, 85.0])
_TRIES = 3
_ITERATIONS = 25
_TOLERANCE = 1e-4


@dataclass(frozen=True, eq=False)
class Mixture:
    """Lobes and their unknowns, shape (3, D, P)."""

    lobes: Lobes
    unknowns: Array


def grow(problem: ProfileProblem, mixture: Mixture | None, *, ring: bool, tick: Callable[[], None]) -> Mixture:
    """Add one lobe to a mixture and fit all of them.

    Parameters
    ----------
    problem : ProfileProblem
    mixture : Mixture or None
        What to add to; None starts a new one.
    ring : bool
        Whether the new lobe is a ring lobe.
    tick : callable
        Called before each try.

    Returns
    -------
    Mixture
        The best of a few tries.
    """
    residual = _residual(problem, mixture)
    tries = []
    for width, center in _promising(problem, residual, ring=ring):
        tick()
        start = _append(problem, mixture, residual, width, center, ring=ring)
        fitted = minimize(problem, start.lobes, start.unknowns, tolerance=_TOLERANCE, iterations=_ITERATIONS)
        tries.append(Mixture(start.lobes, fitted.unknowns))
    return min(tries, key=lambda m: float(problem.squared_error(m.lobes, m.unknowns).sum()))


def _residual(problem: ProfileProblem, mixture: Mixture | None) -> Array:
    """What the mixture leaves, (3, rows, N) [1/sr]; 0 where there are no data."""
    if mixture is None:
        return problem.mean
    weighted = problem.residuals(mixture.lobes, mixture.unknowns)
    return np.asarray(-weighted / np.where(problem.root > 0, problem.root, np.inf))


def _promising(problem: ProfileProblem, residual: Array, *, ring: bool) -> list[tuple[float, float]]:
    """Widths and centers of the lobes that promise the largest gain, the best first, no two alike."""
    scored = []
    for center in _RING_CENTERS if ring else (0.0,):
        for width in _RING_HALF_WIDTHS if ring else _HALF_WIDTHS:
            if width < max(0.1 * center, 0.3 * min(center, np.radians(5.0))):
                continue  # narrower than the steps of the grid there
            along, size = _project(problem, residual, _shape(problem.theta_half, width, center))
            gain = np.maximum(along, 0.0) ** 2 / np.where(size > 0, size, np.inf)
            scored.append((float(gain.sum()), float(width), float(center)))
    chosen: list[tuple[float, float]] = []
    for _, width, center in sorted(scored, reverse=True):
        if all(_differ(width, center, *other) for other in chosen):
            chosen.append((width, center))
    return chosen[:_TRIES]


def _differ(width: float, center: float, other_width: float, other_center: float) -> bool:
    apart = 0.45 * max(center, other_center, np.radians(2.0))
    return abs(np.log(width / other_width)) > 0.6 or abs(center - other_center) > apart


def _shape(theta_half: Array, width: float, center: float) -> Array:
    """Shape of a faint lobe of this half width: cos(theta - center)**gamma."""
    cosine = np.maximum(np.cos(theta_half - center), 1e-9)
    return np.asarray(cosine ** (np.log(0.5) / np.log(np.cos(width))))


def _project(problem: ProfileProblem, residual: Array, shape: Array) -> tuple[Array, Array]:
    """Inner products of the shape with the residual, and with itself, for each channel and row."""
    return (problem.weight * residual) @ shape, problem.weight @ shape**2


def _append(
    problem: ProfileProblem, mixture: Mixture | None, residual: Array, width: float, center: float, *, ring: bool
) -> Mixture:
    """Add a lobe of given width and center, with the amplitude that the residual asks for at each knot."""
    along, size = _project(problem, residual, _shape(problem.theta_half, width, center))
    total = problem.weight.sum(axis=2)
    level = np.sqrt(np.einsum("crn,crn->cr", problem.data, problem.data) / np.where(total > 0, total, np.inf))
    # A lobe that starts too faint has no derivative to grow by.
    amplitude = np.maximum(along / np.where(size > 0, size, np.inf), 0.03 * level + 1e-8)
    basis = problem.basis
    ridge = 1e-9 * np.eye(basis.shape[1]) + 1e-2 * problem.smoothing / max(
        np.abs(problem.smoothing).max(initial=0), 1e-300
    )
    log_kappa = np.linalg.solve(basis.T @ basis + ridge, basis.T @ np.log(np.log1p(amplitude)).T).T
    log_kappa = np.clip(log_kappa, np.log(KAPPA_BOUNDS[0]), np.log(problem.largest_kappa))
    # At this kappa a lobe of gamma 1 has a known half width; its log-cosine scales with 1 / gamma.
    log_gamma = np.log(np.log(np.cos(half_width(np.exp(log_kappa), 1.0))) / np.log(np.cos(width)))
    old = Lobes(0) if mixture is None else mixture.lobes
    unknowns = np.zeros((*log_kappa.shape, 0)) if mixture is None else mixture.unknowns
    place = old.count if ring else old.centered
    kappas, gammas, centers = old.split(unknowns)
    parts = [np.insert(kappas, place, log_kappa, axis=2), np.insert(gammas, place, log_gamma, axis=2), centers]
    if ring:
        parts.append(np.full((*log_kappa.shape, 1), center))
    return Mixture(Lobes(old.centered + (not ring), old.rings + ring), np.concatenate(parts, axis=2))
