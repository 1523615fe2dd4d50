"""Fits on this machine: one child process a fit."""

import asyncio
import contextvars
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractAsyncContextManager
from typing import Any

from dsbrdf.engines.engine import FitTask, Limits, Outcome
from dsbrdf.engines.fair_slots import Places
from dsbrdf.engines.fit_task import compute
from dsbrdf.engines.worker_process import Child, start_fork_server


class Children:
    """Child processes of this machine, so many at once; more wait.

    Parameters
    ----------
    count : int
    limits : Limits
        Of each.
    """

    def __init__(self, count: int, limits: Limits) -> None:
        self._limits = limits
        self._threads = ThreadPoolExecutor(count, "dsbrdf-fit")

    async def run(self, work: Callable[..., Any], *arguments: Any, tell: Callable[[float], None]) -> Any:
        """Call ``work(*arguments, report)`` in a new process; a cancelled call returns when the process is gone.

        Returns
        -------
        object
            What `work` returns, or a `Fault`.
        """
        loop = asyncio.get_running_loop()
        child = Child(work, arguments, self._limits)

        def tell_loop(share: float) -> None:
            loop.call_soon_threadsafe(tell, share)

        context = contextvars.copy_context()  # what the caller has bound for its log lines
        supervision = self._threads.submit(context.run, child.supervise, tell_loop)
        ended = asyncio.wrap_future(supervision)
        try:
            return await asyncio.shield(ended)
        except asyncio.CancelledError:
            if not supervision.cancel():  # it has a thread: it does not only wait for one
                child.stop()
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
        Fits that run at once; more wait.
    limits : Limits, optional
        Of each.
    """

    def __init__(self, workers: int, limits: Limits | None = None) -> None:
        self._turns = Places({"here": workers})
        self._children = Children(workers, limits or Limits())

    async def start(self) -> None:
        """Start what children are forked from."""
        await asyncio.to_thread(start_fork_server)

    def turn(self, whose: str = "") -> AbstractAsyncContextManager[object]:
        """Wait for one of the workers."""
        return self._turns.one(whose)

    async def run(self, task: FitTask, on_progress: Callable[[float], None]) -> Outcome:
        """Compute `task` in a new process; a cancelled call returns when the process is gone."""
        outcome: Outcome = await self._children.run(compute, task, tell=on_progress)
        return outcome

    async def check(self) -> None:
        """Start what children are forked from, if it has ended."""
        try:
            await asyncio.to_thread(start_fork_server)
        except OSError as error:
            raise RuntimeError(f"No process can be started: {error}.") from error

    async def close(self) -> None:
        """Release the threads; the calls of `run` have to be cancelled or over."""
        await self._children.close()
