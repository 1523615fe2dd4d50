"""From a measurement, or its profiles, to a model and a report."""

import time
import warnings
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import Profiles, profiles
from dsbrdf.errors import ConvergenceWarning, InvalidArgumentError
from dsbrdf.fitting.global_method import MAX_ITERATIONS, fit_global
from dsbrdf.fitting.metrics import error_tables, mean_absolute_log_error, relative_errors
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.paper_method import fit_slicewise
from dsbrdf.fitting.report import FitReport, FitResult
from dsbrdf.model.albedo import directional_albedo
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.hemi_epd import energy
from dsbrdf.version import versions

__all__ = ["fit", "profiles_for", "with_samples"]

Array = NDArray[np.float64]


def fit(
    measurement: Measurement | Profiles,
    options: FitOptions | None = None,
    *,
    plain: Profiles | None = None,
    progress: Callable[[float], None] | None = None,
) -> FitResult:
    """Fit the model to a measurement.

    Parameters
    ----------
    measurement : Measurement or Profiles
        Profiles must have been made with the options' horizon cutoff, weighting and robustness.
    options : FitOptions, optional
        Defaults to ``FitOptions()``.
    plain : Profiles, optional
        Where profiles are given that are weighted: those of the same measurement without weights, for the metrics.
    progress : callable, optional
        Called with the share of the work done, 0 to 1, at least once an iteration.  What it raises ends the fit and
        reaches the caller.

    Returns
    -------
    FitResult

    Raises
    ------
    FitError
        If the options leave no data to fit.
    InvalidArgumentError
        If profiles do not agree with the options.

    Warns
    -----
    ConvergenceWarning
        If slices stopped at the bound on the iterations; the report says which.
    """
    options = FitOptions() if options is None else options
    report_progress = progress if progress is not None else _ignore
    clock = _Clock()
    report_progress(0.0)
    data = profiles_for(measurement, options)
    clock.lap("profiles")
    report_progress(0.1)
    progress_fit = lambda share: report_progress(0.1 + 0.8 * share)  # noqa: E731
    if options.method == "paper":
        model, slices = fit_slicewise(data, options, progress_fit)
        selection, rings, bound = [], [], options.em_iterations
        clock.lap("em")
    else:
        outcome = fit_global(data, options, progress_fit, clock.lap)
        model, slices, selection, rings = outcome.model, outcome.slices, outcome.selection, outcome.rings
        bound = MAX_ITERATIONS
    metrics, by_channel, by_theta_diff = _metrics(model, measurement, plain or data, options)
    clock.lap("metrics")
    energies = _energy(model)
    clock.lap("energy")
    chosen = asdict(options) | {"knots": None if options.knots is None else list(options.knots)}
    report = FitReport(
        metrics, by_channel, by_theta_diff, slices, selection, rings, energies, clock.laps, chosen, versions()
    )
    report_progress(1.0)
    open_slices = int(np.sum(np.logical_not(slices["converged"])))
    if open_slices:
        warnings.warn(
            f"{open_slices} slices stopped at the bound of {bound} iterations before they converged",
            ConvergenceWarning,
            stacklevel=2,
        )
    return FitResult(model, report)


def profiles_for(measurement: Measurement | Profiles, options: FitOptions) -> Profiles:
    """Return the profiles of a measurement that a fit with these options works on.

    Raises
    ------
    InvalidArgumentError
        If profiles are given that were made with other options.
    """
    if isinstance(measurement, Measurement):
        return profiles(
            measurement,
            horizon_cutoff=options.horizon_cutoff,
            weighting=options.weighting,
            robust=options.robust,
        )
    for name in ("horizon_cutoff", "weighting", "robust"):
        made, asked = getattr(measurement, name), getattr(options, name)
        if made != asked:
            raise InvalidArgumentError(f"the profiles were made with {name} {made!r}, the options ask for {asked!r}")
    return measurement


def with_samples(result: FitResult, measurement: Measurement) -> FitResult:
    """Complete the report of a fit of profiles with what only the samples can tell.

    Parameters
    ----------
    result : FitResult
        Of `fit` with the profiles of `measurement`.
    measurement : Measurement

    Returns
    -------
    FitResult
        The same as a fit of `measurement` itself, apart from the timings.
    """
    clock, report = _Clock(), result.report
    male = mean_absolute_log_error(result.model, measurement, report.options["horizon_cutoff"])
    clock.lap("metrics")
    timings = report.timings | {"metrics": report.timings["metrics"] + clock.laps["metrics"]}
    return FitResult(result.model, replace(report, metrics=report.metrics | {"male": male}, timings=timings))


def _metrics(
    model: DSBRDF, measurement: Measurement | Profiles, data: Profiles, options: FitOptions
) -> tuple[dict[str, float | None], list[dict[str, Any]], list[dict[str, Any]]]:
    male = None
    if isinstance(measurement, Measurement):
        if data.weighted:
            data = profiles(measurement, horizon_cutoff=options.horizon_cutoff)
        male = mean_absolute_log_error(model, measurement, options.horizon_cutoff)
    elif data.weighted:
        return dict.fromkeys(("relative_rms", "floor", "excess", "male")), [], []
    by_channel, by_theta_diff = error_tables(model, data)
    return relative_errors(model, data) | {"male": male}, by_channel, by_theta_diff


def _energy(model: DSBRDF) -> dict[str, list[Any]]:
    theta_out = np.radians([0.0, 30.0, 60.0, 75.0])
    # A spline is smooth at its knots: without cuts there the quadrature takes a fifth of the time and is good to 1e-3.
    kinks = model.theta_diff if model.interpolation == "linear" else model.theta_diff[[0, -1]]
    albedo = directional_albedo(model.evaluate, theta_out, kinks)
    return {
        "theta_out": theta_out.tolist(),
        "albedo": albedo.tolist(),
        "sum_inverse_c": energy(model.kappa, model.gamma, model.center).sum(axis=2).tolist(),
    }


def _ignore(_: float) -> None:
    """No one wants to know the progress."""


class _Clock:
    """Seconds between laps."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.laps[name] = now - self._last
        self._last = now
