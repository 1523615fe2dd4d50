"""Let owners take fair turns at a bounded number of slots, and wait for the process that uses a slot."""

import asyncio
from collections.abc import AsyncIterator
from concurrent.futures import Future
from contextlib import asynccontextmanager
from typing import TypeVar
from weakref import WeakValueDictionary

from anyio import CancelScope

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
