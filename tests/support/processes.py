"""What tests want to know of processes, their own and others."""

import random
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

T = TypeVar("T")


def short_folder() -> "TemporaryDirectory[str]":
    """A temporary folder for processes: the path of a socket has at most 107 characters, and pytest's are long."""
    return TemporaryDirectory(prefix="dsbrdf-", ignore_cleanup_errors=True)


def children(parent: int) -> list[int]:
    found: list[int] = []
    for path in Path(f"/proc/{parent}/task").glob("*/children"):
        try:
            found += map(int, path.read_text().split())
        except (FileNotFoundError, ProcessLookupError):
            continue
    return [pid for pid in found if alive(pid)]


def command(pid: int) -> bytes:
    """Command line of a process and the name that it has given itself; empty if it has ended."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes() + Path(f"/proc/{pid}/comm").read_bytes()
    except (FileNotFoundError, ProcessLookupError):
        return b""


def alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def free_port() -> int:
    """Return a port that is free, and that the system gives to nobody by itself, so that it can be taken later."""
    while True:
        port = random.SystemRandom().randrange(10_000, 30_000)
        with socket.socket() as probe, suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port


def wait_until(condition: Callable[[], bool], seconds: float = 300.0) -> float:
    start = time.monotonic()
    while not condition():
        assert time.monotonic() - start < seconds, "it did not happen in time"
        time.sleep(0.02)
    return time.monotonic() - start


def until(ask: Callable[[], T], good: Callable[[T], object]) -> T:
    answers: list[T] = []

    def asked() -> bool:
        answers[:] = [ask()]
        return bool(good(answers[0]))

    wait_until(asked)
    return answers[0]


def forked(pid: int) -> list[int]:
    """Processes that the fork server of a process has forked."""
    return [child for server in children(pid) if b"forkserver" in command(server) for child in children(server)]
