"""The application in this process, with one finished fit: for tests that stop a computation and look at who waits."""

import asyncio
import json
import threading
import time
from collections.abc import AsyncIterator, Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import asynccontextmanager
from contextvars import copy_context
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI
from starlette.types import Message

import dsbrdf
from dsbrdf.engines import OnProgress, Processes, local
from dsbrdf.engines.engine import run_step
from dsbrdf.output import to_json
from dsbrdf_service.app import create_app
from dsbrdf_service.settings import Settings
from dsbrdf_service.storage.keys import add_key
from dsbrdf_service.storage.schema import checksum
from dsbrdf_service.storage.store import Store
from dsbrdf_service.wire import to_wire
from tests.support.random_models import random_model

FIT = "a" * 32
_PATIENCE = 60.0  # seconds


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
        done, _ = await asyncio.wait([self.task], timeout=_PATIENCE)
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
        assert self.may_return.wait(_PATIENCE)
        return self.function(*arguments, **named)

    async def until_called(self, times: int = 1) -> None:
        async with asyncio.timeout(_PATIENCE):
            while len(self.calls) < times:
                await asyncio.sleep(0.005)


class Application:
    """A started application whose keys have a finished fit each."""

    def __init__(self, app: FastAPI, store: Store) -> None:
        self.app, self.store = app, store

    def new_key(self) -> str:
        """Return a key that has the fit `FIT`."""
        owner, key = add_key(self.store.database, "a key")
        model = random_model()
        document = to_json(model, None, dsbrdf.decompose(model))
        written = checksum(None, document.encode())
        values = (owner, FIT, "0" * 64, json.dumps(to_wire(dsbrdf.FitOptions())), time.time(), document, written)
        with self.store.database.transaction() as db:
            db.execute(
                "INSERT INTO fits (seq, owner, id, measurement, options, algorithm, library, status, created, result,"
                " checksum) VALUES (1, ?, ?, ?, ?, '1', '1', 'succeeded', ?, ?, ?)",
                values,
            )
        return key

    def ask(
        self,
        target: str,
        key: str,
        method: str = "GET",
        body: bytes = b"",
        media_type: str = "application/json",
        *,
        unread: bool = False,
    ) -> Exchange:
        """Begin a request; an unread one takes no second piece of its answer."""
        path, _, query = target.partition("?")
        headers = [(b"host", b"localhost"), (b"authorization", f"Bearer {key}".encode())]
        if body:
            headers.append((b"content-length", str(len(body)).encode()))
            headers.append((b"content-type", media_type.encode()))
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
