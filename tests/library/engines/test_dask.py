"""A Dask cluster that is not there, is broken, or has other software: no fit is lost, and what is wrong is said."""

import gc
import platform
import signal
import warnings
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict
from pathlib import Path

import numpy
import pytest
import scipy

from dsbrdf.engines import DaskEngine, Fault, FitDocument, FitTask, dask
from dsbrdf.version import Versions, versions
from tests.support.dask_cluster import DaskCluster
from tests.support.engines import (
    ENDLESS,
    LIMITS,
    MIDDLE,
    PATIENCE,
    QUICK,
    Stage,
    assert_same,
    fault_of,
    fitted_by_library,
    ignore,
    started,
    until,
    until_busy,
)
from tests.support.processes import wait_until

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks at processes in /proc"),
]


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
        assert_same(fit.result(PATIENCE), fitted_by_library(plastic_file, QUICK)[0])
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
        (
            ("--memory-limit", "200MiB"),
            False,
            "has 200 MB for a fit, which needs 768 MB: start it with a higher --memory",
        ),
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


@pytest.mark.soak
def test_scheduler_that_hangs_is_a_fault_until_it_answers(own_cluster: DaskCluster, plastic_file: Path) -> None:
    own_cluster.start_scheduler()
    own_cluster.add_worker()
    scheduler = own_cluster.scheduler
    assert scheduler is not None
    with started(DaskEngine(own_cluster.address, 1, LIMITS)) as engine:
        try:
            scheduler.send_signal(signal.SIGSTOP)
            fault = until(lambda: fault_of(engine), bool)
            assert "cannot be reached: " in str(fault)
            fit = engine.submit(FitTask("one", plastic_file, QUICK), ignore)
        finally:
            scheduler.send_signal(signal.SIGCONT)
        assert isinstance(fit.result(PATIENCE), FitDocument)


def test_versions_are_those_of_what_computes() -> None:
    expected = numpy.__version__, scipy.__version__, platform.python_version()
    assert (versions().numpy, versions().scipy, versions().python) == expected
