"""Fits in child processes of this machine: one process a fit, forked from a server that has the library loaded.

A process that is killed, crashes or runs out of memory takes its own fit with it and nothing else. Children
are never forked from the web process itself: they share neither its memory nor its connections.
"""

import asyncio
import logging
import multiprocessing
import os
import signal
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import forkserver
from multiprocessing.context import ForkServerContext

from dsbrdf.engines import Fault, FitTask, Outcome
from dsbrdf.engines.compute import compute_in_child

_THREAD_LIMITS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
# Ended from outside (an operator, the kernel short of memory), so worth another attempt.
_OUTSIDE = (-signal.SIGKILL, -signal.SIGTERM, -signal.SIGHUP, -signal.SIGINT)
_UNKNOWN_EXIT = 255  # what multiprocessing says when the fork server is gone
_LAST_WORDS = 5.0  # seconds that a process gets to end after it has sent its outcome

logger = logging.getLogger(__name__)


class LocalEngine:
    """Engine whose fits run on this machine.

    Parameters
    ----------
    workers : int
        Fits that run at once; more wait.
    seconds : float
        Time limit of a fit [s].
    memory_mb : int
        Address space limit of a fit [MB].
    """

    def __init__(self, workers: int, seconds: float, memory_mb: int) -> None:
        self._seconds = seconds
        self._memory_bytes = memory_mb << 20
        # The fork server takes its environment from here; this process has loaded its BLAS already. A fit is
        # one process on one core, so further threads would only compete with the other fits.
        os.environ.update(dict.fromkeys(_THREAD_LIMITS, "1"))
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload(["dsbrdf.engines.compute"])
        self._threads = ThreadPoolExecutor(workers, "dsbrdf-fit")

    async def run(self, task: FitTask, on_progress: Callable[[float], None]) -> Outcome:
        """Compute `task` in a new process; a cancelled call returns when the process is gone."""
        loop = asyncio.get_running_loop()
        child = _Child(self._context, task, self._memory_bytes)

        def tell(share: float) -> None:
            loop.call_soon_threadsafe(on_progress, share)

        supervision = loop.run_in_executor(self._threads, child.supervise, self._seconds, tell)
        try:
            return await asyncio.shield(supervision)
        except asyncio.CancelledError:
            child.stop()
            await asyncio.wait([supervision])
            raise

    async def check(self) -> None:
        """Start the fork server if it does not run."""
        await asyncio.to_thread(forkserver.ensure_running)

    async def close(self) -> None:
        """Release the threads; the calls of `run` have to be cancelled or over."""
        await asyncio.to_thread(self._threads.shutdown)


class _Child:
    """One process and the pipe on which it tells its progress and, last, its outcome."""

    def __init__(self, context: ForkServerContext, task: FitTask, memory_bytes: int) -> None:
        self._fit_id = task.fit_id
        self._reader, self._writer = context.Pipe(duplex=False)
        self._process = context.Process(
            target=compute_in_child, args=(task, self._writer, memory_bytes), name="dsbrdf-fit", daemon=True
        )
        self._stopped = False

    def stop(self) -> None:
        """End the process, from any thread; if it is just being started, it ends then."""
        self._stopped = True
        if self._process.pid is not None:
            self._process.kill()

    def supervise(self, seconds: float, tell: Callable[[float], None]) -> Outcome:
        """Run the process to its end and return its outcome."""
        with self._reader:
            try:
                with self._writer:
                    self._process.start()
            except (OSError, EOFError) as error:
                logger.exception("the process of fit %s could not be started", self._fit_id)
                return Fault("system", "ProcessLost", f"The fit's process could not be started: {error}.")
            try:
                if self._stopped:
                    self._process.kill()
                return self._listen(seconds, tell)
            finally:
                self._process.join(_LAST_WORDS)
                self._process.kill()
                self._process.join()

    def _listen(self, seconds: float, tell: Callable[[float], None]) -> Outcome:
        deadline = time.monotonic() + seconds
        try:
            while self._reader.poll(max(0.0, deadline - time.monotonic())):
                message: float | Outcome = self._reader.recv()
                if not isinstance(message, float):
                    return message
                tell(message)
        except (EOFError, OSError):
            self._process.join()
            return self._died()
        self._process.kill()
        return Fault("compute", "TimeLimit", f"The fit took longer than the {seconds:g} s that a fit may take.")

    def _died(self) -> Fault:
        code = self._process.exitcode
        logger.warning("the process of fit %s ended with exit code %s", self._fit_id, code)
        reason = signal.Signals(-code).name if code is not None and code < 0 else f"exit code {code}"
        if code in _OUTSIDE or code == _UNKNOWN_EXIT:
            return Fault("system", "ProcessLost", f"The fit's process was ended from outside ({reason}).")
        return Fault("compute", "ProcessCrashed", f"The fit's process crashed ({reason}).")
