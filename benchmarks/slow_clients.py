"""What slow and greedy clients cost the service and the others: one row for each target.

The service is the real one, in a process of its own on the loopback address. The exit code is 1 if a row is missed;
other work on the machine makes the rows with times miss, and those with bytes do not depend on it.
"""

import argparse
import asyncio
import hashlib
import io
import os
import random
import re
import resource
import signal
import socket
import statistics
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager, suppress
from http.client import HTTPConnection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.abandoned_requests import abandoned
from benchmarks.durability_series.harness import Harness
from benchmarks.http_load import PeakMemory, get_repeatedly
from benchmarks.service import Row
from dsbrdf.data.merl import write_merl
from dsbrdf.data.merl_validation import FILE_SIZE
from dsbrdf.data.synthetic import synthetic_measurement
from tests.support.guarded import new_key
from tests.support.processes import wait_until
from tests.support.server import ENDLESS, QUICK, Server

CLIENTS = 64  # of each kind
POLLS = 2000
RATES = (20_000, 200_000, 2_000_000, 10_000_000)  # bytes a second

_SLOW_SECONDS = 24.0  # that a reader keeps its rate
_SPREAD = 5.0  # seconds in which the polls begin: they are not in step
_POINT = "theta_half_deg=10&theta_diff_deg=30"
_NPY = "Content-Type: application/x-npy\r\nAccept: application/x-npy\r\n"


def readers(harness: Harness) -> list[Row]:
    """Read an export, a measurement and a batch at several rates at once."""
    with harness.server() as server:
        path, measurement = _fitted(server.start(), harness)
        batch = _npy(np.random.default_rng(0).uniform(0.0, 90.0, (100_000, 2)))
        requests = {
            "export": _request(f"GET {path}/export?format=merl"),
            "measurement": _request(f"GET /v1/measurements/{measurement}"),
            "batch": _request(f"POST {path}/brdf", _NPY, batch),
        }
        expected = {name: _read(server, request, None) for name, request in requests.items()}
        with ThreadPoolExecutor(len(RATES) * len(requests)) as pool:
            running = {
                (name, rate): pool.submit(_read, server, request, rate)
                for name, request in requests.items()
                for rate in RATES
            }
        cut = [f"{name} at {rate} B/s" for (name, rate), one in running.items() if one.result() != expected[name]]
        whole = f"{len(running) - len(cut)} of {len(running)} whole{': not ' + ', '.join(cut) if cut else ''}"
    asked = "readers of export, measurement and batch at 20 kB/s to 10 MB/s: each gets the whole answer"
    return [Row(asked, whole, not cut)]


def stalled(harness: Harness) -> list[Row]:
    """Stop in the middle of many uploads, batches and exports at once; look at memory and liveness meanwhile."""
    data = harness.measurement.read_bytes()
    with harness.server(idle_timeout="600", least_upload_rate="0") as server, ExitStack() as stack:
        path, _ = _fitted(server.start(), harness)
        _read(server, _request(f"GET {path}/export?format=merl"), None)  # what any work takes once is no cost of these
        batch = _npy(np.zeros((100_000, 2)))
        memory = PeakMemory(server.process.pid)
        requests = [
            _request("POST /v1/measurements", "", data)[: FILE_SIZE // 2],
            _request(f"POST {path}/brdf", _NPY, batch)[: len(batch) // 2],
            _request(f"GET {path}/export?format=merl"),
        ]
        senders = [threading.Thread(target=_send_and_stop, args=(server, requests, stack)) for _ in range(CLIENTS)]
        with _latencies(server) as latencies:
            for sender in senders:
                sender.start()
            for sender in senders:
                sender.join()
            time.sleep(2.0)
        growth = memory.growth() / 1e6
    p99 = float(np.quantile(latencies, 0.99))
    asked = f"{CLIENTS} stalled uploads, {CLIENTS} stalled batches, {CLIENTS} unread exports at once"
    return [
        Row(f"{asked}: memory +64 MB at most", f"+{growth:.0f} MB", growth <= 64.0),
        Row("liveness meanwhile: p99 <= 0.5 s", f"p99 {p99:.3f} s of {len(latencies)}", p99 <= 0.5),
    ]


def polls(harness: Harness) -> list[Row]:
    """Hold as many polls and streams with one key as it gets, while another key asks for values."""
    with harness.server(require_keys="true", key_requests_per_second="1000000", workers="1") as server:
        server.start()
        greedy, other = (new_key(server, name)[1]["Authorization"] for name in ("greedy", "other"))
        path, _ = _fitted(server, harness, other)
        waiting, _ = _fitted(server, harness, greedy, ENDLESS, "respond-async")
        wait_until(lambda: bool(server.workers()))
        for pid in server.workers():  # the fit is waited for, and takes no processor time
            os.kill(pid, signal.SIGSTOP)
        url = f"{str(server.http.base_url).rstrip('/')}{path}/brdf?{_POINT}"
        get_repeatedly(url, 4, 1.0, other)
        quiet = [get_repeatedly(url, 4, 2.0, other) for _ in range(5)]
        with _polling(server, waiting, greedy) as answers:
            busy = [get_repeatedly(url, 4, 2.0, other) for _ in range(5)]
    before, meanwhile = (statistics.median(rate.p99 for rate in rates) for rates in (quiet, busy))
    measured = f"p99 {meanwhile:.1f} ms, quiet {before:.1f} ms; every answer 200; the polls' own {dict(answers)}"
    asked = f"one key with {POLLS} polls and streams beside another's GETs: p99 <= 3 times the quiet one, no 503"
    return [Row(asked, measured, meanwhile <= 3.0 * before)]


PARTS: dict[str, Callable[[Harness], list[Row]]] = {
    "readers": readers,
    "stalled": stalled,
    "polls": polls,
    "abandoned": abandoned,
}


def _fitted(
    server: Server, harness: Harness, key: str = "", options: dict[str, object] | None = None, prefer: str = "wait=60"
) -> tuple[str, str]:
    """Fit the measurement; return the path of the fit and the measurement's id."""
    headers = {"Prefer": prefer} | ({"Authorization": key} if key else {})
    stored = server.http.post("/v1/measurements", content=harness.measurement.read_bytes(), headers=headers)
    document = {"measurement": stored.raise_for_status().json()["sha256"], "options": options or QUICK}
    fit = server.http.post("/v1/fits", json=document, headers=headers).raise_for_status().json()
    return f"/v1/fits/{fit['id']}", fit["measurement"]


def _request(line: str, headers: str = "", body: bytes = b"") -> bytes:
    length = f"Content-Length: {len(body)}\r\n" if body else ""
    return f"{line} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n{headers}{length}\r\n".encode() + body


def _npy(points: NDArray[np.float64]) -> bytes:
    file = io.BytesIO()
    np.save(file, points)
    return file.getvalue()


def _connected(server: Server) -> socket.socket:
    """Connect with a small buffer, so that little is read that nobody has asked for."""
    connection = socket.socket()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 16)
    connection.settimeout(300.0)
    connection.connect((server.http.base_url.host, server.http.base_url.port))
    return connection


def _read(server: Server, request: bytes, rate: int | None) -> tuple[int, str]:
    """Send a request and read the answer, at first at a rate [bytes/s]; return the body's length and digest."""
    with closing(_connected(server)) as connection:
        connection.sendall(request)
        begin, n_bytes, digest, head = time.monotonic(), 0, hashlib.sha256(), b""
        size = 1 << 16 if rate is None else min(1 << 16, rate // 5)
        while part := connection.recv(size):
            n_bytes += len(part)
            if b"\r\n\r\n" in head:
                digest.update(part)
            else:
                head += part
                digest.update(head.partition(b"\r\n\r\n")[2])
            elapsed = time.monotonic() - begin
            if rate is not None and elapsed < _SLOW_SECONDS:
                time.sleep(min(max(0.0, n_bytes / rate - elapsed), _SLOW_SECONDS))
    return n_bytes - head.index(b"\r\n\r\n"), digest.hexdigest()


def _send_and_stop(server: Server, requests: Sequence[bytes], stack: ExitStack) -> None:
    for request in requests:
        connection = stack.enter_context(closing(_connected(server)))
        connection.sendall(request)


@contextmanager
def _latencies(server: Server) -> Iterator[list[float]]:
    """Ask for liveness fifty times a second during the block; yield the times that it took [s]."""
    latencies: list[float] = []
    over = threading.Event()

    def ask() -> None:
        connection = HTTPConnection(server.http.base_url.host, server.http.base_url.port, timeout=60)
        while not over.wait(0.02):
            begin = time.perf_counter()
            connection.request("GET", "/health/live")
            assert connection.getresponse().read()
            latencies.append(time.perf_counter() - begin)
        connection.close()

    thread = threading.Thread(target=ask)
    thread.start()
    try:
        yield latencies
    finally:
        over.set()
        thread.join()


@contextmanager
def _polling(server: Server, path: str, key: str) -> Iterator[Counter[str]]:
    """Poll a fit and follow its events on many connections during the block; yield the statuses of the answers."""
    statuses: Counter[str] = Counter()
    address = server.http.base_url
    over = threading.Event()

    async def poll(number: int) -> None:
        what = f"{path}/events" if number % 4 == 0 else f"{path}?wait=60"
        await asyncio.sleep(_SPREAD * number / POLLS)
        while True:
            retry_after = None
            with suppress(OSError, asyncio.IncompleteReadError):
                reader, writer = await asyncio.open_connection(address.host, address.port)
                writer.write(_request(f"GET {what}", f"Authorization: {key}\r\n"))
                head = await reader.readuntil(b"\r\n\r\n")
                statuses[head.split()[1].decode()] += 1
                await reader.read()
                writer.close()
                retry_after = re.search(rb"retry-after: (\d+)", head)
            await asyncio.sleep(float(retry_after[1]) if retry_after else 1.0)

    async def run() -> None:
        tasks = [asyncio.create_task(poll(number)) for number in range(POLLS)]
        await asyncio.to_thread(over.wait)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    thread = threading.Thread(target=asyncio.run, args=(run(),))
    thread.start()
    time.sleep(_SPREAD + 2.0)  # until all have asked
    try:
        yield statuses
    finally:
        over.set()
        thread.join()


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks slow_clients", description=__doc__)
    parser.add_argument("--only", nargs="+", choices=PARTS, metavar="PART", help=f"some of: {', '.join(PARTS)}")
    arguments = parser.parse_args(argv)
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    print(f"load of the machine: {os.getloadavg()[0]:.1f}\n| asked | measured | |\n|---|---|---|", flush=True)
    missed = False
    for name in arguments.only or PARTS:
        with tempfile.TemporaryDirectory(prefix="dsbrdf-") as folder:
            measurement = Path(folder) / "plastic.binary"
            write_merl(measurement, synthetic_measurement(noise=0.02, seed=1))
            harness = Harness(Path(folder), measurement, random.Random(0), own_interpreter=True)
            for row in PARTS[name](harness):
                print(f"| {row.asked} | {row.measured} | {'ok' if row.holds else 'missed'} |", flush=True)
                missed |= not row.holds
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
