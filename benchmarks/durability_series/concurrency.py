"""Series with many clients at once, and on a disk that is full."""

import errno
import socket
import struct
import subprocess
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import httpx

from benchmarks.durability_series.harness import (
    Harness,
    becomes_true,
    counted_workers,
    leftovers,
    query_database,
    same_bits,
)
from benchmarks.durability_series.stateful_clients import TWO_LOBE_FIT
from tests.support.server import QUICK, Server

_RAW = {"Content-Type": "application/octet-stream"}
_DISK = "160m"  # four measurements and a database


def queued(harness: Harness, times: int) -> str:
    """Submit many fits, each by four clients at once, and count what was computed."""
    masks = [number / times for number in range(times)]
    with harness.server(workers="2", queue_limit=str(times)) as server:
        server.start()
        sha256 = server.http.post("/v1/measurements", content=harness.variant(0)).json()["sha256"]

        def submit_all(order: list[float]) -> set[str]:
            answers = [server.submit(sha256, prefer="respond-async", **QUICK, mask=mask) for mask in order]
            harness.expect(all(answer.status_code in (200, 202) for answer in answers), "a fit was not accepted")
            return {answer.json()["id"] for answer in answers}

        with counted_workers(server) as seen, ThreadPoolExecutor(4) as clients:
            found = list(clients.map(submit_all, [harness.random.sample(masks, times) for _ in range(4)]))
            ids = found[0]
            harness.expect(
                all(one == ids for one in found) and len(ids) == times, "clients were told of different fits"
            )
            done = becomes_true(lambda: query_database(server, _UNFINISHED) == [(0,)], 60.0 + 4.0 * times)
            harness.expect(done, "fits did not come to their end")
        states = Counter(query_database(server, "SELECT status, attempts FROM fits"))
        lost = times - states["succeeded", 1]
        harness.expect(lost == 0, f"not every fit has succeeded at its first attempt: {states}")
        # One that is gone within milliseconds may not have been seen; the service has counted it all the same.
        computed = max(len(seen), _computed(server))
        harness.expect(computed == times, f"{computed} processes computed {times} fits")
        server.stop()
    return f"{times} fits, each submitted by 4 clients: {lost} lost, {computed} computations"


def _computed(server: Server) -> int:
    """Return how many fits a server reports as computed."""
    text = server.http.get("/metrics").text
    return int(float(text.partition('dsbrdf_stage_seconds_count{stage="fitting"} ')[2].split()[0]))


_UNFINISHED = "SELECT count(*) FROM fits WHERE status IN ('accepted', 'running')"


def uploads(harness: Harness, times: int) -> str:
    """Upload many measurements at once; every third client disconnects in the middle."""
    with harness.server() as server:
        server.start()
        base = server.http.base_url

        def upload(number: int) -> int:
            body = harness.variant(number)
            if number % 3 == 0:
                _vanish(base, body, len(body) * (number + 1) // (times + 2), abruptly=number % 2 == 0)
                return 0
            return httpx.post(base.join("/v1/measurements"), content=body, timeout=120).status_code

        with ThreadPoolExecutor(times) as clients:
            answers = Counter(clients.map(upload, range(times)))
        stayed = times - answers[0]
        harness.expect(answers == Counter({0: answers[0], 201: stayed}), f"uploads were answered with {answers}")
        harness.expect(
            becomes_true(lambda: not list((server.data_dir / "tmp").iterdir()), 60.0), "half an upload was kept"
        )
        harness.expect(not (left := leftovers(server)), f"left behind by clients that vanished: {left}")
        harness.expect(len(server.files()) == stayed, f"{len(server.files())} files of {stayed} uploads")
        harness.expect(
            query_database(server, "SELECT count(*) FROM measurements") == [(stayed,)],
            "rows are not those of the files",
        )
        harness.expect("Traceback" not in server.log.read_text(), f"a stack trace is in {server.log}")
        server.stop()
    return f"{stayed} stored, {answers[0]} vanished: {len(harness.faults)} faults"


def _vanish(base: httpx.URL, body: bytes, size: int, abruptly: bool) -> None:
    """Send the beginning of an upload and close the connection, normally or with a reset."""
    with socket.create_connection((base.host, base.port or 80)) as connection:
        head = f"POST /v1/measurements HTTP/1.1\r\nHost: {base.host}\r\nContent-Length: {len(body)}\r\n\r\n"
        connection.sendall(head.encode() + body[:size])
        if abruptly:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


def same_file(harness: Harness, times: int) -> str:
    """Send the same file for the same fit by many clients at once."""
    with harness.server() as server:
        server.start()
        body = harness.variant(0)
        url = server.http.base_url.join("/v1/fits")

        def fit(_: int) -> httpx.Response:
            return httpx.post(url, params=QUICK, content=body, headers={**_RAW, "Prefer": "wait=120"}, timeout=180)

        with counted_workers(server) as seen, ThreadPoolExecutor(times) as clients:
            answers = list(clients.map(fit, range(times)))
        statuses = Counter(answer.status_code for answer in answers)
        harness.expect(statuses == Counter({200: times - 1, 201: 1}), f"the answers were {statuses}")
        harness.expect(len({answer.content for answer in answers}) == 1, "clients were given different fits")
        harness.expect(
            query_database(server, "SELECT attempts FROM fits") == [(1,)], "it was more than one fit, or attempt"
        )
        harness.expect(len(server.files()) == 1, f"{len(server.files())} files are kept")
        computed = max(len(seen), _computed(server))
        harness.expect(computed == 1, f"{computed} processes computed one fit")
        server.stop()
    return f"{times} clients: {len(server.files())} blob, {computed} computation"


def full_disk(harness: Harness, times: int) -> str:
    """Fill the disk while a fit runs, send more than there is room for, then make room, first through the service."""
    recovered = 0.0
    (model,) = harness.models(TWO_LOBE_FIT)
    with _small_disk(harness.folder / "disk") as disk, harness.server(disk, min_free_mb="1") as server:
        server.start()
        for number in range(times):
            sha256, spare = (
                server.http.post("/v1/measurements", content=harness.variant(variant)).json()["sha256"]
                for variant in (3 * number, 3 * number + 1)
            )
            fit_id = server.submit(sha256, prefer="respond-async", **TWO_LOBE_FIT).json()["id"]
            server.until_running(fit_id)
            filler = _fill(disk)
            _refusals(harness, server, sha256)
            harness.expect(becomes_true(lambda: not server.workers(), 60.0), "a fit does not end on the full disk")
            begin = time.monotonic()
            deleted = server.http.delete(f"/v1/measurements/{spare}")
            harness.expect(
                deleted.status_code == 204, f"a deletion on the full disk: {deleted.status_code} {deleted.text}"
            )
            fit = server.http.get(f"/v1/fits/{fit_id}?wait=60").json()
            recovered = max(recovered, time.monotonic() - begin)
            harness.expect(fit["status"] == "succeeded", f"a fit that ended on the full disk: {fit}")
            exported = server.http.get(f"/v1/fits/{fit_id}/export?format=json")
            harness.expect(same_bits(exported.text, model), "a model is not the library's, bit for bit")
            filler.unlink()
            again = server.http.post("/v1/measurements", content=harness.variant(3 * number + 2))
            harness.expect(again.status_code == 201, f"an upload after the full disk: {again.text}")
            ready = becomes_true(lambda: server.http.get("/health/ready").status_code == 200, 30.0)
            harness.expect(ready, "the service is not ready again")
            _clear(server)
        harness.expect(not (left := leftovers(server)), f"left behind: {left}")
        harness.expect(query_database(server, "PRAGMA integrity_check") == [("ok",)], "the database is damaged")
        server.stop()
    return f"{times} times full, at work again within {recovered:.1f} s: {len(harness.faults)} faults"


def _refusals(harness: Harness, server: Server, sha256: str) -> None:
    """Check that a server on a full disk refuses what needs room."""
    upload = server.http.post("/v1/measurements", content=harness.variant(-1))
    harness.expect(upload.status_code == 507, f"an upload to a full disk: {upload.status_code} {upload.text}")
    # The log of the database may have room for a few rows.
    statuses: list[int] = []
    while len(statuses) < 500 and 507 not in statuses:
        answer = server.submit(sha256, prefer="respond-async", **QUICK, mask=len(statuses) / 1000)
        statuses.append(answer.status_code)
    harness.expect(set(statuses) <= {202, 507} and 507 in statuses, f"fits on a full disk: {Counter(statuses)}")
    harness.expect(server.http.get("/v1/fits").status_code == 200, "fits are not listed on a full disk")
    unready = becomes_true(lambda: server.http.get("/health/ready").status_code == 503, 30.0)  # it may be a second old
    harness.expect(unready, "the service is ready although the disk is full")


def _clear(server: Server) -> None:
    """Remove all fits and measurements."""
    while items := server.http.get("/v1/fits?limit=200").json()["items"]:
        for item in items:
            server.http.delete(f"/v1/fits/{item['id']}")
    for item in server.http.get("/v1/measurements").json()["items"]:
        server.http.delete(f"/v1/measurements/{item['sha256']}")


def _fill(disk: Path) -> Path:
    """Write a file that leaves no room, and return its path."""
    path = disk / "filler"
    with path.open("wb", buffering=0) as file:
        for size in (1 << 20, 1 << 12, 1):
            try:
                while file.write(bytes(size)) == size:
                    pass
            except OSError as error:
                if error.errno != errno.ENOSPC:
                    raise
    return path


@contextmanager
def _small_disk(folder: Path) -> Iterator[Path]:
    """Mount a small file system in memory, which needs root."""
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={_DISK}", "tmpfs", folder], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True)
