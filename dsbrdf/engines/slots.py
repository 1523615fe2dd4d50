"""A limited number of slots at places whose number and size may change, given out in order to those who wait."""

import asyncio
from collections import Counter, deque
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager


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
