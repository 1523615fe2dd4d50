"""Slots: in order, at the emptiest place, and safe under cancellation."""

import asyncio

import pytest

from dsbrdf.engines.slots import Slots


def test_slots_are_given_in_order_and_at_the_emptiest_place() -> None:
    async def body() -> None:
        places = Slots()
        places.resize({"a": 2, "b": 1})
        taken: list[str] = []
        go = asyncio.Event()

        async def take(number: int) -> None:
            async with places.slot() as place:
                taken.append(f"{number}{place}")
                await go.wait()

        tasks = [asyncio.create_task(take(number)) for number in range(6)]
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert taken == ["0a", "1a", "2b"]
        tasks[3].cancel()
        places.resize({"c": 1})
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert taken[3:] == ["4c"]
        go.set()
        await asyncio.wait(tasks)
        assert taken[4:] == ["5c"]
        places.resize({})
        with pytest.raises(asyncio.TimeoutError):
            await asyncio.wait_for(take(9), 0.01)

    asyncio.run(body())


def test_slot_of_a_cancelled_waiter_goes_to_the_next() -> None:
    async def body() -> None:
        places = Slots()
        places.resize({"a": 1})

        async def take() -> None:
            async with places.slot():
                await asyncio.sleep(0)

        async with places.slot():
            waiting = asyncio.create_task(take())
            await asyncio.sleep(0)
        waiting.cancel()  # it has been given the place, and has not run since
        await asyncio.wait([waiting])
        await asyncio.wait_for(take(), 1.0)

    asyncio.run(body())
