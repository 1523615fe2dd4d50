"""What one API key's worst requests cost the others: waits of another key, readiness, and memory of the web process.

One key sends tables that take long to read, HEAD requests, exports and tables that it does not read, or uploads that it
does not end. Meanwhile another key asks for values, the document of its fit and what is understood of a table of 400
rows, one after the other. Other work on the machine makes rows miss.
"""

import socket
import statistics
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from functools import partial
from typing import NamedTuple

import httpx

from benchmarks.server.load import PeakMemory
from benchmarks.server.runner import Place, Row, Scenario
from benchmarks.server.runner import main as run_scenarios
from dsbrdf.data.merl_validation import FILE_SIZE
from dsbrdf_service.storage.database import Database
from dsbrdf_service.storage.keys import add_key
from tests.support.server import QUICK, Server

CONNECTIONS = 240
MAX_MEDIAN_MS = 50.0
MAX_WAIT_S = 2.0
MAX_MEMORY_MB = 250.0
_NAMES = b"theta_in,phi_in,theta_out,phi_out,red,green,blue\n"
_TABLE_BYTES = 8_000_000
_WORST_TABLES = (
    b"a," * (_TABLE_BYTES // 2),
    (b"a," * 8000 + b"\n") * (_TABLE_BYTES // 16_001),
    _NAMES + b"a,b,c,d,e,f,g\n" * (_TABLE_BYTES // 14),
    _NAMES + b",,,,,,\n" * 700_000,
    _NAMES + b"10,0,20,180,0.1,0.1,0.1\n" * (_TABLE_BYTES // 24),
    b"theta_out / theta_in" + b",1" * 1990 + b"\n" + (b"1" + b",1" * 1990 + b"\n") * 2000,
)
_ROW = b"%d,0,%d,180,0.1,0.1,0.1\n"
_SMALL_TABLE = _NAMES + b"".join(_ROW % (1 + i % 80, 1 + i // 5) for i in range(400))


class Neighbours(NamedTuple):
    """A service with two keys, each of which has a measurement and a fit."""

    server: Server
    attacker: str
    neighbour: str
    measurement: str
    fit: str


def _headers(key: str, **more: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {key}", **more}


def _repeatedly(
    neighbours: Neighbours, ask: Callable[[httpx.Client, int], object], threads: int, end: threading.Event
) -> None:
    """Ask again and again in some threads until the end."""

    def run(number: int) -> None:
        with httpx.Client(
            base_url=neighbours.server.http.base_url, headers=_headers(neighbours.attacker), timeout=120
        ) as client:
            try:
                while not end.is_set():
                    ask(client, number)
                    number += threads
            except httpx.TransportError:
                if not end.is_set():  # Afterwards, the server may end before its answer.
                    raise

    for number in range(threads):
        threading.Thread(target=run, args=(number,), daemon=True).start()


@contextmanager
def tables(neighbours: Neighbours) -> Iterator[None]:
    """Send tables that take long to read, two at a time."""

    def ask(client: httpx.Client, number: int) -> object:
        body = _WORST_TABLES[number % len(_WORST_TABLES)]
        return client.post("/v1/measurements", content=body, headers={"Content-Type": "text/csv"})

    end = threading.Event()
    _repeatedly(neighbours, ask, 2, end)
    yield
    end.set()


@contextmanager
def heads(neighbours: Neighbours) -> Iterator[None]:
    """Ask whether the measurement is stored, on 16 connections."""
    end, url = threading.Event(), f"/v1/measurements/{neighbours.measurement}/content"
    _repeatedly(neighbours, lambda client, _: client.head(url), 16, end)
    yield
    end.set()


def _unread(neighbours: Neighbours, head: str, body: bytes = b"") -> Callable[[], socket.socket]:
    lines = f"{head} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {neighbours.attacker}\r\n"
    length = f"Content-Length: {FILE_SIZE}\r\n" if body else ""
    return partial(neighbours.server.connection, f"{lines}{length}\r\n".encode() + body)


@contextmanager
def _open(connect: Callable[[], socket.socket]) -> Iterator[None]:
    """Keep connections open that nobody reads."""
    with ExitStack() as connections:
        for _ in range(CONNECTIONS):
            connections.enter_context(connect())
        yield


def exports(neighbours: Neighbours) -> AbstractContextManager[None]:
    """Ask for MERL files of the fit, and do not read them."""
    return _open(_unread(neighbours, f"GET /v1/fits/{neighbours.fit}/export?format=merl"))


def unread(neighbours: Neighbours) -> AbstractContextManager[None]:
    """Ask for tables of the measurement, and do not read them."""
    return _open(_unread(neighbours, f"GET /v1/measurements/{neighbours.measurement}/table.npy"))


def uploads(neighbours: Neighbours) -> AbstractContextManager[None]:
    """Begin uploads, and do not end them."""
    begin = neighbours.server.http.get(
        f"/v1/measurements/{neighbours.measurement}/content", headers=_headers(neighbours.attacker)
    )
    return _open(_unread(neighbours, "POST /v1/measurements", begin.content[:1_000_000]))


ATTACKS: dict[str, Callable[[Neighbours], AbstractContextManager[None]]] = {
    "tables": tables,
    "heads": heads,
    "exports": exports,
    "unread": unread,
    "uploads": uploads,
}


@contextmanager
def two_keys(place: Place) -> Iterator[Neighbours]:
    """Start a service in which two keys have fitted the same measurement."""
    with closing(Database(place.folder / "data", exclusive=False)) as database:
        keys = [add_key(database, name, requests_per_second=1e6)[1] for name in ("attacker", "neighbour")]
    with place.server(require_keys="true", workers="1") as server:
        server.start()
        for key in keys:
            headers = _headers(key, **{"Content-Type": "application/octet-stream", "Prefer": "wait=300"})
            answer = server.http.post(
                "/v1/fits", params=QUICK, content=place.measurement.read_bytes(), headers=headers, timeout=300
            )
            document = answer.raise_for_status().json()
        yield Neighbours(server, keys[0], keys[1], document["measurement"], document["id"])


def measure(attack: str, place: Place) -> list[Row]:
    """Measure the waits of the neighbour during an attack."""
    with two_keys(place) as neighbours:
        return _measured(neighbours, attack, place.amount)


def _measured(neighbours: Neighbours, attack: str, seconds: float) -> list[Row]:
    probes: dict[str, Callable[[httpx.Client], httpx.Response]] = {
        "values": lambda client: client.get(f"/v1/fits/{neighbours.fit}/brdf?theta_half_deg=1&theta_diff_deg=2"),
        "document": lambda client: client.get(f"/v1/fits/{neighbours.fit}"),
        "table": lambda client: client.post("/v1/tables", content=_SMALL_TABLE, headers={"Content-Type": "text/csv"}),
    }
    waits: dict[str, list[float]] = {name: [] for name in probes}
    refused, memory, base = 0, PeakMemory(neighbours.server.process.pid), neighbours.server.http.base_url
    with (
        ATTACKS[attack](neighbours),
        httpx.Client(base_url=base, headers=_headers(neighbours.neighbour), timeout=60) as client,
    ):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for name, probe in probes.items():
                begin = time.perf_counter()
                probe(client).raise_for_status()
                waits[name].append(time.perf_counter() - begin)
            refused += client.get("/health/ready").status_code != 200
            time.sleep(0.02)
    peak = (memory.before + memory.growth()) / (1 << 20)
    medians = {name: 1e3 * statistics.median(times) for name, times in waits.items()}
    largest = {name: max(times) for name, times in waits.items()}
    shown = ", ".join(f"{name} {medians[name]:.0f} ms / {largest[name]:.2f} s" for name in waits)
    holds = max(medians.values()) <= MAX_MEDIAN_MS and max(largest.values()) <= MAX_WAIT_S and not refused
    asked = (
        f"{attack}: another key waits {MAX_MEDIAN_MS:.0f} ms in the median, {MAX_WAIT_S:.0f} s at most, always ready"
    )
    return [
        Row(asked, f"{shown}; not ready {refused} times", holds),
        Row(
            f"{attack}: memory of the web process at most {MAX_MEMORY_MB:.0f} MB",
            f"{peak:.0f} MB",
            peak <= MAX_MEMORY_MB,
        ),
    ]


def main(argv: Sequence[str]) -> int:
    """Print the table."""
    scenarios = {attack: Scenario(partial(measure, attack), 15.0) for attack in ATTACKS}
    return run_scenarios("neighbours", __doc__, scenarios, argv, unit="seconds", own_interpreter=True)
