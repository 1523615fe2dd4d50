import asyncio
import os
import pickle
import random
import shutil
import signal
import time
from dataclasses import replace
from pathlib import Path

import pytest

from dsbrdf import Profiles
from dsbrdf.engines import dask_cluster as cluster_room
from dsbrdf.engines.dask import DaskEngine
from dsbrdf.engines.engine import Engine, Fault, FitLimits, FitTask
from dsbrdf.engines.local import WorkerProcesses, complete_report, fit_reduced, reduce_measurement
from dsbrdf.fitting.report import FitResult
from dsbrdf.version import versions
from tests.support.dask_cluster import DaskCluster, forked
from tests.support.engines import (
    ENDLESS,
    LIMITS,
    MIDDLE,
    PATIENCE,
    QUICK,
    SLOW,
    Stage,
    fault_of,
    in_event_loop,
    ready,
    run,
    started,
    until,
    until_busy,
    until_fitting,
)
from tests.support.processes import alive, wait_until
from tests.support.soak import repeats

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks at processes in /proc"),
]


@in_event_loop
async def test_engine_waits_for_the_cluster_and_follows_its_workers(
    own_cluster: DaskCluster, plastic_file: Path
) -> None:
    stage = Stage(own_cluster)
    address = own_cluster.address
    held: list[object] = []

    async def hold(engine: Engine) -> None:
        async with engine.slot() as turn:
            held.append(turn)
            await asyncio.sleep(PATIENCE)

    async def begun(_: object) -> int:
        return len(held)

    engine = stage.engine()
    await engine.start()
    fault = await until(lambda: fault_of(engine), lambda fault: fault is not None and "Timed out" in fault)
    assert fault.startswith(f"The Dask scheduler at {address} cannot be reached: ")
    fit = asyncio.create_task(engine.run(FitTask("one", plastic_file, QUICK), lambda _: None))
    turns = [asyncio.create_task(hold(engine)) for _ in range(4)]

    own_cluster.start_scheduler()
    await until(lambda: fault_of(engine), lambda fault: fault == f"The Dask cluster at {address} has no workers.")
    assert not any(turn.done() for turn in turns)
    assert not fit.done()

    one = own_cluster.add_worker()
    await ready(engine)
    assert isinstance(await fit, FitResult)
    await until(lambda: begun(turns), lambda count: count == 1)
    own_cluster.add_worker()
    await until(lambda: begun(turns), lambda count: count == 2)
    own_cluster.kill_worker(one)
    await until(lambda: fault_of(engine), lambda fault: fault is None)
    for turn in turns:
        turn.cancel()
    await asyncio.wait(turns)
    await engine.close()


@in_event_loop
async def test_fit_that_loses_four_workers_fails_and_they_leave_nothing(
    own_cluster: DaskCluster, plastic_file: Path
) -> None:
    own_cluster.start_scheduler()
    for _ in range(4):
        own_cluster.add_worker()
    async with started(Stage(own_cluster).engine()) as engine:
        fit = asyncio.create_task(engine.run(FitTask("one", plastic_file, ENDLESS), lambda _: None))
        for _ in range(4):
            worker = await until_busy(own_cluster)
            worker.kill()  # the worker alone: what it has started has to notice
            worker.wait()
        message = "4 workers of the Dask cluster were lost while they ran this fit."
        assert await fit == Fault("system", "WorkerLost", message)
    wait_until(lambda: not list(own_cluster.folder.glob("pymp-*")), PATIENCE)


@in_event_loop
async def test_fit_survives_the_loss_of_the_scheduler(own_cluster: DaskCluster, plastic_file: Path) -> None:
    own_cluster.start_scheduler()
    own_cluster.add_worker()
    stage, shares = Stage(own_cluster), list[float]()
    async with started(stage.engine()) as engine:
        fit = asyncio.create_task(engine.run(FitTask("one", plastic_file, MIDDLE), shares.append))
        for _ in range(2):
            await until_fitting(stage)
            own_cluster.kill_scheduler()
            await until(lambda: fault_of(engine), lambda fault: fault is not None)
            await until(lambda: asyncio.sleep(0), lambda _: not stage.fitting())
            own_cluster.start_scheduler()
            own_cluster.add_worker()  # Dask's workers end when their scheduler is lost
        assert isinstance(await fit, FitResult)
    assert shares == sorted(set(shares))


@in_event_loop
async def test_worker_without_permission_for_child_processes_is_not_used(
    own_cluster: DaskCluster, plastic_file: Path
) -> None:
    own_cluster.start_scheduler()
    own_cluster.add_worker(nanny=True)
    stage = Stage(own_cluster)
    engine = stage.engine()
    await engine.start()
    fault = await until(lambda: fault_of(engine), lambda fault: fault is not None and "processes" in fault)
    assert "may not start child processes" in fault
    assert "--no-nanny" in fault
    assert "DASK_DISTRIBUTED__WORKER__DAEMON=false" in fault
    own_cluster.add_worker()
    await ready(engine)
    assert isinstance(await engine.run(FitTask("one", plastic_file, QUICK), lambda _: None), FitResult)
    await engine.close()


def test_fit_over_the_memory_of_its_worker_is_a_compute_fault(own_cluster: DaskCluster, plastic_file: Path) -> None:
    own_cluster.start_scheduler()
    own_cluster.add_worker("--memory-limit", "200MiB")
    outcome, _ = run(Stage(own_cluster), FitTask("one", plastic_file, SLOW))
    assert outcome == Fault("compute", "MemoryLimit", "The fit needs more memory than a fit may use.")


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

    async def body() -> str:
        engine = DaskEngine(address, 1)
        await engine.start()
        try:
            fault: str = await until(
                lambda: fault_of(engine), lambda fault: "not been reached yet" not in (fault or "")
            )
        finally:
            await engine.close()
        return fault

    fault = asyncio.run(body())
    start = f"The Dask scheduler at {address} cannot be reached: "
    assert fault.startswith(start)
    assert words in fault.removeprefix(start)
    assert "\n" not in fault


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
async def test_worker_that_is_not_used_is_asked_again(cluster: DaskCluster, monkeypatch: pytest.MonkeyPatch) -> None:
    found = versions()
    monkeypatch.setattr(cluster_room, "versions", lambda: replace(found, numpy="0.1"))
    monkeypatch.setattr(cluster_room, "_DESCRIBE_TIMEOUT", 0.0)
    monkeypatch.setattr(cluster_room, "_RETRY_DELAY", 0.1)
    engine = DaskEngine(cluster.address, 1)
    await engine.start()
    await until(lambda: fault_of(engine), lambda fault: "has not answered within 0 s" in (fault or ""))
    monkeypatch.setattr(cluster_room, "_DESCRIBE_TIMEOUT", PATIENCE)
    await until(lambda: fault_of(engine), lambda fault: f"has numpy {found.numpy}, not 0.1" in (fault or ""))
    monkeypatch.undo()
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
    first = asyncio.create_task(children.call(_sleep, 60.0))
    second = asyncio.create_task(children.call(_sleep, 60.0))
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


def test_worker_gets_only_profiles_and_a_file_changed_meanwhile_is_a_system_fault(
    plastic_file: Path, tmp_path: Path
) -> None:
    path = tmp_path / "changing.binary"
    shutil.copyfile(plastic_file, path)
    task = FitTask("one", path, QUICK)
    profiles, seconds = reduce_measurement(task, lambda _: None)
    assert isinstance(profiles, Profiles)
    assert len(pickle.dumps(profiles)) < 6_000_000
    assert seconds > 0.0
    fitted = fit_reduced(profiles, task.options, lambda _: None)
    with path.open("r+b") as file:
        file.seek(-8, os.SEEK_END)
        file.write(bytes(8))
    outcome = complete_report(fitted, task, profiles.sha256, seconds, lambda _: None)
    message = "The measurement's file was changed while it was being fitted."
    assert outcome == Fault("system", "MeasurementChanged", message)
