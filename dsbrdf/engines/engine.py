"""Define the common interface of engines, which run fits.

An engine fits the measurement in a file of this machine, and returns the fit or a description of the failure. An engine
knows no database, no HTTP requests and no output files. Every engine returns the same result for the same task. A fit
that fails does not affect other fits, and no process outlives its engine.
"""

import errno
import logging
import math
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

from dsbrdf.errors import DSBRDFError
from dsbrdf.fitting.options import FitOptions
from dsbrdf.samples.scattered_samples import ScatteredSamples

logger = logging.getLogger(__name__)

OnProgress = Callable[[float], None]
"""Type of the progress callback, which is called with the completed fraction of a fit, 0 to 1."""

NOT_STARTED = "ProcessNotStarted"
"""The `type` of a `Fault` if no process could be started, so that the fit was not attempted."""


@dataclass(frozen=True)
class FitLimits:
    """The limits of one fit."""

    seconds: float = math.inf  # elapsed time after which the fit is stopped [s]
    memory_mb: int | None = None  # address space of the process [MB]; None means no limit
    niceness: int = 0  # increase of the nice value of the process, ignored on systems without nice values
    processor_seconds: float = math.inf  # processor time after which the fit is stopped [s]


NO_LIMITS = FitLimits()
MIN_FIT_MEMORY_MB = 768
"""Every fit fails if its process may use less address space than this [MB]."""


@dataclass(frozen=True)
class FitTask:
    """Describe one fit to compute."""

    fit_id: str  # identifier of the fit for names and logs
    path: Path  # file of the measurement
    options: FitOptions
    samples: ScatteredSamples | None = None  # the samples in the file, if it is a table that was read already
    sha256: str | None = None  # digest of the file, if the file was checked before, so that it is not checked again
    with_thumbnail: bool = False


@dataclass(frozen=True)
class FitDocument:
    """The stored form of a fit that has succeeded."""

    text: str  # the model, its report and its components, as JSON from `to_json`
    metrics: dict[str, float | None]  # metrics of the fit by name; the names are the fields of `Metrics`
    thumbnail: bytes | None = None  # picture of measurement and fit as PNG, if the task requests a thumbnail


@dataclass(frozen=True)
class Fault:
    """Describe why a fit failed.

    The origin ``input`` means that the measurement or the options do not allow a fit; ``compute``, that the computation
    failed or reached its time or memory limit; ``system``, that the process was lost for a reason outside of the fit.
    """

    origin: Literal["input", "compute", "system"]
    type: str  # name of the fault for scripts, which does not change between releases
    message: str  # one sentence for the user on what is wrong


Outcome = FitDocument | Fault
MEMORY_LIMIT = Fault("compute", "MemoryLimit", "The fit needs more memory than a fit may use.")
DISK_FULL = Fault("system", "DiskFull", "There is no space left on the disk.")


class Engine(Protocol):
    """Declare the methods of every engine."""

    def submit(self, task: FitTask, on_progress: OnProgress) -> "Future[Outcome]":
        """Compute a task as soon as a process is free; call `on_progress` in a thread with increasing fractions.

        The method `cancel` of the returned future also stops a running fit. The future is done when the process of the
        fit has ended.
        """

    def check(self) -> None:
        """Prepare for fits; raise OSError with one sentence if no fit can run now."""

    def close(self) -> None:
        """Stop all fits, and return when their processes have ended."""


def run_step(step: Callable[..., Any], *arguments: Any) -> Any:
    """Call a step of a fit; return every failure of the fit as a `Fault` instead of raising it."""
    try:
        return step(*arguments)
    except DSBRDFError as error:
        return Fault("input", type(error).__name__, str(error))
    except MemoryError:
        return MEMORY_LIMIT
    except OSError as error:
        if error.errno == errno.ENOMEM:  # Mapping a file into memory fails with this error if memory is short.
            return MEMORY_LIMIT
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            return DISK_FULL
        # A file can become unreadable after the task was submitted, for example if a user deletes it.
        reason = error.strerror or type(error).__name__
        logger.warning("a measurement could not be read: %s", reason)
        return Fault("system", "MeasurementUnreadable", f"The stored measurement could not be read: {reason}.")
    except Exception as error:
        logger.exception("a fit failed with an unexpected error")
        message = f"The computation failed with {type(error).__name__}; the log has the details."
        return Fault("compute", "InternalError", message)
