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
        ``relative_rms``, ``floor``, ``excess`` (None without a floor) and ``male``; see `dsbrdf.fitting.metrics`.
        Where only the profiles were given ``male`` is None, and all of them are if those were weighted.
    by_channel, by_theta_diff : list of dict
        ``relative_rms``, ``floor`` and ``excess`` of each channel, and of bands of theta_diff [rad]; empty where the
        metrics are None.
    slices : dict
        ``theta_diff`` (D) [rad] and, for each channel and knot (3, D), ``fitted`` (False: no data, parameters of the
        nearest fitted slice), ``converged``, ``iterations`` and ``bounds_hit``.
    selection : list of dict
        For each number of lobes tried: ``n_lobes``, ``e_p``, ``squared_error``, ``bic``, ``t``, ``critical_value``,
        ``significant``; see `dsbrdf.fitting.lobe_selection`.  Empty for the method "paper".
    rings : list of dict
        For each ring lobe tried: ``ring_lobes``, ``squared_error``, ``pays``.
    energy : dict
        ``theta_out`` [rad], ``albedo``: directional albedo there, to about 1e-3, (n, 3); ``sum_inverse_c``: the
        paper's sum of 1/C over the lobes, (3, D).
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
    selection: list[dict[str, Any]]
    rings: list[dict[str, Any]]
    energy: dict[str, list[Any]]
    timings: dict[str, float]
    options: dict[str, Any]
    versions: dict[str, str]


@dataclass(frozen=True)
class FitResult:
    """A model and the report of its fit."""

    model: DSBRDF
    report: FitReport
