"""The connection to a Dask cluster, which is kept up, and calls of functions on chosen workers of it.

What becomes of a call is decided here and not by the scheduler, so that nothing is computed twice without anyone
asking for it: every call is bound to one worker, and ends when the worker or the scheduler is lost. The scheduler
forgets the calls of a client whose connection ends, however it ends.
"""

import asyncio
import logging
import multiprocessing
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from dsbrdf.engines.fair_slots import Places
from dsbrdf.engines.worker_process import start_fork_server
from dsbrdf.version import versions

TOPIC = "dsbrdf-progress"
"""What workers tell the progress of a call under, as ``{"key": ..., "share": ...}``."""

_LOOK = 1.0  # seconds between two looks at who is there, while nothing is heard of a change
_CALM = 0.1  # seconds between two looks, whatever is heard
_SILENCE = 30.0  # seconds without a word after which a worker, or the scheduler, counts as lost
_PATIENCE = 5.0  # seconds until an attempt to connect, or to leave, is given up
_PAUSE = 0.5  # seconds between two attempts
_ANSWER = 30.0  # seconds that a worker gets to tell what it is
_AGAIN = 15.0  # seconds until a worker that cannot run fits is asked once more

logger = logging.getLogger(__name__)


class LostError(Exception):
    """A call has ended without an answer because its worker, or the scheduler, is gone.

    Attributes
    ----------
    worker : bool
        Whether it was the worker alone.
    """

    def __init__(self, *, worker: bool) -> None:
        super().__init__("the worker is gone" if worker else "the scheduler is gone")
        self.worker = worker


@dataclass(frozen=True)
class _Call:
    worker: str
    tell: Callable[[float], None]
    lost: "asyncio.Future[None]"


@dataclass
class _Worker:
    """What is known of a worker that the scheduler names."""

    address: str
    unfit: str | None = "has not told yet what it is"
    status: str = "running"
    threads: int = 0
    asking: "asyncio.Task[None] | None" = None
    _seen: float = 0.0  # when the scheduler has heard of it, by the scheduler's clock
    _heard: float = field(default_factory=time.monotonic)  # when that was news, by the clock here

    def see(self, about: dict[str, Any]) -> None:
        """Take what the scheduler tells."""
        self.status, self.threads = about["status"], about["nthreads"]
        if about["last_seen"] != self._seen:
            self._seen, self._heard = about["last_seen"], time.monotonic()

    @property
    def silent(self) -> bool:
        """Whether it hangs, or its machine is away: what runs there may never end."""
        return time.monotonic() - self._heard > _SILENCE

    @property
    def fault(self) -> str | None:
        """Why it cannot be used now."""
        if self.silent:
            return f"{self.address} has not been heard of for {_SILENCE:g} s"
        if self.unfit is not None:
            return f"{self.address} {self.unfit}"
        return None if self.status == "running" else f"{self.address} is {self.status}"


class Cluster:
    """A Dask cluster as its user sees it; all calls belong into one event loop.

    Parameters
    ----------
    address : str
        Of the scheduler.
    on_size : callable
        Called with the number of threads that can be used, and whether some are of other machines, whenever that
        changes.

    Attributes
    ----------
    threads : Places
        Threads of the workers that can be used, by their addresses.
    """

    def __init__(self, address: str, on_size: Callable[[int, bool], None]) -> None:
        self.threads = Places()
        self._address = address
        self._on_size = on_size
        self._client: Any = None
        self._host = ""
        self._reason = "it has not been reached yet"
        self._usable: dict[str, int] = {}
        self._workers: dict[str, _Worker] = {}
        self._changed = asyncio.Event()
        self._calls: dict[str, _Call] = {}

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

    async def keep(self) -> None:
        """Stay connected, and know who is there, until this is cancelled."""
        client_of: Any = import_module("distributed").Client  # half of it is typed
        options = {"asynchronous": True, "set_as_default": False, "timeout": _PATIENCE, "name": "dsbrdf"}
        while True:
            client: Any = None
            try:
                client = client_of(self._address, **options)
                await client
                await self._attend(client)
                self._lose("the connection was lost")
            except Exception as error:  # whatever a connection may meet, it is tried again
                silent = isinstance(error, TimeoutError) and not str(error)
                reason = f"no answer within {_SILENCE:g} s" if silent else _sentence(error)
                if reason != self._reason:
                    logger.warning("the Dask scheduler at %s cannot be reached: %s", self._address, reason)
                self._lose(reason)
            finally:
                with suppress(TimeoutError):
                    async with asyncio.timeout(_PATIENCE):
                        await _closed(client)
            await asyncio.sleep(_PAUSE)

    async def call(self, worker: str, tell: Callable[[float], None], function: Callable[..., Any], *given: Any) -> Any:
        """Call a function on one worker; cancelling this stops the call there.

        Raises
        ------
        LostError
            If the worker or the scheduler is gone before there is an answer.
        """
        client = self._client
        if client is None or client.status != "running":
            self._lose("the connection was lost")
            raise LostError(worker=False)
        key = f"dsbrdf_fit-{uuid.uuid4().hex}"
        lost = asyncio.get_running_loop().create_future()
        self._calls[key] = _Call(worker, tell, lost)
        # Retries and other workers are up to the caller.
        future = client.submit(
            function, *given, key=key, workers=[worker], allow_other_workers=False, retries=0, pure=False
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
            future.release()  # nobody wants it any more: the worker hears of it

    async def _attend(self, client: Any) -> None:
        """Look who is there whenever something has changed, until the connection is lost."""
        client.subscribe_topic(TOPIC, self._hear)
        client.subscribe_topic("all", lambda _: self._changed.set())  # who comes and goes is told there
        connection = client.scheduler_comm  # Dask would make another one, to a scheduler that knows nothing of us
        self._client = client
        self._host = _host(connection.comm.local_address)
        logger.info("connected to the Dask scheduler at %s", self._address)
        while client.status == "running" and client.scheduler_comm is connection:
            self._changed.clear()
            async with asyncio.timeout(_SILENCE):
                identity = await client.scheduler.identity(n_workers=-1)
            self._see(client, identity["workers"])
            await asyncio.sleep(_CALM)
            with suppress(TimeoutError):
                async with asyncio.timeout(_LOOK):
                    await self._changed.wait()

    def _see(self, client: Any, workers: dict[str, dict[str, Any]]) -> None:
        for address in self._workers.keys() - workers.keys():
            _forget(self._workers.pop(address))
        for address, about in workers.items():
            if address not in self._workers:
                new = self._workers[address] = _Worker(address)
                new.asking = asyncio.create_task(self._ask(client, new))
            self._workers[address].see(about)
        self._use({address: worker.threads for address, worker in self._workers.items() if worker.fault is None})
        for call in self._calls.values():
            worker = self._workers.get(call.worker)
            if (worker is None or worker.silent) and not call.lost.done():
                call.lost.set_result(None)

    async def _ask(self, client: Any, worker: _Worker) -> None:
        """Find out whether a worker can run fits, again and again until it can."""
        while worker.unfit is not None:
            unfit = await _unfit(client, worker.address)
            if unfit is not None and unfit != worker.unfit:
                logger.warning("a worker of the Dask cluster is not used: %s %s", worker.address, unfit)
            worker.unfit = unfit
            self._changed.set()
            await asyncio.sleep(_AGAIN)

    def _use(self, threads: dict[str, int]) -> None:
        if threads != self._usable:
            self._usable = threads
            self.threads.resize(threads)
            self._on_size(sum(threads.values()), any(_host(worker) != self._host for worker in threads))

    def _hear(self, event: tuple[float, dict[str, Any]]) -> None:
        call = self._calls.get(event[1]["key"])
        if call is not None:
            call.tell(float(event[1]["share"]))

    def _lose(self, reason: str) -> None:
        self._client = None
        self._reason = reason
        for worker in self._workers.values():
            _forget(worker)
        self._workers.clear()
        self._use({})
        for call in self._calls.values():
            if not call.lost.done():
                call.lost.set_result(None)


async def _answer_of(future: Any) -> Any:
    from distributed.client import FutureCancelledError

    try:
        return await future
    except FutureCancelledError:  # by the scheduler, because it lost what it knew
        raise LostError(worker=False) from None


def _host(address: str) -> str:
    return address.partition("://")[2].rpartition(":")[0]


def _sentence(error: Exception) -> str:
    return str(error).partition("\n")[0].rstrip(".") or type(error).__name__


def _forget(worker: _Worker) -> None:
    if worker.asking is not None:
        worker.asking.cancel()


async def _closed(client: Any) -> None:
    if client is not None:
        await client.close()


async def _unfit(client: Any, worker: str) -> str | None:
    """Return why a worker cannot run fits, or None."""
    try:
        async with asyncio.timeout(_ANSWER):
            about = (await client.run(describe, workers=[worker]))[worker]
    except TimeoutError:
        return f"has not told within {_ANSWER:g} s what it is"
    except Exception as error:  # whatever is wrong with it
        return f"cannot run dsbrdf ({type(error).__name__}: {_sentence(error)})"
    mine = versions()
    other = [f"{name} {found}, not {mine[name]}" for name, found in about["versions"].items() if found != mine[name]]
    return f"has {' and '.join(other)}" if other else about.get("unfit")


_REMEDY = "start it with --no-nanny, or with DASK_DISTRIBUTED__WORKER__DAEMON=false in its environment"


async def describe() -> dict[str, Any]:
    """Tell what a fit's result and its process depend on; called on workers.

    What processes are forked from is started, too: that takes longer than many a fit, which need not wait for it then.
    """
    daemon = multiprocessing.current_process().daemon
    if not daemon:
        await asyncio.to_thread(start_fork_server)
    return {"versions": versions(), "unfit": f"may not start processes: {_REMEDY}" if daemon else None}
