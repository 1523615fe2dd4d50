"""Run fits in fair turns of their owners: a fit is accepted, then running, then succeeded, failed or cancelled.

The store has the state of every fit. This module has the tasks that wait for their turn or for the engine, the progress
of the fits, and the requests that wait for a change.
"""

import asyncio
import logging
import sqlite3
from collections import Counter
from collections.abc import AsyncIterator, Callable
from concurrent.futures import Future
from contextlib import asynccontextmanager
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple, TypeVar, TypeVarTuple
from weakref import WeakValueDictionary

import prometheus_client
from anyio import CancelScope, move_on_after
from starlette.concurrency import run_in_threadpool

from dsbrdf.engines.engine import NOT_STARTED, Engine, Fault, FitDocument, FitTask, Outcome

from .errors import FitNotFoundError, MeasurementDamagedError
from .log import bind
from .settings import Settings
from .storage.database import in_write_thread, is_passing
from .storage.schema import ROW_DAMAGED, Caller, FitKey, FitRow
from .storage.store import Store
from .wire import from_wire

T = TypeVar("T")


class FairTurns:
    """Limit the work in progress to `count` slots, at which owners alternate.

    Each owner has a queue. Only the first task of each queue waits for a slot, so an owner with many tasks delays
    another owner by only one turn.
    """

    def __init__(self, count: int = 1) -> None:
        self._places = asyncio.Semaphore(count)
        self._queues: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()  # By owner.

    @asynccontextmanager
    async def turn(self, owner: str) -> AsyncIterator[None]:
        """Wait for the turn of an owner, and keep the slot during the block."""
        queue = self._queues.setdefault(owner, asyncio.Lock())
        async with queue:
            await self._places.acquire()
        try:
            yield
        finally:
            self._places.release()


async def result_of(future: "Future[T]") -> T:
    """Await the future of a process; when cancelled, wait for the end of the process, which still uses its slot."""
    try:
        return await asyncio.wrap_future(future)
    except asyncio.CancelledError:
        with CancelScope(shield=True):
            await asyncio.gather(asyncio.wrap_future(future), return_exceptions=True)
        raise


logger = logging.getLogger(__name__)

Values = TypeVarTuple("Values")

_RETRY_DELAY_S = 5.0  # Pause before a failed write, or the failed start of a process, is repeated.
_MIN_POLL_INTERVAL_S = 0.05  # Pause between two readings of the row of a fit that has no task in this process.
_LOST_FIT_DELAY_S = 0.5  # Pause before a lost fit is repeated; a shutdown may end its process before the service.


@dataclass
class _RunningFit:
    """An unfinished fit of this process; its scope cancels the task after calls in threads have returned."""

    task: "asyncio.Task[None]"
    scope: CancelScope
    changed: "asyncio.Future[None]"
    progress: float = 0.0

    def notify(self) -> None:
        """Wake all tasks that wait for a change of this fit."""
        self.changed.set_result(None)
        self.changed = asyncio.get_running_loop().create_future()


class FitMeters(NamedTuple):
    """The Prometheus metrics of fits."""

    waiting: prometheus_client.Histogram
    fitting: prometheus_client.Histogram
    retries: prometheus_client.Counter


class FitQueue:
    """Run fits, and let requests wait for fits or follow their progress."""

    def __init__(self, store: Store, engine: Engine, settings: Settings, meters: FitMeters) -> None:
        self._store = store
        self._engine = engine
        self._turns = FairTurns(settings.workers)
        self._settings = settings
        self._meters = meters
        self._loop = asyncio.get_running_loop()
        self._stopping: asyncio.Future[None] = self._loop.create_future()
        self._running: dict[FitKey, _RunningFit] = {}
        self._followers: Counter[str] = Counter()  # Requests that follow or wait for fits, by owner.

    async def start(self) -> None:
        """Run the fits that an earlier process has left unfinished."""
        for key in await run_in_threadpool(self._store.resume):
            self._begin(key)

    def release_waiters(self) -> None:
        """Answer all requests that wait for fits with the present states, because the service is about to stop."""
        if not self._stopping.done():
            self._stopping.set_result(None)

    async def close(self) -> None:
        """Stop all fits; their rows stay unfinished, so that the next process runs them."""
        self.release_waiters()
        unfinished = list(self._running.values())
        for running in unfinished:
            running.scope.cancel()
        await asyncio.gather(*(running.task for running in unfinished))

    async def submit(
        self, caller: Caller, sha256: str, options: dict[str, Any], name: str | None = None
    ) -> tuple[FitRow, bool]:
        """Accept a fit, or find an equal one; return its stored row, and whether it is new. See `Store.add_fit`."""
        limit = self._settings.queue_limit
        row, new = await in_write_thread(self._store.add_fit, caller, sha256, options, limit, name)
        if new and not self._stopping.done():
            self._begin(row.key)
        return row, new

    async def wait(self, key: FitKey, seconds: float, *ends: "asyncio.Future[None]") -> FitRow:
        """Wait until a fit ends, `seconds` are over or a future in `ends` is done; return the fit's row.

        If an owner already has the maximum number of waiting requests, the row is returned at once.
        """
        with move_on_after(seconds if self.has_room(key.owner) else 0.0):
            async for _ in self.watch(key, *ends, each_step=False):
                pass
        return await run_in_threadpool(self._store.fit, key)

    def progress(self, row: FitRow) -> float:
        """Return the progress of a fit, 0 to 1."""
        if row.status == "succeeded":
            return 1.0
        running = self._running.get(row.key)
        return 0.0 if running is None else running.progress

    async def watch(self, key: FitKey, *ends: "asyncio.Future[None]", each_step: bool = True) -> AsyncIterator[FitRow]:
        """Yield the row of a fit at once, after each step if `each_step`, and at the end of the fit.

        The iteration ends early when the fit is deleted, or a future in `ends` is done.
        """
        self._followers[key.owner] += 1
        ends = self._stopping, *ends
        try:
            while True:
                running = self._running.get(key)
                change = None if running is None else running.changed if each_step else running.task
                row = await run_in_threadpool(self._store.fit, key)
                yield row
                if row.ended or any(map(asyncio.Future.done, ends)):
                    return
                if change is None:  # The fit has no task in this process, so only its row shows a change.
                    await asyncio.sleep(_MIN_POLL_INTERVAL_S)
                else:
                    await asyncio.wait((change, *ends), return_when=asyncio.FIRST_COMPLETED)
        except FitNotFoundError:
            return
        finally:
            self._followers[key.owner] -= 1
            self._followers += Counter()  # Adding an empty counter drops owners whose count is zero.

    def has_room(self, owner: str) -> bool:
        """Return whether another request of an owner may wait; a part of an owner's requests must stay for others."""
        return self._followers[owner] < max(1, self._settings.limit_concurrency // 4)

    async def cancel(self, key: FitKey) -> FitRow | None:
        """Stop an unfinished fit and return its row; None if it has ended already or does not exist."""
        running = self._running.get(key)  # Read first: an equal request may start a new fit after the row changes.
        row = await in_write_thread(self._store.cancel_fit, key)
        if row is not None and running is not None:
            running.scope.cancel()
        return row

    def _begin(self, key: FitKey) -> None:
        previous, scope = self._running.get(key), CancelScope()
        if previous is not None:  # The previous fit has ended in the database, so its task is obsolete.
            previous.scope.cancel()
        task = asyncio.create_task(self._run(key, scope, previous.task if previous else None))
        self._running[key] = running = _RunningFit(task, scope, self._loop.create_future())

        def forget(_: "asyncio.Task[None]") -> None:
            if self._running.get(key) is running:
                del self._running[key]
            running.notify()

        task.add_done_callback(forget)

    async def _run(self, key: FitKey, scope: CancelScope, previous: "asyncio.Task[None] | None") -> None:
        bind("fit", str(key))
        with scope:
            if previous is not None:
                with CancelScope(shield=True):
                    await asyncio.wait([previous])
            try:
                async with self._turns.turn(key.owner):
                    while not await self._attempt(key):
                        pass
            except Exception as error:
                logger.exception("the fit could not be brought to its end")
                message = f"The row of the fit cannot be used: {error}; restore the database from a copy."
                await _write(self._store.fail_fit, key, asdict(Fault("system", ROW_DAMAGED, message)))

    async def _attempt(self, key: FitKey) -> bool:
        """Run a fit once; return False if the fit must run again."""
        row = await _write(self._store.start_fit, key)
        if row is None:
            return True
        if row.error is not None:  # The row is damaged.
            await _write(self._store.fail_fit, key, row.error)
            return True
        self._set_progress(key, 0.0)
        if row.started is not None and row.attempts == 1:
            seconds = max(0.0, row.started - row.created)  # A clock that was set back would give a negative time.
            self._meters.waiting.observe(seconds)
        with self._meters.fitting.time():
            outcome = await self._compute(row)
        if isinstance(outcome, Fault) and outcome.origin == "system":
            await asyncio.sleep(_LOST_FIT_DELAY_S)
            if self._stopping.done():  # The service is stopping; its next start runs the fit.
                return True
            if row.attempts < self._settings.fit_attempts:
                logger.warning("the fit runs again: %s", outcome.message)
                self._meters.retries.inc()
                return False
        await _write(self._record, row.key, outcome)
        return True

    async def _compute(self, row: FitRow) -> Outcome:
        """Check the measurement's file and run the fit of a row; retry while no process can be started."""

        def in_loop(progress: float) -> None:
            self._loop.call_soon_threadsafe(self._set_progress, row.key, progress)

        while True:
            try:
                path = await run_in_threadpool(self._store.sound_file, row.measurement)
                options = from_wire(row.options)
                task = FitTask(str(row.key), path, options, sha256=row.measurement, with_thumbnail=True)
                outcome = await result_of(self._engine.submit(task, in_loop))
                if isinstance(outcome, FitDocument):
                    return outcome
            except MeasurementDamagedError as error:
                return Fault("system", "MeasurementDamaged", error.detail)
            except OSError as error:
                outcome = Fault("system", NOT_STARTED, f"The fit could not be started: {error}.")
            except Exception as error:
                logger.exception("the engine broke")
                message = f"The engine broke with {type(error).__name__}; the log says why."
                return Fault("system", "EngineFailed", message)
            if outcome.type != NOT_STARTED:
                return outcome
            logger.warning("%s Trying again in %g s.", outcome.message, _RETRY_DELAY_S)
            await asyncio.sleep(_RETRY_DELAY_S)

    def _record(self, key: FitKey, outcome: Outcome) -> None:
        if isinstance(outcome, FitDocument):
            self._store.complete_fit(key, outcome.text, outcome.metrics, outcome.thumbnail)
            logger.info("the fit has succeeded")
        else:
            self._store.fail_fit(key, asdict(outcome))
            logger.warning("the fit has failed: %s", outcome.message)

    def _set_progress(self, key: FitKey, progress: float) -> None:
        running = self._running.get(key)
        if running is not None:
            running.progress = progress
            running.notify()


async def _write(write: Callable[[*Values], T], *values: *Values) -> T:
    """Call `write` in a thread, and retry while it fails, so that no computed fit is lost."""
    while True:
        try:
            return await in_write_thread(write, *values)
        except (OSError, sqlite3.DatabaseError) as error:
            if not is_passing(error):
                raise
            logger.warning("the data folder cannot be written to (%s); trying again in %g s", error, _RETRY_DELAY_S)
            await asyncio.sleep(_RETRY_DELAY_S)
