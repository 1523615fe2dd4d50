"""Processes that fit files, one file at a time each.

Fits run beside each other in processes, not in threads: they are many small steps of NumPy, which hold Python's lock.
Each process has one BLAS thread, because on matrices as small as these several threads are slower than one, on a busy
machine up to ten times.  A process that dies takes only its file with it, and none outlives the one that started it.
"""

import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import connection, get_context, parent_process, resource_tracker
from pathlib import Path

from dsbrdf.errors import ConvergenceWarning, DSBRDFError
from dsbrdf.fit import FitOptions, FitResult, fit
from dsbrdf.merl import read_merl

UNREADABLE = (FileNotFoundError, FileExistsError, IsADirectoryError, NotADirectoryError, PermissionError)
"""Errors of the operating system that mean a wrong path, not a fault of the machine."""

ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
_PAUSE = 0.05  # seconds between two messages about progress
_LAST_MOMENTS = 5.0  # seconds that a process gets to end by itself after it has closed its pipe


@dataclass(frozen=True)
class FileFit:
    """What became of one file.

    Attributes
    ----------
    file : Path
        The measurement.
    output : Path or None
        The model's file; None where nothing was to be written.
    result : FitResult or None
        The fit; None where it failed.
    error : str or None
        One sentence that says why it failed.
    lost : bool
        Whether it failed through no fault of the measurement: its process died, or the machine could not read it.
    warnings : tuple of str
        Sentences of the fit about its convergence.
    resumed : bool
        Whether the result was taken from an earlier run.
    """

    file: Path
    output: Path | None = None
    result: FitResult | None = None
    error: str | None = None
    lost: bool = False
    warnings: tuple[str, ...] = ()
    resumed: bool = False


def default_jobs() -> int:
    """Return the number of CPUs that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def fit_in_processes(
    tasks: Iterable[tuple[int, Path]], options: FitOptions, jobs: int
) -> Generator[tuple[int, float | FileFit], None, None]:
    """Fit files in processes of their own.

    Closing the iterator, or an exception in it, ends the processes at once.

    Parameters
    ----------
    tasks : iterable of (int, Path)
        Files and the numbers they go by; asked for the next one when a process has nothing to do.
    options : FitOptions
        For all of them.
    jobs : int
        Number of processes.

    Yields
    ------
    number : int
        Of a file.
    message : float or FileFit
        The share done of its fit and, last, what became of it.
    """
    waiting = iter(tasks)
    idle: list[_Worker] = []
    busy: dict[object, _Worker] = {}
    try:
        while True:
            while len(busy) < jobs and (task := next(waiting, None)) is not None:
                worker = idle.pop() if idle else _Worker(options)
                busy[worker.pipe] = worker
                worker.begin(*task)
            if not busy:
                return
            for pipe in connection.wait(list(busy)):  # type: ignore[arg-type]  # the keys are connections
                worker = busy[pipe]
                message = worker.receive()
                if isinstance(message, FileFit):
                    del busy[pipe]
                    if worker.alive:
                        idle.append(worker)
                yield worker.number, message
    finally:
        for worker in (*idle, *busy.values()):
            worker.end()


class _Worker:
    """A process, the pipe to it, and the file it works on."""

    def __init__(self, options: FitOptions) -> None:
        context = get_context("spawn")
        self.pipe, self._far_end = context.Pipe()
        self.number, self._file = -1, Path()
        self.alive = True
        self._process = context.Process(target=_work, args=(self._far_end, options), name="dsbrdf-fit", daemon=True)

    def begin(self, number: int, file: Path) -> None:
        """Have a file fitted; the process starts with its first one."""
        self.number, self._file = number, file
        if self._process.pid is None:
            with self._far_end, _one_thread(), _interrupts_held():
                self._process.start()
        with suppress(BrokenPipeError):  # the process is gone: `receive` will say so
            self.pipe.send(file)

    def receive(self) -> float | FileFit:
        """Return the next message about the file; where the process has died, that it has."""
        try:
            message: float | FileFit = self.pipe.recv()
        except (EOFError, ConnectionResetError):
            self._process.join(_LAST_MOMENTS)
            self.end()
            return FileFit(self._file, error=self._death(), lost=True)
        return message

    def end(self) -> None:
        """Stop the process, whatever it does: it writes nothing that could be left half done."""
        self.alive = False
        self.pipe.close()
        if self._process.pid is not None:
            self._process.kill()
            self._process.join()

    def _death(self) -> str:
        code = self._process.exitcode or 0
        how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        return f"the process that fitted it {how}; run the command again, with fewer --jobs if memory was short"


def _work(pipe: "connection.Connection[float | FileFit, Path]", options: FitOptions) -> None:
    """Fit the files that come through the pipe, until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # typed at a terminal it is meant for the parent, which ends this
    _end_with_parent()
    while True:
        try:
            file = pipe.recv()
        except EOFError:
            return
        pipe.send(_fit_file(file, options, _sender(pipe)))


def _fit_file(file: Path, options: FitOptions, progress: Callable[[float], None]) -> FileFit:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ConvergenceWarning)
        try:
            result = fit(read_merl(file), options, progress=progress)
        except DSBRDFError as error:
            return FileFit(file, error=str(error))
        except OSError as error:
            return FileFit(file, error=error.strerror or str(error), lost=not isinstance(error, UNREADABLE))
    sentences = tuple(str(warning.message) for warning in caught if issubclass(warning.category, ConvergenceWarning))
    return FileFit(file, result=result, warnings=sentences)


def _sender(pipe: "connection.Connection[float | FileFit, Path]") -> Callable[[float], None]:
    """Return a function that tells the parent of progress, now and then."""
    last = time.monotonic()

    def send(share: float) -> None:
        nonlocal last
        if time.monotonic() - last >= _PAUSE:
            last = time.monotonic()
            pipe.send(float(share))

    return send


def _end_with_parent() -> None:
    """End this process as soon as its parent is gone, however the parent ended."""
    parent = parent_process()
    if parent is None:
        return

    def watch(sentinel: int) -> None:
        connection.wait([sentinel])
        os._exit(1)

    threading.Thread(target=watch, args=(parent.sentinel,), daemon=True).start()


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let processes that start in the block have one BLAS thread: it is read from the environment, once."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
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
    """Hold Ctrl-C back during the block: a process that starts there never gets it, not even while it imports."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # the first process would start it, and that lets interrupts through
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
