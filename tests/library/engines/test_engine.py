"""What every engine promises, held against each of them, and clusters that are lost, broken or of other software."""

import gc
import json
import multiprocessing
import os
import platform
import signal
import time
import warnings
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import closing, contextmanager
from dataclasses import asdict
from pathlib import Path

import numpy
import pytest
import scipy

import dsbrdf
from dsbrdf import ConvergenceWarning, FitOptions, FitResult, decompose, read_measurement
from dsbrdf.engines import DaskEngine, Engine, Fault, FitDocument, FitLimits, FitTask, LocalEngine, Outcome, dask
from dsbrdf.output import result_from_json, to_json
from dsbrdf.output.sphere_panels import thumbnail
from dsbrdf.version import Versions, versions
from tests.support.dask_cluster import DaskCluster
from tests.support.launcher import ForkedProcess
from tests.support.processes import alive, forked, until, wait_until
from tests.support.soak import SOAK
from tests.support.tasks import ENDLESS

needs_proc = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks at processes in /proc")
pytestmark = [pytest.mark.slow, needs_proc]

QUICK = FitOptions(method="paper", n_lobes=1, em_iterations=3)
MIDDLE = FitOptions(method="paper", n_lobes=4, em_iterations=40)
SLOW_FIT = FitOptions(n_lobes=8, ring_lobes=2)
LIMITS = FitLimits(seconds=120.0, memory_mb=4096)
PATIENCE = 120.0
NO_DATA_LEFT = FitOptions(method="paper", n_lobes=8, mask=10.0, horizon_cutoff_deg=1.7)


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


def until_busy(cluster: DaskCluster) -> ForkedProcess:
    return until(lambda: [worker for worker in cluster.workers if forked(worker.pid)], bool)[0]


def ignore(_: float) -> None:
    """Take a share that nobody wants to know."""


def run(stage: Stage, task: FitTask, limits: FitLimits = LIMITS) -> tuple[Outcome, list[float]]:
    shares: list[float] = []
    with started(stage.engine(limits)) as engine:
        return engine.submit(task, shares.append).result(PATIENCE), shares


def assert_same(outcome: Outcome, expected: FitResult) -> None:
    """Compare the document of a fit with a result of the library, bit for bit but for its timings."""
    assert isinstance(outcome, FitDocument)
    plain = [json.loads(text) for text in (outcome.text, to_json(expected.model, expected.report, decompose(expected)))]
    for document in plain:
        del document["report"]["timings"]
    assert plain[0] == plain[1]
    assert outcome.metrics == asdict(expected.report.metrics)


@pytest.fixture(autouse=True)
def impatience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let checks of a cluster, which the tests wait for, find it lost soon: a good one is checked again each time."""
    monkeypatch.setattr(dask, "_CLUSTER_CHECK_LIFETIME_S", 0.0)
    monkeypatch.setattr(dask, "_SCHEDULER_TIMEOUT_S", 1.0)


@pytest.fixture(autouse=True)
def sockets_that_dask_leaves() -> Iterator[None]:
    """Collect them here: a Dask client that is closed while it connects does not close its socket."""
    yield
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "unclosed <socket", ResourceWarning)
        gc.collect()


@pytest.fixture(params=["local", pytest.param("dask", marks=pytest.mark.soak)])
def stage(request: pytest.FixtureRequest) -> Stage:
    return Stage(None if request.param == "local" else request.getfixturevalue("cluster"))


def test_result_equals_that_of_the_library_bit_for_bit(stage: Stage, plastic_file: Path) -> None:
    options = FitOptions(2, "paper", em_iterations=5, weighting="log", robust=True, horizon_cutoff_deg=69)
    with pytest.warns(ConvergenceWarning) as said:
        expected = dsbrdf.fit(plastic_file, options)
    outcome, shares = run(stage, FitTask("one", plastic_file, options, with_thumbnail=True))
    assert isinstance(outcome, FitDocument)
    assert outcome.thumbnail == thumbnail(expected.model, read_measurement(plastic_file))
    assert_same(outcome, expected)
    report = result_from_json(outcome.text).report
    assert list(report.timings) == list(expected.report.timings)
    assert all(seconds > 0 for seconds in report.timings.values())
    assert [str(one.message) for one in said] == [text for text in report.warnings if " converged: " in text]
    assert shares == sorted(set(shares))
    assert shares[-1] == 1.0


@pytest.mark.parametrize(
    ("name", "asked", "fault"),
    [
        ("other", (QUICK, LIMITS), ["input", "MeasurementFormatError", "which begins with the dimensions (90, 90"]),
        ("plastic", (NO_DATA_LEFT, LIMITS), ["input", "FitError", "leave no slice with enough valid samples"]),
        ("gone", (QUICK, LIMITS), ["system", "MeasurementUnreadable", "not be read: No such file or directory."]),
        ("plastic", (SLOW_FIT, FitLimits(60.0, 200)), ["compute", "MemoryLimit", "more memory than a fit may use."]),
        ("plastic", (ENDLESS, FitLimits(0.5, 4096)), ["compute", "TimeLimit", "took longer than the 0.5 s that a fit"]),
    ],
    ids=["no measurement", "no data left", "no file", "memory", "time"],
)
def test_failed_fit_is_a_fault_that_says_why(
    stage: Stage, plastic_file: Path, tmp_path: Path, name: str, asked: tuple[FitOptions, FitLimits], fault: list[str]
) -> None:
    (tmp_path / "other.binary").write_bytes(bytes(range(256)))
    path = plastic_file if name == "plastic" else tmp_path / f"{name}.binary"
    outcome, _ = run(stage, FitTask("one", path, asked[0]), asked[1])
    assert isinstance(outcome, Fault)
    assert [outcome.origin, outcome.type] == fault[:2]
    assert fault[2] in outcome.message
    wait_until(lambda: not stage.fitting())


def test_progress_rises_until_cancelling_ends_a_process_and_closing_the_rest(stage: Stage, plastic_file: Path) -> None:
    shares: list[float] = []
    with started(stage.engine()) as engine:
        fit = engine.submit(FitTask("one", plastic_file, ENDLESS), shares.append)
        waiting = engine.submit(FitTask("two", plastic_file, ENDLESS), shares.append)
        wait_until(lambda: len(shares) > 1, PATIENCE)
        assert shares == sorted(set(shares))
        assert 0.0 < shares[0] < 0.5
        victims = stage.fitting()
        assert len(victims) == 1
        begin = time.monotonic()
        for future in (waiting, fit):
            future.cancel()
            with pytest.raises(CancelledError):
                future.result(PATIENCE)
        wait_until(lambda: not any(map(alive, victims)), PATIENCE)
        if SOAK:
            assert time.monotonic() - begin < 1.0
        assert isinstance(engine.submit(FitTask("three", plastic_file, QUICK), ignore).result(PATIENCE), FitDocument)
        unfinished = [engine.submit(FitTask(name, plastic_file, ENDLESS), ignore) for name in ("four", "five")]
        victims = until(stage.fitting, bool)
    assert all(future.done() for future in unfinished)
    assert not forked(os.getpid())
    wait_until(lambda: not any(map(alive, victims)), PATIENCE)


def test_future_of_a_cancelled_fit_is_done_when_its_process_has_ended(plastic_file: Path) -> None:
    with started(LocalEngine(1)) as engine:
        fit = engine.submit(FitTask("one", plastic_file, ENDLESS), ignore)
        victims = until(lambda: forked(os.getpid()), bool)
        for victim in victims:
            os.kill(victim, signal.SIGSTOP)  # It does not end by itself any more.
        begin = time.monotonic()
        fit.cancel()
        with pytest.raises(CancelledError):
            fit.result(PATIENCE)
        assert not any(map(alive, victims))
        if SOAK:
            assert time.monotonic() - begin < 1.0


def test_fits_at_once_are_as_many_as_the_engine_has_workers(plastic_file: Path) -> None:
    shares: list[list[float]] = []
    with started(LocalEngine(2)) as engine:
        for number in range(3):
            shares.append([])
            engine.submit(FitTask(str(number), plastic_file, SLOW_FIT), shares[-1].append)
        wait_until(lambda: bool(shares[0] and shares[1]), PATIENCE)
        assert not shares[2]
        assert len(forked(os.getpid())) == 2


def test_without_fork_server_processes_are_spawned(plastic_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(multiprocessing, "get_all_start_methods", lambda: ["spawn"])
    outcome, shares = run(Stage(None), FitTask("one", plastic_file, QUICK))
    assert not forked(os.getpid())
    assert isinstance(outcome, FitDocument)
    assert shares[-1] == 1.0


@pytest.mark.filterwarnings("ignore::dsbrdf.errors.ConvergenceWarning")
def test_fits_wait_for_a_cluster_are_those_of_the_library_and_survive_the_loss_of_a_worker(
    own_cluster: DaskCluster, plastic_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    address = own_cluster.address
    with closing(DaskEngine(address, 3, LIMITS)) as engine:
        fault = fault_of(engine)
        assert str(fault).startswith(f"The Dask scheduler at {address} cannot be reached: ")
        fit = engine.submit(FitTask("one", plastic_file, QUICK), ignore)
        own_cluster.start_scheduler()
        until(lambda: fault_of(engine), lambda fault: fault == f"The Dask cluster at {address} has no workers.")
        assert not fit.done()
        own_cluster.add_worker()
        assert_same(fit.result(PATIENCE), dsbrdf.fit(plastic_file, QUICK))
        found = asdict(versions())
        with monkeypatch.context() as patch:
            patch.setattr(dask, "versions", lambda: Versions(**dict.fromkeys(found, "0.1")))
            other = " and ".join(f"{name} {one}, not 0.1" for name, one in found.items())
            until(lambda: fault_of(engine), lambda fault: str(fault).endswith(f" has {other}."))
        until(lambda: fault_of(engine), lambda fault: fault is None)
        own_cluster.add_worker()
        wait_until(lambda: own_cluster.log().count("Registered to:") == 2, PATIENCE)
        fit = engine.submit(FitTask("two", plastic_file, MIDDLE), ignore)
        own_cluster.kill_worker(until_busy(own_cluster))
        assert isinstance(fit.result(PATIENCE), FitDocument)


@pytest.mark.soak
def test_fit_that_loses_four_workers_fails_and_they_leave_nothing(own_cluster: DaskCluster, plastic_file: Path) -> None:
    own_cluster.start_scheduler()
    for _ in range(4):
        own_cluster.add_worker()
    wait_until(lambda: own_cluster.log().count("Registered to:") == 4, PATIENCE)  # so that the engine asks all at once
    with started(Stage(own_cluster).engine()) as engine:
        fit = engine.submit(FitTask("one", plastic_file, ENDLESS), ignore)
        for _ in range(4):
            worker = until_busy(own_cluster)
            worker.kill()  # the worker alone: what it has started has to notice
            worker.wait()
        message = "4 workers of the Dask cluster were lost while they ran this fit."
        assert fit.result(PATIENCE) == Fault("system", "WorkerLost", message)
    wait_until(lambda: not list(own_cluster.folder.glob("pymp-*")), PATIENCE)


@pytest.mark.soak
@pytest.mark.parametrize(
    ("flags", "nanny", "words"),
    [
        ((), True, "may not start child processes: start it with --no-nanny, or with DASK_"),
        (("--memory-limit", "200MiB"), False, "has 200 MB for a fit, which needs 768 MB: start it with a higher"),
    ],
)
def test_worker_that_cannot_fit_is_not_used(
    own_cluster: DaskCluster, plastic_file: Path, flags: tuple[str, ...], nanny: bool, words: str
) -> None:
    own_cluster.start_scheduler()
    own_cluster.add_worker(*flags, nanny=nanny)
    with closing(Stage(own_cluster).engine()) as engine:
        until(lambda: fault_of(engine), lambda fault: words in str(fault))
        own_cluster.add_worker()
        fit = engine.submit(FitTask("one", plastic_file, QUICK), ignore)
        assert isinstance(fit.result(PATIENCE), FitDocument)


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("tcp://no-such-host.invalid:8786", "no-such-host.invalid"),
        ("carrier-pigeon://host:8786", "carrier-pigeon"),
        ("tls://127.0.0.1:1", "TLS"),
    ],
)
def test_unreachable_scheduler_is_reported_in_one_sentence(address: str, words: str) -> None:
    with closing(DaskEngine(address, 1)) as engine:
        fault = str(fault_of(engine))
    start = f"The Dask scheduler at {address} cannot be reached: "
    assert fault.startswith(start)
    assert words in fault.removeprefix(start)
    assert "\n" not in fault


def test_versions_are_those_of_what_computes() -> None:
    expected = numpy.__version__, scipy.__version__, platform.python_version()
    assert (versions().numpy, versions().scipy, versions().python) == expected
