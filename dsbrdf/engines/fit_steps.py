"""What runs in processes of their own: an export, and the steps of a fit.

A fit has one step, or three of which the middle one can run on another machine:

    compute:             file -> result

    reduce_measurement:  file -> profiles
    fit_profiles:        profiles -> result without metrics
    complete_report:     that result, same file -> result

Only the profiles are sent to the other machine, not the file. Both ways give the same result to the last bit, apart
from the timings.
"""

import errno
import logging
import pickle  # nosec B403
import time
import warnings
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from dsbrdf.data.measurement import Measurement
from dsbrdf.data.measurement_files import read_measurement
from dsbrdf.data.merl import map_merl
from dsbrdf.data.reduction import Profiles
from dsbrdf.data.scattered_samples import ScatteredSamples
from dsbrdf.engines.engine import DecomposedFit, Fault, FitTask, OnProgress, Outcome
from dsbrdf.errors import ConvergenceWarning, DSBRDFError, InvalidArgumentError
from dsbrdf.fitting.decomposition import Component, decompose
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import add_sample_metrics, fit, profiles_for
from dsbrdf.fitting.report import FitResult
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.export import export_model

logger = logging.getLogger(__name__)

MEMORY_LIMIT = Fault("compute", "MemoryLimit", "The fit needs more memory than a fit may use.")


@dataclass(frozen=True)
class ReducedMeasurement:
    """What a fit on another machine needs of a measurement.

    Attributes
    ----------
    profiles : bytes
        The profiles, pickled and compressed: 2 MB, or 3 MB if they are robust.
    sha256 : str
        Digest of the file.
    seconds : float
        Time that the reduction took [s].
    """

    profiles: bytes
    sha256: str
    seconds: float


def run_step(step: Callable[..., Any], *arguments: Any) -> Any:
    """Call one of the steps below; every failure of the fit is returned as a `Fault`, not raised."""
    try:
        return step(*arguments)
    except DSBRDFError as error:
        return Fault("input", type(error).__name__, str(error))
    except MemoryError:
        return MEMORY_LIMIT
    except OSError as error:
        if error.errno == errno.ENOMEM:  # a file that is mapped, not read, is refused memory in this way
            return MEMORY_LIMIT
        logger.exception("a measurement could not be read")
        reason = error.strerror or type(error).__name__
        return Fault("system", "MeasurementUnreadable", f"The stored measurement could not be read: {reason}.")
    except Exception as error:
        logger.exception("a fit failed with an unexpected error")
        message = f"The computation failed with {type(error).__name__}; the log has the details."
        return Fault("compute", "InternalError", message)


def compute(task: FitTask, on_progress: OnProgress) -> FitResult:
    """Fit the measurement of a task in one step."""
    measurement = read_measurement(task.path) if task.sha256 is None else map_merl(task.path, task.sha256)
    return _decomposed(_fit(measurement, task.options, on_progress), task)


def reduce_measurement(task: FitTask, _: OnProgress) -> ReducedMeasurement:
    """Reduce the measurement of a task to its profiles."""
    measurement = _grid_measurement(task)
    begin = time.perf_counter()
    profiles = profiles_for(measurement, task.options)
    seconds = time.perf_counter() - begin
    return ReducedMeasurement(zlib.compress(pickle.dumps(profiles), 1), measurement.sha256, seconds)


def fit_profiles(profiles: bytes, options: FitOptions, on_progress: OnProgress) -> FitResult:
    """Fit the profiles of a reduced measurement; the report lacks the metrics that need the samples."""
    # Unpickling is safe here: whoever sends the profiles also sends the code that reads them.
    content: Profiles = pickle.loads(zlib.decompress(profiles))  # noqa: S301  # nosec B301
    return _fit(content, options, on_progress)


def complete_report(result: FitResult, task: FitTask, reduced: ReducedMeasurement, _: OnProgress) -> Outcome:
    """Add the metrics that need the samples to the report of `fit_profiles`; the file must not have changed."""
    measurement = _grid_measurement(task)
    if measurement.sha256 != reduced.sha256:
        return Fault("system", "MeasurementChanged", "The measurement's file was changed while it was being fitted.")
    timings = result.report.timings | {"profiles": reduced.seconds}
    result = FitResult(result.model, replace(result.report, timings=timings))
    return _decomposed(add_sample_metrics(result, measurement), task)


def export_step(model: DSBRDF | Component, file_format: str, _: OnProgress) -> bytes:
    """Return the content of a file with a model, as `export_model` does, for formats that take seconds."""
    return export_model(model, file_format)


def _fit(
    measurement: Measurement | Profiles | ScatteredSamples, options: FitOptions, on_progress: OnProgress
) -> FitResult:
    with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):  # the report has them
        return fit(measurement, options, progress=on_progress)


def _decomposed(result: FitResult, task: FitTask) -> FitResult:
    return DecomposedFit(result.model, result.report, decompose(result.model)) if task.components else result


def _grid_measurement(task: FitTask) -> Measurement:
    measurement = read_measurement(task.path)
    if not isinstance(measurement, Measurement):
        raise InvalidArgumentError("scattered samples are fitted on this machine only: fit them without a scheduler")
    return measurement
