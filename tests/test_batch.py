"""Fits in processes: what they are given, and that nothing outlives or outweighs the command that started them."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from multiprocessing import active_children
from pathlib import Path

import pytest

from dsbrdf import FitOptions, batch, cli
from dsbrdf.batch import FileFit, default_jobs, fit_files
from dsbrdf.engines.child import ONE_THREAD
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.serialize import load
from tests.dask_cluster import DaskCluster

pytestmark = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks at processes in /proc")

QUICK = FitOptions(method="paper", n_lobes=1, em_iterations=40)
SLOW = ("--lobes", "8", "--ring-lobes", "2")
PATIENCE = 30.0


@pytest.fixture
def files(plastic_file: Path, tmp_path: Path) -> list[Path]:
    names = [tmp_path / f"{name}.binary" for name in ("one", "two", "three")]
    for path in names:
        os.link(plastic_file, path)
    return names


def offspring(pid: int) -> list[int]:
    """The processes that any thread of a process has started."""
    return [int(child) for path in Path(f"/proc/{pid}/task").glob("*/children") for child in path.read_text().split()]


def children(pid: int) -> list[int]:
    """The processes that fit for another one: they are forked by its fork server."""
    found = []
    for child in offspring(pid):
        try:
            if b"forkserver" in Path(f"/proc/{child}/cmdline").read_bytes():
                found += offspring(child)
        except (FileNotFoundError, ProcessLookupError):
            continue
    return found


def environment(pid: int) -> dict[str, str]:
    entries = Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
    return dict(entry.decode().split("=", 1) for entry in entries if entry)


def wait_for(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "it took too long"
        time.sleep(0.01)


def is_gone(pid: int) -> bool:
    status = Path(f"/proc/{pid}/status")
    try:
        return "State:\tZ" in status.read_text()
    except (FileNotFoundError, ProcessLookupError):
        return True


def works(pid: int) -> bool:
    """Whether a process has begun to read a measurement: it has used some time."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK") > 0.1


@pytest.fixture
def command(files: list[Path], tmp_path: Path) -> Iterator["subprocess.Popen[str]"]:
    """``dsbrdf fit`` of slow fits in a process group of its own, as a terminal has it, with two processes at work."""
    words = ["fit", *map(str, files), "-o", str(tmp_path / "out"), "--jobs", "2", *SLOW]
    process = subprocess.Popen(
        [sys.executable, "-m", "dsbrdf.cli", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        wait_for(lambda: len(children(process.pid)) == 2)
        yield process
    finally:
        workers = children(process.pid) if process.poll() is None else []
        process.kill()
        process.communicate()
        for worker in workers:
            wait_for(partial(is_gone, worker))


def test_the_results_come_in_order_and_are_written(files: list[Path], tmp_path: Path) -> None:
    missing = tmp_path / "none.binary"
    shares: list[float] = []
    with closing(fit_files([missing, *files], QUICK, tmp_path / "out", jobs=2, progress=shares.append)) as items:
        results = list(items)
    assert [item.file for item in results] == [missing, *files]
    assert results[0] == FileFit(missing, error="No such file or directory")
    assert [path.name for path in sorted((tmp_path / "out").iterdir())] == ["one.json", "three.json", "two.json"]
    for item in results[1:]:
        assert item.result is not None
        assert item.output is not None
        assert load(item.output).kappa.tolist() == item.result.model.kappa.tolist()
    assert shares[-1] == 4.0
    assert all(0.0 <= share <= 4.0 for share in shares)
    assert any(share % 1.0 for share in shares)
    assert active_children() == []


def test_processes_have_one_thread_each_and_this_one_keeps_its_own(
    files: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    seen: list[dict[str, str]] = []
    threads: list[int] = []

    def look(_: float) -> None:
        for worker in active_children():
            assert worker.pid is not None
            with suppress(FileNotFoundError, ProcessLookupError):  # it may end while it is looked at
                seen.append(environment(worker.pid))
                threads.append(len(list(Path(f"/proc/{worker.pid}/task").iterdir())))

    with closing(fit_files(files[:2], QUICK, jobs=2, progress=look)) as items:
        assert all(item.error is None for item in items)
    assert seen
    assert all(found | ONE_THREAD == found for found in seen)
    assert max(threads) == 2  # the fit, and the watch over the parent
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ


def test_closing_early_ends_the_processes(files: list[Path]) -> None:
    with closing(fit_files(files, QUICK, jobs=2)) as items:
        next(items)
        assert active_children()
    assert active_children() == []


def test_jobs() -> None:
    assert default_jobs() >= 1
    with pytest.raises(InvalidArgumentError, match="must be at least 1, not 0"):
        next(fit_files([], QUICK, jobs=0))


def test_a_process_that_dies_takes_only_its_file(files: list[Path], tmp_path: Path, plastic_file: Path) -> None:
    killed: list[int] = []

    def kill_once(_: float) -> None:
        if not killed:
            (worker,) = active_children()
            assert worker.pid is not None
            killed.append(worker.pid)
            os.kill(worker.pid, signal.SIGKILL)

    with closing(fit_files(files, QUICK, tmp_path / "out", jobs=1, progress=kill_once)) as items:
        first, *others = items
    assert first.error is not None
    assert first.lost
    assert "The fit's process was ended from outside (SIGKILL); run the command again" in first.error
    assert [item.error for item in others] == [None, None]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["three.json", "two.json"]


def test_a_killed_process_is_told_in_one_sentence(command: "subprocess.Popen[str]", files: list[Path]) -> None:
    victim = children(command.pid)[0]
    wait_for(lambda: works(victim))
    os.kill(victim, signal.SIGKILL)
    wait_for(lambda: victim not in children(command.pid) and len(children(command.pid)) == 2)  # the third file's turn
    os.killpg(command.pid, signal.SIGINT)
    out, err = command.communicate(timeout=PATIENCE)
    assert command.returncode == 130
    assert out == ""
    lost, end = err.splitlines()
    words = r"The fit's process was ended from outside \(SIGKILL\); run the command again"
    assert re.match(rf"dsbrdf: .*(one|two)\.binary: {words}", lost)
    assert end == "dsbrdf: interrupted"


@pytest.mark.parametrize("at_once", [True, False], ids=["while they start", "while they fit"])
def test_an_interrupt_ends_everything_at_once(
    command: "subprocess.Popen[str]", tmp_path: Path, *, at_once: bool
) -> None:
    workers = children(command.pid)
    if not at_once:
        wait_for(lambda: all(works(worker) for worker in workers))
    begin = time.monotonic()
    os.killpg(command.pid, signal.SIGINT)  # as Ctrl-C does: all processes of the terminal get it
    out, err = command.communicate(timeout=PATIENCE)
    assert time.monotonic() - begin < 3.0
    assert (command.returncode, out, err) == (130, "", "dsbrdf: interrupted\n")
    assert all(is_gone(worker) for worker in workers)
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_no_process_outlives_the_command(
    command: "subprocess.Popen[str]", tmp_path: Path, number: signal.Signals
) -> None:
    workers = children(command.pid)
    wait_for(lambda: all(works(worker) for worker in workers))
    command.send_signal(number)
    command.wait(PATIENCE)
    for worker in workers:
        wait_for(partial(is_gone, worker))
    assert list((tmp_path / "out").iterdir()) == []


def test_an_interrupted_run_resumes(files: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["fit", *map(str, files), "-o", str(out), "--jobs", "1", "--method", "paper", "--lobes", "3"]
    command = [sys.executable, "-m", "dsbrdf.cli", *words, "--em-iterations", "200"]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    wait_for(lambda: (out / "one.json").exists())
    os.killpg(process.pid, signal.SIGINT)
    process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    before = (out / "one.json").read_bytes()
    assert not (out / "three.json").exists()
    again = subprocess.run(command, capture_output=True, text=True, timeout=4 * PATIENCE)
    assert again.returncode == 0
    lines = again.stdout.splitlines()
    assert [line.partition(":")[0] for line in lines] == ["one", "two", "three"]
    assert lines[0].endswith("(kept)")
    assert not lines[2].endswith("(kept)")
    assert (out / "one.json").read_bytes() == before


def test_a_damaged_file_beside_good_ones(files: list[Path], tmp_path: Path) -> None:
    damaged = tmp_path / "cut.binary"
    shutil.copyfile(files[0], damaged)
    os.truncate(damaged, 1000)
    with closing(fit_files([files[0], damaged, files[1]], QUICK, jobs=2)) as items:
        good, bad, other = items
    assert good.error is other.error is None
    assert bad.error is not None
    assert "1000" in bad.error
    assert not bad.lost


def test_a_batch_on_a_cluster_is_that_of_this_machine(files: list[Path], tmp_path: Path, cluster: DaskCluster) -> None:
    missing = tmp_path / "none.binary"
    shares: list[float] = []
    fits = fit_files([*files, missing], QUICK, tmp_path / "out", scheduler=cluster.address, progress=shares.append)
    with closing(fits) as items:
        results = list(items)
    assert [item.error for item in results] == [None, None, None, "No such file or directory"]
    with closing(fit_files(files[:1], QUICK)) as items:
        (expected,) = items
    assert expected.result is not None
    for item in results[:3]:
        assert item.output is not None
        assert item.result is not None
        assert item.warnings == expected.warnings
        assert replace(item.result.report, timings={}) == replace(expected.result.report, timings={})
        assert load(item.output).kappa.tolist() == expected.result.model.kappa.tolist()
    assert shares[-1] == 4.0


def test_a_cluster_that_is_away_is_told_in_one_sentence(
    files: list[Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(batch, "_PATIENCE", 0.5)
    address = "tcp://127.0.0.1:1"
    assert cli.main(["fit", str(files[0]), "--scheduler", address]) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith(f"dsbrdf: The Dask scheduler at {address} cannot be reached")
    assert captured.err.count("\n") == 1
