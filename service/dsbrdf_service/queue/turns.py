"""Fair turns at a bounded number of places, and waiting for the process that uses one."""

import asyncio
from collections.abc import AsyncIterator
from concurrent.futures import Future
from contextlib import asynccontextmanager
from typing import TypeVar
from weakref import WeakValueDictionary

from anyio import CancelScope

T = TypeVar("T")


class FairTurns:
    """A semaphore of `count` places at which owners alternate.

    Each owner has a queue. Only the first of each queue waits for a place, so an owner with much to do delays another
    by one turn.
    """

    def __init__(self, count: int = 1) -> None:
        self._places = asyncio.Semaphore(count)
        self._queues: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()  # By owner.

    @asynccontextmanager
    async def turn(self, owner: str) -> AsyncIterator[None]:
        """Wait for the turn of an owner, and hold it during the block."""
        queue = self._queues.setdefault(owner, asyncio.Lock())
        async with queue:
            await self._places.acquire()
        try:
            yield
        finally:
            self._places.release()


async def result_of(future: "Future[T]") -> T:
    """Await the future of a process; when cancelled, wait for the process to end, which keeps its turn so long."""
    try:
        return await asyncio.wrap_future(future)
    except asyncio.CancelledError:
        with CancelScope(shield=True):
            await asyncio.gather(asyncio.wrap_future(future), return_exceptions=True)
        raise
