"""Fits on the workers of a Dask cluster.

The measurement is read and reduced in a worker process of this machine, the fit runs in a child process of a Dask
worker, and only the profiles are sent, some 5 MB, or scattered samples as they are. Dask decides where a fit runs, and
runs it again when its worker is lost; after the loss of the scheduler, all unfinished fits are sent again. Workers need
the same versions of the software as this machine and permission to start child processes; others are not used.

Anyone who can connect to a Dask cluster can run any code on it, unless TLS is set up in Dask's configuration.
"""

import asyncio
import logging
import multiprocessing
import time
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import asdict, replace
from importlib import import_module
from threading import Event, Semaphore, Thread
from typing import Any

from dsbrdf.data.reduction import Profiles
from dsbrdf.data.scattered_samples import ScatteredSamples
from dsbrdf.engines.engine import STOPPED, Fault, FitLimits, FitTask, OnProgress, Outcome, Threads, rising
from dsbrdf.engines.local import complete_report, fit_reduced, reduce_measurement
from dsbrdf.engines.worker_process import run_in_process, start_fork_server
from dsbrdf.extras import require
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.report import FitResult
from dsbrdf.process_settings import core_count
from dsbrdf.version import versions

_TOPIC = "dsbrdf-progress"  # of Dask's, to which workers send the progress of a fit: {"key": ..., "share": ...}
# Times in seconds.
_PROGRESS_INTERVAL = 0.2  # between two messages of a fit; each costs time on three machines
_LOOK_INTERVAL = 0.5  # between two looks at the cluster
_POLL_INTERVAL = 0.1  # between two looks at a fit
_TIMEOUT = 5.0  # for the scheduler to answer
_START_TIMEOUT = 60.0  # for new workers to answer, which start the server of their child processes

logger = logging.getLogger(__name__)


class DaskEngine:
    """Engine whose fits run on a Dask cluster, of which it gets at most `count` at once.

    A `count` above the number of the workers' threads lets them begin the next fit without waiting. The `limits` hold
    for each process, here and there. Raises MissingExtraError if Dask distributed is not installed.
    """

    def __init__(self, scheduler: str, count: int, limits: FitLimits | None = None) -> None:
        require("dask", "distributed", purpose="fits on a Dask cluster")
        self._address = scheduler
        self._limits = limits or FitLimits()
        self._threads = Threads(count)
        self._cores = Semaphore(core_count())  # for what is computed here
        self._client: Any = None
        self._scheduler = ""  # the id of the one that the client is connected to
        self._lost_because = "it has not been reached yet"
        self._workers: dict[str, str | None] = {}  # by address, why it cannot be used; None if it can
        self._progress: dict[str, OnProgress] = {}  # of the fits on the cluster, by Dask's key
        self._closed = Event()
        self._follower = Thread(target=self._follow, name="dsbrdf-cluster")
        self._follower.start()

    def submit(self, task: FitTask, on_progress: OnProgress) -> "Future[Outcome]":
        """Compute a task; when cancelled, the child process on the Dask worker is ended within a second."""
        return self._threads.submit(self._run, task, rising(on_progress))  # a fit that runs again starts from 0

    def check(self) -> None:
        """Raise RuntimeError if the cluster has no worker that can run fits, or no measurement can be read."""
        workers = self._workers
        if self._client is None:
            raise RuntimeError(f"The Dask scheduler at {self._address} cannot be reached: {self._lost_because}.")
        if not workers:
            raise RuntimeError(f"The Dask cluster at {self._address} has no workers.")
        if None not in workers.values():
            why = "; ".join(f"{worker} {reason}" for worker, reason in sorted(workers.items()))
            raise RuntimeError(f"The Dask cluster at {self._address} has no worker that can run fits: {why}.")
        start_fork_server()

    def close(self) -> None:
        """Stop all fits, and disconnect from the cluster."""
        self._threads.close()
        self._closed.set()
        self._follower.join()

    def _run(self, stopped: Event, task: FitTask, on_progress: OnProgress) -> Outcome:
        found: tuple[Profiles | ScatteredSamples, float] | Fault = self._here(stopped, reduce_measurement, task)
        if isinstance(found, Fault):
            return found
        reduced, seconds = found
        fitted: FitResult | Fault = self._fit(stopped, on_progress, reduced, task.options)
        if isinstance(fitted, Fault):
            return fitted
        completed: Outcome = self._here(stopped, complete_report, fitted, task, reduced.sha256, seconds)
        return completed

    def _here(self, stopped: Event, step: Any, *arguments: Any) -> Any:
        with self._cores:
            return run_in_process(step, arguments, self._limits, lambda _: None, stopped.is_set)

    def _fit(
        self, stopped: Event, on_progress: OnProgress, reduced: Profiles | ScatteredSamples, options: FitOptions
    ) -> FitResult | Fault:
        """Fit on the cluster; wait as long as there is none, and send the fit again when all its workers are lost."""
        while not stopped.wait(_POLL_INTERVAL):
            client, workers = self._client, self._usable()
            if not workers or client.status != "running":
                continue
            future = client.submit(
                fit_on_worker, reduced, options, self._limits, workers=[*workers], retries=3, pure=False
            )
            self._progress[future.key] = on_progress
            try:
                seen = time.monotonic()
                while not (future.done() or stopped.is_set()) and client is self._client:
                    if workers & self._usable():
                        seen = time.monotonic()
                    elif time.monotonic() - seen > _TIMEOUT:  # sooner, it may not have been told that the fit has ended
                        break
                    stopped.wait(_POLL_INTERVAL)
                if future.status in ("finished", "error"):
                    return _answer(future)
            finally:
                del self._progress[future.key]
                future.release()  # tells the worker that the result is not wanted any more
        return STOPPED

    def _usable(self) -> set[str]:
        return {address for address, reason in self._workers.items() if reason is None}

    def _follow(self) -> None:
        """Stay connected, and know which workers can run fits, until the engine is closed."""
        while True:
            try:
                self._look()
            except Exception as error:  # whatever goes wrong with a connection, it is tried again
                self._disconnect(str(error).partition("\n")[0].rstrip(".") or type(error).__name__)
            if self._closed.wait(_LOOK_INTERVAL):
                return self._disconnect("the connection was closed")

    def _look(self) -> None:
        if self._client is None:
            distributed: Any = import_module("distributed")  # only partly typed
            # It logs a lost connection with pages of traces.
            logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
            self._client = distributed.Client(self._address, timeout=_TIMEOUT, set_as_default=False, name="dsbrdf")
            self._client.subscribe_topic(_TOPIC, self._receive_progress)
            self._scheduler = self._client.scheduler_info()["id"]
            logger.info("connected to the Dask scheduler at %s", self._address)
        client = self._client
        if client.status != "running":
            raise ConnectionError("the connection was lost")
        about = client.sync(client.scheduler.identity, n_workers=-1, callback_timeout=_TIMEOUT)
        if about["id"] != self._scheduler:  # Dask has connected to another one, which does not know our fits
            raise ConnectionError("it has been started again")
        known = {address: self._workers.get(address, "is new") for address in about["workers"]}
        others = [address for address, reason in known.items() if reason is not None]
        answers: dict[str, Any] = {}
        if others:
            of_run = {"workers": others, "on_error": "return", "callback_timeout": _START_TIMEOUT}
            answers = client.run(unusable_because, asdict(versions()), **of_run)
        for address, answer in answers.items():
            reason = f"cannot run dsbrdf ({answer!r})" if isinstance(answer, Exception) else answer
            if reason is not None and reason != self._workers.get(address):
                logger.warning("a worker of the Dask cluster is not used: %s %s", address, reason)
            known[address] = reason
        self._workers = known

    def _disconnect(self, reason: str) -> None:
        client, self._lost_because = self._client, reason
        self._client, self._workers = None, {}
        if client is not None:
            logger.warning("the Dask scheduler at %s cannot be reached: %s", self._address, reason)
            with suppress(Exception):
                client.close(timeout=_TIMEOUT)

    def _receive_progress(self, event: tuple[float, dict[str, Any]]) -> None:
        on_progress = self._progress.get(event[1]["key"])
        if on_progress is not None:
            on_progress(float(event[1]["share"]))


def _answer(future: Any) -> FitResult | Fault:
    from distributed.scheduler import KilledWorker

    try:
        outcome: FitResult | Fault = future.result()
    except KilledWorker as error:
        count = error.allowed_failures + 1
        message = f"{count} workers of the Dask cluster were lost while they ran this fit."
        return Fault("system", "WorkerLost", message)
    except Exception as error:
        logger.exception("a fit could not run on the Dask cluster")
        return Fault("system", "ClusterFailed", f"The Dask cluster failed: {type(error).__name__}.")
    return outcome


_REMEDY = "start it with --no-nanny, or with DASK_DISTRIBUTED__WORKER__DAEMON=false in its environment"


async def unusable_because(theirs: dict[str, str]) -> str | None:
    """Return why the Dask worker that calls this cannot run fits for who has `theirs`, its versions; None if it can."""
    mine = asdict(versions())
    other = [f"{name} {found}, not {theirs.get(name)}" for name, found in mine.items() if found != theirs.get(name)]
    if other:
        return f"has {' and '.join(other)}"
    if multiprocessing.current_process().daemon:
        return f"may not start child processes: {_REMEDY}"
    await asyncio.to_thread(start_fork_server)  # takes longer than many fits; now the first one need not wait for it
    return None


def fit_on_worker(reduced: Profiles | ScatteredSamples, options: FitOptions, limits: FitLimits) -> FitResult | Fault:
    """Fit what is reduced in a child process of the Dask worker that calls this; end it if the task is cancelled."""
    from distributed import get_worker
    from distributed.core import Status

    worker = get_worker()
    key = worker.get_current_task()

    def stopped() -> bool:
        # Dask does not stop a running task when it is cancelled, its client has gone or the worker closes.
        state = worker.state.tasks.get(key)
        return state is None or state.state != "executing" or worker.status in (Status.closing, Status.closed)

    on_progress = rising(
        lambda share: worker.log_event(_TOPIC, {"key": key, "share": share}), seconds=_PROGRESS_INTERVAL
    )
    memory: int | None = worker.memory_manager.memory_limit
    if memory is not None:  # the fit's share of it: all threads of the worker use it
        share = memory // worker.state.nthreads >> 20
        limits = replace(limits, memory_mb=share if limits.memory_mb is None else min(share, limits.memory_mb))
    outcome: FitResult | Fault = run_in_process(fit_reduced, (reduced, options), limits, on_progress, stopped)
    return outcome
