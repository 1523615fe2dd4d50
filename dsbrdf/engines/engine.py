"""Where fits run.

An engine turns tasks into outcomes; it knows nothing of database rows, requests or output files. A task names a file
on this machine; an engine that computes on other machines sends them the measurement's profiles, not the file.

`dsbrdf.engines.local` has the engine of this machine, `dsbrdf.engines.dask` that of a Dask cluster. Both give the same
result for the same task, a fit that fails does not affect the others, and no process outlives its engine.
"""

import math
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from dsbrdf.fitting.decomposition import Decomposition
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.report import FitResult

Origin = Literal["input", "compute", "system"]

OnProgress = Callable[[float], None]
"""Called with the finished share of a fit, 0 to 1."""

NOT_STARTED = "ProcessNotStarted"
"""Type of the fault when no process could be started: the fit itself has not been tried."""


@dataclass(frozen=True)
class FitLimits:
    """Limits of one fit.

    Attributes
    ----------
    seconds : float
        Time [s].
    memory_mb : int or None
        Address space of its process [MB]; None sets no limit.
    niceness : int
        How much the process gives way to others: what is added to its nice value, where the system has one.
    """

    seconds: float = math.inf
    memory_mb: int | None = None
    niceness: int = 0


@dataclass(frozen=True)
class FitTask:
    """One fit to compute.

    Attributes
    ----------
    fit_id : str
        Identity of the fit, for names and logs.
    path : Path
        The measurement's file.
    options : FitOptions
    sha256 : str or None
        Digest of the file if it has been checked before, so that it need not be checked again.
    components : bool
        Whether the outcome is a `DecomposedFit`.
    """

    fit_id: str
    path: Path
    options: FitOptions
    sha256: str | None = None
    components: bool = False


@dataclass(frozen=True)
class DecomposedFit(FitResult):
    """What a task that asks for components gets.

    Attributes
    ----------
    decomposition : Decomposition
    """

    decomposition: Decomposition


@dataclass(frozen=True)
class Fault:
    """A fit that failed.

    Attributes
    ----------
    origin : {"input", "compute", "system"}
        ``input``: the measurement or the options do not allow a fit. ``compute``: the computation failed, or
        reached its time or memory limit. ``system``: the process was lost for a reason outside of the fit.
    type : str
        Name of the fault, which stays the same between releases, for scripts.
    message : str
        One sentence.
    """

    origin: Origin
    type: str
    message: str


Outcome = FitResult | Fault


class Engine(Protocol):
    """What every engine offers."""

    async def start(self) -> None:
        """Get ready to run fits; an engine that cannot reach its machines keeps trying by itself."""
        ...

    def slot(self) -> AbstractAsyncContextManager[object]:
        """Wait in line until the engine has room for one more fit; call `run` inside the block."""
        ...

    async def run(self, task: FitTask, on_progress: OnProgress) -> Outcome:
        """Compute a task; `on_progress` gets the finished share, 0 to 1, which never decreases.

        Cancelling this call stops the computation and frees what it used.
        """
        ...

    async def check(self) -> None:
        """Raise RuntimeError with one sentence if no fit can run now."""
        ...

    async def close(self) -> None:
        """Release what `start` acquired; all calls of `run` must have ended or been cancelled."""
        ...
