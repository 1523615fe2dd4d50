"""Series that end processes: kill -9 of the server and of its fits, and SIGTERM."""

import os
import resource
import signal
import socket
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import partial
from pathlib import Path

import httpx

from benchmarks.server.clients import OPTIONS, TWO_LOBE_FIT, StatefulClient, running_clients
from benchmarks.server.runner import (
    Place,
    Row,
    becomes_true,
    leftovers,
    query_database,
    same_bits,
    temporary_files,
)
from dsbrdf.data import FILE_SIZE
from dsbrdf_service.storage.maintenance import purge_folder
from tests.support.server import Server

_CLIENTS = 4
_STARTS_KILLED = 0.25  # share of the starts that are killed, too
_LITTLE_MEMORY = (8 << 20, 160 << 20)  # bytes of address space that a fit may add; it adds some 200 MB
_LONGEST_END = 10.0  # seconds
_LAST_BREATH = 30.0  # seconds after which a process of a server which is gone counts as left behind
_PATIENCE = 60.0  # seconds; on a busy machine everything takes longer


def server_killed(place: Place) -> list[Row]:
    """Kill the server at random moments under load; start it again at once."""
    models, times = place.models(*OPTIONS), place.times
    clients = [StatefulClient(number, place, models) for number in range(min(_CLIENTS, times))]
    with place.server(workers="2") as server:
        server.start()
        for _ in range(times):
            _kill_under_load(place, server, clients)
        promised = sum(client.settle(server.http) for client in clients)
        accepted = sum(client.accepted for client in clients)
        # A kill between the end of a row and that of its file leaves the file.
        files = purge_folder(server.data_dir, None, files_without_rows=True)["files_without_rows"]
        _end(place, server)
    measured = (
        f"{times} kills, {_answers(clients)} requests, {accepted} fits accepted, {promised} of them due at the end, "
        f"{files} files without rows"
    )
    asked = f"{times} times kill -9 of the server: 0 accepted fits lost, 0 orphans, 0 temporary files"
    return place.row(asked, measured)


def _kill_under_load(place: Place, server: Server, clients: list[StatefulClient]) -> None:
    with running_clients(clients, str(server.http.base_url)) as over:
        # However busy the machine is, some requests are answered before the kill and some are in the middle of it.
        enough = _answers(clients) + place.random.randrange(40)
        becomes_true(lambda: _answers(clients) >= enough, 20.0)
        time.sleep(place.random.uniform(0.0, 0.5))
        over.set()
        before = server.processes()
        server.stop(signal.SIGKILL)
    while place.random.random() < _STARTS_KILLED:
        server.launch()
        time.sleep(place.random.uniform(0.0, 2.0))
        before |= server.processes()
        server.stop(signal.SIGKILL)
    server.start()
    outlived = "processes outlived a server that was killed"
    place.expect_soon(lambda: not before & server.processes(), _LAST_BREATH, outlived)
    left = temporary_files(server)
    place.expect(not left, f"left behind by a server that was killed: {left}")


def _answers(clients: list[StatefulClient]) -> int:
    return sum(client.answers.total() for client in clients)


def _end(place: Place, server: Server) -> None:
    """Stop a server, and check that it leaves nothing behind."""
    place.expect(server.stop() == 0, "the server did not end well")
    place.expect_soon(lambda: not server.processes(), _LAST_BREATH, "processes outlived the server")
    left = [*leftovers(server), *(server.data_dir / "run").iterdir()]
    place.expect(not left, f"left behind by the server: {left}")
    place.expect(query_database(server, "PRAGMA integrity_check") == [("ok",)], "the database is damaged")


def child_killed(place: Place) -> list[Row]:
    """Kill the process of one of two fits, sometimes on both attempts; the other fit must not be affected."""
    pair, times = _Pair(place), place.times
    killed = spared = 0
    with place.server(workers="2", fit_attempts="2") as server:
        server.start()
        while killed < times and spared < 2 * times:
            workers = pair.begin(server)
            meant = 1
            hit = _kill_soon(place, place.random.choice(sorted(workers)))
            if hit and killed + 1 < times and place.random.random() < 0.5:
                replacement = _next_worker(server, workers)
                meant += replacement is not None and _kill_soon(place, replacement)
            lost = pair.check(server, _LOST[meant])
            killed, spared = killed + lost, spared + meant - lost
        place.expect(killed >= times, f"only {killed} kills came before the end of a fit")
        _end(place, server)
    asked = f"{times} times kill -9 of a child: only that fit affected, typed error"
    return place.row(asked, f"{killed} kills ({spared} more came too late)")


def out_of_memory(place: Place) -> list[Row]:
    """Let one of two fits run out of memory at a random moment; the other fit must not be affected."""
    pair, times = _Pair(place), place.times
    starved = spared = 0
    with place.server(workers="2") as server:
        server.start()
        while starved < times and spared < 2 * times:
            pair.begin(server, lambda: _starved(place, server))
            lost = pair.check(server, _STARVED)
            starved, spared = starved + lost, spared + 1 - lost
        place.expect(starved == times, f"only {starved} fits ran out of memory")
        _end(place, server)
    asked = f"{times} times out of memory: only that fit affected, typed error"
    return place.row(asked, f"{starved} fits out of memory ({spared} had all they needed by then)")


@contextmanager
def _starved(place: Place, server: Server) -> Iterator[None]:
    """Lower the limit of memory of the process that fits are forked from, so that a fit that begins now has it too."""
    (worker,) = server.workers()
    parent = int(Path(f"/proc/{worker}/stat").read_text().rpartition(")")[2].split()[1])
    few = int(Path(f"/proc/{parent}/statm").read_text().split()[0]) * resource.getpagesize()
    few += place.random.randrange(*_LITTLE_MEMORY)
    before = resource.prlimit(parent, resource.RLIMIT_AS)
    resource.prlimit(parent, resource.RLIMIT_AS, (few, before[1]))
    try:
        yield
    finally:
        resource.prlimit(parent, resource.RLIMIT_AS, before)


# How two fits may end, as pairs of end and attempts; what hits one of them may come when it is over.
_FINE = ("succeeded", 1)
_ONCE = [{_FINE}, {_FINE, ("succeeded", 2)}]
_LOST = {1: _ONCE, 2: [*_ONCE, {_FINE, ("system ProcessLost", 2)}]}
_STARVED = [{_FINE}, {_FINE, ("compute MemoryLimit", 1)}, {_FINE, ("compute ProcessCrashed", 1)}]


class _Pair:
    """Two fits that run at the same time, long enough for one to be killed."""

    def __init__(self, place: Place) -> None:
        self._place = place
        self._options = [{**TWO_LOBE_FIT, "n_lobes": 4, "mask": mask} for mask in (0.5, 0.6)]
        self._models = place.models(*self._options)
        self._fits: list[str] = []

    def begin(self, server: Server, second: Callable[[], AbstractContextManager[None]] = nullcontext) -> set[int]:
        """Start both, the second one within the context that `second` makes, and return their processes."""
        sha256 = server.http.post("/v1/measurements", content=self._place.variant(0)).json()["sha256"]
        self._fits.clear()
        for number, options in enumerate(self._options, start=1):
            with second() if number == 2 else nullcontext():
                answer = server.submit(sha256, prefer="respond-async", **options)
                self._fits.append(answer.json()["id"])
                began = partial(self._began, server, number)
                self._place.expect_soon(began, _PATIENCE, "two fits did not run at once")
        return server.workers()

    def _began(self, server: Server, n_fits: int) -> bool:
        """Whether so many fits have processes, or the last one has ended already."""
        ended = "SELECT 1 FROM fits WHERE id = '{}' AND finished IS NOT NULL"
        return len(server.workers()) == n_fits or bool(query_database(server, ended.format(self._fits[-1])))

    def check(self, server: Server, allowed: list[set[tuple[str, int]]]) -> int:
        """Wait for the ends, compare them with the allowed ones, and remove the fits; return how often one was lost."""
        ends = set()
        for fit_id, model in zip(self._fits, self._models, strict=True):
            fit = server.http.get(f"/v1/fits/{fit_id}?wait=60").json()
            ((attempts,),) = query_database(server, f"SELECT attempts FROM fits WHERE id = '{fit_id}'")
            error = fit["error"]
            ends.add((f"{error['origin']} {error['type']}" if error else fit["status"], attempts))
            if not error:
                exported = server.http.get(f"/v1/fits/{fit_id}/export?format=json")
                self._place.expect(same_bits(exported.text, model), "a model is not the library's, bit for bit")
            server.http.delete(f"/v1/fits/{fit_id}")
        self._place.expect(ends in allowed, f"two fits, one of them hit, ended as {ends}")
        return sum(attempts - (end == "succeeded") for end, attempts in ends)


def _next_worker(server: Server, known: set[int]) -> int | None:
    """Return the process that replaces one of the known ones; none does if that had done its work."""
    becomes_true(lambda: bool(server.workers() - known), 10.0)
    return next(iter(server.workers() - known), None)


def _kill_soon(place: Place, pid: int) -> bool:
    """Kill a process at a random moment; return whether it was still there."""
    time.sleep(place.random.uniform(0.0, 0.3))
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return False
    return True


def terminated(place: Place) -> list[Row]:
    """Send SIGTERM while fits run, event streams and long-polls are open, and an upload has begun."""
    worst = 0.0
    with place.server(workers="2") as server:
        for _ in range(place.times):
            server.start()
            sha256 = server.http.post("/v1/measurements", content=place.variant(0)).json()["sha256"]
            answers = [server.submit(sha256, prefer="respond-async", **TWO_LOBE_FIT, mask=i / 10) for i in range(4)]
            fits = [answer.json()["id"] for answer in answers]
            with _held_open(server, fits):
                time.sleep(place.random.uniform(0.1, 1.0))
                begin = time.monotonic()
                code = server.stop()
                worst = max(worst, time.monotonic() - begin)
            place.expect(code == 0, f"the server ended with {code}")
            server.start()
            for fit_id in fits:
                fit = server.http.get(f"/v1/fits/{fit_id}?wait=60").json()
                place.expect(fit["status"] == "succeeded", f"a fit did not resume: {fit}")
                server.http.delete(f"/v1/fits/{fit_id}")
            _end(place, server)
    place.expect(worst <= _LONGEST_END, f"the server took {worst:.1f} s to end")
    asked = f"{place.times} times SIGTERM: out within {_LONGEST_END:.0f} s, fits resume"
    return place.row(asked, f"out within {worst:.1f} s")


@contextmanager
def _held_open(server: Server, fits: list[str]) -> Iterator[None]:
    """Follow fits by event streams and by long-polls, and send the first half of a measurement."""
    base = server.http.base_url

    def follow(fit_id: str) -> None:
        with suppress(httpx.TransportError), httpx.stream("GET", base.join(f"/v1/fits/{fit_id}/events")) as stream:
            stream.read()

    def poll(fit_id: str) -> None:
        with suppress(httpx.TransportError):
            httpx.get(base.join(f"/v1/fits/{fit_id}?wait=60"), timeout=60)

    with (
        ThreadPoolExecutor(2 * len(fits)) as pool,
        socket.create_connection((base.host, base.port or 80)) as upload,
    ):
        head = f"POST /v1/measurements HTTP/1.1\r\nHost: {base.host}\r\nContent-Length: {FILE_SIZE}\r\n\r\n"
        upload.sendall(head.encode() + bytes(1 << 20))
        for fit_id in fits:
            pool.submit(follow, fit_id)
            pool.submit(poll, fit_id)
        yield
