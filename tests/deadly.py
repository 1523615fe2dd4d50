"""Work for processes of fits that are to die."""

import os
import signal

from dsbrdf.engines import FitTask, Outcome
from dsbrdf.engines.compute import Report, compute


def die(_: Report) -> None:
    """End as a process that is killed."""
    os.kill(os.getpid(), signal.SIGKILL)


def do_nothing(_: Report) -> None:
    """End as a process that has done its work."""


def compute_unless_named_one(task: FitTask, report: Report) -> Outcome:
    """Fit; the process that is to fit the file ``one`` is killed, as the kernel does when memory is short."""
    if task.fit_id == "one":
        die(report)
    return compute(task, report)
