"""The steps of one fit: a single one, or three of which the middle one can run on another machine.

    compute:             file -> outcome

    reduce_measurement:  file -> payload
    fit_payload:         payload -> outcome
    complete_report:     outcome, same file -> outcome

Only the payload is sent to the other machine, not the file. Both ways give the same document to the last bit, apart
from the timings.
"""

import errno
import logging
import pickle  # nosec B403
import time
import warnings
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

from dsbrdf.data.measurement import Measurement
from dsbrdf.data.measurement_files import read_measurement
from dsbrdf.data.merl import map_merl
from dsbrdf.data.reduction import Profiles
from dsbrdf.engines.engine import Fault, FitTask, Fitted, OnProgress, Outcome
from dsbrdf.errors import ConvergenceWarning, DSBRDFError, InvalidArgumentError
from dsbrdf.fitting.decomposition import decompose
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import add_sample_metrics, fit, profiles_for
from dsbrdf.fitting.report import FitResult
from dsbrdf.output.serialize import result_from_json, to_json

logger = logging.getLogger(__name__)

MEMORY_LIMIT = Fault("compute", "MemoryLimit", "The fit needs more memory than a fit may use.")


@dataclass(frozen=True)
class _Payload:
    """What is sent to another machine.

    Attributes
    ----------
    profiles : Profiles
    seconds : float
        Time that the reduction took [s].
    """

    profiles: Profiles
    seconds: float


@dataclass(frozen=True)
class ReducedMeasurement:
    """The encoded payload of a measurement, and the digest of the file from which it was made."""

    payload: bytes
    sha256: str


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


def compute(task: FitTask, on_progress: OnProgress) -> Outcome:
    """Fit the measurement of a task in one step."""
    measurement = read_measurement(task.path) if task.sha256 is None else map_merl(task.path, task.sha256)
    with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):  # the report has them
        return _fitted(fit(measurement, task.options, progress=on_progress), components=task.components)


def reduce_measurement(task: FitTask, _: OnProgress) -> ReducedMeasurement:
    """Reduce the measurement of a task to the payload that a fit needs: 2 MB, or 3 MB if it is robust."""
    measurement = _grid_measurement(task)
    begin = time.perf_counter()
    profiles = profiles_for(measurement, task.options)
    payload = _Payload(profiles, time.perf_counter() - begin)
    return ReducedMeasurement(zlib.compress(pickle.dumps(payload), 1), measurement.sha256)


def fit_payload(payload: bytes, options: FitOptions, on_progress: OnProgress) -> Outcome:
    """Fit a payload; the report lacks the metrics that need the samples."""
    # Unpickling is safe here: whoever sends the payload also sends the code that reads it.
    content: _Payload = pickle.loads(zlib.decompress(payload))  # noqa: S301  # nosec B301
    with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):  # the report has them
        result = fit(content.profiles, options, progress=on_progress)
    timings = result.report.timings | {"profiles": content.seconds}
    return _fitted(FitResult(result.model, replace(result.report, timings=timings)))


def complete_report(fitted: Fitted, task: FitTask, sha256: str, _: OnProgress) -> Outcome:
    """Add the metrics that need the samples to the report of `fit_payload`; the file must not have changed."""
    measurement = _grid_measurement(task)
    if measurement.sha256 != sha256:
        return Fault("system", "MeasurementChanged", "The measurement's file was changed while it was being fitted.")
    return _fitted(add_sample_metrics(result_from_json(fitted.document), measurement), components=task.components)


def _grid_measurement(task: FitTask) -> Measurement:
    measurement = read_measurement(task.path)
    if not isinstance(measurement, Measurement):
        raise InvalidArgumentError("scattered samples are fitted on this machine only: fit them without a scheduler")
    return measurement


def _fitted(result: FitResult, *, components: bool = False) -> Fitted:
    document = to_json(result.model, result.report, decompose(result.model) if components else None)
    return Fitted(document, asdict(result.report.metrics))
