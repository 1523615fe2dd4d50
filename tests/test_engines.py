"""What every engine promises, held against each of them: a cluster has real processes here."""

import asyncio
import json
import math
import multiprocessing
import os
import signal
import subprocess
import sys
import warnings
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

import dsbrdf
from dsbrdf import FitOptions
from dsbrdf.engines import dask_cluster as cluster_room
from dsbrdf.engines import worker_process as child
from dsbrdf.engines.dask import DaskEngine
from dsbrdf.engines.engine import NOT_STARTED, Engine, Fault, FitLimits, FitTask, Fitted, Outcome
from dsbrdf.engines.fair_slots import FairSlots
from dsbrdf.engines.fit_steps import reduce_measurement
from dsbrdf.engines.local import LocalEngine
from dsbrdf.output.serialize import to_json
from tests.dask_cluster import DaskCluster, forked
from tests.service.running import alive, wait_until

pytestmark = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks at processes in /proc")

QUICK = FitOptions(method="paper", n_lobes=1, em_iterations=3)
MIDDLE = FitOptions(method="paper", n_lobes=8, em_iterations=100)
SLOW = FitOptions(n_lobes=8, ring_lobes=2)
ENDLESS = FitOptions(n_lobes=8, ring_lobes=2, knots=tuple(map(math.radians, range(81))))  # minutes
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


@pytest.fixture(params=["local", "dask"])
def stage(request: pytest.FixtureRequest) -> Stage:
    return Stage(None if request.param == "local" else request.getfixturevalue("cluster"))


@asynccontextmanager
async def started(engine: Engine) -> AsyncIterator[Engine]:
    await engine.start()
    try:
        await ready(engine)
        yield engine
    finally:
        await engine.close()


async def ready(engine: Engine) -> None:
    await until(lambda: fault_of(engine), lambda fault: fault is None)


async def fault_of(engine: Engine) -> str | None:
    try:
        await engine.check()
    except RuntimeError as error:
        return str(error)
    return None


async def until(ask: Callable[[], Awaitable[Any]], good: Callable[[Any], bool]) -> Any:
    async with asyncio.timeout(PATIENCE):
        while not good(answer := await ask()):
            await asyncio.sleep(0.02)
    return answer


async def until_fitting(stage: Stage) -> list[int]:
    async def fitting() -> list[int]:
        return stage.fitting()

    found: list[int] = await until(fitting, bool)
    return found


async def until_busy(cluster: DaskCluster) -> "subprocess.Popen[bytes]":
    """Return a worker that fits."""

    async def busy() -> "subprocess.Popen[bytes] | None":
        return next((worker for worker in cluster.workers if forked(worker.pid)), None)

    worker: subprocess.Popen[bytes] = await until(busy, bool)
    return worker


def run(stage: Stage, task: FitTask, limits: FitLimits = LIMITS) -> tuple[Outcome, list[float]]:
    shares: list[float] = []

    async def body() -> Outcome:
        async with started(stage.engine(limits)) as engine:
            return await engine.run(task, shares.append)

    return asyncio.run(body()), shares


def content(document: str) -> Any:
    """A stored fit without its timings."""
    plain = json.loads(document)
    del plain["report"]["timings"]
    return plain


@pytest.mark.parametrize(
    "options",
    [
        MIDDLE,
        FitOptions(method="paper", n_lobes=2, em_iterations=5, weighting="log", robust=True, horizon_cutoff=1.2),
        FitOptions(n_lobes=1, ring_lobes=0, weighting="cosine"),
    ],
    ids=["plain", "log and robust", "global"],
)
def test_the_document_is_that_of_the_library_to_the_last_bit(
    stage: Stage, plastic_file: Path, options: FitOptions
) -> None:
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", dsbrdf.ConvergenceWarning)
        expected = dsbrdf.fit(dsbrdf.read_merl(plastic_file), options)
    outcome, _ = run(stage, FitTask("one", plastic_file, options))
    assert isinstance(outcome, Fitted)
    document = to_json(expected.model, expected.report)
    assert content(outcome.document) == content(document)
    timings = json.loads(outcome.document)["report"]["timings"]
    assert list(timings) == list(expected.report.timings)
    assert all(seconds > 0 for seconds in timings.values())
    assert list(outcome.metrics) == list(expected.report.metrics)
    assert outcome.metrics == expected.report.metrics
    assert outcome.metrics["male"] is not None
    assert outcome.warnings == tuple(str(warning.message) for warning in said)


def test_progress_never_falls(stage: Stage, plastic_file: Path) -> None:
    _, shares = run(stage, FitTask("one", plastic_file, MIDDLE))
    assert shares == sorted(set(shares))
    assert len(shares) > 3
    assert 0.0 < shares[0] < 0.5
    assert shares[-1] == 1.0


@pytest.mark.parametrize(
    ("content", "options", "type_"),
    [
        (b"nothing of the kind", QUICK, "MeasurementFormatError"),
        (None, FitOptions(method="paper", n_lobes=8, mask=10.0, horizon_cutoff=0.03), "FitError"),
    ],
    ids=["no measurement", "no data left"],
)
def test_a_fault_of_the_input_is_told(
    stage: Stage, plastic_file: Path, tmp_path: Path, content: bytes | None, options: FitOptions, type_: str
) -> None:
    path = plastic_file
    if content is not None:
        path = tmp_path / "other.binary"
        path.write_bytes(content)
    outcome, _ = run(stage, FitTask("one", path, options))
    assert isinstance(outcome, Fault)
    assert (outcome.origin, outcome.type) == ("input", type_)
    assert outcome.message


def test_a_file_that_is_gone_is_a_fault_of_the_system(stage: Stage, tmp_path: Path) -> None:
    outcome, _ = run(stage, FitTask("one", tmp_path / "gone.binary", QUICK))
    message = "The stored measurement could not be read: No such file or directory."
    assert outcome == Fault("system", "MeasurementUnreadable", message)


def test_a_fit_has_a_memory_limit(stage: Stage, plastic_file: Path) -> None:
    outcome, _ = run(stage, FitTask("one", plastic_file, SLOW), FitLimits(60.0, 200))
    assert outcome == Fault("compute", "MemoryLimit", "The fit needs more memory than a fit may use.")


def test_a_fit_has_a_time_limit(stage: Stage, plastic_file: Path) -> None:
    outcome, _ = run(stage, FitTask("one", plastic_file, ENDLESS), FitLimits(0.5, 4096))
    assert outcome == Fault("compute", "TimeLimit", "The fit took longer than the 0.5 s that a fit may take.")
    wait_until(lambda: not stage.fitting())


def test_a_killed_process_takes_its_own_fit_only(stage: Stage, plastic_file: Path) -> None:
    async def body() -> None:
        async with started(stage.engine()) as engine:
            fit = asyncio.create_task(engine.run(FitTask("one", plastic_file, ENDLESS), lambda _: None))
            for pid in await until_fitting(stage):
                os.kill(pid, signal.SIGKILL)
            outcome = await fit
            assert isinstance(outcome, Fault)
            assert outcome.origin == "system"
            assert outcome.type in ("ProcessLost", NOT_STARTED)  # the latter if it had not been told yet what to do
            assert isinstance(await engine.run(FitTask("two", plastic_file, QUICK), lambda _: None), Fitted)

    asyncio.run(body())


def test_cancelling_frees_the_processor_within_a_second(stage: Stage, plastic_file: Path) -> None:
    async def body() -> None:
        async with started(stage.engine()) as engine:
            took = []
            for _ in range(3):
                fit = asyncio.create_task(engine.run(FitTask("one", plastic_file, ENDLESS), lambda _: None))
                victims = await until_fitting(stage)
                begin = asyncio.get_running_loop().time()
                fit.cancel()
                with pytest.raises(asyncio.CancelledError):
                    await fit
                while any(alive(pid) for pid in victims):
                    await asyncio.sleep(0.01)
                took.append(asyncio.get_running_loop().time() - begin)
            assert min(took) < 1.0  # the others may have met a busy machine
            assert isinstance(await engine.run(FitTask("two", plastic_file, QUICK), lambda _: None), Fitted)

    asyncio.run(body())


def test_no_process_outlives_the_engine(stage: Stage, plastic_file: Path) -> None:
    async def body() -> list[int]:
        async with started(stage.engine()) as engine:
            fit = asyncio.create_task(engine.run(FitTask("one", plastic_file, ENDLESS), lambda _: None))
            victims = await until_fitting(stage)
            fit.cancel()
            await asyncio.wait([fit])
        return victims

    victims = asyncio.run(body())
    wait_until(lambda: not any(alive(pid) for pid in victims))
    wait_until(lambda: not stage.fitting() and not forked(os.getpid()))


@pytest.mark.parametrize("elsewhere", [False, True], ids=["here", "elsewhere"])
def test_so_many_are_in_flight_as_there_is_room_for(
    stage: Stage, monkeypatch: pytest.MonkeyPatch, *, elsewhere: bool
) -> None:
    if elsewhere:
        monkeypatch.setattr(cluster_room, "_host", lambda address: address)
    # One more than threads is prepared for other machines, so that they need not wait.
    room = 2 if elsewhere and stage.cluster is not None else 1
    begun: list[int] = []

    async def fit_one(engine: Engine, number: int, go: asyncio.Event) -> None:
        async with engine.slot():
            begun.append(number)
            await go.wait()

    async def body() -> None:
        async with started(stage.engine()) as engine:
            go = asyncio.Event()
            tasks = [asyncio.create_task(fit_one(engine, number, go)) for number in range(5)]
            await asyncio.sleep(0.1)
            assert begun == list(range(room))
            go.set()
            await asyncio.gather(*tasks)
            assert begun == [0, 1, 2, 3, 4]

    asyncio.run(body())


SCRIPT = """
import asyncio, sys
from pathlib import Path
from dsbrdf import FitOptions
from dsbrdf.engines.engine import FitTask
from dsbrdf.engines.{room} import {engine}

async def main():
    engine = {engine}({arguments})
    await engine.start()
    while True:
        try:
            await engine.check()
            break
        except RuntimeError:
            await asyncio.sleep(0.1)
    print("ready", flush=True)
    options = FitOptions({options})
    print(type(await engine.run(FitTask("one", Path(sys.argv[1]), options), lambda _: None)).__name__, flush=True)
    await engine.close()

asyncio.run(main())
"""


def script(stage: Stage, folder: Path, options: str) -> Path:
    """A program without ``if __name__ == "__main__"`` that has one fit made."""
    arguments = "1" if stage.cluster is None else f"{stage.cluster.address!r}, 1"
    room, engine = ("local", "LocalEngine") if stage.cluster is None else ("dask", "DaskEngine")
    path = folder / "program.py"
    path.write_text(SCRIPT.format(room=room, engine=engine, arguments=arguments, options=options))
    return path


def test_the_main_module_is_not_run_once_more(stage: Stage, plastic_file: Path, tmp_path: Path) -> None:
    program = script(stage, tmp_path, "method='paper', n_lobes=1, em_iterations=3")
    answer = subprocess.run(
        [sys.executable, str(program), str(plastic_file)], capture_output=True, text=True, timeout=PATIENCE
    )
    assert (answer.stdout, answer.stderr) == ("ready\nFitted\n", "")


def test_nothing_goes_on_after_a_kill(stage: Stage, plastic_file: Path, tmp_path: Path) -> None:
    program = script(stage, tmp_path, repr(ENDLESS).removeprefix("FitOptions(").removesuffix(")"))
    process = subprocess.Popen([sys.executable, str(program), str(plastic_file)], stdout=subprocess.PIPE)
    with process:
        local = stage.cluster is None
        wait_until(lambda: bool(forked(process.pid) if local else stage.fitting()), PATIENCE)
        victims = forked(process.pid) + ([] if local else stage.fitting())
        process.kill()
    wait_until(lambda: not any(alive(pid) for pid in victims))


def test_without_fork_servers_processes_are_started_afresh(plastic_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(multiprocessing, "get_all_start_methods", lambda: ["spawn"])
    assert child._context().get_start_method() == "spawn"
    outcome, shares = run(Stage(None), FitTask("one", plastic_file, QUICK))
    assert isinstance(outcome, Fitted)
    assert shares[-1] == 1.0


# the cluster alone


def test_only_profiles_travel(plastic_file: Path) -> None:
    plain = reduce_measurement(FitTask("one", plastic_file, FitOptions()), lambda _: None)
    weighted = reduce_measurement(FitTask("one", plastic_file, FitOptions(weighting="log")), lambda _: None)
    assert len(plain.payload) < 400_000
    assert len(weighted.payload) < 1_000_000


def test_a_cluster_is_waited_for_and_followed(own_cluster: DaskCluster, plastic_file: Path) -> None:
    stage = Stage(own_cluster)
    address = own_cluster.address

    async def body() -> None:
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
        assert isinstance(await fit, Fitted)
        await until(lambda: begun(turns), lambda count: count == 1)
        own_cluster.add_worker()
        await until(lambda: begun(turns), lambda count: count == 2)
        own_cluster.kill_worker(one)
        await until(lambda: fault_of(engine), lambda fault: fault is None)
        for turn in turns:
            turn.cancel()
        await asyncio.wait(turns)
        await engine.close()

    held: list[object] = []

    async def hold(engine: Engine) -> None:
        async with engine.slot() as turn:
            held.append(turn)
            await asyncio.sleep(PATIENCE)

    async def begun(_: object) -> int:
        return len(held)

    asyncio.run(body())


def test_a_lost_worker_s_fit_runs_again_and_others_go_on(own_cluster: DaskCluster, plastic_file: Path) -> None:
    own_cluster.start_scheduler()
    own_cluster.add_worker()
    own_cluster.add_worker()
    shares: list[float] = []

    async def body() -> None:
        async with started(DaskEngine(own_cluster.address, 2, LIMITS)) as engine:
            await until(lambda: asyncio.sleep(0, own_cluster.log().count("Registered to")), lambda count: count == 2)
            fits = [asyncio.create_task(engine.run(FitTask("one", plastic_file, MIDDLE), shares.append))]
            victim = await until_busy(own_cluster)
            fits.append(asyncio.create_task(engine.run(FitTask("two", plastic_file, MIDDLE), lambda _: None)))
            own_cluster.kill_worker(victim)
            assert [type(outcome) for outcome in await asyncio.gather(*fits)] == [Fitted, Fitted]
        assert shares == sorted(set(shares))

    asyncio.run(body())


def test_a_fit_that_loses_worker_after_worker_is_given_up(own_cluster: DaskCluster, plastic_file: Path) -> None:
    own_cluster.start_scheduler()
    stage = Stage(own_cluster)
    for _ in range(4):
        own_cluster.add_worker()

    async def body() -> None:
        async with started(stage.engine()) as engine:
            fit = asyncio.create_task(engine.run(FitTask("one", plastic_file, ENDLESS), lambda _: None))
            for _ in range(4):
                own_cluster.kill_worker(await until_busy(own_cluster))
            outcome = await fit
            assert isinstance(outcome, Fault)
            assert (outcome.origin, outcome.type) == ("system", "WorkerLost")
            assert outcome.message == "4 workers of the Dask cluster were lost while they ran this fit."

    asyncio.run(body())


def test_a_fit_outlives_the_scheduler(own_cluster: DaskCluster, plastic_file: Path) -> None:
    own_cluster.start_scheduler()
    own_cluster.add_worker()
    stage = Stage(own_cluster)

    async def body() -> None:
        async with started(stage.engine()) as engine:
            fit = asyncio.create_task(engine.run(FitTask("one", plastic_file, SLOW), lambda _: None))
            for _ in range(2):
                await until_fitting(stage)
                own_cluster.kill_scheduler()
                await until(lambda: fault_of(engine), lambda fault: fault is not None)
                await until(lambda: asyncio.sleep(0), lambda _: not stage.fitting())
                own_cluster.start_scheduler()
                own_cluster.add_worker()  # Dask's workers end when their scheduler is lost
            assert isinstance(await fit, Fitted)

    asyncio.run(body())


def test_a_worker_that_may_not_start_processes_is_not_used(own_cluster: DaskCluster, plastic_file: Path) -> None:
    own_cluster.start_scheduler()
    own_cluster.add_worker(nanny=True)
    stage = Stage(own_cluster)

    async def body() -> None:
        engine = stage.engine()
        await engine.start()
        fault = await until(lambda: fault_of(engine), lambda fault: fault is not None and "processes" in fault)
        assert "may not start child processes" in fault
        assert "--no-nanny" in fault
        assert "DASK_DISTRIBUTED__WORKER__DAEMON=false" in fault
        own_cluster.add_worker()
        await ready(engine)
        assert isinstance(await engine.run(FitTask("one", plastic_file, QUICK), lambda _: None), Fitted)
        await engine.close()

    asyncio.run(body())


def test_a_worker_of_other_versions_is_not_used(cluster: DaskCluster, monkeypatch: pytest.MonkeyPatch) -> None:
    found = dsbrdf.fit.__globals__["versions"]()
    monkeypatch.setattr(cluster_room, "versions", lambda: found | {"numpy": "0.1"})

    async def body() -> str:
        engine = DaskEngine(cluster.address, 1)
        await engine.start()
        try:
            fault: str = await until(lambda: fault_of(engine), lambda fault: fault is not None and "numpy" in fault)
        finally:
            await engine.close()
        return fault

    assert f"has numpy {found['numpy']}, not 0.1" in asyncio.run(body())


def test_fits_stay_within_the_memory_of_their_worker(own_cluster: DaskCluster, plastic_file: Path) -> None:
    own_cluster.start_scheduler()
    own_cluster.add_worker("--memory-limit", "200MiB")
    outcome, _ = run(Stage(own_cluster), FitTask("one", plastic_file, SLOW))
    assert outcome == Fault("compute", "MemoryLimit", "The fit needs more memory than a fit may use.")


# who comes first is served first


def test_places_are_given_in_order_and_to_the_emptiest() -> None:
    async def body() -> None:
        places = FairSlots({"a": 2, "b": 1})
        taken: list[str] = []
        go = asyncio.Event()

        async def take(number: int) -> None:
            async with places.slot() as place:
                taken.append(f"{number}{place}")
                await go.wait()

        tasks = [asyncio.create_task(take(number)) for number in range(6)]
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert taken == ["0a", "1a", "2b"]
        tasks[3].cancel()
        places.resize({"c": 1})
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert taken[3:] == ["4c"]
        go.set()
        await asyncio.wait(tasks)
        assert taken[4:] == ["5c"]
        places.resize({})
        with pytest.raises(asyncio.TimeoutError):
            await asyncio.wait_for(take(9), 0.01)

    asyncio.run(body())


def test_a_place_given_to_one_who_leaves_goes_to_the_next() -> None:
    async def body() -> None:
        places = FairSlots({"a": 1})

        async def take() -> None:
            async with places.slot():
                await asyncio.sleep(0)

        async with places.slot():
            waiting = asyncio.create_task(take())
            await asyncio.sleep(0)
        waiting.cancel()  # it has been given the place, and has not run since
        await asyncio.wait([waiting])
        await asyncio.wait_for(take(), 1.0)

    asyncio.run(body())
