"""Minimise a sum of squares within bounds by the method of Levenberg and Marquardt.

The damping is updated as by Nielsen (1999, IMM-REP-1999-05). An unknown at a bound is fixed if its step would cross the
bound. SciPy's solvers need the whole Jacobian; the problems of this package compute only the normal equations, which
are much smaller.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
from scipy.linalg.blas import dsymv, ssymv
from scipy.linalg.lapack import dgesv as gesv
from scipy.linalg.lapack import dpotrf, dtrtrs, spotrf, strtrs

from dsbrdf.arrays import Array, Mask

COST_TOLERANCE = 1e-3
"""An iteration that lowers the cost by a smaller fraction counts as stalled; the fit ends after several of them."""
MAX_UNKNOWN_STEP = 1.5
"""Maximum change of an unknown in one iteration: a logarithm, an angle [rad] or an elongation."""
START_DAMPING = 1e-2
MAX_DAMPING = 1e8
"""Iterations end if the damping is larger, because then no step lowers the cost."""
LIMIT_PASSES = 5
MIN_UNKNOWN_CHANGE = 1e-9
MAX_STALLED_ITERATIONS = 2
"""The fit ends after this number of stalled iterations in a row."""
Precision = np.dtype[np.floating[Any]]


class Costed(Protocol):
    """A point at which a problem was evaluated."""

    @property
    def unknowns(self) -> Array:
        """The unknowns at this point."""

    @property
    def cost(self) -> float:
        """The cost at this point."""


At = TypeVar("At", bound=Costed)


class Problem(Protocol[At]):
    """A sum of squares of functions of the unknowns, which `minimize` minimises."""

    @property
    def precision(self) -> Precision:
        """Precision in which the normal equations are solved."""

    def limit(self, unknowns: Array) -> Array:
        """Clip unknowns to their bounds."""

    def evaluate(self, unknowns: Array) -> At:
        """Return the cost, with whatever `linearize` needs."""

    def linearize(self, at: At) -> tuple[Array, Array]:
        """Return the lower triangle of the Gauss-Newton matrix, and half the gradient of the cost."""


@dataclass(frozen=True, eq=False)
class Solution:
    """The unknowns that `minimize` found, and the course of the iterations."""

    unknowns: Array
    cost: float
    converged: bool  # whether the cost stopped falling before the maximum number of iterations
    iterations: int


def minimize(
    problem: Problem[At],
    start: Array,
    *,
    iterations: int,
    tolerance: float = COST_TOLERANCE,
    fixed: Mask | None = None,
    on_iteration: Callable[[int], None] | None = None,
) -> Solution:
    """Minimise the cost by Levenberg-Marquardt within the bounds of the problem, from the unknowns `start`.

    An iteration that lowers the cost by less than the fraction `tolerance` counts as stalled. `on_iteration` is called
    with the number of each iteration. Unknowns that are `fixed` keep their start values.
    """
    at = problem.evaluate(problem.limit(start))
    damping, growth, stalled, is_new = START_DAMPING, 2.0, 0, True
    symv = ssymv if problem.precision == np.float32 else dsymv
    for number in range(1, iterations + 1):
        if on_iteration is not None:
            on_iteration(number)
        if is_new:
            matrix, gradient = problem.linearize(at)
        step = _step(problem, at.unknowns, matrix, gradient, damping, fixed)
        predicted = -float(2.0 * gradient @ step + step @ symv(1.0, matrix.T, step))
        proposed = problem.evaluate(at.unknowns + step) if predicted > 0.0 else at
        gain = (at.cost - proposed.cost) / predicted if predicted > 0.0 else -1.0
        is_new = gain > 0.0
        if is_new:
            stalled = stalled + 1 if at.cost - proposed.cost < tolerance * at.cost else 0
            at, damping, growth = proposed, damping * max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3), 2.0
            if stalled >= MAX_STALLED_ITERATIONS:
                return Solution(at.unknowns, at.cost, True, number)
        else:
            damping, growth = damping * growth, growth * 2.0
            if damping > MAX_DAMPING:
                return Solution(at.unknowns, at.cost, True, number)
    return Solution(at.unknowns, at.cost, False, iterations)


def _step(
    problem: Problem[Any], unknowns: Array, matrix: Array, gradient: Array, damping: float, fixed: Mask | None
) -> Array:
    """Return the damped Gauss-Newton step within the bounds of the problem, in the precision of the problem.

    An unknown that would cross its bound gets the step up to the bound. The other unknowns are then solved again with
    the same Cholesky factor; otherwise the other unknowns would compensate a step that is not made.
    """
    # An unknown at a bound is fixed if the cost falls beyond the bound.
    pushed = problem.limit(unknowns - MIN_UNKNOWN_CHANGE * np.sign(gradient))
    held = np.abs(pushed - unknowns) <= 0.5 * MIN_UNKNOWN_CHANGE
    if fixed is not None:
        held |= fixed
    if held.all():
        return np.zeros_like(gradient)
    potrf, trtrs = (spotrf, strtrs) if problem.precision == np.float32 else (dpotrf, dtrtrs)
    damped, diagonal = matrix.astype(problem.precision), matrix.diagonal()
    np.einsum("nn->n", damped)[...] += damping * (diagonal + 1e-12 * diagonal[~held].max())
    places = np.flatnonzero(held)
    damped[places], damped[:, places] = 0.0, 0.0
    damped[places, places] = 1.0
    factor, failed = potrf(damped.T, overwrite_a=True, clean=False)
    if failed:  # With a singular matrix, no step is made, so that the damping grows.
        return np.zeros_like(gradient)
    half = trtrs(factor, np.where(held, 0.0, -gradient), trans=1)[0]
    solved, places, columns = trtrs(factor, half)[0], np.zeros(0, np.intp), np.zeros((held.size, 0), order="F")
    stopped = np.zeros(held.size, bool)
    for _ in range(LIMIT_PASSES):
        step = problem.limit(unknowns + np.minimum(np.maximum(solved, -MAX_UNKNOWN_STEP), MAX_UNKNOWN_STEP)) - unknowns
        newly = np.flatnonzero(~stopped & ~held & (np.abs(step - solved) > MIN_UNKNOWN_CHANGE))
        if not newly.size:
            break
        stopped[newly] = True
        places = np.concatenate([places, newly])
        unit = np.zeros((held.size, newly.size), problem.precision, order="F")
        unit[newly, np.arange(newly.size)] = 1.0
        columns = np.concatenate([columns, trtrs(factor, unit, trans=1, overwrite_b=True)[0]], axis=1)
        force = gesv(columns.T @ columns, step[places] - columns.T @ half)[2]
        solved = trtrs(factor, half + columns @ force)[0]
        solved[places] = step[places]  # An unknown at its bound must not leave the bound by rounding.
    return step
