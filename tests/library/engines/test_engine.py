"""What every engine promises, held against each of them: a cluster has real processes here."""

import multiprocessing
import os
import signal
import time
from concurrent.futures import CancelledError
from pathlib import Path

import pytest

from dsbrdf import FitOptions, read_measurement
from dsbrdf.engines import Fault, FitDocument, FitLimits, FitTask, LocalEngine
from dsbrdf.output import result_from_json
from dsbrdf.output.sphere_panels import thumbnail
from tests.support.dask_cluster import forked
from tests.support.engines import (
    ENDLESS,
    LIMITS,
    OF_SAMPLES,
    PATIENCE,
    QUICK,
    SLOW_FIT,
    Stage,
    assert_same,
    fitted_by_library,
    ignore,
    run,
    started,
    until,
    until_fitting,
)
from tests.support.processes import alive, wait_until
from tests.support.soak import SOAK

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks at processes in /proc"),
]
NO_DATA_LEFT = FitOptions(method="paper", n_lobes=8, mask=10.0, horizon_cutoff_deg=1.7)


@pytest.fixture(params=["local", pytest.param("dask", marks=pytest.mark.soak)])
def stage(request: pytest.FixtureRequest) -> Stage:
    return Stage(None if request.param == "local" else request.getfixturevalue("cluster"))


@pytest.mark.parametrize(
    ("data", "options"),
    [
        ("plastic", FitOptions(2, "paper", em_iterations=5, weighting="log", robust=True, horizon_cutoff_deg=69)),
        ("samples", OF_SAMPLES),
    ],
    ids=["paper, log and robust", "scattered samples"],
)
def test_result_equals_that_of_the_library_bit_for_bit(
    stage: Stage, data: str, options: FitOptions, request: pytest.FixtureRequest
) -> None:
    path: Path = request.getfixturevalue(f"{data}_file")
    expected, said = fitted_by_library(path, options)
    outcome, shares = run(stage, FitTask("one", path, options, with_thumbnail=True))
    assert isinstance(outcome, FitDocument)
    assert outcome.thumbnail == thumbnail(expected.model, read_measurement(path))
    assert_same(outcome, expected)
    report = result_from_json(outcome.text).report
    assert list(report.timings) == list(expected.report.timings)
    assert all(seconds > 0 for seconds in report.timings.values())
    assert said == [text for text in report.warnings if " converged: " in text]
    assert shares == sorted(set(shares))
    assert shares[-1] == 1.0


@pytest.mark.parametrize(
    ("name", "options", "limits", "fault"),
    [
        ("other", QUICK, LIMITS, ("input", "MeasurementFormatError", "which begins with the dimensions (90, 90, 180)")),
        ("plastic", NO_DATA_LEFT, LIMITS, ("input", "FitError", "leave no slice with enough valid samples")),
        ("gone", QUICK, LIMITS, ("system", "MeasurementUnreadable", "not be read: No such file or directory.")),
        ("plastic", SLOW_FIT, FitLimits(60.0, 200), ("compute", "MemoryLimit", "more memory than a fit may use.")),
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
    (tmp_path / "other.binary").write_bytes(bytes(range(256)))
    path = plastic_file if name == "plastic" else tmp_path / f"{name}.binary"
    outcome, _ = run(stage, FitTask("one", path, options), limits)
    assert isinstance(outcome, Fault)
    assert (outcome.origin, outcome.type) == fault[:2]
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
        victims = until_fitting(stage)
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
