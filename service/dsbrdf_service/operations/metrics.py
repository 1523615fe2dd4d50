"""What is counted and timed, for Prometheus; each application has a registry of its own.

Labels take few values: a path counts under its route's template, and nothing by owner, fit or measurement.
"""

import logging
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from time import perf_counter
from typing import Any, Literal, get_args

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from ..storage.database import Database
from ..storage.schema import Status

Stage = Literal["upload", "waiting", "fitting"]

NO_ROUTE = "unknown"
_METHODS = frozenset(("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"))
_SECONDS = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)

logger = logging.getLogger(__name__)


class Metrics(Collector):
    """The metrics of one service; each says in its description what it counts."""

    def __init__(self) -> None:
        self._registry = registry = CollectorRegistry()
        ProcessCollector(registry=registry)
        labels = ("method", "route", "status")
        requests = Counter("dsbrdf_requests", "Requests answered.", labels, registry=registry)
        timed: dict[str, Any] = {"buckets": _SECONDS, "registry": registry}
        from_head_to_end = "Time from a request's head to the end of its answer [s]."
        request_seconds = Histogram("dsbrdf_request_seconds", from_head_to_end, ("method", "route"), **timed)
        # Looking labels up takes longer than counting.
        self._of_request = cache(lambda *of: (requests.labels(*of), request_seconds.labels(*of[:2])))
        stage_seconds = Histogram("dsbrdf_stage_seconds", "Time of a part of the work [s].", ("stage",), **timed)
        self._stages = {stage: stage_seconds.labels(stage) for stage in get_args(Stage)}
        self.requests_in_progress = Gauge("dsbrdf_requests_in_progress", "Requests being answered.", registry=registry)
        self.event_streams = Gauge("dsbrdf_event_streams", "Streams of a fit's events being sent.", registry=registry)
        self.uploaded_bytes = Counter("dsbrdf_uploaded_bytes", "Bytes of request bodies received.", registry=registry)
        self.retries = Counter("dsbrdf_fit_retries", "Fits that ran again after a lost process.", registry=registry)

    def answered(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count a request; `route` is its route's template or `NO_ROUTE`."""
        counter, histogram = self._of_request(method if method in _METHODS else "other", route, status)
        counter.inc()
        histogram.observe(seconds)

    def record_time(self, stage: Stage, seconds: float) -> None:
        """Record how long a stage of the work took."""
        self._stages[stage].observe(seconds)

    @contextmanager
    def timing(self, stage: Stage) -> Iterator[None]:
        """Record how long the block takes, unless it raises."""
        begin = perf_counter()
        yield
        self.record_time(stage, perf_counter() - begin)

    def exposition(self) -> bytes:
        """Return everything in Prometheus' text format."""
        return generate_latest(self._registry)

    def collect_from(self, database: Database) -> None:
        """Count the fits in each state, and the bytes on disk, whenever the metrics are read."""
        self._database = database
        self._registry.register(self)

    def collect(self) -> Iterator[Metric]:
        """Yield gauges of what is stored, read from the database: counters would start at zero with the process."""
        states = GaugeMetricFamily("dsbrdf_fits", "Fits by state; the accepted ones are the queue.", labels=("state",))
        files = "SELECT coalesce(sum(size), 0) FROM (SELECT DISTINCT sha256, size FROM measurements)"
        try:
            numbers = dict(self._database.rows("SELECT status, count(*) FROM fits GROUP BY status"))
            ((stored_bytes,),) = self._database.rows(files)
        except sqlite3.Error as error:  # the other metrics are still of use
            logger.warning("the metrics lack those of the database: %s", error)
            return
        for state in get_args(Status):
            states.add_metric((state,), numbers.get(state, 0))
        yield states
        yield GaugeMetricFamily("dsbrdf_stored_bytes", "Bytes of stored measurements.", value=stored_bytes)
