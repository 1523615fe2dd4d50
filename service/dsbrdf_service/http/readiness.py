"""Check within a time limit whether the service can take work; simultaneous requests share one check."""

import asyncio
import logging
import sqlite3
from collections.abc import Callable
from functools import partial

from anyio import CapacityLimiter, to_thread

from dsbrdf.engines.engine import Engine

from ..settings import Settings
from ..storage.store import Store

LIMIT = 3.0  # [s] Time limit of all checks together.

logger = logging.getLogger(__name__)


class Readiness:
    """Check the store, the folder of measurements, the disk and the engine, one after the other."""

    def __init__(self, store: Store, engine: Engine, settings: Settings) -> None:
        self._stopping = False
        self._checks: dict[str, Callable[[], None]] = {
            "The database": store.check,
            "The folder of measurements": store.blobs.check,
            "The disk": partial(store.check_space, settings.min_free_mb),
            "The engine": engine.check,
        }
        self._thread = CapacityLimiter(1)  # Checks have their own thread, so that they never wait for requests.
        self._current = ""  # The name of the running check.
        self._answer: asyncio.Task[str | None] | None = None

    def stop(self) -> None:
        """Report from now on that the service is not ready."""
        self._stopping = True

    async def fault(self) -> str | None:
        """Return one sentence for each failed check; None if the service is ready.

        A check that hangs is not started a second time, and does not delay the end of the service.
        """
        if self._stopping:
            return "The service is shutting down."
        if self._answer is None or self._answer.done():
            check = to_thread.run_sync(self._check, abandon_on_cancel=True, limiter=self._thread)
            self._answer = asyncio.create_task(check)
        answer = self._answer
        await asyncio.wait([answer], timeout=LIMIT)
        return answer.result() if answer.done() else f"{self._current} has not answered within {LIMIT:g} s."

    def _check(self) -> str | None:
        faults = []
        for name, check in self._checks.items():
            self._current = name
            try:
                check()
            except (OSError, sqlite3.Error, RuntimeError) as error:
                # The client gets the reason of a failed check; the log also names the file.
                logger.warning("%s is not ready: %s", name, error)
                reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
                faults.append(f"{name} is not ready: {reason.rstrip('.')}.")
        return " ".join(faults) or None
