"""Run computations in worker processes; one thread per process starts it, receives its messages and ends it.

If a process is killed, crashes, hangs or runs out of memory, only the computation of this process fails. The module
`dsbrdf.engines.worker` runs in the worker process.
"""

import logging
import math
import os
import pickle  # nosec B403
import signal
import socket
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import suppress
from contextvars import copy_context
from functools import partial
from multiprocessing import connection
from typing import Any

from dsbrdf.engines.engine import MEMORY_LIMIT, NO_LIMITS, NOT_STARTED, Fault, FitLimits, OnProgress
from dsbrdf.engines.fork_server import START_LOCK, context, start_fork_server
from dsbrdf.engines.worker import OUT_OF_MEMORY, run_in_worker

_EXIT_TIMEOUT_S = 5.0  # A process is killed if it still runs this long after sending its outcome.
_UNKNOWN_EXIT_CODE = 255  # `multiprocessing` reports this code if the fork server is gone.
# If a process ends for one of these reasons, which lie outside of the fit, another attempt may succeed.
_FROM_OUTSIDE = ("SIGKILL", "SIGTERM", "SIGHUP", "SIGINT", f"exit code {_UNKNOWN_EXIT_CODE}")
_NOTHING = object()  # replaces the outcome if a process dies without sending an outcome

logger = logging.getLogger(__name__)


class Processes:
    """Run at most `count` worker processes at once, each with limits; further calls wait."""

    def __init__(self, count: int, limits: FitLimits = NO_LIMITS) -> None:
        self._limits = limits
        self._threads = ThreadPoolExecutor(count, "dsbrdf-process")
        self._unfinished: set[_Call] = set()

    def call(
        self, step: Callable[..., Any], *arguments: Any, on_progress: OnProgress = lambda _: None
    ) -> "Future[Any]":
        """Call ``step(*arguments, on_progress)`` in a new process; the future gets its result, or a `Fault`.

        The step must be importable, and its arguments must be picklable. The method `cancel` of the future ends the
        process, and the future is done when the process has ended.
        """
        call = _Call(self._limits, on_progress, step, arguments)
        self._unfinished.add(call)
        call.add_done_callback(self._unfinished.discard)
        try:
            self._threads.submit(copy_context().run, call.settle)
        except RuntimeError:
            # No thread could be started for this call, which must not wait for a thread of another call.
            call.cancel()
            raise
        return call

    def check(self) -> None:
        """Start the fork server, unless it runs; raise OSError if it cannot be started."""
        start_fork_server()

    def close(self) -> None:
        """End all processes, and return when they have ended."""
        for call in self._unfinished.copy():
            call.cancel()
        self._threads.shutdown()


class _Call(Future[Any]):
    """Represent a computation in a process; `cancel` ends the process, and the future is done after its end."""

    def __init__(self, limits: FitLimits, on_progress: OnProgress, step: Callable[..., Any], arguments: Any) -> None:
        super().__init__()
        self._limits, self._on_progress, self._step, self._arguments = limits, on_progress, step, arguments
        self._stop: Callable[[], object] = lambda: None
        self._is_stopped = False

    def cancel(self) -> bool:
        self._is_stopped = True
        if super().cancel():  # The result is True if the computation has not begun.
            return True
        with suppress(OSError):  # The process may have ended already.
            self._stop()
        return False

    def settle(self) -> None:
        """Run the computation in a process, and set the result or the exception of this future."""
        if not self.set_running_or_notify_cancel():
            return
        try:
            outcome = self._run()
            if self._is_stopped:
                raise CancelledError  # noqa: TRY301 (handled like any error)
        except BaseException as error:  # For example, an argument cannot be pickled, or the progress callback fails.
            self.set_exception(error)
        else:
            self.set_result(outcome)

    def _run(self) -> Any:
        """Start a process, receive messages until its outcome, its end or its time limit, and end the process."""
        ours, its = socket.socketpair()
        arguments = its, self._limits, self._step, self._arguments
        process = context().Process(target=run_in_worker, args=arguments, name="dsbrdf-fit", daemon=True)
        self._stop = partial(ours.shutdown, socket.SHUT_RDWR)  # Closing the connection ends the wait for messages.
        with ours:
            try:
                with its:
                    # If `cancel` was called before `_stop` was set, the process must not be started.
                    if self._is_stopped:
                        return _NOTHING
                    start_fork_server()
                    with START_LOCK:
                        process.start()
            except (OSError, EOFError) as error:
                logger.exception("the process of a fit could not be started")
                return Fault("system", NOT_STARTED, f"The fit's process could not be started: {error}.")
            patience = 0.0
            try:
                outcome = _outcome(ours, self._limits.seconds, self._on_progress)
                patience = _EXIT_TIMEOUT_S
            except TimeoutError:
                message = f"The fit took longer than the {self._limits.seconds:g} s that a fit may take."
                outcome = Fault("compute", "TimeLimit", message)
            finally:
                code = _end(process, 0.0 if self._is_stopped else patience)
        return _fault_of_exit(code) if outcome is _NOTHING else outcome


def _outcome(pipe: socket.socket, seconds: float, on_progress: OnProgress) -> Any:
    """Receive messages until the outcome or the end of the stream; raise TimeoutError after `seconds`."""
    deadline = time.monotonic() + seconds
    with pipe.makefile("rb") as stream:
        while True:
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise TimeoutError
            pipe.settimeout(left if math.isfinite(left) else None)
            try:
                kind, content = pickle.load(stream)  # noqa: S301 (the sender is a process of this program) # nosec B301
            except (EOFError, ConnectionError, pickle.UnpicklingError):
                return _NOTHING
            if kind == "outcome":
                return content
            if kind == "progress":
                on_progress(content)
            elif logging.getLogger(content.name).isEnabledFor(content.levelno):
                logging.getLogger(content.name).handle(content)


def _end(process: Any, patience: float) -> int | None:
    """Wait for the end of a process and return its exit code; after `patience` seconds, the process is killed."""
    if not connection.wait([process.sentinel], patience):
        _kill(process)
        connection.wait([process.sentinel])
    with START_LOCK:
        process.join()
    code: int | None = process.exitcode
    if code == _UNKNOWN_EXIT_CODE:
        _kill(process)
    return code


def _kill(process: Any) -> None:
    with suppress(ProcessLookupError):  # `Process.kill` is not used, because it does nothing without the fork server.
        os.kill(process.pid, getattr(signal, "SIGKILL", signal.SIGTERM))


def _fault_of_exit(code: int | None) -> Fault:
    if code == OUT_OF_MEMORY:
        return MEMORY_LIMIT
    reason = signal.Signals(-code).name if code is not None and code < 0 else f"exit code {code}"
    if reason == "SIGXCPU":
        return Fault("compute", "ProcessorLimit", "The fit took more processor time than a fit may take.")
    if reason in _FROM_OUTSIDE:
        return Fault("system", "ProcessLost", f"The fit's process was ended from outside ({reason}).")
    return Fault("compute", "ProcessCrashed", f"The fit's process crashed ({reason}).")
