"""What a process of a computation is given, and what is said of its end."""

import os
import resource
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import closing
from pathlib import Path
from threading import Event
from typing import Any

import pytest

from dsbrdf.engines import Fault, FitLimits, OnProgress, Processes
from dsbrdf.engines.engine import MEMORY_LIMIT
from tests.support.processes import alive, children, forked, wait_until
from tests.support.soak import repeats
from tests.support.tasks import address_space, die, do_nothing, exit_with, nice_value, spin, stop_itself

pytestmark = pytest.mark.slow
PATIENCE = 300.0


@pytest.fixture
def processes() -> Iterator[Processes]:
    with closing(Processes(2, FitLimits())) as started:
        yield started


def run_alone(step: Callable[[OnProgress], Any], **limits: Any) -> Any:
    with closing(Processes(1, FitLimits(**limits))) as processes:
        return processes.call(step).result(PATIENCE)


def test_end_of_a_process_is_told_while_others_start(processes: Processes) -> None:
    for _ in range(repeats(3, 10)):
        lost, others = processes.call(die, signal.SIGKILL), [processes.call(do_nothing) for _ in range(4)]
        told = Fault("system", "ProcessLost", "The fit's process was ended from outside (SIGKILL).")
        assert lost.result(PATIENCE) == told
        assert [other.result(PATIENCE) for other in others] == [None] * 4


def test_what_a_process_does_to_itself_is_a_crash(processes: Processes) -> None:
    assert run_alone(do_nothing, memory_mb=1) == MEMORY_LIMIT  # but for one that has no memory to begin
    assert processes.call(die, signal.SIGABRT).result(PATIENCE) == MEMORY_LIMIT
    crash, end = processes.call(die, signal.SIGSEGV), processes.call(exit_with, 3)
    assert crash.result(PATIENCE) == Fault("compute", "ProcessCrashed", "The fit's process crashed (SIGSEGV).")
    assert end.result(PATIENCE) == Fault("compute", "ProcessCrashed", "The fit's process crashed (exit code 3).")
    nameless = processes.call(die, signal.SIGRTMIN + 1)
    assert nameless.result(PATIENCE).message == f"The fit's process crashed (signal {signal.SIGRTMIN + 1})."


def test_process_that_stops_while_it_sends_holds_up_no_other() -> None:
    with closing(Processes(2, FitLimits(seconds=1.5))) as processes:
        stopped = processes.call(stop_itself)
        while not stopped.done():
            assert processes.call(do_nothing).result(PATIENCE) is None
            time.sleep(0.1)
        fault = stopped.result()
    assert (fault.origin, fault.type) == ("compute", "TimeLimit")


def test_call_whose_progress_nobody_can_take_fails_alone_and_its_process_ends(processes: Processes) -> None:
    def refuse(_: float) -> None:
        raise ValueError("not wanted")

    with pytest.raises(ValueError, match="not wanted"):
        processes.call(stop_itself, on_progress=refuse).result(PATIENCE)
    assert not forked(os.getpid())
    assert processes.call(do_nothing).result(PATIENCE) is None


def test_arguments_that_cannot_be_sent_are_an_error_of_their_call(processes: Processes) -> None:
    with pytest.raises((TypeError, AttributeError), match="pickle"):
        processes.call(print, lambda: None).result(PATIENCE)
    assert processes.call(do_nothing).result(PATIENCE) is None


def test_cancel_while_a_process_is_prepared_is_not_lost(processes: Processes, monkeypatch: pytest.MonkeyPatch) -> None:
    make_pair, begun, cancelled = socket.socketpair, Event(), Event()

    def make_pair_after_the_cancel() -> tuple[socket.socket, socket.socket]:
        begun.set()
        assert cancelled.wait(PATIENCE)
        return make_pair()

    monkeypatch.setattr(socket, "socketpair", make_pair_after_the_cancel)
    call = processes.call(stop_itself)
    assert begun.wait(PATIENCE)
    call.cancel()
    cancelled.set()
    with pytest.raises(CancelledError):
        call.result(10.0)
    assert not forked(os.getpid())


def test_process_whose_server_is_lost_is_ended_and_another_server_is_started(processes: Processes) -> None:
    stopped = processes.call(stop_itself)
    wait_until(lambda: len(forked(os.getpid())) == 1)
    (victim,) = forked(os.getpid())
    (server,) = (pid for pid in children(os.getpid()) if victim in children(pid))
    os.kill(server, signal.SIGKILL)
    wait_until(lambda: not alive(server))
    assert processes.call(do_nothing).result(PATIENCE) is None
    stopped.cancel()
    wait_until(stopped.done)
    wait_until(lambda: not alive(victim))


def test_a_limit_of_processor_time_is_no_crash() -> None:
    fault = run_alone(spin, processor_seconds=1.0)
    assert (fault.origin, fault.type) == ("compute", "ProcessorLimit")


def test_a_process_gives_way_as_its_limits_say() -> None:
    assert run_alone(nice_value, niceness=3) == os.nice(0) + 3


@pytest.mark.parametrize(("outside", "asked"), [(2048, 4096), (4096, 2048)])
def test_narrower_one_of_two_memory_limits_holds(outside: int, asked: int) -> None:
    """One is set from outside: on the server, from which processes inherit it; it may be a soft one."""
    with closing(Processes(1, FitLimits(memory_mb=asked))) as processes:
        processes.check()
        processes.call(do_nothing).result(PATIENCE)
        servers = [pid for pid in children(os.getpid()) if b"forkserver" in Path(f"/proc/{pid}/cmdline").read_bytes()]
        before = resource.prlimit(servers[0], resource.RLIMIT_AS)
        resource.prlimit(servers[0], resource.RLIMIT_AS, (outside << 20, before[1]))
        try:
            assert processes.call(address_space).result(PATIENCE) == 2048 << 20
        finally:
            resource.prlimit(servers[0], resource.RLIMIT_AS, before)


EIGHT_CHECKS = """
import tempfile, time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier
from dsbrdf.engines.local import LocalEngine

make_folder = tempfile.mkdtemp

def make_folder_slowly(*arguments, **named):  # as on a slow disk
    time.sleep(0.1)
    return make_folder(*arguments, **named)

tempfile.mkdtemp = make_folder_slowly
engine, together = LocalEngine(1), Barrier(8)

def check(_):
    together.wait()
    engine.check()

with ThreadPoolExecutor(8) as pool:
    list(pool.map(check, range(8)))
print(len(list(Path(tempfile.gettempdir()).glob("pymp-*"))))
engine.check()
"""


def test_threads_that_start_the_server_at_once_share_one_folder(tmp_path: Path) -> None:
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", EIGHT_CHECKS], env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stdout.strip(), done.stderr) == (0, "1", "")
