"""The connection to a Dask cluster, which is kept up, and calls of functions on chosen workers of it.

What becomes of a call is decided here and not by the scheduler, so that nothing is computed twice without anyone
asking for it: every call is bound to one worker, and ends when the worker or the scheduler is lost. The scheduler
forgets the calls of a client whose connection ends, however it ends.
"""

import asyncio
import logging
import multiprocessing
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from dsbrdf.engines.places import Places
from dsbrdf.fit import versions

TOPIC = "dsbrdf-progress"
"""What workers tell the progress of a call under, as ``{"key": ..., "share": ...}``."""

_LOOK = 0.25  # seconds between two looks at who is there
_PATIENCE = 5.0  # seconds until an attempt to connect is given up
_PAUSE = 0.5  # seconds between two attempts
_ANSWER = 15.0  # seconds that a new worker gets to tell what it is

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
        self._present: set[str] = set()
        self._asked: dict[str, asyncio.Task[str | None]] = {}
        self._calls: dict[str, _Call] = {}

    def fault(self) -> str | None:
        """Return why nothing can be computed now, in one sentence, or None."""
        if self._client is None:
            return f"The Dask scheduler at {self._address} cannot be reached: {self._reason}."
        if not self._present:
            return f"The Dask cluster at {self._address} has no workers."
        if not self._usable:
            reasons = {task.result() for task in self._asked.values() if _answered(task)} - {None}
            why = "; ".join(sorted(str(reason) for reason in reasons)) or "they have not told yet what they are"
            return f"The Dask cluster at {self._address} has no worker that can run fits: {why}."
        return None

    async def keep(self) -> None:
        """Stay connected, and know who is there, until this is cancelled."""
        client_of: Any = import_module("distributed").Client  # half of it is typed
        options = {"asynchronous": True, "set_as_default": False, "timeout": _PATIENCE, "name": "dsbrdf"}
        while True:
            client = client_of(self._address, **options)
            try:
                await client
                await self._attend(client)
                self._lose("the connection was lost")
            except Exception as error:  # whatever a connection may meet, it is tried again
                reason = str(error).partition("\n")[0].rstrip(".") or type(error).__name__
                if reason != self._reason:
                    logger.warning("the Dask scheduler at %s cannot be reached: %s", self._address, reason)
                self._lose(reason)
            finally:
                await client.close()
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
        client.subscribe_topic(TOPIC, self._hear)
        self._client = client
        self._host = _host(client.scheduler_comm.comm.local_address)
        logger.info("connected to the Dask scheduler at %s", self._address)
        while client.status == "running":
            workers = (await client.scheduler.identity(n_workers=-1))["workers"]
            self._present = set(workers)
            for address in workers:
                if address not in self._asked:
                    self._asked[address] = asyncio.create_task(_unfit(client, address))
            for address in [address for address in self._asked if address not in workers]:
                self._asked.pop(address).cancel()
            self._use(
                {
                    address: about["nthreads"]
                    for address, about in workers.items()
                    if about["status"] == "running"
                    and _answered(self._asked[address])
                    and self._asked[address].result() is None
                }
            )
            for call in self._calls.values():
                if call.worker not in workers and not call.lost.done():
                    call.lost.set_result(None)
            await asyncio.sleep(_LOOK)

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
        self._present = set()
        for task in self._asked.values():
            task.cancel()
        self._asked.clear()
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


def _answered(task: "asyncio.Task[str | None]") -> bool:
    return task.done() and not task.cancelled()


async def _unfit(client: Any, worker: str) -> str | None:
    """Return why a worker cannot run fits, or None."""
    try:
        async with asyncio.timeout(_ANSWER):
            about = (await client.run(describe, workers=[worker]))[worker]
    except Exception as error:  # whatever is wrong with it
        reason = f"{worker} cannot run dsbrdf ({type(error).__name__}: {error})"
    else:
        mine = versions()
        other = [
            f"{name} {found}, not {mine[name]}" for name, found in about["versions"].items() if found != mine[name]
        ]
        if not other and about["children"]:
            return None
        reason = f"{worker} has {' and '.join(other)}" if other else f"{worker} may not start processes: {_REMEDY}"
    logger.warning("a worker of the Dask cluster is not used: %s", reason)
    return reason


_REMEDY = "start it with --no-nanny, or with DASK_DISTRIBUTED__WORKER__DAEMON=false in its environment"


def describe() -> dict[str, Any]:
    """Tell what a fit's result and its process depend on; called on workers."""
    return {"versions": versions(), "children": not multiprocessing.current_process().daemon}
