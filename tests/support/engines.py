"""An engine to test, where its fits run, and waiting for what it does."""

import json
import os
import warnings
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import TypeVar

from dsbrdf import ConvergenceWarning, FitOptions, FitResult, decompose, fit
from dsbrdf.engines import DaskEngine, Engine, FitDocument, FitLimits, FitTask, LocalEngine, Outcome
from dsbrdf.output import to_json
from tests.support import endless_fit
from tests.support.dask_cluster import DaskCluster, forked
from tests.support.launcher import ForkedProcess
from tests.support.processes import wait_until

T = TypeVar("T")
QUICK = FitOptions(method="paper", n_lobes=1, em_iterations=3)
MIDDLE = FitOptions(method="paper", n_lobes=4, em_iterations=40)
SLOW_FIT = FitOptions(n_lobes=8, ring_lobes=2)
ENDLESS = endless_fit.OPTIONS
LIMITS = FitLimits(seconds=120.0, memory_mb=4096)
PATIENCE = 120.0


class Stage:
    """An engine to test, and where its fits run."""

    def __init__(self, cluster: DaskCluster | None) -> None:
        self.cluster = cluster

    def engine(self, limits: FitLimits = LIMITS) -> Engine:
        return LocalEngine(1, limits) if self.cluster is None else DaskEngine(self.cluster.address, 1, limits)

    def fitting(self) -> list[int]:
        return forked(os.getpid()) if self.cluster is None else self.cluster.fitting()


@contextmanager
def started(engine: Engine) -> Iterator[Engine]:
    """Close the engine after the block, which begins when fits can run."""
    with closing(engine):
        wait_until(lambda: fault_of(engine) is None, PATIENCE)
        yield engine


def fault_of(engine: Engine) -> str | None:
    try:
        engine.check()
    except OSError as error:
        return str(error)
    return None


def until(ask: Callable[[], T], good: Callable[[T], object]) -> T:
    """Return the first good answer of a function."""
    answers: list[T] = []

    def asked() -> bool:
        answers[:] = [ask()]
        return bool(good(answers[0]))

    wait_until(asked, PATIENCE)
    return answers[0]


def until_fitting(stage: Stage) -> list[int]:
    return until(stage.fitting, bool)


def until_busy(cluster: DaskCluster) -> ForkedProcess:
    return until(lambda: [worker for worker in cluster.workers if forked(worker.pid)], bool)[0]


def ignore(_: float) -> None:
    """Take a share that nobody wants to know."""


def run(stage: Stage, task: FitTask, limits: FitLimits = LIMITS) -> tuple[Outcome, list[float]]:
    shares: list[float] = []
    with started(stage.engine(limits)) as engine:
        return engine.submit(task, shares.append).result(PATIENCE), shares


@cache
def fitted_by_library(file: Path, options: FitOptions) -> tuple[FitResult, list[str]]:
    """What the library makes of a file, and its warnings; every engine is compared with it."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", ConvergenceWarning)
        result = fit(file, options)
    return result, [str(warning.message) for warning in said]


def assert_same(outcome: Outcome, expected: FitResult) -> None:
    """Compare the document of a fit with a result of the library, bit for bit but for its timings."""
    assert isinstance(outcome, FitDocument)
    plain = [json.loads(text) for text in (outcome.text, to_json(expected.model, expected.report, decompose(expected)))]
    for document in plain:
        del document["report"]["timings"]
    assert plain[0] == plain[1]
    assert outcome.metrics == asdict(expected.report.metrics)
