"""How many lobes, and where they start: the structure of the global fit.

The search works on slices only, the rows of the knots, and on every second node of theta_half, which makes it cheap:

1. Grow a mixture lobe by lobe up to the bound K_max.
2. For each K, the expected negative log probability of the *other* half of the nodes (Nishino 2009, section 5),

       E_p = - sum_n v_n L_n log p(theta_n) / sum_n v_n L_n,

   for each (slice, channel), where p is the mixture normalised over the valid part of the hemisphere and v_n the solid
   angle of node n.  Held-out nodes keep a lobe that fits noise from looking better.  A hundredth of a uniform density
   is mixed into p, so that a tail in which a least-squares fit has underflowed does not decide alone.
3. Williams' step-down test takes the smallest K that is not significantly worse than K_max.  Its pooled variance is
   inflated where the loss of a too small K differs between slices, so a K found to be worse than K_max is taken out of
   the layout before the next larger one is tested.
4. Add ring lobes while they pay, with a row between each two knots as well, so that what runs between the knots counts.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dsbrdf.growth import Mixture, grow
from dsbrdf.options import MAX_RING_LOBES
from dsbrdf.profiles import CENTER_CUTOFF
from dsbrdf.refine import FitData, ProfileProblem
from dsbrdf.selection import bic, williams_test

Array = NDArray[np.float64]

LARGEST_AUTOMATIC = 5
"""Upper bound of the automatic number of lobes."""
BACKGROUND = 0.01
"""Share of a uniform density in the probability of E_p."""
RING_PAYS = 0.005
"""A ring lobe must lower the squared error, floor included, by this share."""
NEGLIGIBLE = 1e-6
"""... and by this share of the squared signal: errors below 0.1 % of the signal are nobody's material."""
_SLICE_SMOOTHING = 1e-6
_FITTED, _HELD_OUT = slice(0, None, 2), slice(1, None, 2)


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
    slices = ProfileProblem(data, knots, knots, _FITTED, _SLICE_SMOOTHING)
    mixtures: list[Mixture] = []
    for _ in range(LARGEST_AUTOMATIC if n_lobes == "auto" else n_lobes):
        mixtures.append(grow(slices, mixtures[-1] if mixtures else None, ring=False, tick=tick))
    held_out = ProfileProblem(data, knots, knots, _HELD_OUT)
    chosen, table = choose_n_lobes(slices, held_out, mixtures)
    mixture = mixtures[chosen - 1 if n_lobes == "auto" else -1]
    between = np.unique(np.concatenate([knots, (knots[1:] + knots[:-1]) // 2]))
    mixture, rings = _add_rings(ProfileProblem(data, knots, between, _FITTED), mixture, ring_lobes, tick)
    return Structure(mixture, table, rings)


def choose_n_lobes(
    fitted: ProfileProblem, held_out: ProfileProblem, mixtures: list[Mixture]
) -> tuple[int, list[dict[str, Any]]]:
    """Smallest number of lobes that is not significantly worse than the largest.

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
    tests: list[dict[str, Any]] = [{"t": None, "critical_value": None, "significant": False} for _ in mixtures]
    if statistic.shape[1] > 0:
        chosen = 1
        while chosen <= len(mixtures):
            test = williams_test(statistic[chosen - 1 :]).table[0]
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


def expected_negative_log_probability(problem: ProfileProblem, mixture: Mixture) -> Array:
    """E_p over theta_half >= 1 degree of each (channel, row), flattened; NaN without data (Nishino 2009, section 5)."""
    residual = problem.residuals(mixture.lobes, mixture.unknowns)
    positive = problem.root > 0
    model = np.where(positive, residual / np.where(positive, problem.root, 1.0), 0.0) + problem.mean
    outside = problem.theta_half >= CENTER_CUTOFF
    solid_angle = positive * outside * np.sin(problem.theta_half) * np.gradient(problem.theta_half)
    total = np.sum(solid_angle * problem.mean, axis=2, keepdims=True)
    model_total = np.sum(solid_angle * model, axis=2, keepdims=True)
    area = solid_angle.sum(axis=2, keepdims=True)
    tiny = np.finfo(float).tiny
    probability = (1.0 - BACKGROUND) * model / np.maximum(model_total, tiny) + BACKGROUND / np.maximum(area, tiny)
    log_probability = np.log(np.maximum(probability, tiny))
    result = -np.sum(solid_angle * problem.mean * log_probability, axis=2) / np.where(total > 0, total, 1.0)[:, :, 0]
    return np.where(total[:, :, 0] > 0, result, np.nan).ravel()


def _add_rings(
    problem: ProfileProblem, mixture: Mixture, ring_lobes: int | Literal["auto"], tick: Callable[[], None]
) -> tuple[Mixture, list[dict[str, Any]]]:
    """Add the ring lobes asked for, or those that pay."""
    table: list[dict[str, Any]] = []
    error = _error(problem, mixture)
    for number in range(1, (MAX_RING_LOBES if ring_lobes == "auto" else ring_lobes) + 1):
        larger = grow(problem, mixture, ring=True, tick=tick)
        larger_error = _error(problem, larger)
        gain = error - larger_error
        pays = bool(gain > RING_PAYS * (error + problem.floor.sum()) + NEGLIGIBLE * problem.signal.sum())
        table.append({"ring_lobes": number, "squared_error": larger_error + float(problem.floor.sum()), "pays": pays})
        if ring_lobes == "auto" and not pays:
            break
        mixture, error = larger, larger_error
    return mixture, table


def _error(problem: ProfileProblem, mixture: Mixture) -> float:
    return float(problem.squared_error(mixture.lobes, mixture.unknowns).sum())
