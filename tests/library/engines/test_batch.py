"""Fits in processes: what they are given, and that nothing outlives or outweighs the command that started them."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, closing
from multiprocessing import active_children
from pathlib import Path
from typing import Any

import pytest

import dsbrdf
from dsbrdf import FitOptions
from dsbrdf.engines import FileFit, LocalEngine, batch, dask, fit_files, local
from tests.support.command_line import sentence
from tests.support.processes import alive, forked, short_folder, until, wait_until
from tests.support.tasks import ENDLESS, compute_unless_named_one

needs_proc = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks at processes in /proc")
pytestmark = [pytest.mark.slow, needs_proc]

QUICK = FitOptions(method="paper", n_lobes=1, em_iterations=40)
PATIENCE = 120.0


@pytest.fixture(autouse=True)
def interrupts() -> Iterator[None]:
    """Let Ctrl-C reach what is started here: what runs in the background of a shell ignores it, and so would that."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def files(plastic_file: Path, tmp_path: Path) -> list[Path]:
    names = [tmp_path / f"{name}.binary" for name in ("one", "two", "three")]
    for path in names:
        os.link(plastic_file, path)
    return names


def works(pid: int) -> bool:
    """Whether a process has begun to read a measurement, and used some time for it, and has not ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except (FileNotFoundError, ProcessLookupError):
        return False
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK") > 0.1


def test_each_result_is_written(files: list[Path], tmp_path: Path) -> None:
    missing = tmp_path / "none.binary"
    del files[2:]
    shares: list[float] = []
    asked = [missing, *files]
    with closing(fit_files(asked, QUICK, LocalEngine(2), tmp_path / "out", progress=shares.append)) as items:
        results = sorted(items, key=lambda item: asked.index(item.file))
    assert [item.file for item in results] == asked
    assert results[0] == FileFit(missing, error="No such file or directory")
    assert [path.name for path in sorted((tmp_path / "out").iterdir())] == ["one.json", "two.json"]
    for item in results[1:]:
        assert item.result is not None
        assert item.output is not None
        assert dsbrdf.load(item.output) == item.result
    assert shares[-1] == 3.0
    assert all(0.0 <= share <= 3.0 for share in shares)
    assert any(share % 1.0 for share in shares)
    assert shares == sorted(shares)
    assert active_children() == []


class Seen(Exception):  # noqa: N818
    """The end of a batch, when enough has been seen of it."""


def test_fit_processes_have_one_thread_and_end_with_the_iterator_and_the_environment_stays(
    files: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    workers = set[int]()

    def look(_: float) -> None:
        workers.update(forked(os.getpid()))
        # In each the fit, and the watch over the parent.
        threads = [len([*Path(f"/proc/{pid}").glob("task/*")]) for pid in workers if works(pid)]
        if threads == [2, 2]:
            raise Seen

    asked = [Path("none.binary"), *files[:2]]
    with closing(fit_files(asked, ENDLESS, LocalEngine(2), progress=look)) as items:
        assert next(items).error == "No such file or directory"
        with pytest.raises(Seen):
            next(items)
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ
    assert active_children() == []
    assert not any(map(alive, workers))


def test_killed_process_loses_only_its_file(files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local, "compute", compute_unless_named_one)
    with closing(fit_files(files, QUICK, LocalEngine(1), tmp_path / "out")) as items:
        first, *others = items
    assert first.lost
    assert "was ended from outside (SIGKILL); run the command again" in (first.error or "")
    assert [item.error for item in others] == [None, None]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["three.json", "two.json"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_ended_command_leaves_no_process_and_no_file(files: list[Path], tmp_path: Path, number: signal.Signals) -> None:
    """Two endless fits are at work, in a process group of their own as a terminal has it."""
    words = ["fit", *map(str, files), "-o", str(tmp_path / "out"), "--jobs=2", "--n-lobes=10", "--ring-lobes=9"]
    words += ["--robust", "--lobe=student", f"--knots-deg={','.join(map(str, ENDLESS.knots_deg))}"]
    program = [sys.executable, "-m", "dsbrdf.cli.main", *words]
    piped: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with ExitStack() as stack:
        temporary = stack.enter_context(short_folder())
        environment = {**os.environ, "TMPDIR": temporary}
        command = stack.enter_context(subprocess.Popen(program, env=environment, start_new_session=True, **piped))
        try:
            workers = until(lambda: forked(command.pid), lambda found: len(found) == 2)
            if number == signal.SIGINT:
                os.killpg(command.pid, number)  # as Ctrl-C does: all processes of the terminal get it, while they start
                assert command.communicate(timeout=PATIENCE) == ("", "dsbrdf: interrupted\n")
                assert command.returncode == 130
                assert not any(map(alive, workers))
            else:
                wait_until(lambda: all(map(works, workers)), PATIENCE)
                command.kill()
                command.wait(PATIENCE)
            wait_until(lambda: not any(map(alive, workers)), PATIENCE)
            wait_until(lambda: not [*Path(temporary).iterdir()], PATIENCE)
        finally:
            command.kill()
    assert list((tmp_path / "out").iterdir()) == []


def test_lost_cluster_is_named(files: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "_CLUSTER_TIMEOUT_S", 0.5)
    monkeypatch.setattr(dask, "_SCHEDULER_TIMEOUT_S", 0.5)
    address = "tcp://127.0.0.1:1"
    said = sentence("fit", files[0], "--scheduler", address, code=1)
    assert said.startswith(f"dsbrdf: The Dask scheduler at {address} cannot be reached")
