"""A computation in a process of its own, seen from both of its ends.

The process may be killed, crash, hang or run out of memory: that is the outcome of this computation and touches no
other. It has one BLAS thread, because on matrices as small as these several threads are slower than one, on a busy
machine up to ten times. It ends when the process that wanted it ends, however that happens.
"""

import ctypes
import logging
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing import connection, parent_process, resource_tracker, util
from typing import Any

from dsbrdf.engines.engine import NOT_STARTED, Fault, Limits
from dsbrdf.engines.fit_task import outcome_of

try:
    import resource
except ImportError:  # pragma: no cover (no such limits outside POSIX)
    resource = None  # type: ignore[assignment]

ONE_THREAD = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_THREADS": "1",
}
SERVER_FOLDER = "DSBRDF_FORK_SERVER_FOLDER"
"""The environment variable that tells the fork server the folder of its socket."""

_MMAP_THRESHOLD, _TRIM_THRESHOLD = -3, -1  # glibc's M_MMAP_THRESHOLD and M_TRIM_THRESHOLD
_SMALLEST_STEP = 0.005  # of progress, that is worth a message
_LOOK_UP = 0.1  # seconds after which it is asked again whether the outcome is still wanted
# Ended from outside (an operator, the kernel short of memory), so worth another attempt.
_OUTSIDE = tuple(-getattr(signal, name) for name in ("SIGKILL", "SIGTERM", "SIGHUP", "SIGINT") if hasattr(signal, name))
_UNKNOWN_EXIT = 255  # what multiprocessing says when the fork server is gone
_LAST_WORDS = 5.0  # seconds that a process gets to end after it has sent its outcome

_starting = threading.Lock()

logger = logging.getLogger(__name__)


def start_fork_server() -> None:
    """Start what children are forked from, if there is such a thing here and it does not run."""
    if "forkserver" in multiprocessing.get_all_start_methods():
        from multiprocessing import forkserver

        with _as_children_start():
            _context()
            forkserver.ensure_running()


class Child:
    """One process and the pipe on which it tells its progress and, last, its outcome.

    Children are forked from a server that has the library loaded, never from this process: they share neither its
    memory nor its connections. Where there are no fork servers they are started afresh, which takes longer.

    Parameters
    ----------
    work : callable
        Importable function of `arguments` and of a function that takes the finished share, 0 to 1.
    arguments : tuple
        To be pickled.
    limits : Limits
    """

    def __init__(self, work: Callable[..., Any], arguments: tuple[Any, ...], limits: Limits) -> None:
        context = _context()
        self._seconds = limits.seconds
        self._reader, self._writer = context.Pipe(duplex=False)
        self._process = context.Process(  # type: ignore[attr-defined]  # every context has it
            target=_work, args=(work, arguments, self._writer, limits.memory_mb), name="dsbrdf-fit", daemon=True
        )
        self._stopped = False

    def stop(self) -> None:
        """End the process, from any thread; if it is just being started, it ends then."""
        self._stopped = True
        if self._process.pid is not None:
            self._process.kill()

    def supervise(self, tell: Callable[[float], None], wanted: Callable[[], bool] | None = None) -> Any:
        """Run the process to its end.

        Parameters
        ----------
        tell : callable
            Gets the finished share.
        wanted : callable, optional
            Asked every now and then; when it returns False the process is ended.

        Returns
        -------
        object
            What the work has returned, or a `Fault`.
        """
        with self._reader:
            try:
                with self._writer, _as_children_start():
                    self._process.start()
            except (OSError, EOFError) as error:
                logger.exception("the process of a fit could not be started")
                return Fault("system", NOT_STARTED, f"The fit's process could not be started: {error}.")
            try:
                if self._stopped:
                    self._process.kill()
                return self._listen(tell, wanted)
            finally:
                self._join(_LAST_WORDS)
                self._process.kill()
                self._join()

    def _listen(self, tell: Callable[[float], None], wanted: Callable[[], bool] | None) -> Any:
        deadline = time.monotonic() + self._seconds
        try:
            while (left := deadline - time.monotonic()) > 0:
                if wanted is not None and not wanted():
                    self._process.kill()
                    return Fault("system", "NotWanted", "The fit was stopped because its result is not wanted.")
                if self._reader.poll(_LOOK_UP if wanted is not None else min(left, 3600.0)):
                    message = self._reader.recv()
                    if isinstance(message, logging.LogRecord):
                        if logging.getLogger(message.name).isEnabledFor(message.levelno):
                            logging.getLogger(message.name).handle(message)
                    elif isinstance(message, float):
                        tell(message)
                    else:
                        return message
        except (EOFError, OSError):
            self._join()
            return self._died()
        self._process.kill()
        return Fault("compute", "TimeLimit", f"The fit took longer than the {self._seconds:g} s that a fit may take.")

    def _join(self, seconds: float | None = None) -> None:
        """Wait for the end of the process; how it was can be read once, and who starts another one reads it, too."""
        if connection.wait([self._process.sentinel], seconds):
            with _starting:
                self._process.join()

    def _died(self) -> Fault:
        code = self._process.exitcode
        reason = signal.Signals(-code).name if code is not None and code < 0 else f"exit code {code}"
        if code in _OUTSIDE or code == _UNKNOWN_EXIT:
            return Fault("system", "ProcessLost", f"The fit's process was ended from outside ({reason}).")
        return Fault("compute", "ProcessCrashed", f"The fit's process crashed ({reason}).")


def _context() -> multiprocessing.context.BaseContext:
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["dsbrdf.engines.fork_server_preload"])
    return context


def _work(
    work: Callable[..., Any],
    arguments: tuple[Any, ...],
    pipe: "connection.Connection[Any, Any]",
    memory_mb: int | None,
) -> None:
    """What the process does: the pipe gets the progress as floats, what is logged, and, last, the outcome."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # typed at a terminal it is meant for the parent
    _end_with_parent()
    if resource is not None:
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if memory_mb is not None:
            resource.setrlimit(resource.RLIMIT_AS, (memory_mb << 20, memory_mb << 20))
    _keep_memory()
    logging.basicConfig(handlers=[_ToParent(pipe)], level=logging.INFO, force=True)
    sent = 0.0

    def report(share: float) -> None:
        nonlocal sent
        if share - sent >= _SMALLEST_STEP:
            sent = float(share)
            pipe.send(sent)

    pipe.send(outcome_of(work, *arguments, report))


def _keep_memory() -> None:
    """Let the C library keep what is freed for what is asked for next: a fit needs the same arrays again and again.

    By itself, glibc gives large buffers back each time, and every page of a new one is a fault to be served: a tenth of
    the time of a fit. Other C libraries have no such call.
    """
    with suppress(AttributeError, OSError, TypeError):
        library = ctypes.CDLL(None)
        library.mallopt(_MMAP_THRESHOLD, 1 << 25)  # the most that every version takes
        library.mallopt(_TRIM_THRESHOLD, 1 << 30)


class _ToParent(logging.Handler):
    """Leaves what is logged to the parent, which knows where it goes."""

    def __init__(self, pipe: "connection.Connection[Any, Any]") -> None:
        super().__init__()
        self._pipe = pipe

    def emit(self, record: logging.LogRecord) -> None:
        record.msg, record.args = record.getMessage(), None
        if record.exc_info:
            record.exc_text = logging.Formatter().formatException(record.exc_info)
            record.exc_info = None  # a traceback cannot travel
        self._pipe.send(record)


def _end_with_parent() -> None:
    """Kill this process as soon as its parent is gone, however the parent ended."""
    parent = parent_process()
    if parent is None:
        return
    sentinel = parent.sentinel

    def watch() -> None:
        connection.wait([sentinel])
        os.kill(os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))

    threading.Thread(target=watch, name="end-with-parent", daemon=True).start()


@contextmanager
def _as_children_start() -> Iterator[None]:
    """Let processes that start in the block have what they should have of this one, and nothing else."""
    with _starting, ExitStack() as stack:
        for give in (_environment, _interrupts_held, _main_hidden):
            stack.enter_context(give())
        yield


@contextmanager
def _environment() -> Iterator[None]:
    """The number of BLAS threads is read from there, once."""
    wanted = {**ONE_THREAD, SERVER_FOLDER: util.get_temp_dir()}
    before = {name: os.environ.get(name) for name in wanted}
    os.environ.update(wanted)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back: a process that starts there never gets it, not even while it imports."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # the first process would start it, and that lets interrupts through
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _main_hidden() -> Iterator[None]:
    """Keep processes from running the program's main module once more: they need nothing of it.

    That would take time, and a script without ``if __name__ == "__main__"`` would start itself over and over.
    """
    main = vars(sys.modules["__main__"])
    before: dict[str, Any] = {name: main[name] for name in ("__spec__", "__file__") if name in main}
    main["__spec__"] = None
    main.pop("__file__", None)
    try:
        yield
    finally:
        main.update(before)
