"""A limited number of slots, given out fairly to those who wait."""

import asyncio
from collections import Counter, deque
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager


class FairSlots:
    """Slots of one or several places, each with a capacity that may change at any time.

    Owners take turns; the requests of one owner are served in the order in which they came.

    All calls must be made in one event loop.

    Parameters
    ----------
    capacity : mapping of str to int, optional
        Number of slots of each place.
    """

    def __init__(self, capacity: Mapping[str, int] | None = None) -> None:
        self._capacity = dict(capacity or {})
        self._taken: Counter[str] = Counter()
        self._waiting: dict[str, deque[asyncio.Future[str]]] = {}  # by owner; the next owner to be served comes first

    def resize(self, capacity: Mapping[str, int]) -> None:
        """Change the places and their capacities; a slot of a removed place stays taken until it is released."""
        self._capacity = dict(capacity)
        self._serve()

    @asynccontextmanager
    async def slot(self, owner: str = "") -> AsyncIterator[str]:
        """Wait for a slot, hold it during the block, and yield its place: the one with the most free slots."""
        granted: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(owner, deque()).append(granted)
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
        if self._taken[place] <= 0:
            del self._taken[place]
        self._serve()

    def _serve(self) -> None:
        while self._waiting:
            owner, waiting = next(iter(self._waiting.items()))
            if waiting and waiting[0].done():  # cancelled while it waited
                waiting.popleft()
            elif not waiting:
                del self._waiting[owner]
            else:
                free = {place: count - self._taken[place] for place, count in self._capacity.items()}
                place = max(free, key=free.__getitem__, default=None)
                if place is None or free[place] <= 0:
                    return
                self._taken[place] += 1
                waiting.popleft().set_result(place)
                self._waiting[owner] = self._waiting.pop(owner)  # behind the other owners
