"""Define the steps of a fit that run in worker processes, and the engine that runs fits on this machine."""

import warnings
from concurrent.futures import Future
from dataclasses import asdict, replace

from dsbrdf.components.decomposition import decompose
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import Profiles
from dsbrdf.engines.engine import FitDocument, FitTask, OnProgress, Outcome
from dsbrdf.engines.processes import Processes
from dsbrdf.errors import ConvergenceWarning
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.report import FitResult
from dsbrdf.output.serialize import to_json
from dsbrdf.output.sphere_panels import thumbnail
from dsbrdf.pipeline import fit
from dsbrdf.samples.reading import open_checked, read_measurement
from dsbrdf.samples.scattered_samples import ScatteredSamples


def compute(task: FitTask, on_progress: OnProgress) -> FitDocument:
    """Fit the measurement of a task, and return the fit as a `FitDocument`."""
    measurement = measurement_of(task)
    result = fit_quietly(measurement, task.options, on_progress)
    return document_of(result, measurement if task.with_thumbnail else None)


def measurement_of(task: FitTask) -> Measurement | ScatteredSamples:
    """Return the samples of a task, or read the measurement in its file."""
    if task.samples is not None:
        return task.samples
    return read_measurement(task.path) if task.sha256 is None else open_checked(task.path, task.sha256)


def fit_quietly(
    measurement: Measurement | Profiles | ScatteredSamples, options: FitOptions, on_progress: OnProgress
) -> FitResult:
    """Fit without raising a ConvergenceWarning, because the report contains the warning."""
    with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):
        return fit(measurement, options, progress=on_progress)


def document_of(result: FitResult, drawn: Measurement | ScatteredSamples | None = None) -> FitDocument:
    """Return the stored form of a fit; if `drawn` is a measurement, add a thumbnail of the measurement and the fit.

    The remarks of the decomposition into components are added to the warnings of the report.
    """
    parts = decompose(result.model)
    report = replace(result.report, warnings=(*result.report.warnings, *parts.remarks))
    text = to_json(result.model, report, parts)
    return FitDocument(text, asdict(result.report.metrics), None if drawn is None else thumbnail(result.model, drawn))


class LocalEngine(Processes):
    """Run fits on this machine, each in a worker process with limits; at most `count` fits run at once."""

    def submit(self, task: FitTask, on_progress: OnProgress) -> "Future[Outcome]":
        """Compute a task in a new worker process."""
        return self.call(compute, task, on_progress=on_progress)
