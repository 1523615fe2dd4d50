"""Run fits and other computations in worker processes of this machine.

One thread per process starts it, receives its messages and ends it. If a process is killed, crashes, hangs or runs out
of memory, only the computation of this process fails. Processes are forked from the fork server, a process that has
loaded the library; they share neither memory nor connections with this process. On systems without fork servers, each
process is a new interpreter, which takes longer to start. The module `dsbrdf.engines.worker` runs in the process.
"""

import logging
import math
import multiprocessing
import os
import pickle  # nosec B403
import signal
import socket
import threading
import time
import warnings
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import suppress
from contextvars import copy_context
from dataclasses import asdict
from functools import partial
from multiprocessing import connection, resource_tracker, util
from pathlib import Path
from typing import Any

from dsbrdf.components.decomposition import decompose
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import Profiles
from dsbrdf.engines.engine import (
    MEMORY_LIMIT,
    NO_LIMITS,
    NOT_STARTED,
    Fault,
    FitDocument,
    FitLimits,
    FitTask,
    OnProgress,
    Outcome,
)
from dsbrdf.engines.worker import OUT_OF_MEMORY, run_in_worker
from dsbrdf.errors import ConvergenceWarning
from dsbrdf.fitting.options import FitOptions
from dsbrdf.output.serialize import to_json
from dsbrdf.output.sphere_panels import thumbnail
from dsbrdf.pipeline import fit
from dsbrdf.result import FitResult
from dsbrdf.samples.reading import open_checked, read_measurement
from dsbrdf.samples.scattered_samples import ScatteredSamples

_EXIT_TIMEOUT_S = 5.0  # A process is killed if it still runs this long after sending its outcome.
_UNKNOWN_EXIT_CODE = 255  # `multiprocessing` reports this code if the fork server is gone.
# If a process ends for one of these reasons, which lie outside of the fit, another attempt may succeed.
_FROM_OUTSIDE = ("SIGKILL", "SIGTERM", "SIGHUP", "SIGINT", f"exit code {_UNKNOWN_EXIT_CODE}")
_NOTHING = object()  # replaces the outcome if a process dies without sending an outcome
# The fork server imports these modules once for all workers; the first limits the BLAS threads of all others.
_preloaded = ["dsbrdf.engines.fork_server_preload"]

# A start also collects other processes' exit codes, so no process is started while an exit code is collected.
_START_LOCK = threading.Lock()

logger = logging.getLogger(__name__)


def preload(module: str) -> None:
    """Let the fork server import a module once for all worker processes, unless the server runs already."""
    if module not in _preloaded:
        _preloaded.append(module)


def _context() -> Any:
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    forking = multiprocessing.get_context("forkserver")
    forking.set_forkserver_preload(_preloaded)
    return forking


def start_fork_server() -> None:
    """Start the fork server, unless it runs already or the system has none.

    The server and its workers ignore Ctrl-C. Raises OSError if the server cannot be started, or if the socket of a
    running server has been removed.
    """
    if _context().get_start_method() != "forkserver":
        return
    from multiprocessing import forkserver  # Windows does not have it.

    with _START_LOCK:
        # The resource tracker starts first, because its start unblocks SIGINT, which must be blocked below.
        resource_tracker.ensure_running()
        signals = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            forkserver.ensure_running()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, signals)
        if not any(Path(util.get_temp_dir()).glob("listener-*")):
            raise FileNotFoundError("no process can be started: a socket has been removed; start this program again")


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
        process = _context().Process(target=run_in_worker, args=arguments, name="dsbrdf-fit", daemon=True)
        self._stop = partial(ours.shutdown, socket.SHUT_RDWR)  # Closing the connection ends the wait for messages.
        with ours:
            try:
                with its:
                    # If `cancel` was called before `_stop` was set, the process must not be started.
                    if self._is_stopped:
                        return _NOTHING
                    start_fork_server()
                    with _START_LOCK:
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
    with _START_LOCK:
        process.join()
    code: int | None = process.exitcode
    if code == _UNKNOWN_EXIT_CODE:
        _kill(process)
    return code


def _kill(process: Any) -> None:
    with suppress(ProcessLookupError):  # `Process.kill` is not used, because it does nothing without the fork server.
        os.kill(process.pid, getattr(signal, "SIGKILL", signal.SIGTERM))


def _fault_of_exit(code: int | None) -> Fault:
    # Native libraries abort if an allocation fails.
    if code in (OUT_OF_MEMORY, -signal.SIGABRT):
        return MEMORY_LIMIT
    reason = f"exit code {code}"
    if code is not None and code < 0:  # Most real-time signals have no name.
        reason = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
    if reason == "SIGXCPU":
        return Fault("compute", "ProcessorLimit", "The fit took more processor time than a fit may take.")
    if reason in _FROM_OUTSIDE:
        return Fault("system", "ProcessLost", f"The fit's process was ended from outside ({reason}).")
    return Fault("compute", "ProcessCrashed", f"The fit's process crashed ({reason}).")


def compute(task: FitTask, on_progress: OnProgress) -> FitDocument:
    """Fit the measurement of a task, and return the fit as a `FitDocument`."""
    measurement = measurement_of(task)
    result = fit_quietly(measurement, task.options, on_progress)
    return document_of(result, measurement if task.with_thumbnail else None)


def measurement_of(task: FitTask) -> Measurement | ScatteredSamples:
    """Return the samples of a task, or read the measurement in its file."""
    if task.samples is not None:
        return task.samples
    return read_measurement(task.path) if task.sha256 is None else open_checked(task.path, task.sha256)


def fit_quietly(
    measurement: Measurement | Profiles | ScatteredSamples, options: FitOptions, on_progress: OnProgress
) -> FitResult:
    """Fit without raising a ConvergenceWarning, because the report contains the warning."""
    with warnings.catch_warnings(action="ignore", category=ConvergenceWarning):
        return fit(measurement, options, progress=on_progress)


def document_of(result: FitResult, drawn: Measurement | ScatteredSamples | None = None) -> FitDocument:
    """Return the stored form of a fit; if `drawn` is a measurement, add a thumbnail of the measurement and the fit."""
    text = to_json(result.model, result.report, decompose(result))
    return FitDocument(text, asdict(result.report.metrics), None if drawn is None else thumbnail(result.model, drawn))


class LocalEngine(Processes):
    """Run fits on this machine, each in a worker process with limits; at most `count` fits run at once."""

    def submit(self, task: FitTask, on_progress: OnProgress) -> "Future[Outcome]":
        """Compute a task in a new worker process."""
        return self.call(compute, task, on_progress=on_progress)
