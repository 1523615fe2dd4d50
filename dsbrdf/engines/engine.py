"""Where fits run.

An engine takes tasks and gives outcomes; it knows nothing of rows, requests or output files. A task names a file of
this machine; an engine that computes elsewhere sends the measurement's profiles there, not the file.

`dsbrdf.engines.local` has the engine of this machine, `dsbrdf.engines.dask` that of a Dask cluster. Both keep the same
promises: the same document for the same task, a failure of one fit touches no other, and nothing outlives its engine.
"""

import math
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from dsbrdf.fitting.options import FitOptions

Origin = Literal["input", "compute", "system"]

NOT_STARTED = "ProcessNotStarted"
"""The type of the fault of a machine that cannot start a process just now; the fit itself has not been tried."""


@dataclass(frozen=True)
class Limits:
    """What one fit may take.

    Attributes
    ----------
    seconds : float
        Time [s].
    memory_mb : int or None
        Address space of its process [MB]; None sets no limit.
    """

    seconds: float = math.inf
    memory_mb: int | None = None


@dataclass(frozen=True)
class FitTask:
    """One fit to be computed.

    Attributes
    ----------
    fit_id : str
        Identity of the fit, for names and logs.
    path : Path
        The measurement's file.
    options : FitOptions
    """

    fit_id: str
    path: Path
    options: FitOptions


@dataclass(frozen=True)
class Fitted:
    """A fit that succeeded.

    Attributes
    ----------
    document : str
        Model and report as the library's JSON.
    metrics : dict
        Those of the report.
    warnings : tuple of str
        Sentences of the fit about its convergence.
    """

    document: str
    metrics: dict[str, float | None]
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Fault:
    """A fit that failed.

    Attributes
    ----------
    origin : {"input", "compute", "system"}
        ``input``: the measurement or the options do not allow a fit. ``compute``: the computation broke, or
        met its time or memory limit. ``system``: the process was lost to no fault of the fit.
    type : str
        Stable name of the fault, for scripts.
    message : str
        One sentence.
    """

    origin: Origin
    type: str
    message: str


Outcome = Fitted | Fault


class Engine(Protocol):
    """The five calls that every engine has."""

    async def start(self) -> None:
        """Get ready to run fits; an engine whose machines are away goes on looking for them by itself."""
        ...

    def turn(self, whose: str = "") -> AbstractAsyncContextManager[object]:
        """Wait until a fit may be begun: as many are in flight as the engine has room for. `run` belongs inside.

        First come, first served among the fits of one owner; owners take turns.
        """
        ...

    async def run(self, task: FitTask, on_progress: Callable[[float], None]) -> Outcome:
        """Compute `task`; `on_progress` gets the finished share, 0 to 1, which never falls.

        Cancelling the awaiting task stops the computation and frees what it used.
        """
        ...

    async def check(self) -> None:
        """Raise RuntimeError, with one sentence, unless fits can run now."""
        ...

    async def close(self) -> None:
        """Give back what `start` took; the calls of `run` have to be cancelled or over."""
        ...
