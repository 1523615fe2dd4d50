"""Fits on this machine: one worker process a fit."""

import asyncio
import contextvars
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractAsyncContextManager
from typing import Any

from dsbrdf.engines.engine import FitLimits, FitTask, OnProgress, Outcome
from dsbrdf.engines.fit_steps import compute
from dsbrdf.engines.worker_process import WorkerProcess, start_fork_server


class WorkerProcesses:
    """Worker processes of this machine, a limited number at once; further calls wait.

    Parameters
    ----------
    count : int
        Most processes at once.
    limits : FitLimits
        Of each process.
    """

    def __init__(self, count: int, limits: FitLimits) -> None:
        self._limits = limits
        self._threads = ThreadPoolExecutor(count, "dsbrdf-fit")

    async def run(self, step: Callable[..., Any], *arguments: Any, on_progress: OnProgress) -> Any:
        """Call ``step(*arguments, on_progress)`` in a new process; when cancelled, end the process before returning.

        Returns
        -------
        object
            What `step` returns, or a `Fault`.
        """
        loop = asyncio.get_running_loop()
        process = WorkerProcess(step, arguments, self._limits)

        def progress_in_loop(share: float) -> None:
            loop.call_soon_threadsafe(on_progress, share)

        context = contextvars.copy_context()  # carries the fields that the caller has bound for its log lines
        supervision = self._threads.submit(context.run, process.run, progress_in_loop)
        ended = asyncio.wrap_future(supervision)
        try:
            return await asyncio.shield(ended)
        except asyncio.CancelledError:
            if not supervision.cancel():  # it runs already
                process.stop()
                await asyncio.wait([ended])
            raise

    async def close(self) -> None:
        """Release the threads."""
        await asyncio.to_thread(self._threads.shutdown)


class LocalEngine:
    """Engine whose fits run on this machine.

    Parameters
    ----------
    workers : int
        Most fits at once; further ones wait.
    limits : FitLimits, optional
        Of each fit.
    """

    def __init__(self, workers: int, limits: FitLimits | None = None) -> None:
        self._slots = asyncio.Semaphore(workers)
        self._processes = WorkerProcesses(workers, limits or FitLimits())

    async def start(self) -> None:
        """Start the server from which worker processes are forked."""
        await asyncio.to_thread(start_fork_server)

    def slot(self) -> AbstractAsyncContextManager[object]:
        """Wait until a worker process may be started."""
        return self._slots

    async def run(self, task: FitTask, on_progress: OnProgress) -> Outcome:
        """Compute a task in a new process; when cancelled, end the process before returning."""
        outcome: Outcome = await self._processes.run(compute, task, on_progress=on_progress)
        return outcome

    async def check(self) -> None:
        """Start the fork server again if it has ended; raise RuntimeError if no process can be started."""
        try:
            await asyncio.to_thread(start_fork_server)
        except OSError as error:
            raise RuntimeError(f"no process can be started: {error}") from error

    async def close(self) -> None:
        """Release the threads; all calls of `run` must have ended or been cancelled."""
        await self._processes.close()
