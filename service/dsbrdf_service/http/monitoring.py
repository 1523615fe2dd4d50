"""Count and time requests and fits for Prometheus, and check whether the service can take work.

Labels have few values: a request counts under the template of its route, never by owner, fit or measurement.
"""

import asyncio
import logging
import sqlite3
from collections.abc import Callable
from functools import cache, partial
from typing import Any, get_args

from anyio import CapacityLimiter, to_thread
from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, generate_latest

from dsbrdf.engines.engine import Engine

from ..queue import FitMeters
from ..settings import Settings
from ..storage.health import check_rows, check_space, fits_by_status, measurement_bytes
from ..storage.schema import Status
from ..storage.store import Store

NO_ROUTE = "unknown"
_METHODS = frozenset(("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"))
_BUCKET_BOUNDS_S = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)


class Metrics:
    """The metrics of one service."""

    def __init__(self) -> None:
        self._registry = registry = CollectorRegistry()
        ProcessCollector(registry=registry)
        labels = ("method", "route", "status")
        requests = Counter("dsbrdf_requests", "Requests answered.", labels, registry=registry)
        timed: dict[str, Any] = {"buckets": _BUCKET_BOUNDS_S, "registry": registry}
        from_head_to_end = "Time from a request's head to the end of its answer [s]."
        request_seconds = Histogram("dsbrdf_request_seconds", from_head_to_end, ("method", "route"), **timed)
        # Counters are cached by their labels, because finding a counter takes longer than counting.
        self._of_request = cache(lambda *of: (requests.labels(*of), request_seconds.labels(*of[:2])))
        stage_seconds = Histogram("dsbrdf_stage_seconds", "Time of a part of the work [s].", ("stage",), **timed)
        self.upload_seconds = stage_seconds.labels("upload")
        self.requests_in_progress = Gauge("dsbrdf_requests_in_progress", "Requests being answered.", registry=registry)
        retries = Counter("dsbrdf_fit_retries", "Fits that ran again after a lost process.", registry=registry)
        self.fit_meters = FitMeters(stage_seconds.labels("waiting"), stage_seconds.labels("fitting"), retries)
        fits = "Fits by state; the accepted ones are the queue."
        self._fits = Gauge("dsbrdf_fits", fits, ("state",), registry=registry)
        self._stored_bytes = Gauge("dsbrdf_stored_bytes", "Bytes of stored measurements.", registry=registry)

    def answered(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count a request; `route` is its route's template or `NO_ROUTE`."""
        counter, histogram = self._of_request(method if method in _METHODS else "other", route, status)
        counter.inc()
        histogram.observe(seconds)

    def exposition(self, store: Store) -> bytes:
        """Return all metrics in Prometheus' text format, with the present counts of the store."""
        numbers = fits_by_status(store.database)
        for state in get_args(Status):
            self._fits.labels(state).set(numbers.get(state, 0))
        self._stored_bytes.set(measurement_bytes(store.database))
        return generate_latest(self._registry)


READY_TIMEOUT_S = 3.0  # Time limit of all checks together.

logger = logging.getLogger(__name__)


class Readiness:
    """Check the store, the folder of measurements, the disk and the engine, one after the other."""

    def __init__(self, store: Store, engine: Engine, settings: Settings) -> None:
        self._stopping = False
        self._checks: dict[str, Callable[[], None]] = {
            "The database": partial(check_rows, store.database),
            "The folder of measurements": store.blobs.check,
            "The disk": partial(check_space, store.folder, settings.min_free_mb),
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
        await asyncio.wait([answer], timeout=READY_TIMEOUT_S)
        return answer.result() if answer.done() else f"{self._current} has not answered within {READY_TIMEOUT_S:g} s."

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
