"""Light load on a server: many requests on a few connections, large bodies at once, and a process's memory meanwhile.

Requests of a rate are sent by a process of its own: ``python -m benchmarks.server.load URL CONNECTIONS SECONDS``.
"""

import asyncio
import json
import os
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from http.client import HTTPConnection
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

import numpy as np


class Rate(NamedTuple):
    """Answers per second, the median and the 99th percentile of their times [ms], and the server's time [us].

    The server's time is its processor time for one answer, which other work on the machine hardly changes.
    """

    per_second: float
    p50: float
    p99: float
    processor_us: float


def get_repeatedly(url: str, connections: int, seconds: float, server: int) -> Rate:
    """Ask the process `server` for a page again and again on so many connections; every answer has to be 200."""
    before = processor_seconds(server)
    command = [sys.executable, "-m", "benchmarks.server.load", url, str(connections), str(seconds)]
    run = subprocess.run(command, check=False, capture_output=True, text=True)
    if run.returncode:
        raise SystemExit(f"{url} did not answer every request with 200:\n{run.stderr}")
    n_answers, elapsed, p50, p99 = json.loads(run.stdout)
    return Rate(n_answers / elapsed, p50, p99, 1e6 * (processor_seconds(server) - before) / n_answers)


def processor_seconds(pid: int, *, with_children: bool = False) -> float:
    """Return the processor time that a process has used, or it and its children that have ended [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11 : 15 if with_children else 13])) / os.sysconf("SC_CLK_TCK")


async def _get_from_here(url: str, connections: int, seconds: float) -> list[float]:
    """Return the number of answers, the time that they took [s], and the median and 99th percentile of one [ms]."""
    parts = urlsplit(url)
    head = f"GET {parts.path}?{parts.query} HTTP/1.1\r\nHost: {parts.netloc}\r\n\r\n".encode()
    loop = asyncio.get_running_loop()
    end = loop.time() + seconds
    times: list[float] = []

    async def ask() -> None:
        reader, writer = await asyncio.open_connection(parts.hostname, parts.port)
        while (begin := loop.time()) < end:
            writer.write(head)
            answer = await reader.readuntil(b"\r\n\r\n")
            length = re.search(rb"content-length: (\d+)", answer)
            if not answer.startswith(b"HTTP/1.1 200 ") or length is None:
                raise SystemExit(answer.decode())
            await reader.readexactly(int(length[1]))
            times.append(loop.time() - begin)
        writer.close()

    begin = loop.time()
    await asyncio.gather(*(ask() for _ in range(connections)))
    return [len(times), loop.time() - begin, *(1e3 * np.quantile(times, [0.5, 0.99])).tolist()]


def post(url: str, body: Sequence[bytes | memoryview], headers: dict[str, str]) -> tuple[int, bytes]:
    """Send one body, in parts that are not copied, on a connection of its own; return status and answer."""
    parts = urlsplit(url)
    connection = HTTPConnection(parts.hostname or "", parts.port, timeout=300)
    try:
        connection.connect()
        connection.sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.putrequest("POST", f"{parts.path}?{parts.query}")
        for name, value in {**headers, "Content-Length": str(sum(len(part) for part in body))}.items():
            connection.putheader(name, value)
        connection.endheaders()
        for part in body:
            connection.sock.sendall(part)
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


def at_once(calls: Sequence[Callable[[], object]]) -> float:
    """Make all calls at the same time, each in a thread; return how long the last one took [s]."""
    barrier = threading.Barrier(len(calls) + 1)

    def run(call: Callable[[], object]) -> None:
        barrier.wait()
        call()

    with ThreadPoolExecutor(len(calls)) as threads:
        running = [threads.submit(run, call) for call in calls]
        barrier.wait()
        begin = time.perf_counter()
        for one in running:
            one.result()
        return time.perf_counter() - begin


class PeakMemory:
    """Most physical memory that a process has had since this was made [bytes]."""

    def __init__(self, pid: int) -> None:
        self._folder = Path(f"/proc/{pid}")
        (self._folder / "clear_refs").write_text("5")  # forgets the peak so far
        self.before = self._field("VmRSS")

    def growth(self) -> int:
        """Return by how much the peak is above what there was at the start."""
        return self._field("VmHWM") - self.before

    def _field(self, name: str) -> int:
        found = re.search(rf"{name}:\s+(\d+) kB", (self._folder / "status").read_text())
        assert found
        return int(found[1]) << 10


@contextmanager
def program(command: Sequence[str], log: Path) -> Iterator[tuple[str, int]]:
    """Run a server that says in its log where it listens; yield its address and its process id."""
    with log.open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=output)
    try:
        while not (found := re.search(r"running on (http://\S+)", log.read_text())):
            if process.poll() is not None:
                raise SystemExit(f"{command} did not start:\n{log.read_text()}")
            time.sleep(0.02)
        yield found[1], process.pid
    finally:
        process.terminate()
        process.wait(20)


if __name__ == "__main__":
    print(json.dumps(asyncio.run(_get_from_here(sys.argv[1], int(sys.argv[2]), float(sys.argv[3])))))
