"""Where fits run.

An engine turns tasks, which name files of this machine, into outcomes; it knows nothing of database rows, requests or
output files. That of this machine and that of a Dask cluster give the same result for the same task, a fit that fails
does not affect the others, and no process outlives its engine.
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
from dsbrdf.samples.table_options import AS_WRITTEN, TableOptions

logger = logging.getLogger(__name__)

OnProgress = Callable[[float], None]
"""Called with the finished share of a fit, 0 to 1."""

NOT_STARTED = "ProcessNotStarted"
"""Type of the fault when no process could be started: the fit itself has not been tried."""


@dataclass(frozen=True)
class FitLimits:
    """Limits of one fit."""

    seconds: float = math.inf  # time [s]
    memory_mb: int | None = None  # address space of its process [MB]; None sets no limit
    niceness: int = 0  # added to the nice value of its process, where the system has one
    processor_seconds: float = math.inf  # time of the processor, which other work does not lengthen [s]


NO_LIMITS = FitLimits()


@dataclass(frozen=True)
class FitTask:
    """One fit to compute."""

    fit_id: str  # for names and logs
    path: Path  # the measurement's file
    options: FitOptions
    table: TableOptions = AS_WRITTEN  # how a table in the file is read
    sha256: str | None = None  # digest of the file, if it has been checked before: a table is one of samples then
    with_thumbnail: bool = False


@dataclass(frozen=True)
class FitDocument:
    """A fit that has succeeded: what is stored of it."""

    text: str  # the JSON of `to_json`, with the components
    metrics: dict[str, float | None]  # The keys are the names in `Metrics`.
    thumbnail: bytes | None = None  # PNG, if the task asks for one


@dataclass(frozen=True)
class Fault:
    """A fit that failed.

    ``input``: the measurement or the options do not allow a fit. ``compute``: the computation failed, or reached its
    time or memory limit. ``system``: the process was lost for a reason outside of the fit.
    """

    origin: Literal["input", "compute", "system"]
    type: str  # stays the same between releases, for scripts
    message: str  # one sentence


Outcome = FitDocument | Fault
MEMORY_LIMIT = Fault("compute", "MemoryLimit", "The fit needs more memory than a fit may use.")
DISK_FULL = Fault("system", "DiskFull", "There is no space left on the disk.")


class Engine(Protocol):
    """What every engine offers."""

    def submit(self, task: FitTask, on_progress: OnProgress) -> "Future[Outcome]":
        """Compute a task, when those before it leave room; `on_progress` is called in a thread, with rising shares.

        `Future.cancel` stops the fit also while it runs. The future is done when the fit's process has ended.
        """

    def check(self) -> None:
        """Get ready to run fits; raise OSError with one sentence if none can run now."""

    def close(self) -> None:
        """Stop all fits, and return when their processes have ended."""


def run_step(step: Callable[..., Any], *arguments: Any) -> Any:
    """Call a step of a fit; every failure of the fit is returned as a `Fault`, not raised."""
    try:
        return step(*arguments)
    except DSBRDFError as error:
        return Fault("input", type(error).__name__, str(error))
    except MemoryError:
        return MEMORY_LIMIT
    except OSError as error:
        if error.errno == errno.ENOMEM:  # a file that is mapped, not read, is refused memory in this way
            return MEMORY_LIMIT
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            return DISK_FULL
        reason = error.strerror or type(error).__name__  # for example, it was deleted meanwhile
        logger.warning("a measurement could not be read: %s", reason)
        return Fault("system", "MeasurementUnreadable", f"The stored measurement could not be read: {reason}.")
    except Exception as error:
        logger.exception("a fit failed with an unexpected error")
        message = f"The computation failed with {type(error).__name__}; the log has the details."
        return Fault("compute", "InternalError", message)
