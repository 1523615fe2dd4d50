"""One turn at a time, given out fairly to those who wait."""

import asyncio
from collections import deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager


class FairTurns:
    """Owners take turns; the requests of one owner are served in the order in which they came.

    All calls must be made in one event loop.
    """

    def __init__(self) -> None:
        self._taken = False
        self._waiting: dict[str, deque[asyncio.Future[None]]] = {}  # by owner; the next to be served comes first

    @asynccontextmanager
    async def turn(self, owner: str) -> AsyncIterator[None]:
        """Wait for the turn of an owner, and hold it during the block."""
        granted: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.setdefault(owner, deque()).append(granted)
        self._serve()
        try:
            await granted
            yield
        finally:
            if granted.done() and not granted.cancelled():  # also where it was cancelled just after it was granted
                self._taken = False
                if more := self._waiting.pop(owner, None):
                    self._waiting[owner] = more  # behind all other owners who wait now
                self._serve()

    def _serve(self) -> None:
        while self._waiting and not self._taken:
            owner, waiting = next(iter(self._waiting.items()))
            if not waiting:
                del self._waiting[owner]
            elif not (granted := waiting.popleft()).done():  # else cancelled while it waited
                self._taken = True
                granted.set_result(None)
