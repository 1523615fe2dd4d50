"""A store and a queue of fits, whose engine ends a fit when a test says so."""

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import dsbrdf
from dsbrdf.engines import FitDocument, FitTask, Outcome
from dsbrdf.output import to_json
from dsbrdf_service.http.monitoring import Metrics
from dsbrdf_service.queue import FitQueue
from dsbrdf_service.settings import Settings
from dsbrdf_service.storage.schema import Caller, FitKey, FitRow
from dsbrdf_service.storage.store import Store
from dsbrdf_service.wire import to_wire
from tests.support.random_models import random_model
from tests.support.server import LOCAL, add

OPTIONS = dsbrdf.FitOptions()
MAX_WAIT_S = 60.0


@cache
def stored_text() -> str:
    model = random_model()
    return to_json(model, None, dsbrdf.decompose(model))


class Fit(Future[Outcome]):
    """A fit that can be cancelled while it runs, as those of engines."""

    def cancel(self) -> bool:
        if not self.done():
            self.set_exception(CancelledError())
        return False


class Engine:
    """Ends fits when it may, each with another number as its metrics, so that one can tell which has ended."""

    def __init__(self) -> None:
        self.outcomes: list[Outcome | Exception] = []  # The next calls end with these in place of results.
        self.begun: list[str] = []
        self.holds = True
        self.held: list[tuple[Fit, int]] = []

    def submit(self, task: FitTask, on_progress: Callable[[float], None]) -> Fit:
        self.begun.append(task.fit_id)
        self.held.append((Fit(), len(self.begun)))
        fit = self.held[-1][0]
        if not self.holds:
            self.go_on()
        return fit

    def go_on(self) -> None:
        """End what is held, and all that comes."""
        self.holds = False
        for fit, number in self.held:
            if not fit.done():
                outcome = self.outcomes.pop(0) if self.outcomes else FitDocument(stored_text(), {"run": number})
                fit.set_exception(outcome) if isinstance(outcome, Exception) else fit.set_result(outcome)
        self.held.clear()


class _Slow(NamedTuple):
    """A call that has got to its pause, the end of the pause, and that of the first such call."""

    there: threading.Event
    on: threading.Event
    over: threading.Event


class Race:
    """A store with one measurement, and a queue of fits on it."""

    workers = 1

    def __init__(self, folder: Path) -> None:
        self.store = Store(folder)
        self.engine: Any = Engine()
        self.measurement = add(self.store)
        self.begin()

    def begin(self) -> None:
        self.meters = Metrics().fit_meters
        self.queue = FitQueue(self.store, self.engine, Settings(workers=self.workers), self.meters)

    async def submit(self, caller: Caller = LOCAL, options: dsbrdf.FitOptions = OPTIONS) -> FitKey:
        row, _ = await self.queue.submit(caller, self.measurement, to_wire(options))
        return row.key

    async def until_it_runs(self) -> None:
        await until(lambda: bool(self.engine.begun))

    async def end(self, key: FitKey) -> FitRow:
        self.engine.go_on()
        return await self.queue.wait(key, MAX_WAIT_S)

    def slow_down(self, monkeypatch: pytest.MonkeyPatch, name: str, *pauses: float, after: bool = False) -> _Slow:
        """Make calls of the store pause, one after the other, before they work or after it."""
        original = getattr(self.store, name)
        slow = _Slow(threading.Event(), threading.Event(), threading.Event())
        rest = iter(pauses)

        def work(*arguments: Any) -> Any:
            answer = original(*arguments) if after else None
            slow.there.set()
            slow.on.wait(next(rest, 0.0))
            answer = answer if after else original(*arguments)
            slow.over.set()
            return answer

        monkeypatch.setattr(self.store, name, work)
        return slow


async def until(happened: Callable[[], bool]) -> None:
    async with asyncio.timeout(MAX_WAIT_S):
        while not happened():
            await asyncio.sleep(0.001)
