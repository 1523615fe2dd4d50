"""What every engine promises, held against each of them: a cluster has real processes here."""

import asyncio
import multiprocessing
import os
import signal
import subprocess
import sys
import warnings
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import dsbrdf
from dsbrdf import FitOptions
from dsbrdf.engines import dask_cluster as cluster_room
from dsbrdf.engines import worker_process as child
from dsbrdf.engines.engine import NOT_STARTED, Engine, Fault, FitLimits, FitTask
from dsbrdf.fitting.report import FitResult
from dsbrdf.output.serialize import to_json
from tests.support.dask_cluster import forked
from tests.support.engines import (
    ENDLESS,
    PATIENCE,
    QUICK,
    SLOW,
    Stage,
    content,
    in_event_loop,
    run,
    started,
    until,
    until_fitting,
)
from tests.support.mixtures import mixture, scattered_samples
from tests.support.processes import alive, wait_until
from tests.support.soak import SOAK

pytestmark = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks at processes in /proc")


@pytest.fixture(params=["local", "dask"])
def stage(request: pytest.FixtureRequest) -> Stage:
    return Stage(None if request.param == "local" else request.getfixturevalue("cluster"))


@pytest.mark.parametrize(
    "options",
    [
        FitOptions(method="paper", n_lobes=2, em_iterations=5, weighting="log", robust=True, horizon_cutoff=1.2),
        FitOptions(n_lobes=1, ring_lobes=0, weighting="cosine"),
    ],
    ids=["paper, log and robust", "global"],
)
def test_result_equals_that_of_the_library_bit_for_bit(stage: Stage, plastic_file: Path, options: FitOptions) -> None:
    expected, said = fitted_by_library(plastic_file, options)
    outcome, shares = run(stage, FitTask("one", plastic_file, options))
    assert isinstance(outcome, FitResult)
    found, document = (to_json(result.model, result.report) for result in (outcome, expected))
    assert content(found) == content(document)
    assert list(outcome.report.timings) == list(expected.report.timings)
    assert all(seconds > 0 for seconds in outcome.report.timings.values())
    assert said == [text for text in outcome.report.warnings if "before they converged" in text]
    assert shares == sorted(set(shares))
    assert shares[-1] == 1.0


def test_scattered_samples_are_fitted_as_by_the_library(stage: Stage, tmp_path: Path) -> None:
    samples, path = scattered_samples(mixture(1, 0), 400), tmp_path / "samples.csv"
    head = ",".join(f"omega_{side}_{axis}" for side in ("in", "out") for axis in "xyz")
    table = np.hstack([samples.omega_in, samples.omega_out, samples.values])
    np.savetxt(path, table, delimiter=",", header=f"{head},red,green,blue", comments="")
    outcome, _ = run(stage, FitTask("one", path, FitOptions(n_lobes=1)))
    assert isinstance(outcome, FitResult)
    expected = dsbrdf.fit(path, n_lobes=1)
    found, document = (to_json(result.model, result.report) for result in (outcome, expected))
    assert content(found) == content(document)
    assert list(outcome.report.timings) == list(expected.report.timings)


@cache
def fitted_by_library(file: Path, options: FitOptions) -> tuple[FitResult, list[str]]:
    """What the library makes of a file, and its warnings; every engine is compared with it."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", dsbrdf.ConvergenceWarning)
        result = dsbrdf.fit(dsbrdf.read_merl(file), options)
    return result, [str(warning.message) for warning in said]


@in_event_loop
async def test_progress_rises_while_the_fit_runs(stage: Stage, plastic_file: Path) -> None:
    shares: list[float] = []
    async with started(stage.engine()) as engine:
        fit = asyncio.create_task(engine.run(FitTask("one", plastic_file, SLOW), shares.append))
        await until(lambda: asyncio.sleep(0.02, len(shares)), lambda count: count > 3)
        fit.cancel()
        await asyncio.wait([fit])
    assert shares == sorted(set(shares))
    assert 0.0 < shares[0] < 0.5


@pytest.mark.parametrize(
    ("content", "options", "type_"),
    [
        (b"nothing of the kind", QUICK, "MeasurementFormatError"),
        (None, FitOptions(method="paper", n_lobes=8, mask=10.0, horizon_cutoff=0.03), "FitError"),
    ],
    ids=["no measurement", "no data left"],
)
def test_unusable_input_is_an_input_fault(
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


def test_missing_file_is_a_system_fault(stage: Stage, tmp_path: Path) -> None:
    outcome, _ = run(stage, FitTask("one", tmp_path / "gone.binary", QUICK))
    message = "The stored measurement could not be read: No such file or directory."
    assert outcome == Fault("system", "MeasurementUnreadable", message)


@pytest.mark.parametrize(
    ("options", "limits", "fault"),
    [
        (SLOW, FitLimits(60.0, 200), ("MemoryLimit", "The fit needs more memory than a fit may use.")),
        (ENDLESS, FitLimits(0.5, 4096), ("TimeLimit", "The fit took longer than the 0.5 s that a fit may take.")),
    ],
    ids=["memory", "time"],
)
def test_fit_over_a_limit_is_a_compute_fault(
    stage: Stage, plastic_file: Path, options: FitOptions, limits: FitLimits, fault: tuple[str, str]
) -> None:
    outcome, _ = run(stage, FitTask("one", plastic_file, options), limits)
    assert outcome == Fault("compute", *fault)
    wait_until(lambda: not stage.fitting())


@in_event_loop
async def test_killed_process_fails_only_its_own_fit(stage: Stage, plastic_file: Path) -> None:
    async with started(stage.engine()) as engine:
        fit = asyncio.create_task(engine.run(FitTask("one", plastic_file, ENDLESS), lambda _: None))
        for pid in await until_fitting(stage):
            os.kill(pid, signal.SIGKILL)
        outcome = await fit
        assert isinstance(outcome, Fault)
        assert outcome.origin == "system"
        assert outcome.type in ("ProcessLost", NOT_STARTED)  # the latter if it had not been told yet what to do
        assert isinstance(await engine.run(FitTask("two", plastic_file, QUICK), lambda _: None), FitResult)


@in_event_loop
async def test_cancelling_ends_the_process_of_the_fit_and_closing_all_others(stage: Stage, plastic_file: Path) -> None:
    async with started(stage.engine()) as engine:
        fit = asyncio.create_task(engine.run(FitTask("one", plastic_file, ENDLESS), lambda _: None))
        victims = await until_fitting(stage)
        begin = asyncio.get_running_loop().time()
        fit.cancel()
        with pytest.raises(asyncio.CancelledError):
            await fit
        await until(lambda: asyncio.sleep(0.01, any(map(alive, victims))), lambda any_alive: not any_alive)
        if SOAK:
            assert asyncio.get_running_loop().time() - begin < 1.0
        assert isinstance(await engine.run(FitTask("two", plastic_file, QUICK), lambda _: None), FitResult)
    wait_until(lambda: not stage.fitting() and not forked(os.getpid()))


@pytest.mark.parametrize("elsewhere", [False, True], ids=["here", "elsewhere"])
@in_event_loop
async def test_fits_in_flight_are_as_many_as_there_are_slots(
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

    async with started(stage.engine()) as engine:
        go = asyncio.Event()
        tasks = [asyncio.create_task(fit_one(engine, number, go)) for number in range(5)]
        await until(lambda: asyncio.sleep(0, len(begun)), lambda count: count >= room)
        for _ in range(20):  # gives the event loop time to start one fit too many
            await asyncio.sleep(0)
        assert begun == list(range(room))
        go.set()
        await asyncio.gather(*tasks)
        assert begun == [0, 1, 2, 3, 4]


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


def test_main_module_is_not_imported_by_fit_processes(stage: Stage, plastic_file: Path, tmp_path: Path) -> None:
    program = script(stage, tmp_path, "method='paper', n_lobes=1, em_iterations=3")
    answer = subprocess.run(
        [sys.executable, str(program), str(plastic_file)], capture_output=True, text=True, timeout=PATIENCE
    )
    assert (answer.stdout, answer.stderr) == ("ready\nDecomposedFit\n", "")


def test_killed_program_leaves_no_fit_process(stage: Stage, plastic_file: Path, tmp_path: Path) -> None:
    program = script(stage, tmp_path, repr(ENDLESS).removeprefix("FitOptions(").removesuffix(")"))
    process = subprocess.Popen([sys.executable, str(program), str(plastic_file)], stdout=subprocess.PIPE)
    with process:
        local = stage.cluster is None
        wait_until(lambda: bool(forked(process.pid) if local else stage.fitting()), PATIENCE)
        victims = forked(process.pid) + ([] if local else stage.fitting())
        process.kill()
    wait_until(lambda: not any(alive(pid) for pid in victims))


def test_without_fork_server_processes_are_spawned(plastic_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(multiprocessing, "get_all_start_methods", lambda: ["spawn"])
    assert child._context().get_start_method() == "spawn"
    outcome, shares = run(Stage(None), FitTask("one", plastic_file, QUICK))
    assert isinstance(outcome, FitResult)
    assert shares[-1] == 1.0
