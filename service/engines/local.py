"""Fits in child processes of this machine: one process a fit, forked from a server that has the library loaded.

A process that is killed, crashes or runs out of memory takes its own fit with it and nothing else.
"""

import asyncio
import logging
import multiprocessing
import os
import signal
from collections.abc import Callable
from multiprocessing.connection import Connection

from pebble import ProcessExpired, ProcessFuture, concurrent
from starlette.concurrency import run_in_threadpool

from service.engines import Fault, FitTask, Outcome
from service.engines.compute import compute_in_child

_THREAD_LIMITS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
# Ended from outside (an operator, the kernel short of memory), so worth another attempt.
_OUTSIDE = (-signal.SIGKILL, -signal.SIGTERM, -signal.SIGHUP, -signal.SIGINT)

logger = logging.getLogger(__name__)


class LocalEngine:
    """Engine whose fits run on this machine.

    Parameters
    ----------
    seconds : float
        Time limit of a fit [s].
    memory_mb : int
        Address space limit of a fit [MB].
    """

    def __init__(self, seconds: float, memory_mb: int) -> None:
        self._seconds = seconds
        self._memory_bytes = memory_mb << 20
        # The fork server takes its environment from here; this process has loaded its BLAS already. A fit is
        # one process on one core, so further threads would only compete with the other fits.
        os.environ.update(dict.fromkeys(_THREAD_LIMITS, "1"))
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload(["service.engines.compute"])
        self._running: set[ProcessFuture[Outcome]] = set()
        decorate = concurrent.process(name="dsbrdf-fit", timeout=seconds, mp_context=self._context)
        self._start = decorate(compute_in_child)

    async def run(self, task: FitTask, on_progress: Callable[[float], None]) -> Outcome:
        """Compute `task` in a new process; cancelling the call ends the process."""
        reader, writer = self._context.Pipe(duplex=False)
        launch = asyncio.ensure_future(run_in_threadpool(self._launch, task, writer))
        try:
            future = await asyncio.shield(launch)
        except asyncio.CancelledError:
            launch.add_done_callback(_cancel_launched)
            reader.close()
            raise
        loop = asyncio.get_running_loop()
        loop.add_reader(reader.fileno(), self._drain, reader, on_progress)
        self._running.add(future)
        try:
            return await asyncio.wrap_future(future)
        except TimeoutError:
            message = f"The fit took longer than the {self._seconds:g} s that a fit may take."
            return Fault("compute", "TimeLimit", message)
        except ProcessExpired as error:
            return _lost(task, error)
        finally:
            self._running.discard(future)
            loop.remove_reader(reader.fileno())
            reader.close()

    async def check(self) -> None:
        """Start the fork server if it does not run."""
        await run_in_threadpool(_ensure_forkserver)

    async def close(self) -> None:
        """End every process."""
        for future in tuple(self._running):
            future.cancel()  # type: ignore[no-untyped-call]

    def _launch(self, task: FitTask, writer: Connection) -> "ProcessFuture[Outcome]":
        try:
            return self._start(task, writer, self._memory_bytes)
        finally:
            writer.close()

    @staticmethod
    def _drain(reader: Connection, on_progress: Callable[[float], None]) -> None:
        try:
            while reader.poll():
                on_progress(reader.recv())
        except EOFError:
            asyncio.get_running_loop().remove_reader(reader.fileno())


def _cancel_launched(launch: "asyncio.Future[ProcessFuture[Outcome]]") -> None:
    if not launch.cancelled() and launch.exception() is None:
        launch.result().cancel()  # type: ignore[no-untyped-call]


def _ensure_forkserver() -> None:
    from multiprocessing import forkserver

    forkserver.ensure_running()


def _lost(task: FitTask, error: ProcessExpired) -> Fault:
    code = error.exitcode
    logger.warning("the process of fit %s ended with exit code %s", task.fit_id, code)
    if code in _OUTSIDE:
        message = f"The fit's process was ended from outside ({signal.Signals(-code).name})."
        return Fault("system", "ProcessLost", message)
    reason = signal.Signals(-code).name if code is not None and code < 0 else f"exit code {code}"
    return Fault("compute", "ProcessCrashed", f"The fit's process crashed ({reason}).")
