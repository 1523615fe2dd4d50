"""From a measurement, or its profiles, to a model and a report."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from os import PathLike
from typing import Any

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.measurement_files import read_measurement
from dsbrdf.data.reduction import Profiles, profiles
from dsbrdf.data.scattered_samples import ScatteredSamples
from dsbrdf.errors import ConvergenceWarning, InvalidArgumentError
from dsbrdf.fitting.global_method import fit_global, refine_at_samples
from dsbrdf.fitting.metrics import ALBEDO_ANGLES, Metrics, error_tables, sample_errors, sample_metrics
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.paper_method import fit_slicewise
from dsbrdf.fitting.report import DirectionalAlbedo, FitReport, FitResult, FoundModel, KnotReport
from dsbrdf.fitting.report_warnings import (
    accuracy_warnings,
    convergence_sentence,
    coverage_warnings,
    error_warnings,
    fit_warnings,
    unit_warnings,
)
from dsbrdf.fitting.sample_bins import sample_profiles, sample_rows, scattered_metrics
from dsbrdf.fitting.usual_materials import typical_error, usual_material, with_usual_values
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.process_settings import one_blas_thread
from dsbrdf.version import versions

_BINNED_ROUNDS = 2  # fits of scattered samples in bins: the second knows how to move them there
_HELD_OUT = 5  # of which each one scattered sample tells whether a lobe pays
_MOST_EXACT = 30_000  # scattered samples that are fitted where they are; of more, so many taken at random
_EXACT_ROUNDS = 3  # fits of scattered samples where they are


@one_blas_thread
def fit(
    measurement: Measurement | Profiles | ScatteredSamples | str | PathLike[str] | Array,
    options: FitOptions | None = None,
    *,
    progress: Callable[[float], None] | None = None,
    **choices: Any,
) -> FitResult:
    """Fit the model to a measurement.

    Parameters
    ----------
    measurement : Measurement, Profiles, ScatteredSamples, path-like or ndarray
        A path names a file that `dsbrdf.read_measurement` reads; an array has the shape (3, 90, 90, 180), see
        `Measurement.from_values`. Of scattered samples, which are fitted without a grid in between, only relative_rms
        and male are known. Profiles must have been made with the options' horizon cutoff, weighting and robustness;
        the metrics need the samples and are None then, see `add_sample_metrics`.
    options : FitOptions, optional
        Defaults to ``FitOptions()``.
    progress : callable, optional
        Called with the share of the work done, 0 to 1, at least once an iteration. What it raises ends the fit and
        reaches the caller.
    **choices
        Single options by name, such as ``n_lobes=2``, instead of ``options``.

    Raises
    ------
    FitError
        If the options leave no data to fit.
    InvalidArgumentError
        If profiles do not agree with the options, or an option is unknown or given twice.
    MeasurementFormatError
        If a file or an array is not an acceptable measurement.

    Warns
    -----
    ConvergenceWarning
        If the fit, or slices of it, stopped at the bound on the iterations. The report's `warnings` have this one too.
    """
    if options is not None and choices:
        raise InvalidArgumentError("give the options as FitOptions or by name, not both")
    options = options or FitOptions(**choices)
    if isinstance(measurement, str | PathLike):
        measurement = read_measurement(measurement)
    elif not isinstance(measurement, Measurement | Profiles | ScatteredSamples):
        measurement = Measurement.from_values(measurement)
    in_slices = options.method == "paper"
    report_progress = progress or (lambda _: None)
    clock = _Clock()
    report_progress(0.0)
    if isinstance(measurement, ScatteredSamples):
        result = _fit_samples(measurement, options, report_progress, clock)
    elif options.cosine is not None:
        raise InvalidArgumentError("cosine is for scattered samples; leave it out for a measurement on a grid")
    else:
        data = profiles_for(measurement, options)
        clock.lap("profiles")
        report_progress(0.1)
        on_share = lambda share: report_progress(0.1 + 0.8 * share)  # noqa: E731
        if in_slices:
            found = fit_slicewise(data, options, on_share)
            clock.lap("em")
        else:
            found, _ = fit_global(data, options, on_share, clock.lap)
        result = _result(found, data, options, clock, scattered=False)
    if isinstance(measurement, Measurement):
        result = add_sample_metrics(result, measurement)
    report_progress(1.0)
    if not np.all(result.report.knots.converged):
        sentence = convergence_sentence(result.report.knots, in_slices=in_slices)
        warnings.warn(sentence, ConvergenceWarning, stacklevel=3)
    return result


def _result(found: FoundModel, data: Profiles, options: FitOptions, clock: _Clock, *, scattered: bool) -> FitResult:
    """Model and report, without the metrics."""
    model, knots = found.model, found.knots
    albedo = DirectionalAlbedo(tuple(ALBEDO_ANGLES.tolist()), tuple(map(tuple, model.albedo(ALBEDO_ANGLES).tolist())))
    clock.lap("albedo")
    in_slices = options.method == "paper"
    report = FitReport(
        warnings=tuple(fit_warnings(model, data, knots, albedo, in_slices=in_slices, scattered=scattered)),
        metrics=Metrics(),
        by_channel=(),
        by_theta_diff=(),
        knots=knots,
        growth=found.growth,
        selection=found.selection,
        albedo=albedo,
        n_numbers=model.n_numbers,
        timings=clock.laps,
        options=options,
        versions=versions(),
    )
    return FitResult(model, report)


def _fit_samples(
    samples: ScatteredSamples, options: FitOptions, progress: Callable[[float], None], clock: _Clock
) -> FitResult:
    """Fit samples in bins, again with the samples moved to their bins by the model found, then where they are.

    Values of the usual material, with little weight, tell what no sample tells; where a fit of all parameters follows
    the samples worse than that material, it is the model. A robust fit ends in the bins, where it compares samples
    with their neighbours.
    """
    if options.method != "global":
        raise InvalidArgumentError("scattered samples cannot be fitted with method 'paper', which needs whole slices")
    samples = samples if options.cosine is None else samples.divided_by_cosine(options.cosine)
    usual, usual_cost = usual_material(samples)
    measured, (samples, far) = samples, with_usual_values(samples, usual)
    clock.lap("usual material")
    order = np.random.default_rng(0).permutation(len(samples.values))
    left_out = order % _HELD_OUT == 0
    parts = samples.take(~left_out), samples.take(left_out)
    model: DSBRDF | None = None
    for number in range(_BINNED_ROUNDS):
        data = sample_profiles(samples, options, model)
        fitted, held_out = (sample_profiles(part, options, model) for part in parts)
        clock.lap("profiles")
        found, mixture = fit_global(
            data,
            options,
            lambda share, done=number: progress(0.9 * (done + share) / _BINNED_ROUNDS),  # type: ignore[misc]
            clock.lap,
            (fitted, held_out),
        )
        model = found.model
    exact = samples.take(order < _MOST_EXACT)
    for _ in range(0 if options.robust else _EXACT_ROUNDS):
        found, mixture = refine_at_samples(sample_rows(exact, data, options, found.model), mixture, found.growth)
        clock.lap("refine")
    is_usual = typical_error(usual, measured) < typical_error(found.model, measured)
    if is_usual:
        found = replace(found, model=usual, knots=KnotReport.from_arrays(usual.theta_diff, True, True, 0, False))
    result = _result(found, data, options, clock, scattered=True)
    metrics = scattered_metrics(found.model, measured, options.horizon_cutoff)
    of_units = unit_warnings(measured, usual_cost, np.array(result.report.albedo.albedo))
    sentences = (*measured.notes, *of_units, *coverage_warnings(far, is_usual=is_usual))
    if not (is_usual or options.robust):
        rest = samples.take((order < _MOST_EXACT) & ~left_out)
        without, _ = refine_at_samples(sample_rows(rest, data, options, found.model), mixture, found.growth)
        judged = measured.take(left_out[: len(measured.values)])
        there = scattered_metrics(without.model, judged, options.horizon_cutoff)
        sentences += tuple(error_warnings(metrics, there))
        clock.lap("left out")
    sentences += result.report.warnings
    return replace(result, report=replace(result.report, metrics=metrics, warnings=sentences))


def profiles_for(measurement: Measurement | Profiles, options: FitOptions) -> Profiles:
    """Return the profiles of a measurement that a fit with these options works on.

    Raises InvalidArgumentError if profiles are given that were made with other options.
    """
    # The method "global" weighs the folded bins, which are never weighted before.
    weighting = options.resolved_weighting if options.method == "paper" else "plain"
    wanted: dict[str, Any] = {
        "horizon_cutoff": options.horizon_cutoff,
        "weighting": weighting,
        "robust": options.robust,
    }
    if isinstance(measurement, Measurement):
        return profiles(measurement, **wanted)
    for name, asked in wanted.items():
        made = getattr(measurement, name)
        if made != asked:
            raise InvalidArgumentError(f"the profiles were made with {name} {made!r}, the options ask for {asked!r}")
    return measurement


def add_sample_metrics(result: FitResult, measurement: Measurement) -> FitResult:
    """Complete the report of a `fit` of the profiles of a measurement with what only its samples can tell.

    The result is the same as a fit of the measurement itself, apart from the timings.
    """
    clock, model, report = _Clock(), result.model, result.report
    sums = sample_errors(model, measurement, report.options.horizon_cutoff)
    by_channel, by_theta_diff = error_tables(sums)
    metrics = sample_metrics(model, measurement, sums, np.array(report.albedo.albedo))
    clock.lap("metrics")
    complete = replace(
        report,
        warnings=(*report.warnings, *accuracy_warnings(metrics)),
        metrics=metrics,
        by_channel=by_channel,
        by_theta_diff=by_theta_diff,
        timings=report.timings | clock.laps,
    )
    return FitResult(model, complete)


class _Clock:
    """Seconds between laps."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.laps[name] = now - self._last
        self._last = now
