"""A computation in a process of its own: the side that starts it and the side that computes.

The process may be killed, crash, hang or run out of memory: that is the outcome of this computation and affects no
other. It uses one BLAS thread, see `dsbrdf.process_settings`. It ends when the process that started it ends, however
that happens.
"""

import logging
import mmap
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import connection, resource_tracker, util
from pathlib import Path
from typing import Any

from dsbrdf.engines.engine import MEMORY_LIMIT, NOT_STARTED, STOPPED, Fault, FitLimits, OnProgress, rising, run_step
from dsbrdf.process_settings import ONE_BLAS_THREAD, end_with_parent, keep_freed_memory, reserve_blas_memory

try:
    import resource
except ImportError:  # pragma: no cover (no such limits outside POSIX)
    resource = None  # type: ignore[assignment]

SERVER_FOLDER = "DSBRDF_FORK_SERVER_FOLDER"
"""Environment variable that names the folder of the fork server's socket."""

_MIN_PROGRESS_STEP = 0.01  # smaller steps of progress are not sent
_POLL_INTERVAL = 0.1  # seconds between two questions whether the outcome is still wanted
_EXIT_TIMEOUT = 5.0  # seconds that a process has to end after it has sent its outcome
# Exit codes of a process that an operator or the kernel ended, so that another attempt may succeed.
_ENDED_FROM_OUTSIDE = tuple(
    -getattr(signal, name) for name in ("SIGKILL", "SIGTERM", "SIGHUP", "SIGINT") if hasattr(signal, name)
)
_LEAST_MEMORY = 4 << 20  # bytes without which a step is not begun
_OUT_OF_MEMORY = 75  # exit code of a process that could not send its outcome
_UNKNOWN_EXIT = 255  # reported by multiprocessing when the fork server is gone

_start_lock = threading.Lock()

logger = logging.getLogger(__name__)


def start_fork_server() -> None:
    """Start the server from which worker processes are forked, unless it runs or this system has none.

    Raises RuntimeError if it cannot be started, or be reached because its socket has been removed.
    """
    if "forkserver" in multiprocessing.get_all_start_methods():
        from multiprocessing import forkserver

        try:
            with _start_conditions():
                _context()
                forkserver.ensure_running()
                reachable = any(Path(util.get_temp_dir()).glob("listener-*"))
        except OSError as error:
            raise RuntimeError(f"no process can be started: {error}") from error
        if not reachable:
            raise RuntimeError("no process can be started: a socket has been removed; start this program again")


def run_in_process(
    step: Callable[..., Any],
    arguments: tuple[Any, ...],
    limits: FitLimits,
    on_progress: OnProgress,
    stopped: Callable[[], bool],
) -> Any:
    """Call ``step(*arguments, on_progress)`` in a process of its own; return what it returns, or a `Fault`.

    The process is forked from a server that has the library loaded, never from this one, whose memory and connections
    it does not share; without fork servers it is a new interpreter, which takes longer. The step is importable, its
    arguments can be pickled. `stopped` is called ten times a second; when it returns True, the process is ended.
    """
    context = _context()
    reader, writer = context.Pipe(duplex=False)
    process: multiprocessing.process.BaseProcess = context.Process(  # type: ignore[attr-defined]  # every context has it
        target=_run_in_worker, args=(step, arguments, writer, limits), name="dsbrdf-fit", daemon=True
    )
    with reader:
        try:
            with writer, _start_conditions():
                process.start()
        except (OSError, EOFError) as error:
            logger.exception("the process of a fit could not be started")
            return Fault("system", NOT_STARTED, f"The fit's process could not be started: {error}.")
        try:
            return _outcome(process, reader, limits.seconds, on_progress, stopped)
        finally:
            _join(process, _EXIT_TIMEOUT)
            process.kill()
            _join(process)


def _outcome(
    process: multiprocessing.process.BaseProcess,
    reader: "connection.Connection[Any, Any]",
    seconds: float,
    on_progress: OnProgress,
    stopped: Callable[[], bool],
) -> Any:
    """Receive messages until the outcome comes, the process dies or its time is up."""
    deadline = time.monotonic() + seconds
    try:
        while (left := deadline - time.monotonic()) > 0:
            if stopped():
                process.kill()
                return STOPPED
            if reader.poll(min(left, _POLL_INTERVAL)):
                message = reader.recv()
                if isinstance(message, logging.LogRecord):
                    if logging.getLogger(message.name).isEnabledFor(message.levelno):
                        logging.getLogger(message.name).handle(message)
                elif isinstance(message, float):
                    on_progress(message)
                else:
                    return message
    except (EOFError, OSError):
        _join(process)
        return _fault_of_exit(process.exitcode)
    process.kill()
    return Fault("compute", "TimeLimit", f"The fit took longer than the {seconds:g} s that a fit may take.")


def _join(process: multiprocessing.process.BaseProcess, seconds: float | None = None) -> None:
    """Wait for the end of a process."""
    if connection.wait([process.sentinel], seconds):
        with _start_lock:  # starting another process collects the exit codes of ended ones too
            process.join()


def _fault_of_exit(code: int | None) -> Fault:
    if code == _OUT_OF_MEMORY:
        return MEMORY_LIMIT
    reason = signal.Signals(-code).name if code is not None and code < 0 else f"exit code {code}"
    if code in _ENDED_FROM_OUTSIDE or code == _UNKNOWN_EXIT:
        return Fault("system", "ProcessLost", f"The fit's process was ended from outside ({reason}).")
    return Fault("compute", "ProcessCrashed", f"The fit's process crashed ({reason}).")


def _context() -> multiprocessing.context.BaseContext:
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["dsbrdf.engines.fork_server_preload"])
    return context


def _run_in_worker(
    step: Callable[..., Any],
    arguments: tuple[Any, ...],
    pipe: "connection.Connection[Any, Any]",
    limits: FitLimits,
) -> None:
    """Run a step in the worker process; send progress as floats, log records and, last, the outcome."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in a terminal reaches all processes; the parent handles it
    try:
        _prepare(pipe, limits)
        pipe.send(run_step(step, *arguments, rising(pipe.send, step=_MIN_PROGRESS_STEP)))
    except (MemoryError, RuntimeError) as error:  # there is not even enough to begin, or to send the outcome
        limited = resource is not None and resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY
        if isinstance(error, MemoryError) or limited:  # else a thread is refused for another reason
            os._exit(_OUT_OF_MEMORY)
        raise


def _prepare(pipe: "connection.Connection[Any, Any]", limits: FitLimits) -> None:
    """Set the limits, that of memory unless a narrower one was set from outside; MemoryError if hardly any is left.

    What goes wrong without memory need not be an exception, as the stack cannot grow either.
    """
    end_with_parent()
    if limits.niceness and hasattr(os, "nice"):
        os.nice(limits.niceness)
    if resource is not None:
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        reserve_blas_memory()
        most, _ = resource.getrlimit(resource.RLIMIT_AS)
        if limits.memory_mb is not None and (most == resource.RLIM_INFINITY or limits.memory_mb << 20 < most):
            resource.setrlimit(resource.RLIMIT_AS, (limits.memory_mb << 20, limits.memory_mb << 20))
        try:
            mmap.mmap(-1, _LEAST_MEMORY).close()
        except OSError:
            raise MemoryError from None
    keep_freed_memory()
    logging.basicConfig(handlers=[_LogToParent(pipe)], level=logging.INFO, force=True)


class _LogToParent(logging.Handler):
    """Sends log records to the parent process, whose logging is configured."""

    def __init__(self, pipe: "connection.Connection[Any, Any]") -> None:
        super().__init__()
        self._pipe = pipe

    def emit(self, record: logging.LogRecord) -> None:
        record.msg, record.args = record.getMessage(), None
        if record.exc_info:
            record.exc_text = logging.Formatter().formatException(record.exc_info)
            record.exc_info = None  # a traceback cannot be pickled
        self._pipe.send(record)


@contextmanager
def _start_conditions() -> Iterator[None]:
    """Hold the conditions under which worker processes and their fork server must be started, which inherit them.

    Ctrl-C is blocked, so that they are not interrupted even during their imports. The program's main module is hidden:
    they do not need it, and a script without ``if __name__ == "__main__"`` would start itself again and again.
    """
    main, blocks_signals = vars(sys.modules["__main__"]), hasattr(signal, "pthread_sigmask")
    with _start_lock:
        # Not before the lock: threads that ask for the folder at once for the first time would get one each.
        environment = {**ONE_BLAS_THREAD, SERVER_FOLDER: util.get_temp_dir()}
        if blocks_signals:
            resource_tracker.ensure_running()  # starting it later, with the first process, would unblock interrupts
            signals = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        shown: dict[str, Any] = {name: main[name] for name in ("__spec__", "__file__") if name in main}
        before = {name: os.environ.get(name) for name in environment}
        try:
            os.environ.update(environment)
            main["__spec__"] = None
            main.pop("__file__", None)
            yield
        finally:
            main.update(shown)
            for name, value in before.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value
            if blocks_signals:
                signal.pthread_sigmask(signal.SIG_SETMASK, signals)
