"""Count and time requests and fits for Prometheus; each application has a registry of its own.

Labels have few values: a request counts under the template of its route, never by owner, fit or measurement.
"""

from functools import cache
from typing import Any, get_args

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, generate_latest

from ..queue.fit_queue import FitMeters
from ..storage.schema import Status
from ..storage.store import Store

NO_ROUTE = "unknown"
_METHODS = frozenset(("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"))
_BUCKET_BOUNDS_S = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)


class Metrics:
    """Hold the metrics of one service."""

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
        numbers = store.fits_by_status()
        for state in get_args(Status):
            self._fits.labels(state).set(numbers.get(state, 0))
        self._stored_bytes.set(store.measurement_bytes())
        return generate_latest(self._registry)
