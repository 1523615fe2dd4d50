"""Work for the processes of fits: a fit that does not end while a test looks at it, and tasks that are to die."""

import os
import resource
import signal
import socket
import sys

from dsbrdf import FitOptions
from dsbrdf.engines import FitTask, OnProgress, Outcome
from dsbrdf.engines.local import compute

ENDLESS = FitOptions(n_lobes=10, ring_lobes=9, knots_deg=tuple(range(90)), robust=True, lobe="student")
"""The longest fit that options can ask for."""


def die(number: signal.Signals, _: OnProgress) -> None:
    os.kill(os.getpid(), number)


def exit_with(code: int, _: OnProgress) -> None:
    os._exit(code)


def stop_itself(on_progress: OnProgress) -> None:
    """Stop in the middle of sending the outcome."""
    on_progress(0.5)
    send = socket.socket.sendall

    def send_half(pipe: socket.socket, data: bytes) -> None:
        send(pipe, data[: len(data) // 2])
        os.kill(os.getpid(), signal.SIGSTOP)

    vars(sys.modules["socket"])["socket"].sendall = send_half


def address_space(_: OnProgress) -> int:
    return resource.getrlimit(resource.RLIMIT_AS)[0]


def spin(_: OnProgress) -> None:
    while True:
        pass


def do_nothing(_: OnProgress) -> None:
    """End as a process that has done its work."""


def compute_unless_named_one(task: FitTask, on_progress: OnProgress) -> Outcome:
    """Fit; the process that is to fit the file ``one`` is killed, as the kernel does when memory is short."""
    if task.fit_id == "one":
        die(signal.SIGKILL, on_progress)
    return compute(task, on_progress)


def nice_value(_: OnProgress) -> int:
    return os.nice(0)
