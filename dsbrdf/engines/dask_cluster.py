"""A connection to a Dask cluster that restores itself, and calls of functions on chosen workers.

Every call is bound to one worker and fails when the worker or the scheduler is lost. The caller decides whether to
repeat it, not the scheduler, so that nothing is computed twice unasked. The scheduler drops the calls of a client whose
connection ends, however it ends.
"""

import asyncio
import logging
import multiprocessing
import time
import uuid
from collections import Counter, deque
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import asdict, dataclass, field
from importlib import import_module
from typing import Any

from dsbrdf.engines.engine import OnProgress
from dsbrdf.engines.worker_process import start_fork_server
from dsbrdf.version import versions

TOPIC = "dsbrdf-progress"
"""Dask topic to which workers send the progress of a call, as ``{"key": ..., "share": ...}``."""

# Times in seconds.
_MAX_POLL_INTERVAL = 1.0  # between two queries of the workers while no change is reported
_MIN_POLL_INTERVAL = 0.1  # between two queries of the workers however many changes are reported
_HEARTBEAT_TIMEOUT = 30.0  # without a message, after which a worker or the scheduler counts as lost
_CONNECT_TIMEOUT = 5.0  # of an attempt to connect or to disconnect
_RECONNECT_DELAY = 0.5  # between two attempts to connect
_DESCRIBE_TIMEOUT = 30.0  # for a worker to answer with its versions
_RETRY_DELAY = 15.0  # before a worker that cannot run fits is asked again

logger = logging.getLogger(__name__)


class Slots:
    """Slots of one or several places, each with a capacity that may change at any time.

    All calls must be made in one event loop.
    """

    def __init__(self) -> None:
        self._capacity: dict[str, int] = {}
        self._taken: Counter[str] = Counter()
        self._waiting: deque[asyncio.Future[str]] = deque()

    def resize(self, capacity: Mapping[str, int]) -> None:
        """Change the places and their numbers of slots; one of a removed place stays taken until it is released."""
        self._capacity = dict(capacity)
        self._serve()

    @asynccontextmanager
    async def slot(self) -> AsyncIterator[str]:
        """Wait for a slot, hold it during the block, and yield its place: the one with the most free slots."""
        granted: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._waiting.append(granted)
        self._serve()
        try:
            place = await granted
        except asyncio.CancelledError:
            if granted.done() and not granted.cancelled():  # cancelled just after the slot was granted
                self._release(granted.result())
            raise
        try:
            yield place
        finally:
            self._release(place)

    def _release(self, place: str) -> None:
        self._taken[place] -= 1
        self._serve()

    def _serve(self) -> None:
        while self._waiting:
            free = {place: count - self._taken[place] for place, count in self._capacity.items()}
            place = max(free, key=free.__getitem__, default=None)
            if place is None or free[place] <= 0:
                return
            granted = self._waiting.popleft()
            if not granted.done():  # else cancelled while it waited
                self._taken[place] += 1
                granted.set_result(place)


class LostError(Exception):
    """A call has ended without an answer because its worker or the scheduler is lost; `worker` tells which."""

    def __init__(self, *, worker: bool) -> None:
        super().__init__("the worker is lost" if worker else "the scheduler is lost")
        self.worker = worker


@dataclass
class _Worker:
    """What is known about a worker that the scheduler lists."""

    address: str
    unusable_because: str | None = "has not answered yet with its versions"
    status: str = "running"
    threads: int = 0
    check: "asyncio.Task[None]" = field(init=False)
    _last_seen: float = 0.0  # by the scheduler, on its clock
    _last_change: float = field(default_factory=time.monotonic)  # of `_last_seen`, on this machine's clock

    def update(self, about: dict[str, Any]) -> None:
        """Take over what the scheduler reports."""
        self.status, self.threads = about["status"], about["nthreads"]
        if about["last_seen"] != self._last_seen:
            self._last_seen, self._last_change = about["last_seen"], time.monotonic()

    @property
    def timed_out(self) -> bool:
        """Whether it hangs or cannot be reached, so that its calls may never end."""
        return time.monotonic() - self._last_change > _HEARTBEAT_TIMEOUT

    @property
    def fault(self) -> str | None:
        """Why it cannot be used now; None if it can."""
        if self.timed_out:
            return f"{self.address} has sent nothing for {_HEARTBEAT_TIMEOUT:g} s"
        if self.unusable_because is not None:
            return f"{self.address} {self.unusable_because}"
        return None if self.status == "running" else f"{self.address} is {self.status}"


class Cluster:
    """A Dask cluster and its usable workers; all calls must be made in one event loop.

    The `threads` of the workers are slots by their addresses. There is `room` for as many fits, and for so many more
    that are prepared in advance if some workers are on other machines.
    """

    def __init__(self, address: str, in_advance: int) -> None:
        self.threads, self.room = Slots(), Slots()
        self._address = address
        self._in_advance = in_advance
        self._client: Any = None
        self._host = ""
        self._reason = "it has not been reached yet"
        self._usable: dict[str, int] = {}
        self._workers: dict[str, _Worker] = {}
        self._changed = asyncio.Event()
        self._calls: dict[str, tuple[str, OnProgress, asyncio.Future[None]]] = {}  # with the worker, and its loss

    def fault(self) -> str | None:
        """Return why nothing can be computed now, in one sentence, or None."""
        if self._client is None:
            return f"The Dask scheduler at {self._address} cannot be reached: {self._reason}."
        if not self._workers:
            return f"The Dask cluster at {self._address} has no workers."
        if not self._usable:
            why = "; ".join(sorted(filter(None, (worker.fault for worker in self._workers.values()))))
            return f"The Dask cluster at {self._address} has no worker that can run fits: {why}."
        return None

    async def stay_connected(self) -> None:
        """Stay connected and keep the list of workers up to date, until cancelled."""
        client_of: Any = import_module("distributed").Client  # only partly typed
        options = {"asynchronous": True, "set_as_default": False, "timeout": _CONNECT_TIMEOUT, "name": "dsbrdf"}
        while True:
            client: Any = None
            try:
                client = client_of(self._address, **options)
                await client
                await self._watch_workers(client)
                self._disconnected("the connection was lost")
            except asyncio.CancelledError:
                self._disconnected("the connection was closed")
                raise
            except Exception as error:  # whatever goes wrong with a connection, it is tried again
                no_answer = isinstance(error, TimeoutError) and not str(error)
                reason = f"no answer within {_HEARTBEAT_TIMEOUT:g} s" if no_answer else _first_line(error)
                if reason != self._reason:
                    logger.warning("the Dask scheduler at %s cannot be reached: %s", self._address, reason)
                self._disconnected(reason)
            finally:
                if client is not None:
                    with suppress(TimeoutError):
                        async with asyncio.timeout(_CONNECT_TIMEOUT):
                            await client.close()
            await asyncio.sleep(_RECONNECT_DELAY)

    async def call(self, worker: str, on_progress: OnProgress, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function on one worker; cancelling this call cancels the function's task on the worker.

        Raises LostError if the worker or the scheduler is lost before there is an answer.
        """
        client = self._client
        if client is None or client.status != "running":
            self._disconnected("the connection was lost")
            raise LostError(worker=False)
        key = f"dsbrdf_fit-{uuid.uuid4().hex}"
        lost: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._calls[key] = worker, on_progress, lost
        # The caller decides about retries and other workers.
        future = client.submit(
            function, *arguments, key=key, workers=[worker], allow_other_workers=False, retries=0, pure=False
        )
        answer = asyncio.ensure_future(_answer_of(future))
        try:
            await asyncio.wait([answer, lost], return_when=asyncio.FIRST_COMPLETED)
            if answer.done():
                return answer.result()
            raise LostError(worker=self._client is client)
        finally:
            del self._calls[key]
            answer.cancel()
            future.release()  # tells the worker that the result is not wanted any more

    async def _watch_workers(self, client: Any) -> None:
        """Query the workers at intervals and after every change, until the connection is lost."""
        client.subscribe_topic(TOPIC, self._receive_progress)
        client.subscribe_topic("all", lambda _: self._changed.set())  # reports workers that come and go
        connection = client.scheduler_comm  # if Dask reconnects, it is to a scheduler that does not know our calls
        self._client = client
        self._host = _host(connection.comm.local_address)
        logger.info("connected to the Dask scheduler at %s", self._address)
        while client.status == "running" and client.scheduler_comm is connection:
            self._changed.clear()
            async with asyncio.timeout(_HEARTBEAT_TIMEOUT):
                identity = await client.scheduler.identity(n_workers=-1)
            self._update_workers(client, identity["workers"])
            await asyncio.sleep(_MIN_POLL_INTERVAL)
            with suppress(TimeoutError):
                async with asyncio.timeout(_MAX_POLL_INTERVAL):
                    await self._changed.wait()

    def _update_workers(self, client: Any, workers: dict[str, dict[str, Any]]) -> None:
        for address in self._workers.keys() - workers.keys():
            self._workers.pop(address).check.cancel()
        for address, about in workers.items():
            if address not in self._workers:
                new = self._workers[address] = _Worker(address)
                new.check = asyncio.create_task(self._check(client, new))
            self._workers[address].update(about)
        threads = {address: worker.threads for address, worker in self._workers.items() if worker.fault is None}
        if threads != self._usable:
            self._usable = threads
            self.threads.resize(threads)
            elsewhere = any(_host(worker) != self._host for worker in threads)
            self.room.resize({"cluster": sum(threads.values()) + self._in_advance * elsewhere} if threads else {})
        for address, _, lost in self._calls.values():
            worker = self._workers.get(address)
            if (worker is None or worker.timed_out) and not lost.done():
                lost.set_result(None)

    async def _check(self, client: Any, worker: _Worker) -> None:
        """Find out whether a worker can run fits; repeat until it can."""
        while worker.unusable_because is not None:
            reason = await _unusable_because(client, worker.address)
            if reason is not None and reason != worker.unusable_because:
                logger.warning("a worker of the Dask cluster is not used: %s %s", worker.address, reason)
            worker.unusable_because = reason
            self._changed.set()
            await asyncio.sleep(_RETRY_DELAY)

    def _receive_progress(self, event: tuple[float, dict[str, Any]]) -> None:
        if event[1]["key"] in self._calls:
            _, on_progress, _ = self._calls[event[1]["key"]]
            on_progress(float(event[1]["share"]))

    def _disconnected(self, reason: str) -> None:
        self._client = None
        self._reason = reason
        self._update_workers(None, {})


async def _answer_of(future: Any) -> Any:
    from distributed.client import FutureCancelledError

    try:
        return await future
    except FutureCancelledError:  # by the scheduler, after a restart
        raise LostError(worker=False) from None


def _host(address: str) -> str:
    return address.partition("://")[2].rpartition(":")[0]


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0].rstrip(".") or type(error).__name__


async def _unusable_because(client: Any, worker: str) -> str | None:
    """Return why a worker cannot run fits, or None."""
    try:
        async with asyncio.timeout(_DESCRIBE_TIMEOUT):
            about = (await client.run(describe, workers=[worker]))[worker]
    except TimeoutError:
        return f"has not answered within {_DESCRIBE_TIMEOUT:g} s with its versions"
    except Exception as error:  # whatever is wrong with the worker
        return f"cannot run dsbrdf ({type(error).__name__}: {_first_line(error)})"
    mine = asdict(versions())
    other = [f"{name} {found}, not {mine[name]}" for name, found in about["versions"].items() if found != mine[name]]
    return f"has {' and '.join(other)}" if other else about.get("unusable_because")


_REMEDY = "start it with --no-nanny, or with DASK_DISTRIBUTED__WORKER__DAEMON=false in its environment"


async def describe() -> dict[str, Any]:
    """Return a worker's versions and whether it can run fits; called on the worker."""
    daemon = multiprocessing.current_process().daemon
    if not daemon:  # takes longer than many fits; now the first one need not wait for it
        await asyncio.to_thread(start_fork_server)
    return {
        "versions": asdict(versions()),
        "unusable_because": f"may not start child processes: {_REMEDY}" if daemon else None,
    }
