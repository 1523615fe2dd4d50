"""What runs in the processes of fits, and the engine of this machine."""

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
from dsbrdf.samples.measurement_files import open_checked, read_measurement
from dsbrdf.samples.scattered_samples import ScatteredSamples


def compute(task: FitTask, on_progress: OnProgress) -> FitDocument:
    """Fit the measurement of a task."""
    measurement = measurement_of(task)
    result = fit_quietly(measurement, task.options, on_progress)
    return document_of(result, measurement if task.with_thumbnail else None)


def measurement_of(task: FitTask) -> Measurement | ScatteredSamples:
    """Return what is in the file of a task."""
    if task.sha256 is None:
        return read_measurement(task.path, task.table)
    return open_checked(task.path, task.sha256)


def fit_quietly(
    measurement: Measurement | Profiles | ScatteredSamples, options: FitOptions, on_progress: OnProgress
) -> FitResult:
    """Fit without a Python warning: the report has them."""
    with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):
        return fit(measurement, options, progress=on_progress)


def document_of(result: FitResult, drawn: Measurement | ScatteredSamples | None = None) -> FitDocument:
    """Return what is stored of a fit; the thumbnail shows it with the measurement, if that is given.

    The warnings are those of the fit, then the remarks on the components.
    """
    parts = decompose(result.model)
    report = replace(result.report, warnings=(*result.report.warnings, *parts.remarks))
    text = to_json(result.model, report, parts)
    return FitDocument(text, asdict(result.report.metrics), None if drawn is None else thumbnail(result.model, drawn))


class LocalEngine(Processes):
    """Engine with at most so many fits at once on this machine, each in a worker process with the limits."""

    def submit(self, task: FitTask, on_progress: OnProgress) -> "Future[Outcome]":
        """Compute a task in a new process."""
        return self.call(compute, task, on_progress=on_progress)
