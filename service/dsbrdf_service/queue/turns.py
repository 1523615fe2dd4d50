"""Turns at what only so many can do at once, and the end of what was begun in one."""

import asyncio
from collections.abc import AsyncIterator
from concurrent.futures import Future
from contextlib import asynccontextmanager
from typing import TypeVar
from weakref import WeakValueDictionary

from anyio import CancelScope

T = TypeVar("T")


class FairTurns:
    """At most `count` turns at once; owners alternate, and each is served in the order it came.

    Of each owner one waits among those of all owners, who are served in their order; the others wait behind it.
    """

    def __init__(self, count: int = 1) -> None:
        self._places = asyncio.Semaphore(count)
        self._queues: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()  # by owner, while one waits

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
    """Await a process; when cancelled, return after its end, so that its turn is not given away before."""
    try:
        return await asyncio.wrap_future(future)
    except asyncio.CancelledError:
        with CancelScope(shield=True):
            await asyncio.gather(asyncio.wrap_future(future), return_exceptions=True)
        raise
