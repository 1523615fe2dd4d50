"""Fits on the workers of a Dask cluster.

The measurement is read and reduced in a worker process of this machine, the fit runs in a child process of a Dask
worker, and only the profiles are sent, some 5 MB, or scattered samples as they are. Dask workers need the same versions
of the software as this machine and permission to start child processes; other workers of the cluster are not used. The
fits of a worker that is lost run again on another one; after the connection to the scheduler was lost, all unfinished
fits are sent again.

Anyone who can connect to a Dask cluster can run any code on it, unless TLS is set up in Dask's configuration.
"""

import asyncio
import importlib
import logging
from contextlib import AbstractAsyncContextManager
from dataclasses import replace
from typing import Any

from dsbrdf.data.reduction import Profiles
from dsbrdf.data.scattered_samples import ScatteredSamples
from dsbrdf.engines.dask_cluster import TOPIC, Cluster, LostError
from dsbrdf.engines.engine import Fault, FitLimits, FitTask, OnProgress, Outcome, rising
from dsbrdf.engines.local import WorkerProcesses, complete_report, fit_reduced, reduce_measurement
from dsbrdf.engines.worker_process import run_in_process
from dsbrdf.extras import require
from dsbrdf.fitting.options import FitOptions

_PROGRESS_INTERVAL = 0.2  # seconds between two progress messages of a fit; each costs time on three machines
_MAX_LOST_WORKERS = 3  # a fit fails when it has lost more workers: the limit that Dask has for its tasks

_Reduced = Profiles | ScatteredSamples

logger = logging.getLogger(__name__)


class DaskEngine:
    """Engine whose fits run on a Dask cluster, as many at once as its workers have threads.

    At most so many `helpers`, worker processes of this machine, read measurements at once. As many fits are prepared in
    advance if Dask workers run on other machines, so that these need not wait. The `limits` hold for each process, here
    and there. Raises MissingExtraError if Dask distributed is not installed.
    """

    def __init__(self, scheduler: str, helpers: int, limits: FitLimits | None = None) -> None:
        require("dask", "distributed", purpose="fits on a Dask cluster")
        self._limits = limits or FitLimits()
        self._processes = WorkerProcesses(helpers, self._limits)
        self._cluster = Cluster(scheduler, helpers)
        self._connection_task: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Begin to connect to the scheduler."""
        await self._processes.start()
        await asyncio.to_thread(importlib.import_module, "distributed")
        # It logs a lost connection with pages of traces; `Cluster` logs one line instead.
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        self._connection_task = asyncio.create_task(self._cluster.stay_connected())

    def slot(self) -> AbstractAsyncContextManager[object]:
        """Wait until the cluster has a thread for one more fit, or until one more may be prepared in advance."""
        return self._cluster.room.slot()

    async def run(self, task: FitTask, on_progress: OnProgress) -> Outcome:
        """Compute a task; when cancelled, the child process on the Dask worker is ended within a second."""
        found: tuple[_Reduced, float] | Fault = await self._processes.call(reduce_measurement, task)
        if isinstance(found, Fault):
            return found
        reduced, seconds = found
        outcome = await self._fit(reduced, task.options, rising(on_progress))  # when run again it starts from 0
        if isinstance(outcome, Fault):
            return outcome
        completed: Outcome = await self._processes.call(complete_report, outcome, task, reduced.sha256, seconds)
        return completed

    async def check(self) -> None:
        """Raise RuntimeError if the scheduler has no worker that can run fits, or no measurement can be read."""
        fault = self._cluster.fault()
        if fault is not None:
            raise RuntimeError(fault)
        await self._processes.check("no process that reads measurements")

    async def close(self) -> None:
        """Disconnect from the cluster; all calls of `run` must have ended or been cancelled."""
        if self._connection_task is not None:
            self._connection_task.cancel()
            await asyncio.wait([self._connection_task])
        await self._processes.close()

    async def _fit(self, reduced: _Reduced, options: FitOptions, on_progress: OnProgress) -> Outcome:
        lost = 0
        while lost <= _MAX_LOST_WORKERS:
            async with self._cluster.threads.slot() as worker:
                try:
                    outcome: Outcome = await self._cluster.call(
                        worker, on_progress, fit_on_worker, reduced, options, self._limits
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


def fit_on_worker(reduced: _Reduced, options: FitOptions, limits: FitLimits) -> Outcome:
    """Fit what is reduced in a child process of the Dask worker that calls this; end it if the task is cancelled."""
    from distributed import get_worker
    from distributed.core import Status

    worker = get_worker()
    key = worker.get_current_task()

    def still_wanted() -> bool:
        # Dask does not stop a running task when it is cancelled, its client has gone or the worker closes.
        state = worker.state.tasks.get(key)
        return state is not None and state.state == "executing" and worker.status not in (Status.closing, Status.closed)

    on_progress = rising(
        lambda share: worker.log_event(TOPIC, {"key": key, "share": share}), seconds=_PROGRESS_INTERVAL
    )
    limits = _with_memory_share(limits, worker)
    outcome: Outcome = run_in_process(fit_reduced, (reduced, options), limits, on_progress, still_wanted)
    return outcome


def _with_memory_share(limits: FitLimits, worker: Any) -> FitLimits:
    """Lower the memory limit to the fit's share of the worker's memory, which all of its threads use."""
    memory: int | None = worker.memory_manager.memory_limit
    if memory is None:
        return limits
    share = memory // worker.state.nthreads >> 20
    return replace(limits, memory_mb=share if limits.memory_mb is None else min(share, limits.memory_mb))
