"""An engine to test, where its fits run, and waiting for what it does."""

import asyncio
import json
import os
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from functools import wraps
from inspect import isawaitable
from pathlib import Path
from typing import Any, ParamSpec

import pytest

from dsbrdf import FitOptions
from dsbrdf.engines.dask import DaskEngine
from dsbrdf.engines.engine import Engine, FitLimits, FitTask, Outcome
from dsbrdf.engines.local import LocalEngine
from tests.support import endless_fit
from tests.support.dask_cluster import DaskCluster, forked
from tests.support.launcher import ForkedProcess

pytestmark = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks at processes in /proc")

P = ParamSpec("P")
QUICK = FitOptions(method="paper", n_lobes=1, em_iterations=3)
MIDDLE = FitOptions(method="paper", n_lobes=4, em_iterations=100)
SLOW = FitOptions(n_lobes=8, ring_lobes=2)
ENDLESS = endless_fit.OPTIONS
LIMITS = FitLimits(seconds=120.0, memory_mb=4096)
PATIENCE = 120.0


class Stage:
    """An engine to test, and where its fits run."""

    def __init__(self, cluster: DaskCluster | None) -> None:
        self.cluster = cluster

    def engine(self, limits: FitLimits = LIMITS) -> Engine:
        return LocalEngine(1, limits) if self.cluster is None else DaskEngine(self.cluster.address, 1, limits)

    def fitting(self) -> list[int]:
        return forked(os.getpid()) if self.cluster is None else self.cluster.fitting()


@asynccontextmanager
async def started(engine: Engine) -> AsyncIterator[Engine]:
    await engine.start()
    try:
        await ready(engine)
        yield engine
    finally:
        await engine.close()


async def ready(engine: Engine) -> None:
    await until(lambda: fault_of(engine), lambda fault: fault is None)


async def fault_of(engine: Engine) -> str | None:
    try:
        await engine.check()
    except RuntimeError as error:
        return str(error)
    return None


async def until(ask: Callable[[], Any], good: Callable[[Any], bool]) -> Any:
    """Return the first good answer of a function, or of a coroutine function."""
    async with asyncio.timeout(PATIENCE):
        while True:
            answer = ask()
            answer = await answer if isawaitable(answer) else answer
            if good(answer):
                return answer
            await asyncio.sleep(0.02)


async def until_fitting(stage: Stage) -> list[int]:
    found: list[int] = await until(stage.fitting, bool)
    return found


async def until_busy(cluster: DaskCluster) -> ForkedProcess:
    """Return a worker that fits."""
    (worker, *_) = await until(lambda: [worker for worker in cluster.workers if forked(worker.pid)], bool)
    return worker


def in_event_loop(test: Callable[P, Coroutine[Any, Any, None]]) -> Callable[P, None]:
    """Let pytest call a test that is a coroutine, in an event loop of its own."""

    @wraps(test)
    def run_it(*arguments: P.args, **named: P.kwargs) -> None:
        asyncio.run(test(*arguments, **named))

    return run_it


def run(stage: Stage, task: FitTask, limits: FitLimits = LIMITS) -> tuple[Outcome, list[float]]:
    shares: list[float] = []

    async def body() -> Outcome:
        async with started(stage.engine(limits)) as engine:
            return await engine.run(task, shares.append)

    return asyncio.run(body()), shares


def content(document: str) -> Any:
    """A stored fit without its timings."""
    plain = json.loads(document)
    del plain["report"]["timings"]
    return plain
