"""Run in a worker process: set the limits of the process, call a step, and send the outcome.

A worker process uses one BLAS thread, see `dsbrdf.process_settings`. A worker process ends when its parent process
ends, for whatever reason.
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
except ImportError:  # pragma: no cover (only POSIX has this module)
    resource = None  # type: ignore[assignment]

OUT_OF_MEMORY = 75
"""Exit code of a process that had too little memory to send its outcome."""

_MIN_PROGRESS_INTERVAL_S = 0.05
_MIN_FREE_MEMORY_BYTES = 4 << 20  # A step does not begin with less free memory, because it could crash.


def run_in_worker(pipe: socket.socket, limits: FitLimits, step: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    """Run a step; send its progress, its log records and finally its outcome, as pairs (kind, content)."""
    # Ctrl-C reaches all processes of a terminal, but only the parent process handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def send(kind: str, content: object) -> None:
        try:
            pipe.sendall(pickle.dumps((kind, content)))
        except ConnectionError:  # The parent process has closed the connection and will kill this process.
            os._exit(0)

    try:
        _prepare(limits)
        logging.basicConfig(handlers=[_LogToParent(send)], level=logging.INFO, force=True)
        send("outcome", run_step(step, *arguments, _rising(partial(send, "progress"))))
    except (MemoryError, RuntimeError) as error:  # Memory is too short to begin the step, or to send its outcome.
        limited = resource is not None and resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY
        # A RuntimeError means too little memory only if a memory limit is set.
        if isinstance(error, MemoryError) or limited:
            os._exit(OUT_OF_MEMORY)
        raise


def _rising(on_progress: OnProgress) -> OnProgress:
    """Throttle a progress callback: forward increasing fractions, at most one every 50 ms, and always the final 1."""
    last, then = 0.0, -math.inf

    def filtered(share: float) -> None:
        nonlocal last, then
        now = time.monotonic()
        if share > last and (now - then >= _MIN_PROGRESS_INTERVAL_S or share >= 1.0):
            last, then = float(share), now
            on_progress(last)

    return filtered


def _prepare(limits: FitLimits) -> None:
    """Set the limits of this process; if the process has a stricter memory limit already, keep that limit.

    Raises MemoryError if less than 4 MB can be allocated, because a step without memory may crash without an error.
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
    """Send log records to the parent process, whose logging is configured."""

    def __init__(self, send: Callable[[str, object], None]) -> None:
        super().__init__()
        self._send = send

    def emit(self, record: logging.LogRecord) -> None:
        # `format` turns the traceback into text, because a traceback cannot be pickled.
        self.format(record)
        record.msg, record.args, record.exc_info = record.message, None, None
        self._send("log", record)
