"""What a fit gives: the model and a report of how it was found and how good it is."""

from dataclasses import dataclass
from typing import Any

from dsbrdf.model.dsbrdf import DSBRDF


@dataclass(frozen=True)
class FitReport:
    """What a fit did and how good it is; plain numbers, lists and dicts throughout.

    Attributes
    ----------
    metrics : dict
        Those of `dsbrdf.fitting.metrics.METRICS`; ``excess`` is None without a floor, and all are None where only
        profiles were given.
    by_channel, by_theta_diff : list of dict
        The first five of them for each channel, and for bands of theta_diff [rad]; empty where they are None.
    slices : dict
        ``theta_diff`` [rad] of the knots and, for each channel and knot (3, knots), ``fitted`` (False: no data there),
        ``converged``, ``iterations`` and ``bounds_hit``.
    growth : list of dict
        For each lobe tried: ``n_lobes``, ``ring_lobes``, ``error`` on the samples held out, as a share of their squared
        signal, and ``pays``.  Empty for the method "paper".
    selection : list of dict
        Of the method "paper", where it chose the number of lobes, for each number: ``n_lobes``, ``e_p`` (expected
        negative log probability), ``squared_error``, ``bic``, and Williams' ``t``, ``critical_value`` and
        ``significant``.  Else empty.
    albedo : dict
        ``theta_out`` [rad], ``albedo``: directional albedo there, (n, 3).
    n_numbers : int
        How many numbers the model stores.
    timings : dict
        Seconds for each step.
    options : dict
        The `FitOptions` used.
    versions : dict
        Of the algorithm, this library and what it computes with.
    """

    metrics: dict[str, float | None]
    by_channel: list[dict[str, Any]]
    by_theta_diff: list[dict[str, Any]]
    slices: dict[str, list[Any]]
    growth: list[dict[str, Any]]
    selection: list[dict[str, Any]]
    albedo: dict[str, list[Any]]
    n_numbers: int
    timings: dict[str, float]
    options: dict[str, Any]
    versions: dict[str, str]


@dataclass(frozen=True)
class FitResult:
    """A model and the report of its fit."""

    model: DSBRDF
    report: FitReport
