"""Whether the service can take work: each part is checked within a time limit, at most once a second."""

import asyncio
import logging
import shutil
import sqlite3
import time
from collections.abc import Awaitable, Callable
from functools import partial
from typing import TypeVar

import anyio.to_thread

from dsbrdf.engines.engine import Engine

from ..settings import Settings
from ..storage.store import Store

LIMIT = 3.0  # seconds that a part may take to answer
_FRESH = 1.0  # seconds for which the answer of a part is used again

T = TypeVar("T")

logger = logging.getLogger(__name__)


class Readiness:
    """Checks the store, the folder of measurements, the disk and the engine."""

    def __init__(self, store: Store, engine: Engine, settings: Settings) -> None:
        self._stopping = False
        self._parts = (
            _Part("The database", partial(_in_thread, store.check)),
            _Part("The folder of measurements", partial(_in_thread, store.blobs.check)),
            _Part("The disk", partial(_in_thread, partial(_check_space, store, settings.min_free_mb))),
            _Part("The engine", engine.check),
        )

    def stop(self) -> None:
        """Report from now on that the service is not ready."""
        self._stopping = True

    async def fault(self) -> str | None:
        """Return one or more sentences about what is wrong; None if the service is ready."""
        if self._stopping:
            return "The service is shutting down."
        faults = await asyncio.gather(*(part.fault() for part in self._parts))
        return " ".join(fault for fault in faults if fault is not None) or None


class _Part:
    """One part and its check; a check that hangs is not started a second time."""

    def __init__(self, name: str, check: Callable[[], Awaitable[None]]) -> None:
        self._name = name
        self._check = check
        self._answer: asyncio.Task[str | None] | None = None
        self._asked = 0.0

    async def fault(self) -> str | None:
        now = time.monotonic()
        if self._answer is None or (self._answer.done() and now - self._asked > _FRESH):
            self._asked = now
            self._answer = asyncio.create_task(self._ask())
        answer = self._answer
        await asyncio.wait([answer], timeout=LIMIT)
        return answer.result() if answer.done() else f"{self._name} has not answered within {LIMIT:g} s."

    async def _ask(self) -> str | None:
        try:
            await self._check()
        except (OSError, sqlite3.Error, RuntimeError) as error:
            # The client gets the reason; the log also names the part.
            logger.warning("%s is not ready: %s", self._name, error)
            reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            return f"{self._name} is not ready: {reason.rstrip('.')}."
        return None


def _check_space(store: Store, least_mb: int) -> None:
    free = shutil.disk_usage(store.folder).free >> 20
    if free < least_mb:
        raise RuntimeError(f"only {free} MB are free; the service needs {least_mb} MB")


async def _in_thread(check: Callable[[], None]) -> None:
    # A disk that hangs must not delay the end of the service.
    await anyio.to_thread.run_sync(check, abandon_on_cancel=True)
