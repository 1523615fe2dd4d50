"""The application in this process, whose computations a test stops, and a queue whose fits end when a test says so."""

import asyncio
import json
import threading
import time
from collections.abc import AsyncIterator, Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import asynccontextmanager
from contextvars import copy_context
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from fastapi import FastAPI
from starlette.types import Message

import dsbrdf
from dsbrdf.engines import FitDocument, FitTask, OnProgress, Outcome, Processes, local
from dsbrdf.engines.engine import run_step
from dsbrdf.output import to_json
from dsbrdf_service.app import create_app
from dsbrdf_service.http.monitoring import Metrics
from dsbrdf_service.queue import FitQueue
from dsbrdf_service.settings import Settings
from dsbrdf_service.storage.keys import add_key
from dsbrdf_service.storage.schema import Caller, FitKey, FitRow, checksum
from dsbrdf_service.storage.store import Store
from dsbrdf_service.wire import to_wire
from tests.support.models import random_model
from tests.support.server import LOCAL, add

FIT = "a" * 32
OPTIONS = dsbrdf.FitOptions()
MAX_WAIT_S = 60.0


async def until(happened: Callable[[], bool]) -> None:
    async with asyncio.timeout(MAX_WAIT_S):
        while not happened():
            await asyncio.sleep(0.001)


@cache
def stored_text() -> str:
    model = random_model()
    return to_json(model, None, dsbrdf.decompose(model))


@dataclass
class Exchange:
    """A request that can be given up, and what has been answered."""

    task: "asyncio.Task[None]"
    gone: asyncio.Event
    messages: list[Message]

    async def leave(self) -> None:
        """Close the connection, and wait until the application has seen it."""
        self.gone.set()
        await self.end()

    async def end(self) -> "Exchange":
        done, _ = await asyncio.wait([self.task], timeout=MAX_WAIT_S)
        assert done, "there is no answer"
        return self

    @property
    def status(self) -> int:
        status: int = self.messages[0]["status"]
        return status

    @property
    def headers(self) -> dict[str, str]:
        return {name.decode().lower(): value.decode() for name, value in self.messages[0]["headers"]}

    @property
    def body(self) -> bytes:
        return b"".join(message.get("body", b"") for message in self.messages[1:])


@dataclass
class Blocked:
    """A function that notes its calls and returns when it may."""

    function: Callable[..., Any]
    calls: list[tuple[Any, ...]] = field(default_factory=list)
    may_return: threading.Event = field(default_factory=threading.Event)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        self.calls.append(arguments)
        assert self.may_return.wait(MAX_WAIT_S)
        return self.function(*arguments, **named)

    async def until_called(self) -> None:
        await until(lambda: bool(self.calls))


class Application:
    """A started application whose keys have a finished fit each."""

    def __init__(self, app: FastAPI, store: Store) -> None:
        self.app, self.store = app, store

    def new_key(self) -> str:
        owner, key = add_key(self.store.database, "a key")
        written = checksum(None, stored_text().encode())
        values = (owner, FIT, "0" * 64, json.dumps(to_wire(OPTIONS)), time.time(), stored_text(), written)
        columns = "seq, algorithm, library, status, owner, id, measurement, options, created, result, checksum"
        with self.store.database.transaction() as db:
            db.execute(f"INSERT INTO fits ({columns}) VALUES (1, '1', '1', 'succeeded', ?, ?, ?, ?, ?, ?, ?)", values)
        return key

    def ask(
        self,
        target: str,
        key: str,
        method: str = "GET",
        body: bytes = b"",
        kind: str = "application/json",
        *,
        unread: bool = False,
    ) -> Exchange:
        """Begin a request; an unread one takes no second piece of its answer."""
        path, _, query = target.partition("?")
        headers = [(b"host", b"localhost"), (b"authorization", f"Bearer {key}".encode())]
        if body:
            headers.append((b"content-length", str(len(body)).encode()))
            headers.append((b"content-type", kind.encode()))
        scope: dict[str, Any] = {"type": "http", "http_version": "1.0", "method": method, "path": path}
        scope |= {"headers": headers, "query_string": query.encode(), "client": ("127.0.0.1", 1)}
        messages: list[Message] = []
        gone, unsent = asyncio.Event(), [body]

        async def receive() -> Message:
            if unsent:
                return {"type": "http.request", "body": unsent.pop(), "more_body": False}
            await gone.wait()
            return {"type": "http.disconnect"}

        async def send(message: Message) -> None:
            if not gone.is_set():
                messages.append(message)
            if unread and message["type"] == "http.response.body":
                await gone.wait()

        return Exchange(asyncio.create_task(self.app(scope, receive, send)), gone, messages)


def _call_in_thread(
    _: Processes, step: Callable[..., Any], *arguments: Any, on_progress: OnProgress = lambda _: None
) -> "Future[Any]":
    """Call a step as `Processes.call` does, but in a thread; one that is not wanted any more runs on."""
    threads = ThreadPoolExecutor(1)
    call = threads.submit(partial(copy_context().run, run_step, step, *arguments, on_progress))
    threads.shutdown(wait=False)
    return call


@asynccontextmanager
async def application(folder: Path, monkeypatch: pytest.MonkeyPatch, **settings: Any) -> AsyncIterator[Application]:
    """Run the application during the block, without other processes: steps are called in threads."""
    monkeypatch.setattr(local, "start_fork_server", lambda: None)
    monkeypatch.setattr(Processes, "call", _call_in_thread)
    store = Store(folder)
    app = create_app(Settings(data_dir=folder, workers=1, require_keys=True, **settings), store)
    async with app.router.lifespan_context(app):
        yield Application(app, store)


class Fit(Future[Outcome]):
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
