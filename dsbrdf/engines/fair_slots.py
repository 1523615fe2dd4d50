"""Turns at places that take only so many at once."""

import asyncio
from collections import Counter, deque
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager


class Places:
    """Places with a capacity each, which may change at any time.

    Those who wait for somebody are served in turns with those who wait for somebody else, and who of them comes first
    is served first.

    All calls belong into one event loop.

    Parameters
    ----------
    capacity : mapping of str to int, optional
        How many each place takes.
    """

    def __init__(self, capacity: Mapping[str, int] | None = None) -> None:
        self._capacity = dict(capacity or {})
        self._taken: Counter[str] = Counter()
        self._waiting: dict[str, deque[asyncio.Future[str]]] = {}  # in the order of their turns

    def resize(self, capacity: Mapping[str, int]) -> None:
        """Change places and capacities; who holds a place that is gone keeps the hold until it ends."""
        self._capacity = dict(capacity)
        self._serve()

    @asynccontextmanager
    async def one(self, whose: str = "") -> AsyncIterator[str]:
        """Wait for a place on behalf of somebody and hold it during the block; the emptiest is taken."""
        turn: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(whose, deque()).append(turn)
        self._serve()
        try:
            place = await turn
        except asyncio.CancelledError:
            if turn.done() and not turn.cancelled():  # it was given in the same moment
                self._give_back(turn.result())
            raise
        try:
            yield place
        finally:
            self._give_back(place)

    def _give_back(self, place: str) -> None:
        self._taken[place] -= 1
        if self._taken[place] <= 0:
            del self._taken[place]
        self._serve()

    def _serve(self) -> None:
        while self._waiting:
            whose, waiting = next(iter(self._waiting.items()))
            if waiting and waiting[0].done():  # cancelled while it waited
                waiting.popleft()
            elif not waiting:
                del self._waiting[whose]
            else:
                free = {place: count - self._taken[place] for place, count in self._capacity.items()}
                place = max(free, key=free.__getitem__, default=None)
                if place is None or free[place] <= 0:
                    return
                self._taken[place] += 1
                waiting.popleft().set_result(place)
                self._waiting[whose] = self._waiting.pop(whose)  # behind the others
