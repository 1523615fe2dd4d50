import asyncio
import pickle
from pathlib import Path

import pytest

from dsbrdf import FitOptions, Profiles
from dsbrdf.engines.dask import DaskEngine
from dsbrdf.engines.engine import Engine, Fault, FitTask
from dsbrdf.engines.local import reduce_measurement
from dsbrdf.fitting.report import FitResult
from tests.support.dask_cluster import DaskCluster
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
from tests.support.processes import wait_until

pytestmark = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks at processes in /proc")


def test_task_for_a_worker_holds_only_profiles(plastic_file: Path) -> None:
    profiles, seconds = reduce_measurement(FitTask("one", plastic_file, FitOptions()), lambda _: None)
    assert isinstance(profiles, Profiles)
    assert len(pickle.dumps(profiles)) < 6_000_000
    assert seconds > 0.0


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
async def test_fit_of_a_lost_worker_runs_again(own_cluster: DaskCluster, plastic_file: Path) -> None:
    own_cluster.start_scheduler()
    own_cluster.add_worker()
    own_cluster.add_worker()
    shares: list[float] = []
    async with started(DaskEngine(own_cluster.address, 2, LIMITS)) as engine:
        await until(lambda: asyncio.sleep(0, own_cluster.log().count("Registered to")), lambda count: count == 2)
        fits = [asyncio.create_task(engine.run(FitTask("one", plastic_file, MIDDLE), shares.append))]
        victim = await until_busy(own_cluster)
        fits.append(asyncio.create_task(engine.run(FitTask("two", plastic_file, MIDDLE), lambda _: None)))
        own_cluster.kill_worker(victim)
        assert all(isinstance(outcome, FitResult) for outcome in await asyncio.gather(*fits))
    assert shares == sorted(set(shares))


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
    stage = Stage(own_cluster)
    async with started(stage.engine()) as engine:
        fit = asyncio.create_task(engine.run(FitTask("one", plastic_file, MIDDLE), lambda _: None))
        for _ in range(2):
            await until_fitting(stage)
            own_cluster.kill_scheduler()
            await until(lambda: fault_of(engine), lambda fault: fault is not None)
            await until(lambda: asyncio.sleep(0), lambda _: not stage.fitting())
            own_cluster.start_scheduler()
            own_cluster.add_worker()  # Dask's workers end when their scheduler is lost
        assert isinstance(await fit, FitResult)


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
