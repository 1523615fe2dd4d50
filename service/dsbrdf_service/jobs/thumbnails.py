"""Small pictures of fits for the page's list: drawn once, after the fit, and kept as long as it."""

import asyncio
import logging
import sqlite3
from contextlib import suppress

from starlette.concurrency import run_in_threadpool

from ..errors import ProblemError
from ..storage.database import in_write_thread
from ..storage.schema import FitKey
from ..storage.store import Store
from .computations import Computations
from .steps import StoredMeasurement, thumbnail_step

logger = logging.getLogger(__name__)


class Thumbnails:
    """Draws each thumbnail once for all who wait for it, also if nobody does."""

    def __init__(self, store: Store, computations: Computations) -> None:
        self._store = store
        self._computations = computations
        self._drawing: dict[FitKey, asyncio.Task[bytes]] = {}

    async def get(self, key: FitKey) -> bytes:
        """Return the thumbnail of a fit as PNG; raise ProblemError if there is no such fit, or it has no result."""
        kept = await run_in_threadpool(self._store.thumbnail, key)
        return await asyncio.shield(self._begin(key)) if kept is None else kept

    def draw_soon(self, key: FitKey) -> None:
        """Draw the thumbnail of a fit that has just succeeded, before somebody asks for it."""
        self._begin(key).add_done_callback(_log_failure)

    async def measured(self, key: FitKey) -> StoredMeasurement | None:
        """Return the measurement of a fit, unless it is not stored any more or is a table of samples."""
        try:
            sha256 = (await run_in_threadpool(self._store.fit, key)).measurement
            path = await run_in_threadpool(self._store.measurement_file, key.owner, sha256, drawn="grid")
        except ProblemError as error:
            if error.kind != "not-found":
                raise
            return None
        return StoredMeasurement(path, sha256)

    async def close(self) -> None:
        """Give up what is being drawn."""
        tasks = list(self._drawing.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _begin(self, key: FitKey) -> "asyncio.Task[bytes]":
        if key not in self._drawing:
            self._drawing[key] = task = asyncio.create_task(self._draw(key))
            task.add_done_callback(lambda _: self._drawing.pop(key))
        return self._drawing[key]

    async def _draw(self, key: FitKey) -> bytes:
        stored, measured = await run_in_threadpool(self._store.result, key), await self.measured(key)
        picture = await self._computations.run_unasked(key.owner, thumbnail_step, stored, measured)
        with suppress(OSError, sqlite3.Error):  # the disk may be full: then it is drawn again
            await in_write_thread(self._store.keep_thumbnail, key, picture)
        return picture


def _log_failure(task: "asyncio.Task[bytes]") -> None:
    if not task.cancelled() and task.exception():
        logger.info("a thumbnail could not be drawn (%s); it is drawn when it is asked for", task.exception())
