"""Where fits run.

An engine takes tasks and gives outcomes; it knows nothing of rows, ids of requests or HTTP. A task names a
file of this machine; an engine that computes elsewhere sends the measurement's profiles there, not the file.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from dsbrdf.options import FitOptions

Origin = Literal["input", "compute", "system"]


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
    """A fit that succeeded: model and report as the library's JSON, and the report's metrics."""

    document: str
    metrics: dict[str, float | None]


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
    """The three calls that every engine has."""

    async def run(self, task: FitTask, on_progress: Callable[[float], None]) -> Outcome:
        """Compute `task`; `on_progress` gets the finished share, 0 to 1.

        Cancelling the awaiting task stops the computation and frees what it used.
        """
        ...

    async def check(self) -> None:
        """Raise RuntimeError, with one sentence, unless fits can run."""
        ...

    async def close(self) -> None:
        """Stop everything that runs."""
        ...
