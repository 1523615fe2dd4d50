"""The computation of one fit, wherever it runs, and what happens in a child process around it."""

import logging
import os
import signal
import threading
import warnings
from collections.abc import Callable
from multiprocessing import connection, parent_process

import dsbrdf
from dsbrdf.engines import Fault, FitTask, Fitted, Outcome
from dsbrdf.serialize import to_json

try:
    import resource
except ImportError:  # pragma: no cover (no such limits outside POSIX)
    resource = None  # type: ignore[assignment]

_SMALLEST_STEP = 0.005  # of progress, that is worth a message

logger = logging.getLogger(__name__)


def compute(task: FitTask, on_progress: Callable[[float], None]) -> Outcome:
    """Fit the measurement of `task`; every failure of the fit is an outcome, not an exception."""
    try:
        measurement = dsbrdf.read_merl(task.path)
        with warnings.catch_warnings():
            # Which slices did not converge is part of the report.
            warnings.simplefilter("ignore", dsbrdf.ConvergenceWarning)
            result = dsbrdf.fit(measurement, task.options, progress=on_progress)
        document = to_json(result.model, result.report)
    except dsbrdf.DSBRDFError as error:
        return Fault("input", type(error).__name__, str(error))
    except MemoryError:
        return Fault("compute", "MemoryLimit", "The fit needs more memory than a fit may use.")
    except OSError as error:
        logger.exception("fit %s could not read its measurement", task.fit_id)
        reason = error.strerror or type(error).__name__
        return Fault("system", "MeasurementUnreadable", f"The stored measurement could not be read: {reason}.")
    except Exception as error:
        logger.exception("fit %s broke", task.fit_id)
        message = f"The computation broke with {type(error).__name__}; the service's log has the details."
        return Fault("compute", "InternalError", message)
    return Fitted(document, dict(result.report.metrics))


def compute_in_child(task: FitTask, pipe: connection.Connection, memory_bytes: int) -> None:
    """Fit in a process of its own, which ends with its parent and cannot take more than `memory_bytes`.

    The pipe gets the progress as floats and, last, the outcome.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # typed at a terminal it is meant for the parent
    _end_with_parent()
    _limit_memory(memory_bytes)
    sent = 0.0

    def report(share: float) -> None:
        nonlocal sent
        if share - sent >= _SMALLEST_STEP:
            sent = float(share)
            pipe.send(sent)

    pipe.send(compute(task, report))


def _end_with_parent() -> None:
    """Kill this process as soon as its parent is gone, however the parent ended."""
    parent = parent_process()
    if parent is None:
        return
    sentinel = parent.sentinel

    def watch() -> None:
        connection.wait([sentinel])
        os.kill(os.getpid(), signal.SIGKILL)

    threading.Thread(target=watch, name="end-with-parent", daemon=True).start()


def _limit_memory(memory_bytes: int) -> None:
    if resource is not None:
        resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
