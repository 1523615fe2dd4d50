"""Work for processes of fits that are to die."""

import os
import signal

from dsbrdf.engines import FitTask, Outcome
from dsbrdf.engines.compute import Report, compute


def compute_unless_named_one(task: FitTask, report: Report) -> Outcome:
    """Fit; the process that is to fit the file ``one`` is killed, as the kernel does when memory is short."""
    if task.fit_id == "one":
        os.kill(os.getpid(), signal.SIGKILL)
    return compute(task, report)
