"""What a worker process does: set its limits, call a step, send what comes of it.

It uses one BLAS thread, see `dsbrdf.process_settings`, and ends when the process that started it ends, however that
happens.
"""

import logging
import math
import mmap
import os
import pickle  # nosec B403
import signal
import socket
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from dsbrdf.engines.engine import FitLimits, OnProgress, run_step
from dsbrdf.process_settings import end_with_parent, keep_freed_memory, reserve_blas_memory

try:
    import resource
except ImportError:  # pragma: no cover (no such limits outside POSIX)
    resource = None  # type: ignore[assignment]

OUT_OF_MEMORY = 75
"""Exit code of a process that could not send its outcome."""

_MIN_PROGRESS_INTERVAL_S = 0.05
_MIN_FREE_MEMORY_BYTES = 4 << 20  # With less, a step is not begun.


def run_in_worker(pipe: socket.socket, limits: FitLimits, step: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    """Run a step; send its progress, log records and, last, the outcome, each as a pair of its kind and itself."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in a terminal reaches all processes; the parent handles it

    def send(kind: str, content: object) -> None:
        try:
            pipe.sendall(pickle.dumps((kind, content)))
        except ConnectionError:  # nobody wants the outcome any more, and this process is about to be killed
            os._exit(0)

    try:
        _prepare(limits)
        logging.basicConfig(handlers=[_LogToParent(send)], level=logging.INFO, force=True)
        send("outcome", run_step(step, *arguments, _rising(partial(send, "progress"))))
    except (MemoryError, RuntimeError) as error:  # there is not even enough to begin, or to send the outcome
        limited = resource is not None and resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY
        if isinstance(error, MemoryError) or limited:  # else a thread is refused for another reason
            os._exit(OUT_OF_MEMORY)
        raise


def _rising(on_progress: OnProgress) -> OnProgress:
    """Return a function that passes on shares which rise, of those that come soon after another only the last, 1."""
    last, then = 0.0, -math.inf

    def filtered(share: float) -> None:
        nonlocal last, then
        now = time.monotonic()
        if share > last and (now - then >= _MIN_PROGRESS_INTERVAL_S or share >= 1.0):
            last, then = float(share), now
            on_progress(last)

    return filtered


def _prepare(limits: FitLimits) -> None:
    """Set the limits, that of memory unless a narrower one was set from outside; MemoryError if hardly any is left.

    What goes wrong without memory need not be an exception, as the stack cannot grow either.
    """
    end_with_parent()
    if limits.niceness and hasattr(os, "nice"):
        os.nice(limits.niceness)
    if resource is not None:
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if math.isfinite(limits.processor_seconds):
            seconds = math.ceil(limits.processor_seconds)
            resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
        reserve_blas_memory()
        most, _ = resource.getrlimit(resource.RLIMIT_AS)
        if limits.memory_mb is not None and (most == resource.RLIM_INFINITY or limits.memory_mb << 20 < most):
            resource.setrlimit(resource.RLIMIT_AS, (limits.memory_mb << 20, limits.memory_mb << 20))
        try:
            mmap.mmap(-1, _MIN_FREE_MEMORY_BYTES).close()
        except OSError:
            raise MemoryError from None
    keep_freed_memory()


class _LogToParent(logging.Handler):
    """Sends log records to the parent process, whose logging is configured."""

    def __init__(self, send: Callable[[str, object], None]) -> None:
        super().__init__()
        self._send = send

    def emit(self, record: logging.LogRecord) -> None:
        self.format(record)  # sets its message and the text of its traceback, which cannot be pickled
        record.msg, record.args, record.exc_info = record.message, None, None
        self._send("log", record)
