"""What one key's user notes while another caller begins requests that compute, and leaves again."""

import asyncio
import itertools
import json
import os
import signal
import statistics
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress

from benchmarks.durability_series.harness import Harness
from benchmarks.http_load import Row, get_repeatedly
from tests.support.guarded import new_key
from tests.support.processes import wait_until
from tests.support.server import ENDLESS, QUICK, Server

ABANDONED = 64  # requests of each kind at once
SECONDS = 3.0  # of each run

_FITS = 8  # of the one who leaves
_STAY = 2.0  # seconds until a request is given up and another one begins
_COMPONENTS = ("", "&component=specular_spike", "&component=specular_lobe", "&component=diffuse")


def abandoned(harness: Harness) -> list[Row]:
    """Begin many requests of each kind with one key and leave, again and again; ask for values with another key."""
    rows = []
    (folder := harness.folder / "abandoned").mkdir()
    with harness.server(folder, require_keys="true", key_requests_per_second="1000000", workers="1") as server:
        server.start()
        greedy, other = (new_key(server, name)[1] for name in ("greedy", "other"))
        fits = [_fit(server, harness, greedy, {**QUICK, "em_iterations": 3 + number}) for number in range(_FITS)]
        fit, endless = _fit(server, harness, other, QUICK), _fit(server, harness, greedy, ENDLESS)
        wait_until(lambda: bool(server.workers()))
        for pid in server.workers():  # the fit is followed, and takes no processor time
            os.kill(pid, signal.SIGSTOP)
        url = f"{str(server.http.base_url).rstrip('/')}{fit}/brdf?theta_half_deg=10&theta_diff_deg=30"
        get_repeatedly(url, 4, 1.0, other["Authorization"])
        key = f"Authorization: {greedy['Authorization']}\r\n"
        for name, count, requests in _kinds(key, fits, endless):
            quiet = [get_repeatedly(url, 4, SECONDS, other["Authorization"]).p99 for _ in range(3)]
            with _abandoning(server, count, requests):
                begin = time.perf_counter()
                server.http.get(f"{fit}/export?format=csv", headers=other).raise_for_status()
                first = time.perf_counter() - begin
                busy = [get_repeatedly(url, 4, SECONDS, other["Authorization"]).p99 for _ in range(3)]
            before, meanwhile = statistics.median(quiet), statistics.median(busy)
            asked = (
                f"{count} abandoned {name}: another key's GET p99 <= 3 times the quiet one, its export <= 3 s, no 503"
            )
            measured = f"p99 {meanwhile:.1f} ms, quiet {before:.1f} ms; export {first:.2f} s; every answer 200"
            rows.append(Row(asked, measured, meanwhile <= 3.0 * before and first <= 3.0))
    return rows


def _kinds(key: str, fits: Sequence[str], endless: str) -> Iterator[tuple[str, int, Callable[[int], bytes]]]:
    """Yield name, number and requests of each kind; those of one kind ask for different things where there are some."""

    def get(path: str) -> bytes:
        return f"GET {path} HTTP/1.1\r\nHost: x\r\n{key}\r\n".encode()

    def export(file_format: str) -> Callable[[int], bytes]:
        part = itertools.cycle(_COMPONENTS)
        return lambda number: get(f"{fits[number % _FITS]}/export?format={file_format}{next(part)}")

    points = json.dumps({"theta_half_deg": [1.5] * 100_000, "theta_diff_deg": [30.5] * 100_000})
    head = f"HTTP/1.1\r\nHost: x\r\n{key}Content-Type: application/json\r\nContent-Length: {len(points)}"
    figures = ("profiles", "lobes", "parameters", "residual")
    yield "exports as materialx", ABANDONED, export("materialx")
    yield "exports as bsdf", ABANDONED, export("bsdf")
    yield "exports as merl", ABANDONED, export("merl")
    yield "figures", ABANDONED, lambda number: get(f"{fits[number % _FITS]}/figures/{figures[number % 4]}.svg")
    yield "components", ABANDONED, lambda number: get(f"{fits[number % _FITS]}/components")
    yield "batches", ABANDONED, lambda number: f"POST {fits[number % _FITS]}/brdf {head}\r\n\r\n{points}".encode()
    yield "event streams", ABANDONED, lambda _: get(f"{endless}/events")


@contextmanager
def _abandoning(server: Server, count: int, request: Callable[[int], bytes]) -> Iterator[None]:
    """Begin so many requests and leave them, again and again, during the block."""
    over = threading.Event()
    address = server.http.base_url

    async def leave_again(number: int) -> None:
        await asyncio.sleep(_STAY * number / count)
        while True:
            with suppress(OSError):
                _, writer = await asyncio.open_connection(address.host, address.port)
                writer.write(request(number))
                await asyncio.sleep(_STAY)
                writer.close()

    async def run() -> None:
        tasks = [asyncio.create_task(leave_again(number)) for number in range(count)]
        await asyncio.to_thread(over.wait)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    thread = threading.Thread(target=asyncio.run, args=(run(),))
    thread.start()
    time.sleep(1.5 * _STAY)  # until all have begun
    try:
        yield
    finally:
        over.set()
        thread.join()


def _fit(server: Server, harness: Harness, key: dict[str, str], options: dict[str, object]) -> str:
    """Fit the measurement, or begin an endless fit; return the fit's path."""
    stored = server.http.post("/v1/measurements", content=harness.measurement.read_bytes(), headers=key)
    document = {"measurement": stored.raise_for_status().json()["sha256"], "options": options}
    prefer = {"Prefer": "respond-async" if options is ENDLESS else "wait=60"}
    return (
        f"/v1/fits/{server.http.post('/v1/fits', json=document, headers=key | prefer).raise_for_status().json()['id']}"
    )
