"""How many lobes the paper's method takes: Williams' test on the expected negative log probability of each slice.

For K = 1, 2, ... lobes and each block, a slice of a channel (Nishino 2009, section 5),

    E_p = - sum_n v_n L_n log p(theta_n) / sum_n v_n L_n,

where p is the mixture normalised over the nodes that the slice has, L_n the data and v_n the solid angle of node n; a
hundredth of a uniform density is mixed into p, so that a tail in which a fit has underflowed does not decide alone.
The smallest K that Williams' step-down test does not find worse than the largest is taken.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dsbrdf.fitting import em
from dsbrdf.fitting.williams_test import williams_test

Array = NDArray[np.float64]

LARGEST_AUTOMATIC = 5
"""Upper bound of the automatic number of lobes (Nishino 2009, section 5)."""
BACKGROUND = 0.01
"""Share of a uniform density in the probability."""


@dataclass(frozen=True)
class SelectionStep:
    """One number of lobes compared.

    Attributes
    ----------
    n_lobes : int
    e_p : float
        Expected negative log probability, mean over the slices.
    squared_error : float
        Over all samples used [1/sr^2].
    bic : float or None
        Bayesian information criterion with Gaussian errors of unknown variance; None for an exact fit.
    t, critical_value : float or None
        Williams' statistic and what it is compared with, see `WilliamsRow`.
    significant : bool
        Whether so few lobes are worse than the most.
    """

    n_lobes: int
    e_p: float
    squared_error: float
    bic: float | None
    t: float | None
    critical_value: float | None
    significant: bool


def choose_n_lobes(
    theta_half: Array,
    mean: Array,
    weight: Array,
    within: Array,
    fit_slices: Callable[[int], em.SliceFits],
) -> tuple[int, tuple[SelectionStep, ...]]:
    """Fit every number of lobes and choose one.

    Parameters
    ----------
    theta_half : ndarray, shape (N,)
        Nodes [rad].
    mean, weight, within : ndarray, shape (slices, N)
        Profiles of the slices, the last one the squared error that no mixture can avoid.
    fit_slices : callable
        Fits the slices with a number of lobes.

    Returns
    -------
    n_lobes : int
    table : tuple of SelectionStep
        For 1, 2, ... lobes.
    """
    # More lobes than half of the nodes of a slice would fit anything.
    largest = int(np.clip(np.count_nonzero(weight, axis=1).min() // 2, 1, LARGEST_AUTOMATIC))
    log_cos, errors, statistic = np.log(np.cos(theta_half)), [], []
    for n_lobes in range(1, largest + 1):
        found = fit_slices(n_lobes)
        curves = em.lobe_curves(log_cos, np.log(np.stack([found.kappa, found.gamma], axis=-1))).sum(axis=1)
        statistic.append(expected_negative_log_probability(theta_half, mean, weight > 0.0, curves))
        error = float(np.sum(weight * (curves - mean) ** 2 + within))
        n_samples = float(weight.sum())
        penalty = 2 * n_lobes * len(mean) * np.log(n_samples)
        errors.append((error, float(n_samples * np.log(error / n_samples) + penalty) if error > 0.0 else None))
    rows = williams_test(statistic)
    table = tuple(
        SelectionStep(row.n_lobes, row.mean, *found, row.t, row.critical_value, row.significant)
        for row, found in zip(rows, errors, strict=True)
    )
    return next(row.n_lobes for row in rows if not row.significant), table


def expected_negative_log_probability(theta_half: Array, mean: Array, used: NDArray[np.bool_], curves: Array) -> Array:
    """E_p of each slice, shape (slices,); 0 for slices of zeros.

    Parameters
    ----------
    theta_half : ndarray, shape (N,)
    mean, curves : ndarray, shape (slices, N)
        The data and the mixtures [1/sr].
    used : ndarray of bool, shape (slices, N)
    """
    solid_angle = used * np.sin(theta_half) * np.gradient(theta_half)
    light = solid_angle * mean
    tiny = np.finfo(float).tiny
    area, total = (
        np.maximum(np.sum(part, axis=1, keepdims=True), tiny) for part in (solid_angle, solid_angle * curves)
    )
    probability = (1.0 - BACKGROUND) * curves / total + BACKGROUND / area
    return np.asarray(-np.sum(light * np.log(probability), axis=1) / np.maximum(light.sum(axis=1), tiny))
