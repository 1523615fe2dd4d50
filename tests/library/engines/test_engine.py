"""What every engine promises, held against each of them: a cluster has real processes here."""

import asyncio
import multiprocessing
import os
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
from dsbrdf.engines.engine import Engine, Fault, FitLimits, FitTask
from dsbrdf.fitting.report import FitResult
from dsbrdf.output.serialize import to_json
from tests.support.dask_cluster import DaskCluster, forked
from tests.support.engines import (
    ENDLESS,
    LIMITS,
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

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks at processes in /proc"),
]
NO_DATA_LEFT = FitOptions(method="paper", n_lobes=8, mask=10.0, horizon_cutoff=0.03)


@pytest.fixture(params=["local", "dask"])
def stage(request: pytest.FixtureRequest) -> Stage:
    return Stage(None if request.param == "local" else request.getfixturevalue("cluster"))


@pytest.fixture(scope="module")
def samples_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    samples, path = scattered_samples(mixture(1, 0), 400), tmp_path_factory.mktemp("samples") / "samples.csv"
    head = ",".join(f"omega_{side}_{axis}" for side in ("in", "out") for axis in "xyz")
    table = np.hstack([samples.omega_in, samples.omega_out, samples.values])
    np.savetxt(path, table, delimiter=",", header=f"{head},red,green,blue", comments="")
    return path


@pytest.mark.parametrize(
    ("data", "options"),
    [
        ("plastic", FitOptions(2, "paper", em_iterations=5, weighting="log", robust=True, horizon_cutoff=1.2)),
        ("plastic", FitOptions(n_lobes=1, ring_lobes=0, weighting="cosine")),
        ("samples", FitOptions(n_lobes=1)),
    ],
    ids=["paper, log and robust", "global", "scattered samples"],
)
def test_result_equals_that_of_the_library_bit_for_bit(
    stage: Stage, data: str, options: FitOptions, request: pytest.FixtureRequest
) -> None:
    path: Path = request.getfixturevalue(f"{data}_file")
    expected, said = fitted_by_library(path, options)
    outcome, shares = run(stage, FitTask("one", path, options))
    assert isinstance(outcome, FitResult)
    found, document = (to_json(result.model, result.report) for result in (outcome, expected))
    assert content(found) == content(document)
    assert list(outcome.report.timings) == list(expected.report.timings)
    assert all(seconds > 0 for seconds in outcome.report.timings.values())
    assert said == [text for text in outcome.report.warnings if " converged: " in text]
    assert shares == sorted(set(shares))
    assert shares[-1] == 1.0


@cache
def fitted_by_library(file: Path, options: FitOptions) -> tuple[FitResult, list[str]]:
    """What the library makes of a file, and its warnings; every engine is compared with it."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", dsbrdf.ConvergenceWarning)
        result = dsbrdf.fit(file, options)
    return result, [str(warning.message) for warning in said]


@pytest.mark.parametrize(
    ("name", "options", "limits", "fault"),
    [
        ("other", QUICK, LIMITS, ("input", "MeasurementFormatError", "a MERL measurement has (90, 90, 180)")),
        ("plastic", NO_DATA_LEFT, LIMITS, ("input", "FitError", "leave no slice with enough valid samples")),
        ("gone", QUICK, LIMITS, ("system", "MeasurementUnreadable", "not be read: No such file or directory.")),
        ("plastic", SLOW, FitLimits(60.0, 200), ("compute", "MemoryLimit", "more memory than a fit may use.")),
        ("plastic", ENDLESS, FitLimits(0.5, 4096), ("compute", "TimeLimit", "took longer than the 0.5 s that a fit")),
    ],
    ids=["no measurement", "no data left", "no file", "memory", "time"],
)
def test_failed_fit_is_a_fault_that_says_why(
    stage: Stage,
    plastic_file: Path,
    tmp_path: Path,
    name: str,
    options: FitOptions,
    limits: FitLimits,
    fault: tuple[str, str, str],
) -> None:
    (tmp_path / "other.binary").write_bytes(b"nothing of the kind")
    path = plastic_file if name == "plastic" else tmp_path / f"{name}.binary"
    outcome, _ = run(stage, FitTask("one", path, options), limits)
    assert isinstance(outcome, Fault)
    assert (outcome.origin, outcome.type) == fault[:2]
    assert fault[2] in outcome.message
    wait_until(lambda: not stage.fitting())


@in_event_loop
async def test_progress_rises_until_cancelling_ends_the_process_and_closing_all_others(
    stage: Stage, plastic_file: Path
) -> None:
    shares: list[float] = []
    async with started(stage.engine()) as engine:
        fit = asyncio.create_task(engine.run(FitTask("one", plastic_file, SLOW), shares.append))
        await until(lambda: asyncio.sleep(0.02, len(shares)), lambda count: count > 3)
        assert shares == sorted(set(shares))
        assert 0.0 < shares[0] < 0.5
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


PROGRAM = """
import asyncio, sys
from pathlib import Path
from tests.support.engines import ENDLESS, QUICK, DaskEngine, FitTask, started

async def main():
    async with started(DaskEngine(sys.argv[1], 1)) as engine:
        for options in (QUICK, ENDLESS):
            outcome = await engine.run(FitTask("one", Path(sys.argv[2]), options), lambda _: None)
            print(type(outcome).__name__, flush=True)

asyncio.run(main())
"""


def test_processes_do_not_import_the_main_module_and_none_outlives_a_killed_program(
    cluster: DaskCluster, plastic_file: Path, tmp_path: Path
) -> None:
    """The program has no ``if __name__ == "__main__"``; it reads in a process of its own and fits on the cluster."""
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    process = subprocess.Popen(
        [sys.executable, str(program), cluster.address, str(plastic_file)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
    )
    with process:
        assert process.stdout is not None
        assert process.stdout.readline() == "DecomposedFit\n"
        wait_until(lambda: bool(cluster.fitting()), PATIENCE)
        victims = forked(process.pid) + cluster.fitting()
        process.kill()
        assert process.communicate() == ("", "")
    wait_until(lambda: not any(map(alive, victims)))


def test_without_fork_server_processes_are_spawned(plastic_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(multiprocessing, "get_all_start_methods", lambda: ["spawn"])
    assert child._context().get_start_method() == "spawn"
    outcome, shares = run(Stage(None), FitTask("one", plastic_file, QUICK))
    assert isinstance(outcome, FitResult)
    assert shares[-1] == 1.0
