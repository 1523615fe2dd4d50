"""What runs in processes of this machine, one a fit: a fit in one step, or in three.

    compute:             file -> document

    reduce_measurement: file -> profiles, or scattered samples as they are
    fit_reduced:         these -> result, of profiles without metrics, perhaps on another machine
    complete_report:     that result, same file -> document

Both ways give the same document to the last bit, apart from the timings.
"""

import time
import warnings
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import asdict, replace
from threading import Event
from typing import Any

from dsbrdf.data.measurement import Measurement
from dsbrdf.data.measurement_files import open_checked, read_measurement
from dsbrdf.data.merl import read_merl
from dsbrdf.data.reduction import Profiles
from dsbrdf.data.scattered_samples import ScatteredSamples
from dsbrdf.engines.engine import Fault, FitDocument, FitLimits, FitTask, OnProgress, Outcome, Threads
from dsbrdf.engines.worker_process import run_in_process, start_fork_server
from dsbrdf.errors import ConvergenceWarning
from dsbrdf.fitting.decomposition import decompose
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import add_sample_metrics, fit, profiles_for
from dsbrdf.fitting.report import FitResult
from dsbrdf.output.serialize import to_json


def compute(task: FitTask, on_progress: OnProgress) -> FitDocument:
    """Fit the measurement of a task in one step."""
    return document_of(fit_reduced(_measurement(task), task.options, on_progress))


def reduce_measurement(task: FitTask, _: OnProgress) -> tuple[Profiles | ScatteredSamples, float]:
    """Return the measurement of a task in as few numbers as a fit needs, and the time [s] that this took."""
    measurement = _measurement_now(task)
    begin = time.perf_counter()
    reduced = profiles_for(measurement, task.options) if isinstance(measurement, Measurement) else measurement
    return reduced, time.perf_counter() - begin


def fit_reduced(
    measurement: Measurement | Profiles | ScatteredSamples, options: FitOptions, on_progress: OnProgress
) -> FitResult:
    """Fit a measurement; of profiles, the report lacks the metrics that need the samples."""
    with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):  # the report has them
        return fit(measurement, options, progress=on_progress)


def complete_report(result: FitResult, task: FitTask, sha256: str, seconds: float, _: OnProgress) -> Outcome:
    """Add what a fit of profiles lacks; the file must still be the one with this digest, reduced in this time."""
    measurement = _measurement_now(task)
    if measurement.sha256 != sha256:
        return Fault("system", "MeasurementChanged", "The measurement's file was changed while it was being fitted.")
    if isinstance(measurement, Measurement):
        timings = result.report.timings | {"profiles": seconds}
        result = add_sample_metrics(replace(result, report=replace(result.report, timings=timings)), measurement)
    return document_of(result)


def document_of(result: FitResult) -> FitDocument:
    """Return what is stored of a fit."""
    text = to_json(result.model, result.report, decompose(result.model))
    return FitDocument(text, asdict(result.report.metrics))


def _measurement(task: FitTask) -> Measurement | ScatteredSamples:
    if task.sha256 is None:
        return read_measurement(task.path, task.options)
    return open_checked(task.path, task.sha256, task.options)


def _measurement_now(task: FitTask) -> Measurement | ScatteredSamples:
    """Return the measurement as its file is now, with its present digest, also if it has been read before."""
    measurement = _measurement(task)
    return read_merl(task.path) if isinstance(measurement, Measurement) and task.sha256 is not None else measurement


class WorkerProcesses:
    """At most `count` worker processes of this machine at once, each with the limits; further calls wait."""

    def __init__(self, count: int, limits: FitLimits) -> None:
        self._limits = limits
        self._threads = Threads(count)

    def call(
        self, step: Callable[..., Any], *arguments: Any, on_progress: OnProgress = lambda _: None
    ) -> "Future[Any]":
        """Call ``step(*arguments, on_progress)`` in a new process; the future gets what it returns, or a `Fault`.

        `Future.cancel` ends the process; the future is done when it has ended.
        """
        return self._threads.submit(self._run, step, arguments, on_progress)

    def check(self) -> None:
        """Start the server from which processes are forked, unless it runs; RuntimeError if it cannot be started."""
        start_fork_server()

    def close(self) -> None:
        """End all processes, and return when they have ended."""
        self._threads.close()

    def _run(
        self, stopped: Event, step: Callable[..., Any], arguments: tuple[Any, ...], on_progress: OnProgress
    ) -> Any:
        return run_in_process(step, arguments, self._limits, on_progress, stopped.is_set)


class LocalEngine(WorkerProcesses):
    """Engine with at most so many fits at once on this machine, each in a worker process with the limits."""

    def __init__(self, workers: int, limits: FitLimits | None = None) -> None:
        super().__init__(workers, limits or FitLimits())

    def submit(self, task: FitTask, on_progress: OnProgress) -> "Future[Outcome]":
        """Compute a task in a new process."""
        return self.call(compute, task, on_progress=on_progress)
