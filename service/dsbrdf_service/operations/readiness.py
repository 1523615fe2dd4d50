"""Whether the service can take work: each part is checked within a time limit, at most once a second."""

import asyncio
import logging
import shutil
import sqlite3
import time
from collections.abc import Awaitable, Callable
from functools import partial

from anyio import to_thread

from dsbrdf.engines.engine import Engine

from ..settings import Settings
from ..storage.store import Store

LIMIT = 3.0  # seconds that a part may take to answer
_FRESH = 1.0  # seconds for which the answer of a part is used again
# A disk that hangs must not delay the end of the service.
_in_thread = partial(to_thread.run_sync, abandon_on_cancel=True)

logger = logging.getLogger(__name__)


class Readiness:
    """Checks the store, the folder of measurements, the disk and the engine."""

    def __init__(self, store: Store, engine: Engine, settings: Settings) -> None:
        self._stopping = False
        self._checks: dict[str, Callable[[], Awaitable[None]]] = {
            "The database": partial(_in_thread, store.check),
            "The folder of measurements": partial(_in_thread, store.blobs.check),
            "The disk": partial(_in_thread, _check_space, store, settings.min_free_mb),
            "The engine": partial(_in_thread, engine.check),
        }
        self._asked: dict[str, tuple[float, asyncio.Task[str | None]]] = {}  # when, and what the check returns

    def stop(self) -> None:
        """Report from now on that the service is not ready."""
        self._stopping = True

    async def fault(self) -> str | None:
        """Return one or more sentences about what is wrong; None if the service is ready."""
        if self._stopping:
            return "The service is shutting down."
        faults = await asyncio.gather(*(self._fault_of(name) for name in self._checks))
        return " ".join(fault for fault in faults if fault is not None) or None

    async def _fault_of(self, name: str) -> str | None:
        """Return what is wrong with one part; a check that hangs is not started a second time."""
        asked, answer = self._asked.get(name, (0.0, None))
        now = time.monotonic()
        if answer is None or (answer.done() and now - asked > _FRESH):
            answer = asyncio.create_task(self._ask(name))
            self._asked[name] = now, answer
        await asyncio.wait([answer], timeout=LIMIT)
        return answer.result() if answer.done() else f"{name} has not answered within {LIMIT:g} s."

    async def _ask(self, name: str) -> str | None:
        try:
            await self._checks[name]()
        except (OSError, sqlite3.Error, RuntimeError) as error:
            # The client gets the reason; the log also names the part.
            logger.warning("%s is not ready: %s", name, error)
            reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            return f"{name} is not ready: {reason.rstrip('.')}."
        return None


def _check_space(store: Store, least_mb: int) -> None:
    free = shutil.disk_usage(store.folder).free >> 20
    if free < least_mb:
        raise RuntimeError(f"only {free} MB are free; the service needs {least_mb} MB")
