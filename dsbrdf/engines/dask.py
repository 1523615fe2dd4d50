"""Fits on the workers of a Dask cluster.

The measurement is read and reduced in a child process of this machine, the fit runs in a child process of a worker,
and only the profiles travel, some 0.3 MB. Workers have to have the same versions as this machine and must be allowed
to start processes; the others of the cluster are not used. A worker that is lost takes its fits with it, and these run
again on another one; when the scheduler comes back after it was lost, everything unfinished is sent once more.

A Dask cluster runs whatever it is sent by whoever can connect to it, unless TLS is set up in Dask's configuration.
"""

import asyncio
import importlib
import logging
import time
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import replace
from typing import Any

from dsbrdf.engines.dask_cluster import TOPIC, Cluster, LostError
from dsbrdf.engines.engine import Fault, FitTask, Fitted, Limits, Outcome
from dsbrdf.engines.fair_slots import Places
from dsbrdf.engines.fit_task import Reduced, complete, fit_parcel, reduce
from dsbrdf.engines.local import Children
from dsbrdf.engines.worker_process import Child, start_fork_server
from dsbrdf.extras import require
from dsbrdf.fitting.options import FitOptions

_TELL = 0.2  # seconds between two messages of a fit's progress, which cost worker, scheduler and this machine
_LOST_WORKERS = 3  # that one fit may outlive before it is given up: as many as Dask allows a task

logger = logging.getLogger(__name__)


class DaskEngine:
    """Engine whose fits run on a Dask cluster, as many at once as its workers have threads.

    Parameters
    ----------
    scheduler : str
        Its address, such as ``tcp://host:8786``.
    helpers : int
        Child processes of this machine at once, which read measurements.  So many fits are prepared ahead for workers
        of other machines, which then need not wait; those of this machine would only have to share its cores.
    limits : Limits, optional
        Of each process, here and on the workers.

    Raises
    ------
    MissingExtraError
        If Dask distributed is not installed.
    """

    def __init__(self, scheduler: str, helpers: int, limits: Limits | None = None) -> None:
        require("dask", "distributed", purpose="fits on a Dask cluster")
        self._limits = limits or Limits()
        self._children = Children(helpers, self._limits)
        self._turns = Places()
        self._helpers = helpers
        self._cluster = Cluster(scheduler, self._make_room)
        self._keeping: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Begin to look for the scheduler."""
        await asyncio.to_thread(start_fork_server)
        await asyncio.to_thread(importlib.import_module, "distributed")
        # What it would say of a connection that is lost, in pages, is said here in a line.
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        self._keeping = asyncio.create_task(self._cluster.keep())

    def turn(self, whose: str = "") -> AbstractAsyncContextManager[object]:
        """Wait until the cluster has a thread for one more fit, or one may be prepared meanwhile."""
        return self._turns.one(whose)

    async def run(self, task: FitTask, on_progress: Callable[[float], None]) -> Outcome:
        """Compute `task`; a worker on which a cancelled call has begun frees its processor within a moment."""
        reduced: Reduced | Fault = await self._children.run(reduce, task, tell=_ignore)
        if isinstance(reduced, Fault):
            return reduced
        outcome = await self._fit(reduced.packed, task.options, _rising(on_progress))
        if isinstance(outcome, Fault):
            return outcome
        completed: Outcome = await self._children.run(complete, outcome, task, reduced.sha256, tell=_ignore)
        return completed

    async def check(self) -> None:
        """Raise RuntimeError if the scheduler is away, or has no worker that can run fits."""
        fault = self._cluster.fault()
        if fault is not None:
            raise RuntimeError(fault)

    async def close(self) -> None:
        """Leave the cluster; the calls of `run` have to be cancelled or over."""
        if self._keeping is not None:
            self._keeping.cancel()
            await asyncio.wait([self._keeping])
        await self._children.close()

    def _make_room(self, threads: int, elsewhere: bool) -> None:
        self._turns.resize({"cluster": threads + self._helpers * elsewhere} if threads else {})

    async def _fit(self, packed: bytes, options: FitOptions, tell: Callable[[float], None]) -> Fitted | Fault:
        lost = 0
        while lost <= _LOST_WORKERS:
            async with self._cluster.threads.one() as worker:
                try:
                    outcome: Fitted | Fault = await self._cluster.call(
                        worker, tell, fit_on_worker, packed, options, self._limits
                    )
                except LostError as error:
                    logger.warning("a fit on the worker %s has to run again: %s", worker, error)
                    lost += error.worker
                except Exception as error:
                    logger.exception("a fit could not run on the worker %s", worker)
                    return Fault("system", "ClusterFailed", f"The Dask cluster failed: {type(error).__name__}.")
                else:
                    return outcome
        return Fault("system", "WorkerLost", f"{lost} workers of the Dask cluster were lost while they ran this fit.")


def fit_on_worker(packed: bytes, options: FitOptions, limits: Limits) -> Outcome:
    """Fit a parcel in a child process of the Dask worker that calls this, as long as anyone wants the result."""
    from distributed import get_worker
    from distributed.core import Status

    worker = get_worker()
    key = worker.get_current_task()

    told = 0.0

    def tell(share: float) -> None:
        nonlocal told
        now = time.monotonic()
        if now - told < _TELL and share < 1.0:
            return
        told = now
        worker.log_event(TOPIC, {"key": key, "share": share})

    def wanted() -> bool:
        # Dask leaves what runs alone when it is cancelled, when its client is gone and when the worker has to close.
        state = worker.state.tasks.get(key)
        return state is not None and state.state == "executing" and worker.status not in (Status.closing, Status.closed)

    outcome: Outcome = Child(fit_parcel, (packed, options), _share(limits, worker)).supervise(tell, wanted)
    return outcome


def _share(limits: Limits, worker: Any) -> Limits:
    """Keep the fits of a worker together within the memory that the worker was given."""
    memory: int | None = worker.memory_manager.memory_limit
    if memory is None:
        return limits
    share = memory // worker.state.nthreads >> 20
    return replace(limits, memory_mb=share if limits.memory_mb is None else min(share, limits.memory_mb))


def _rising(tell: Callable[[float], None]) -> Callable[[float], None]:
    """Hold back shares that are not larger than all before: a fit that runs again begins anew."""
    highest = 0.0

    def told(share: float) -> None:
        nonlocal highest
        if share > highest:
            highest = share
            tell(share)

    return told


def _ignore(_: float) -> None:
    """Reading takes no time that would be worth telling."""
