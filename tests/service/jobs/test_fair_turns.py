"""Turns: owners alternate, one at a time, and who gives up costs nobody a turn."""

import asyncio

import pytest

from service.jobs.computations import FairTurns

pytestmark = pytest.mark.anyio


async def test_owners_take_turns_and_the_requests_of_one_come_in_order() -> None:
    turns, served = FairTurns(), list[str]()

    async def take(owner: str, number: int) -> None:
        async with turns.turn(owner):
            assert len(served) == len(over)
            served.append(f"{owner}{number}")
            await asyncio.sleep(0)
            over.append(None)

    over: list[None] = []
    waiting = [("a", 0), ("a", 1), ("a", 2), ("b", 0), ("b", 1), ("c", 0)]
    await asyncio.gather(*(take(*who) for who in waiting))
    assert served == ["a0", "b0", "c0", "a1", "b1", "a2"]


async def test_turn_of_a_cancelled_waiter_goes_to_the_next() -> None:
    turns = FairTurns()

    async def take() -> None:
        async with turns.turn("a"):
            await asyncio.sleep(0)

    async with turns.turn("a"):
        waits, granted = asyncio.create_task(take()), asyncio.create_task(take())
        await asyncio.sleep(0)
        waits.cancel()  # while it waits
    granted.cancel()  # it has been given the turn, and has not run since
    await asyncio.wait([waits, granted])
    await asyncio.wait_for(take(), 1.0)
