import os
import platform
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import forkserver
from threading import current_thread, main_thread
from typing import Any

import pytest

from dsbrdf.engines.engine import Fault, FitLimits, OnProgress
from dsbrdf.engines.worker_process import run_in_process
from tests.support.crashing_tasks import die, do_nothing, fill_and_free, nice_value

pytestmark = pytest.mark.slow


def run_alone(step: Callable[[OnProgress], Any], niceness: int = 0) -> Any:
    return run_in_process(step, (), FitLimits(niceness=niceness), lambda _: None, lambda: False)


def test_exit_status_is_known_while_other_processes_start(monkeypatch: pytest.MonkeyPatch) -> None:
    read = forkserver.read_signed

    def read_slowly(descriptor: int) -> int:
        if current_thread() is not main_thread():  # the one that waits for the end comes to read it late
            time.sleep(0.2)
        number: int = read(descriptor)
        return number

    monkeypatch.setattr(forkserver, "read_signed", read_slowly)
    for _ in range(4):
        with ThreadPoolExecutor(1) as pool:
            lost = pool.submit(run_alone, die)
            while not lost.done():
                assert run_alone(do_nothing) is None
        assert lost.result() == Fault("system", "ProcessLost", "The fit's process was ended from outside (SIGKILL).")


@pytest.mark.skipif(not hasattr(os, "nice"), reason="the system has no nice values")
def test_a_process_gives_way_as_its_limits_say() -> None:
    assert run_alone(nice_value, 3) == os.nice(0) + 3


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries have a way of their own with memory")
def test_freed_memory_is_reused() -> None:
    pages = run_alone(fill_and_free)
    assert 0 < pages < 10_000  # given back each time, it would be 51,200
