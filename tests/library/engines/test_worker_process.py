import asyncio
import os
import platform
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import forkserver
from threading import current_thread, main_thread
from typing import Any

import pytest

from dsbrdf.engines.dask_cluster import Slots
from dsbrdf.engines.engine import Fault, FitLimits, OnProgress
from dsbrdf.engines.worker_process import run_in_process
from tests.support.crashing_tasks import die, do_nothing, fill_and_free, nice_value
from tests.support.engines import in_event_loop

pytestmark = pytest.mark.slow


def run_alone(step: Callable[[OnProgress], Any], niceness: int = 0) -> Any:
    return run_in_process(step, (), FitLimits(niceness=niceness), lambda _: None, lambda: True)


def test_exit_status_is_known_while_other_processes_start(monkeypatch: pytest.MonkeyPatch) -> None:
    read = forkserver.read_signed

    def read_slowly(descriptor: int) -> int:
        if current_thread() is not main_thread():  # the one that waits for the end comes to read it late
            time.sleep(0.2)
        number: int = read(descriptor)
        return number

    monkeypatch.setattr(forkserver, "read_signed", read_slowly)
    for _ in range(4):
        with ThreadPoolExecutor(1) as pool:
            lost = pool.submit(run_alone, die)
            while not lost.done():
                assert run_alone(do_nothing) is None
        assert lost.result() == Fault("system", "ProcessLost", "The fit's process was ended from outside (SIGKILL).")


@pytest.mark.skipif(not hasattr(os, "nice"), reason="the system has no nice values")
def test_a_process_gives_way_as_its_limits_say() -> None:
    assert run_alone(nice_value, 3) == os.nice(0) + 3


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries have a way of their own with memory")
def test_freed_memory_is_reused() -> None:
    pages = run_alone(fill_and_free)
    assert 0 < pages < 10_000  # given back each time, it would be 51,200


@in_event_loop
async def test_slots_are_given_in_order_and_at_the_emptiest_place() -> None:
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


@in_event_loop
async def test_slot_of_a_cancelled_waiter_goes_to_the_next() -> None:
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
