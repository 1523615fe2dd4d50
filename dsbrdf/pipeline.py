"""Fit a measurement, its profiles or scattered samples: return a model and a report."""

from __future__ import annotations

import inspect
import time
import warnings
from collections.abc import Callable, Iterable
from dataclasses import fields, replace
from os import PathLike
from typing import Any

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.faults import profile_findings
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import Profiles, profiles
from dsbrdf.data.value_faults import value_findings
from dsbrdf.errors import ConvergenceWarning, InvalidArgumentError
from dsbrdf.findings import Finding
from dsbrdf.fitting.global_method import fit_global, refine_at_samples
from dsbrdf.fitting.metrics import ALBEDO_ANGLES, Metrics, error_tables, sample_errors, sample_metrics
from dsbrdf.fitting.options import FitOptions, check_names
from dsbrdf.fitting.report import DirectionalAlbedo, FoundModel
from dsbrdf.paper.paper_method import fit_slicewise
from dsbrdf.process_settings import one_blas_thread
from dsbrdf.result import (
    MAX_EXPECTED_ERROR,
    FitReport,
    FitResult,
    accuracy_findings,
    convergence_finding,
    fit_findings,
    sample_findings,
)
from dsbrdf.samples.doubts import sample_doubts
from dsbrdf.samples.prediction import SamplePrediction, thinned, without_outliers
from dsbrdf.samples.reading import read_measurement
from dsbrdf.samples.scattered_fit import (
    expected_error,
    left_out_errors,
    left_out_values,
    pairs_to_measure,
    predicted_profiles,
    sample_rows,
    scattered_metrics,
    unconfirmed_sample,
)
from dsbrdf.samples.scattered_samples import ScatteredSamples
from dsbrdf.samples.table_options import TABLE_OPTIONS, TableOptions
from dsbrdf.version import versions

FEW_SAMPLES = 200
"""With fewer scattered samples, the model is mostly that of physical layers, which a finding says."""
REFINEMENT_ROUNDS = 3
"""Number of fits to the scattered samples; before each fit, the latest model moves samples to whole degrees."""
MAX_REFINED_SAMPLES = 30_000
"""If there are more scattered samples, the model is refined at a random subset of this size."""


@one_blas_thread
def fit(
    measurement: Measurement | Profiles | ScatteredSamples | str | PathLike[str] | Array,
    options: FitOptions | None = None,
    *,
    progress: Callable[[float], None] | None = None,
    **choices: Any,
) -> FitResult:
    """Fit the model to a measurement, which may be an object, an array or a file.

    Parameters
    ----------
    measurement : Measurement, Profiles, ScatteredSamples, path-like or ndarray
        A path must name a file that `dsbrdf.read_measurement` reads. An array must have the shape (3, 90, 90, 180), see
        `Measurement.from_values`. Scattered samples are fitted without a grid. Profiles must have been made with the
        horizon cutoff, the weighting and the robustness of the options; their metrics are None, because metrics need
        the samples, see `add_sample_metrics`.
    options : FitOptions, optional
        Defaults to ``FitOptions()``.
    progress : callable, optional
        Called with the completed fraction, 0 to 1, at least once in each iteration. If it raises an exception, the fit
        ends with this exception.
    **choices
        Single options by name instead of ``options``, such as ``n_lobes=2``, and options with which a table in a file
        is read, such as ``scale=0.01``. All are listed below.

    Raises
    ------
    FitError
        If the options leave no data to fit.
    InvalidArgumentError
        If profiles were made with other options, or an option is unknown or given twice.
    MeasurementFormatError
        If a file or an array is not an acceptable measurement.

    Warns
    -----
    ConvergenceWarning
        If the fit, or slices of it, stopped at the maximum number of iterations. The report contains this warning too.
    """
    of_table = {name: choices.pop(name) for name in TABLE_OPTIONS if name in choices}
    if options is not None and choices:
        raise InvalidArgumentError("give the options as FitOptions or by name, not both")
    check_names(choices, (*(declared.name for declared in fields(FitOptions)), *TABLE_OPTIONS))
    options = options or FitOptions(**choices)
    if isinstance(measurement, str | PathLike):
        measurement = read_measurement(measurement, **of_table)
    elif of_table:
        named = " and ".join(of_table)
        remedy = f"give the path of the table, or leave {named} out"
        raise InvalidArgumentError(f"{named} applies to a table in a file: {remedy}")
    elif not isinstance(measurement, Measurement | Profiles | ScatteredSamples):
        measurement = Measurement.from_values(measurement)
    in_slices = options.method == "paper"
    report_progress = progress or (lambda _: None)
    clock = _Clock()
    report_progress(0.0)
    if isinstance(measurement, ScatteredSamples):
        result = _fit_samples(measurement, options, report_progress, clock)
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
        result = _result(found, data, options, clock, profile_findings(data))
    if isinstance(measurement, Measurement):
        result = add_sample_metrics(result, measurement)
    report_progress(1.0)
    if not np.all(result.report.knots.converged):
        stopped = convergence_finding(result.report.knots, in_slices=in_slices)
        warnings.warn(stopped.sentence, ConvergenceWarning, stacklevel=3)
    return result


_OPTIONS = "\n".join(
    (inspect.getdoc(options) or "").partition("Attributes\n----------\n")[2].partition("\n\n")[0]
    for options in (FitOptions, TableOptions)
)
fit.__doc__ = (inspect.getdoc(fit) or "").replace(
    "Raises\n", f"Other Parameters\n----------------\n{_OPTIONS}\n\nRaises\n", 1
)


def _result(
    found: FoundModel,
    data: Profiles,
    options: FitOptions,
    clock: _Clock,
    faults: Iterable[Finding] = (),
    *,
    is_unit_wrong: bool = False,
) -> FitResult:
    """Return the result of a fit, the model and its report, without metrics; `faults` are findings about the data."""
    model, knots = found.model, found.knots
    albedo = DirectionalAlbedo(tuple(ALBEDO_ANGLES.tolist()), tuple(map(tuple, model.albedo(ALBEDO_ANGLES).tolist())))
    clock.lap("albedo")
    in_slices = options.method == "paper"
    findings = fit_findings(data, knots, albedo, in_slices=in_slices, is_unit_wrong=is_unit_wrong)
    report = FitReport(
        findings_of_fit=(*faults, *findings),
        metrics=Metrics(),
        by_channel=(),
        by_theta_diff=(),
        knots=knots,
        search=found.search,
        selection=found.selection,
        directional_albedo=albedo,
        n_numbers=model.n_numbers,
        timings=clock.laps,
        options=options,
        versions=versions(),
    )
    return FitResult(model, report)


def _fit_samples(
    samples: ScatteredSamples, options: FitOptions, progress: Callable[[float], None], clock: _Clock
) -> FitResult:
    """Fit the model to samples with a usual albedo, and report on the samples as they were measured."""
    if options.method != "global":
        raise InvalidArgumentError("scattered samples cannot be fitted with method 'paper', which needs whole slices")
    doubts = sample_doubts(samples)
    used = replace(samples, values=samples.values * doubts.factor)  # At the end, the model is divided by this factor.
    if options.robust:
        used = without_outliers(used)
    known = thinned(used)
    prediction = SamplePrediction.fit(known)
    clock.lap("prediction")
    table, found = _model_of_samples(used, prediction, options, progress, clock)
    progress(0.9)
    without = left_out_values(known, prediction, found.model)
    left_out, rows = left_out_errors(known, without, options.horizon_cutoff)
    expected = expected_error(prediction, found.model, known)
    pairs = pairs_to_measure(prediction, found.model) if expected > MAX_EXPECTED_ERROR else ()
    clock.lap("left out")
    amplitude = found.model.amplitude / doubts.factor
    if np.all(samples.values == samples.values[:, :1]):  # The samples are grey, so the model must be exactly grey too.
        amplitude = np.broadcast_to(amplitude.mean(axis=0), amplitude.shape).copy()
    found = replace(found, model=replace(found.model, amplitude=amplitude))
    result = _result(found, table, options, clock, is_unit_wrong=doubts.factor != 1.0)
    metrics = scattered_metrics(found.model, samples, options.horizon_cutoff)
    metrics = replace(metrics, relative_rms_left_out=left_out, relative_rms_expected=expected)
    findings = (
        *(Finding("reading", sentence) for sentence in samples.notes),
        *doubts.findings,
        *sample_findings(samples, metrics, prediction.layers.found[0].structure.name, FEW_SAMPLES),
        *(Finding("unconfirmed-sample", sentence) for sentence in unconfirmed_sample(known, without)),
        *result.report.findings_of_fit,
    )
    report = replace(
        result.report,
        metrics=metrics,
        findings_of_fit=findings,
        left_out=rows,
        measure_next=pairs,
        samples=samples.sha256,
    )
    return replace(result, report=report)


def _model_of_samples(
    samples: ScatteredSamples,
    prediction: SamplePrediction,
    options: FitOptions,
    progress: Callable[[float], None],
    clock: _Clock,
) -> tuple[Profiles, FoundModel]:
    """Fit a table predicted from samples, then the table and the samples together."""
    table = predicted_profiles(samples, prediction, options)
    clock.lap("profiles")
    found, mixture = fit_global(table, options, lambda share: progress(0.1 + 0.7 * share), clock.lap)
    exact = thinned(samples, MAX_REFINED_SAMPLES)
    for _ in range(REFINEMENT_ROUNDS):
        data = sample_rows(exact, table, options, prediction, found.model)
        refined, mixture = refine_at_samples(data, mixture)
        found = replace(refined, search=found.search)
    clock.lap("refine at samples")
    return table, found


def profiles_for(measurement: Measurement | Profiles, options: FitOptions) -> Profiles:
    """Return the profiles that a fit with these options needs.

    Raises InvalidArgumentError if the profiles passed as `measurement` were made with other options.
    """
    # The method "global" weights the means in bins of phi_diff itself, so it needs profiles without weighting.
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
            raise InvalidArgumentError(
                f"the profiles were made with {name}={made!r}, but the options have {asked!r}: use equal values"
            )
    return measurement


def add_sample_metrics(result: FitResult, measurement: Measurement) -> FitResult:
    """Add the metrics, and the findings about them, to a fit of profiles, from the samples of the measurement.

    The result equals a fit of the measurement itself, except for the timings.
    """
    clock, model, report = _Clock(), result.model, result.report
    sums = sample_errors(model, measurement, report.options.horizon_cutoff)
    by_channel, by_theta_diff = error_tables(sums)
    metrics = sample_metrics(model, measurement, sums, np.array(report.directional_albedo.rgb))
    clock.lap("metrics")
    accuracy = accuracy_findings(metrics, is_clipped=result.is_clipped)
    complete = replace(
        report,
        findings_of_fit=(*report.findings_of_fit, *value_findings(measurement), *accuracy),
        metrics=metrics,
        by_channel=by_channel,
        by_theta_diff=by_theta_diff,
        timings=report.timings | clock.laps,
    )
    return FitResult(model, complete)


class _Clock:
    """Measure the seconds between laps."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.laps[name] = now - self._last
        self._last = now
