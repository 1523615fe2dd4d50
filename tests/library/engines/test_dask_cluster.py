import asyncio
import os
import random
import shutil
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from dsbrdf.engines import dask_cluster as cluster_room
from dsbrdf.engines.dask import DaskEngine
from dsbrdf.engines.engine import Fault, FitLimits, FitTask
from dsbrdf.engines.local import WorkerProcesses, complete_report, fit_reduced, reduce_measurement
from dsbrdf.fitting.report import FitResult
from dsbrdf.version import versions
from tests.support.dask_cluster import DaskCluster, forked
from tests.support.engines import (
    ENDLESS,
    LIMITS,
    PATIENCE,
    QUICK,
    Stage,
    fault_of,
    in_event_loop,
    ready,
    started,
    until,
    until_fitting,
)
from tests.support.processes import alive
from tests.support.soak import repeats

pytestmark = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks at processes in /proc")


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("tcp://no-such-host.invalid:8786", "no-such-host.invalid"),
        ("carrier-pigeon://host:8786", "carrier-pigeon"),
        ("tls://127.0.0.1:1", "TLS"),
    ],
)
def test_unreachable_scheduler_is_reported_in_one_sentence(
    address: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_room, "_CONNECT_TIMEOUT", 1.0)
    fault = fault_at(address, lambda fault: fault is not None and "has not been reached yet" not in fault)
    start = f"The Dask scheduler at {address} cannot be reached: "
    assert fault.startswith(start)
    assert words in fault.removeprefix(start)
    assert "\n" not in fault


def fault_at(address: str, known: Callable[[str | None], bool]) -> str:
    """Return the fault of an engine with a cluster, once it is known."""

    async def body() -> str:
        engine = DaskEngine(address, 1)
        await engine.start()
        try:
            fault: str = await until(lambda: fault_of(engine), known)
        finally:
            await engine.close()
        return fault

    return asyncio.run(body())


def test_worker_with_other_versions_is_not_used(cluster: DaskCluster, monkeypatch: pytest.MonkeyPatch) -> None:
    found = versions()
    monkeypatch.setattr(cluster_room, "versions", lambda: replace(found, numpy="0.1"))
    fault = fault_at(cluster.address, lambda fault: fault is not None and "numpy" in fault)
    assert f"has numpy {found.numpy}, not 0.1" in fault


@in_event_loop
async def test_fit_of_a_hanging_worker_runs_on_another_and_a_hanging_scheduler_is_a_fault_until_it_answers(
    own_cluster: DaskCluster, plastic_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_room, "_HEARTBEAT_TIMEOUT", 3.0)
    own_cluster.start_scheduler()
    hung, scheduler = own_cluster.add_worker(), own_cluster.scheduler
    assert scheduler is not None
    try:
        async with started(DaskEngine(own_cluster.address, 1, LIMITS)) as engine:
            fit = asyncio.create_task(engine.run(FitTask("one", plastic_file, ENDLESS), lambda _: None))
            (victim,) = await until_fitting(Stage(own_cluster))
            hung.send_signal(signal.SIGSTOP)
            fault = await until(lambda: fault_of(engine), lambda fault: fault is not None)
            assert fault.endswith("has sent nothing for 3 s.")
            other = own_cluster.add_worker()
            await until(lambda: asyncio.sleep(0, forked(other.pid)), bool)
            hung.send_signal(signal.SIGCONT)
            await until(lambda: asyncio.sleep(0), lambda _: not alive(victim))
            fit.cancel()
            await asyncio.wait([fit])
            scheduler.send_signal(signal.SIGSTOP)
            fault = await until(lambda: fault_of(engine), lambda fault: fault is not None)
            assert fault.endswith("cannot be reached: no answer within 3 s.")
            fit = asyncio.create_task(engine.run(FitTask("one", plastic_file, QUICK), lambda _: None))
            scheduler.send_signal(signal.SIGCONT)
            await ready(engine)
            assert isinstance(await fit, FitResult)
    finally:
        for process in (hung, scheduler):
            process.send_signal(signal.SIGCONT)


@in_event_loop
async def test_worker_that_did_not_describe_itself_is_asked_again(
    cluster: DaskCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_room, "_DESCRIBE_TIMEOUT", 0.0)
    monkeypatch.setattr(cluster_room, "_RETRY_DELAY", 0.1)
    engine = DaskEngine(cluster.address, 1)
    await engine.start()
    await until(lambda: fault_of(engine), lambda fault: "has not answered within 0 s" in (fault or ""))
    monkeypatch.setattr(cluster_room, "_DESCRIBE_TIMEOUT", PATIENCE)
    await ready(engine)
    await engine.close()


@in_event_loop
async def test_fit_is_cancelled_at_any_moment(cluster: DaskCluster, plastic_file: Path) -> None:
    stage, moments = Stage(cluster), random.Random(4)
    async with started(DaskEngine(cluster.address, 1, LIMITS)) as engine:
        for last in (0.1, 0.3, 1.0) * repeats(1, 4):
            fits = [asyncio.create_task(engine.run(FitTask("one", plastic_file, QUICK), lambda _: None))]
            fits += [asyncio.create_task(engine.run(FitTask("two", plastic_file, ENDLESS), lambda _: None))]
            await asyncio.sleep(moments.uniform(0.0, last))
            for fit in fits:
                fit.cancel()
            await asyncio.wait(fits)
            assert forked(os.getpid()) == []
            await until(lambda: asyncio.sleep(0), lambda _: not stage.fitting())
        assert isinstance(await engine.run(FitTask("two", plastic_file, QUICK), lambda _: None), FitResult)


@in_event_loop
async def test_waiting_fit_is_cancelled_at_once() -> None:
    children = WorkerProcesses(1, FitLimits())
    first = asyncio.create_task(children.run(_sleep, 60.0, on_progress=lambda _: None))
    second = asyncio.create_task(children.run(_sleep, 60.0, on_progress=lambda _: None))
    await until(lambda: asyncio.sleep(0, forked(os.getpid())), bool)
    second.cancel()
    await asyncio.wait([second], timeout=PATIENCE)
    assert second.cancelled()
    assert not first.done()
    first.cancel()
    await asyncio.wait([first])
    await children.close()


def _sleep(seconds: float, _: object) -> None:
    time.sleep(seconds)


def test_file_changed_during_its_fit_is_a_system_fault(plastic_file: Path, tmp_path: Path) -> None:
    path = tmp_path / "changing.binary"
    shutil.copyfile(plastic_file, path)
    task = FitTask("one", path, QUICK)
    profiles, seconds = reduce_measurement(task, lambda _: None)
    fitted = fit_reduced(profiles, task.options, lambda _: None)
    assert isinstance(fitted, FitResult)
    with path.open("r+b") as file:
        file.seek(-8, os.SEEK_END)
        file.write(bytes(8))
    outcome = complete_report(fitted, task, profiles.sha256, seconds, lambda _: None)
    message = "The measurement's file was changed while it was being fitted."
    assert outcome == Fault("system", "MeasurementChanged", message)
