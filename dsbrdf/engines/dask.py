"""Run fits on the workers of a Dask cluster.

A process of this machine reads the measurement, reduces it to profiles, and completes the report. The fit runs in a
child process of a Dask worker. Only the profiles (5 MB) or the scattered samples are sent to the worker. Dask chooses
the worker of a fit, and runs the fit again if the worker is lost. If the scheduler is lost, this machine sends the fit
again. A worker is used only if its software has the same versions as here and it may start child processes.

Anyone who can connect to a Dask cluster can run any code there, unless TLS is set up in Dask's configuration.
"""

import asyncio
import logging
import multiprocessing
import time
from collections.abc import AsyncIterator
from concurrent.futures import CancelledError, Future, wait
from contextlib import asynccontextmanager, closing, suppress
from dataclasses import asdict, replace
from importlib import import_module
from typing import Any

from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import Profiles
from dsbrdf.engines.engine import MIN_FIT_MEMORY_MB, NO_LIMITS, Fault, FitLimits, FitTask, OnProgress, Outcome
from dsbrdf.engines.local import Processes, document_of, fit_quietly, measurement_of, preload, start_fork_server
from dsbrdf.extras import require
from dsbrdf.fitting.options import FitOptions
from dsbrdf.pipeline import add_sample_metrics, profiles_for
from dsbrdf.result import FitResult
from dsbrdf.samples.scattered_samples import ScatteredSamples
from dsbrdf.version import versions

# Workers publish the progress of fits, as {key of the fit: completed fraction}, under this topic of Dask.
_PROGRESS_TOPIC = "dsbrdf-progress"
_CANCEL_POLL_INTERVAL_S = 0.1  # A worker checks at this interval whether its fit has been cancelled.
_CLUSTER_POLL_INTERVAL_S = 0.5
_SCHEDULER_TIMEOUT_S = 2.5
_START_TIMEOUT_S = 60.0  # The cluster counts as unreachable if the fork server of a worker takes longer to start.
_CLUSTER_CHECK_LIFETIME_S = 5.0  # After a successful check, the cluster counts as usable for this time.
_LOST_WORKER_TIMEOUT_S = 5.0  # If all workers are lost, the scheduler has this time to report how the fit ended.

logger = logging.getLogger(__name__)


class DaskEngine(Processes):
    """Run fits on a Dask cluster, which receives at most `count` fits at once.

    If `count` exceeds the number of threads of all workers, a worker can begin its next fit without waiting. The
    `limits` apply to the child processes of the workers. Raises MissingExtraError if Dask distributed is not installed.
    """

    def __init__(self, scheduler: str, count: int, limits: FitLimits = NO_LIMITS) -> None:
        require("dask", "distributed", purpose="fits on a Dask cluster")
        preload("distributed")
        super().__init__(count)  # The processes of this machine have no time limit, because they wait for the cluster.
        self._scheduler, self._fit_limits = scheduler, limits
        self._good_at = float("-inf")

    def submit(self, task: FitTask, on_progress: OnProgress) -> "Future[Outcome]":
        """Compute a task; after `Future.cancel`, the child process on the Dask worker ends within a second."""
        return self.call(compute_on_cluster, task, self._scheduler, self._fit_limits, on_progress=on_progress)

    def check(self) -> None:
        """Raise OSError if the cluster has no usable worker, or if this machine cannot start processes."""
        if time.monotonic() - self._good_at > _CLUSTER_CHECK_LIFETIME_S:
            asyncio.run(_try(self._scheduler))
            self._good_at = time.monotonic()
        super().check()


@asynccontextmanager
async def _cluster(scheduler: str) -> AsyncIterator[tuple[Any, set[str]]]:
    """Connect to a cluster; yield the client and the addresses of the usable workers, at least one of them."""
    distributed: Any = import_module("distributed")  # The type annotations of `distributed` are incomplete.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # Dask logs every lost connection with long tracebacks.
    client = distributed.Client(
        scheduler, timeout=_SCHEDULER_TIMEOUT_S, asynchronous=True, set_as_default=False, name="dsbrdf"
    )
    try:
        yield client, await _usable(client, scheduler)
    finally:
        with suppress(Exception):
            await client.close(timeout=_SCHEDULER_TIMEOUT_S)


async def _usable(client: Any, scheduler: str) -> set[str]:
    """Connect the client, and return the addresses of the workers that can run fits."""
    try:
        # Without a time limit, Dask would wait for ever for a scheduler that hangs.
        async with asyncio.timeout(2 * _SCHEDULER_TIMEOUT_S):
            await client
        async with asyncio.timeout(_START_TIMEOUT_S):
            answers = await client.run(unusable_because, asdict(versions()), on_error="return")
    except Exception as error:
        reason = str(error).partition("\n")[0].rstrip(".") or type(error).__name__
        raise ConnectionError(f"The Dask scheduler at {scheduler} cannot be reached: {reason}.") from error
    if not answers:
        raise ConnectionError(f"The Dask cluster at {scheduler} has no workers.")
    why = "; ".join(
        f"{worker} {f'cannot run dsbrdf ({answer!r})' if isinstance(answer, Exception) else answer}"
        for worker, answer in sorted(answers.items())
        if answer is not None
    )
    usable = {worker for worker, answer in answers.items() if answer is None}
    if not usable:
        raise ConnectionError(f"The Dask cluster at {scheduler} has no worker that can run fits: {why}.")
    if why:
        logger.info("not all workers of the Dask cluster are used: %s", why)
    return usable


async def _try(scheduler: str) -> None:
    async with _cluster(scheduler):
        pass


def compute_on_cluster(task: FitTask, scheduler: str, limits: FitLimits, on_progress: OnProgress) -> Outcome:
    """Fit the measurement of a task on a cluster; wait while no cluster can be reached."""
    measurement = measurement_of(task)
    begin = time.perf_counter()
    reduced = profiles_for(measurement, task.options) if isinstance(measurement, Measurement) else measurement
    seconds = time.perf_counter() - begin
    while (result := asyncio.run(_fit(reduced, task.options, scheduler, limits, on_progress))) is None:
        time.sleep(_CLUSTER_POLL_INTERVAL_S)
    if isinstance(result, Fault):
        return result
    if isinstance(measurement, Measurement):
        timings = result.report.timings | {"profiles": seconds}
        result = add_sample_metrics(replace(result, report=replace(result.report, timings=timings)), measurement)
    return document_of(result, measurement if task.with_thumbnail else None)


async def _fit(
    reduced: Profiles | ScatteredSamples,
    options: FitOptions,
    scheduler: str,
    limits: FitLimits,
    on_progress: OnProgress,
) -> FitResult | Fault | None:
    """Fit on a cluster; return None if no cluster can be reached, or if its scheduler or all its workers are lost."""
    try:
        async with _cluster(scheduler) as (client, workers):
            fit = client.submit(fit_on_worker, reduced, options, limits, workers=[*workers], retries=3, pure=False)
            client.subscribe_topic(_PROGRESS_TOPIC, lambda event: on_progress(event[1].get(fit.key, 0.0)))
            answer = asyncio.create_task(_answer(fit))
            while not (await asyncio.wait([answer], timeout=_CLUSTER_POLL_INTERVAL_S))[0]:
                if not workers & (await client.scheduler.identity(n_workers=-1))["workers"].keys():
                    await asyncio.wait([answer], timeout=_LOST_WORKER_TIMEOUT_S)
                    break
            return answer.result() if answer.done() else None
    except (CancelledError, OSError) as error:
        logger.info("a fit is sent again: %r", error)
    return None


async def _answer(future: Any) -> FitResult | Fault:
    from distributed import KilledWorker

    try:
        return await future
    except KilledWorker as error:
        count = error.allowed_failures + 1
        return Fault("system", "WorkerLost", f"{count} workers of the Dask cluster were lost while they ran this fit.")
    except CancelledError:  # The scheduler is lost, and the caller of this function sends the fit again.
        raise
    except Exception as error:
        logger.exception("a fit could not run on the Dask cluster")
        return Fault("system", "ClusterFailed", f"The Dask cluster failed: {type(error).__name__}.")


_REMEDY = "start it with --no-nanny, or with DASK_DISTRIBUTED__WORKER__DAEMON=false in its environment"


async def unusable_because(theirs: dict[str, str], dask_worker: Any) -> str | None:
    """Return why this Dask worker cannot run fits of a client with the software versions `theirs`, or None if it can.

    Dask's method `Client.run` adds the argument `dask_worker`.
    """
    mine = asdict(versions())
    other = [f"{name} {found}, not {theirs.get(name)}" for name, found in mine.items() if found != theirs.get(name)]
    if other:
        return f"has {' and '.join(other)}"
    if multiprocessing.current_process().daemon:
        return f"may not start child processes: {_REMEDY}"
    memory = _memory_of_fit(dask_worker)
    if memory is not None and memory < MIN_FIT_MEMORY_MB:
        return f"has {memory} MB for a fit, which needs {MIN_FIT_MEMORY_MB} MB: start it with a higher --memory-limit"
    await asyncio.to_thread(start_fork_server)  # Starting the fork server now lets the first fit start sooner.
    return None


def _memory_of_fit(worker: Any) -> int | None:
    """Return the memory limit of a fit [MB]: the Dask worker's limit divided by its number of threads, or None."""
    memory: int | None = worker.memory_manager.memory_limit
    return None if memory is None else memory // worker.state.nthreads >> 20


def fit_on_worker(reduced: Profiles | ScatteredSamples, options: FitOptions, limits: FitLimits) -> FitResult | Fault:
    """Fit profiles or samples in a child process of this Dask worker; end the process if the fit is cancelled."""
    from distributed import get_worker
    from distributed.core import Status

    worker = get_worker()
    key = worker.get_current_task()

    def stopped() -> bool:
        # Dask itself does not stop a running task if the task is cancelled, its client is lost or the worker closes.
        state = worker.state.tasks.get(key)
        return state is None or state.state != "executing" or worker.status in (Status.closing, Status.closed)

    memory = _memory_of_fit(worker)
    if memory is not None:
        limits = replace(limits, memory_mb=memory if limits.memory_mb is None else min(memory, limits.memory_mb))
    with closing(Processes(1, limits)) as here:
        fit = here.call(
            fit_quietly, reduced, options, on_progress=lambda share: worker.log_event(_PROGRESS_TOPIC, {key: share})
        )
        while not wait([fit], _CANCEL_POLL_INTERVAL_S).done:
            if stopped():
                fit.cancel()
    return fit.result()
