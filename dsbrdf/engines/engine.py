"""Where fits run.

An engine turns tasks, which name files of this machine, into outcomes; it knows nothing of database rows, requests or
output files. That of this machine and that of a Dask cluster give the same result for the same task, a fit that fails
does not affect the others, and no process outlives its engine.
"""

import errno
import logging
import math
import time
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

from dsbrdf.errors import DSBRDFError
from dsbrdf.fitting.decomposition import Decomposition
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.report import FitResult

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


@dataclass(frozen=True)
class FitTask:
    """One fit to compute."""

    fit_id: str  # for names and logs
    path: Path  # the measurement's file
    options: FitOptions
    sha256: str | None = None  # digest of the file, if it has been checked before


@dataclass(frozen=True)
class DecomposedFit(FitResult):
    """A fit with the components of its model, which its warnings have needed already."""

    decomposition: Decomposition


@dataclass(frozen=True)
class Fault:
    """A fit that failed.

    ``input``: the measurement or the options do not allow a fit. ``compute``: the computation failed, or reached its
    time or memory limit. ``system``: the process was lost for a reason outside of the fit.
    """

    origin: Literal["input", "compute", "system"]
    type: str  # stays the same between releases, for scripts
    message: str  # one sentence


Outcome = FitResult | Fault


def rising(on_progress: OnProgress, step: float = 0.0, seconds: float = 0.0) -> OnProgress:
    """Pass on only shares above the last one by at least a step, and, but for the very last, so many seconds later."""
    last, then = 0.0, -math.inf

    def filtered(share: float) -> None:
        nonlocal last, then
        now = time.monotonic()
        if share > last and share - last >= step and (now - then >= seconds or share >= 1.0):
            last, then = float(share), now
            on_progress(last)

    return filtered


MEMORY_LIMIT = Fault("compute", "MemoryLimit", "The fit needs more memory than a fit may use.")


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
        logger.exception("a measurement could not be read")
        reason = error.strerror or type(error).__name__
        return Fault("system", "MeasurementUnreadable", f"The stored measurement could not be read: {reason}.")
    except Exception as error:
        logger.exception("a fit failed with an unexpected error")
        message = f"The computation failed with {type(error).__name__}; the log has the details."
        return Fault("compute", "InternalError", message)


class Engine(Protocol):
    """What every engine offers."""

    async def start(self) -> None:
        """Get ready to run fits; an engine that cannot reach its machines keeps trying by itself."""

    def slot(self) -> AbstractAsyncContextManager[object]:
        """Wait in line until the engine has room for one more fit; call `run` inside the block."""

    async def run(self, task: FitTask, on_progress: OnProgress) -> Outcome:
        """Compute a task; `on_progress` gets the finished share, 0 to 1, which never decreases.

        Cancelling this call stops the computation and frees what it used.
        """

    async def check(self) -> None:
        """Raise RuntimeError with one sentence if no fit can run now."""

    async def close(self) -> None:
        """Release what `start` acquired; all calls of `run` must have ended or been cancelled."""
