"""How many lobes, and where they start: the structure of the global fit.

The search works on slices only, the rows of the knots, and on every second node of theta_half, which makes it cheap:

1. Grow a mixture lobe by lobe up to the bound K_max.
2. For each K, after some more iterations almost without the pull between channels (E_p would see what it does to a lobe
   that is faint but wide), the expected negative log probability of the *other* half of the nodes (Nishino 2009,
   section 5),

       E_p = - sum_n v_n L_n log p(theta_n) / sum_n v_n L_n,

   for each (slice, channel), where p is the mixture normalised over the valid part of the hemisphere and v_n the solid
   angle of node n.  Held-out nodes keep a lobe that fits noise from looking better.  A hundredth of a uniform density
   is mixed into p, so that a tail in which a least-squares fit has underflowed does not decide alone.
3. Williams' step-down test takes the smallest K that is not significantly worse than K_max, by more than
   `INDIFFERENCE`: neighbouring slices share their smoothness and hence their errors, so that the test takes differences
   far below what any lobe of a material makes for significant.  Its pooled variance is inflated where the loss of a too
   small K differs between slices, so a K found to be worse than K_max is taken out of the layout before the next larger
   one is tested.
4. Add ring lobes while they pay on the held-out nodes, with a row between each two knots as well, so that what runs
   between the knots counts.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dsbrdf.data.grid import CENTER_CUTOFF
from dsbrdf.fitting.least_squares import FitData, ProfileProblem, minimize
from dsbrdf.fitting.matching_pursuit import Mixture, grow
from dsbrdf.fitting.options import MAX_RING_LOBES
from dsbrdf.fitting.williams_test import bic, williams_test

Array = NDArray[np.float64]

LARGEST_AUTOMATIC = 5
"""Upper bound of the automatic number of lobes."""
BACKGROUND = 0.01
"""Share of a uniform density in the probability of E_p."""
INDIFFERENCE = 3e-4
"""Difference in E_p, nats for a unit of energy, that decides nothing."""
RING_PAYS = 0.005
"""A ring lobe must lower the squared error, floor included, by this share."""
NEGLIGIBLE = 1e-6
"""... and by this share of the squared signal: errors below 0.1 % of the signal are nobody's material."""
_SLICE_SMOOTHING = 1e-6
_FEWEST_TO_SPLIT = 10  # columns of theta_half
_TEST_COUPLING = 1e-8
_TEST_TOLERANCE, _TEST_ITERATIONS = 1e-5, 25


@dataclass(frozen=True, eq=False)
class Structure:
    """Outcome of `find_structure`: a mixture to refine, and how it was chosen (tables for the report)."""

    mixture: Mixture
    selection: list[dict[str, Any]]
    rings: list[dict[str, Any]]


def find_structure(
    data: FitData,
    knots: NDArray[np.intp],
    n_lobes: int | Literal["auto"],
    ring_lobes: int | Literal["auto"],
    tick: Callable[[], None],
) -> Structure:
    """Choose the lobes and fit them to the slices at the knots.

    Parameters
    ----------
    data : FitData
    knots : ndarray of int, shape (D,)
        Rows of the theta_diff axis.
    n_lobes, ring_lobes : int or "auto"
        As in `FitOptions`.
    tick : callable
        Called at least once for each lobe grown.

    Returns
    -------
    Structure
    """
    columns = np.flatnonzero(data.weight.sum(axis=(0, 1)) > 0)
    fitted, held_out = columns[::2], columns[1::2]
    if columns.size < _FEWEST_TO_SPLIT:  # nothing to spare: no test of ring lobes then
        fitted, held_out = columns, columns
        ring_lobes = 0 if ring_lobes == "auto" else ring_lobes
    # More lobes than half of the nodes of a slice would fit anything.
    largest = max(1, min(LARGEST_AUTOMATIC, fitted.size // 2)) if n_lobes == "auto" else n_lobes
    slices = ProfileProblem(data, knots, knots, fitted, _SLICE_SMOOTHING)
    mixtures: list[Mixture] = []
    for _ in range(largest):
        mixtures.append(grow(slices, mixtures[-1] if mixtures else None, ring=False, tick=tick))
    free = ProfileProblem(data, knots, knots, fitted, _SLICE_SMOOTHING, _TEST_COUPLING)
    settled = [_settle(free, mixture) for mixture in mixtures]
    chosen, table = choose_n_lobes(free, ProfileProblem(data, knots, knots, held_out), settled)
    mixture = settled[chosen - 1 if n_lobes == "auto" else -1]
    between = np.unique(np.concatenate([knots, (knots[1:] + knots[:-1]) // 2]))
    problem, test = (ProfileProblem(data, knots, between, part) for part in (fitted, held_out))
    mixture, rings = _add_rings(problem, test, mixture, ring_lobes, tick)
    return Structure(mixture, table, rings)


def choose_n_lobes(
    fitted: ProfileProblem, held_out: ProfileProblem, mixtures: list[Mixture]
) -> tuple[int, list[dict[str, Any]]]:
    """Smallest number of lobes that is not significantly worse than the largest by more than `INDIFFERENCE`.

    Parameters
    ----------
    fitted, held_out : ProfileProblem
        What the mixtures were fitted to, and the nodes that E_p is taken on.
    mixtures : list of Mixture
        Of 1, 2, ... lobes.

    Returns
    -------
    n_lobes : int
    table : list of dict
        For each K: ``n_lobes``, ``e_p`` (mean over slices and channels), ``squared_error`` (of the slices, floor
        included), ``bic``, and Williams' ``t``, ``critical_value`` and ``significant`` from the layout that it was
        tested in.
    """
    statistic = np.array([expected_negative_log_probability(held_out, mixture) for mixture in mixtures])
    statistic = statistic[:, np.isfinite(statistic).all(axis=0)]
    n_samples = float(np.count_nonzero(fitted.weight))
    rows = []
    for k, mixture in enumerate(mixtures):
        error = float(np.sum(fitted.squared_error(mixture.lobes, mixture.unknowns) + fitted.floor))
        criterion = float(bic(error, n_samples, mixture.unknowns.size))
        rows.append({"n_lobes": k + 1, "squared_error": error, "bic": criterion if np.isfinite(criterion) else None})
    chosen = len(mixtures)
    compared = statistic.copy()
    compared[-1] += INDIFFERENCE
    tests: list[dict[str, Any]] = [{"t": None, "critical_value": None, "significant": False} for _ in mixtures]
    if statistic.shape[1] > 0:
        chosen = 1
        while chosen <= len(mixtures):
            test = williams_test(compared[chosen - 1 :]).table[0]
            tests[chosen - 1] = {key: asdict(test)[key] for key in tests[0]}
            if not test.significant:
                break
            chosen += 1
    means = statistic.mean(axis=1) if statistic.shape[1] else np.full(len(mixtures), np.nan)
    table = [
        row | {"e_p": float(mean) if np.isfinite(mean) else None} | test
        for row, mean, test in zip(rows, means, tests, strict=True)
    ]
    return chosen, table


def _settle(problem: ProfileProblem, mixture: Mixture) -> Mixture:
    """Continue the fit of a mixture to another problem."""
    lobes = mixture.lobes
    fitted = minimize(problem, lobes, mixture.unknowns, tolerance=_TEST_TOLERANCE, iterations=_TEST_ITERATIONS)
    return Mixture(lobes, fitted.unknowns)


def expected_negative_log_probability(problem: ProfileProblem, mixture: Mixture) -> Array:
    """E_p over theta_half >= 1 degree of each (channel, row), flattened; NaN without data (Nishino 2009, section 5)."""
    residual = problem.residuals(mixture.lobes, mixture.unknowns)
    positive = problem.root > 0
    model = np.where(positive, residual / np.where(positive, problem.root, 1.0), 0.0) + problem.mean
    outside = problem.theta_half >= CENTER_CUTOFF
    step = np.gradient(problem.theta_half) if problem.theta_half.size > 1 else np.ones(1)
    solid_angle = positive * outside * np.sin(problem.theta_half) * step
    total = np.sum(solid_angle * problem.mean, axis=2, keepdims=True)
    model_total = np.sum(solid_angle * model, axis=2, keepdims=True)
    area = solid_angle.sum(axis=2, keepdims=True)
    tiny = np.finfo(float).tiny
    probability = (1.0 - BACKGROUND) * model / np.maximum(model_total, tiny) + BACKGROUND / np.maximum(area, tiny)
    log_probability = np.log(np.maximum(probability, tiny))
    result = -np.sum(solid_angle * problem.mean * log_probability, axis=2) / np.where(total > 0, total, 1.0)[:, :, 0]
    return np.where(total[:, :, 0] > 0, result, np.nan).ravel()


def _add_rings(
    problem: ProfileProblem,
    test: ProfileProblem,
    mixture: Mixture,
    ring_lobes: int | Literal["auto"],
    tick: Callable[[], None],
) -> tuple[Mixture, list[dict[str, Any]]]:
    """Add the ring lobes asked for, or those that pay on the nodes that are held out."""
    table: list[dict[str, Any]] = []
    error, floor, signal = _error(test, mixture), float(test.floor.sum()), float(test.signal.sum())
    for number in range(1, (MAX_RING_LOBES if ring_lobes == "auto" else ring_lobes) + 1):
        larger = grow(problem, mixture, ring=True, tick=tick)
        larger_error = _error(test, larger)
        pays = error - larger_error > RING_PAYS * (error + floor) + NEGLIGIBLE * signal
        table.append({"ring_lobes": number, "squared_error": larger_error + floor, "pays": pays})
        if ring_lobes == "auto" and not pays:
            break
        mixture, error = larger, larger_error
    return mixture, table


def _error(problem: ProfileProblem, mixture: Mixture) -> float:
    return float(problem.squared_error(mixture.lobes, mixture.unknowns).sum())
