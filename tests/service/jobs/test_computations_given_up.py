"""A computation that is given up while it waits for its turn, and the same one that is asked for at that moment."""

import asyncio
import threading

import pytest
from starlette.requests import ClientDisconnect, Request
from starlette.types import Message

from dsbrdf.engines.engine import FitLimits
from service.access.authentication import CALLER_NAME
from service.jobs.computations import Computations

pytestmark = pytest.mark.anyio

PATIENCE = 60.0  # seconds


class Client:
    """A client that leaves when it is told to."""

    def __init__(self) -> None:
        self.leaves = asyncio.Event()
        self.request = Request({"type": "http", "method": "GET", CALLER_NAME: "key one"}, self._receive)

    async def _receive(self) -> Message:
        await self.leaves.wait()
        return {"type": "http.disconnect"}


async def test_end_of_a_computation_that_was_given_up_leaves_the_next_one_shared() -> None:
    computed: list[str] = []
    busy = threading.Event()

    computations = Computations(FitLimits(10.0, 1024))

    async def ask(client: Client, name: str, steps: int = 0) -> None:
        for _ in range(steps):
            await asyncio.sleep(0)
        compute = busy.wait if name == "busy" else lambda: computed.append(name)
        await computations.run(client.request, name, compute, {})

    first = Client()
    before, given_up = asyncio.create_task(ask(Client(), "busy")), asyncio.create_task(ask(first, "values"))
    await asyncio.sleep(0)
    first.leaves.set()
    with pytest.raises(ClientDisconnect):
        await given_up
    # The third comes when the task of the first has ended, the second at once: before its next step.
    third = asyncio.create_task(ask(Client(), "values", steps=10))
    asyncio.get_running_loop().call_later(0.1, busy.set)
    async with asyncio.timeout(PATIENCE):
        await ask(Client(), "values")
        await asyncio.gather(before, third)
    await computations.close()
    assert computed == ["values"]
