"""Series with many clients at once, and on a disk that is full."""

import errno
import subprocess
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import httpx

from benchmarks.server.clients import TWO_LOBE_FIT, vanish
from benchmarks.server.runner import (
    Place,
    Row,
    counted_workers,
    leftovers,
    query_database,
    same_bits,
    unfinished,
)
from tests.support.server import QUICK, Server

_RAW = {"Content-Type": "application/octet-stream"}
_DISK = "160m"  # four measurements and a database


def queued(place: Place) -> list[Row]:
    """Submit many fits, each by four clients at once, and count what was computed."""
    times = place.times
    masks = [number / times for number in range(times)]
    with place.server(workers="2", queue_limit=str(times)) as server:
        server.start()
        sha256 = server.http.post("/v1/measurements", content=place.variant(0)).json()["sha256"]

        def submit_all(order: list[float]) -> set[str]:
            answers = [server.submit(sha256, prefer="respond-async", **QUICK, mask=mask) for mask in order]
            place.expect(all(answer.status_code in (200, 202) for answer in answers), "a fit was not accepted")
            return {answer.json()["id"] for answer in answers}

        with counted_workers(server) as seen, ThreadPoolExecutor(4) as clients:
            found = list(clients.map(submit_all, [place.random.sample(masks, times) for _ in range(4)]))
            ids = found[0]
            place.expect(all(one == ids for one in found) and len(ids) == times, "clients were told of different fits")
            place.expect_soon(lambda: unfinished(server) == 0, 60.0 + 4.0 * times, "fits did not come to their end")
        states = Counter(query_database(server, "SELECT status, attempts FROM fits"))
        lost = times - states["succeeded", 1]
        place.expect(lost == 0, f"not every fit has succeeded at its first attempt: {states}")
        # One that is gone within milliseconds may not have been seen; the service has counted it all the same.
        computed = max(len(seen), _computed(server))
        place.expect(computed == times, f"{computed} processes computed {times} fits")
        server.stop()
    measured = f"{times} fits, each submitted by 4 clients: {lost} lost, {computed} computations"
    return place.row(f"{times} queued fits: 0 lost, 0 computed twice", measured)


def _computed(server: Server) -> int:
    """Return how many fits a server reports as computed."""
    text = server.http.get("/metrics").text
    return int(float(text.partition('dsbrdf_stage_seconds_count{stage="fitting"} ')[2].split()[0]))


def uploads(place: Place) -> list[Row]:
    """Upload many measurements at once; every third client disconnects in the middle."""
    times = place.times
    with place.server() as server:
        server.start()
        base = server.http.base_url

        def upload(number: int) -> int:
            body = place.variant(number)
            if number % 3 == 0:
                vanish(base, body, len(body) * (number + 1) // (times + 2), abruptly=number % 2 == 0)
                return 0
            return httpx.post(base.join("/v1/measurements"), content=body, timeout=120).status_code

        with ThreadPoolExecutor(times) as clients:
            answers = Counter(clients.map(upload, range(times)))
        stayed = times - answers[0]
        place.expect(answers == Counter({0: answers[0], 201: stayed}), f"uploads were answered with {answers}")
        halves = server.data_dir / "tmp"
        place.expect_soon(lambda: not list(halves.iterdir()), 60.0, "half an upload was kept")
        place.expect(not (left := leftovers(server)), f"left behind by clients that vanished: {left}")
        place.expect(len(server.files()) == stayed, f"{len(server.files())} files of {stayed} uploads")
        place.expect(
            query_database(server, "SELECT count(*) FROM measurements") == [(stayed,)],
            "rows are not those of the files",
        )
        place.expect("Traceback" not in server.log.read_text(), f"a stack trace is in {server.log}")
        server.stop()
    asked = f"{times} uploads, a third vanish: nothing left behind"
    return place.row(asked, f"{stayed} stored, {answers[0]} vanished")


def same_file(place: Place) -> list[Row]:
    """Send the same file for the same fit by many clients at once."""
    times = place.times
    with place.server() as server:
        server.start()
        body = place.variant(0)
        url = server.http.base_url.join("/v1/fits")

        def fit(_: int) -> httpx.Response:
            return httpx.post(url, params=QUICK, content=body, headers={**_RAW, "Prefer": "wait=120"}, timeout=180)

        with counted_workers(server) as seen, ThreadPoolExecutor(times) as clients:
            answers = list(clients.map(fit, range(times)))
        statuses = Counter(answer.status_code for answer in answers)
        place.expect(statuses == Counter({200: times - 1, 201: 1}), f"the answers were {statuses}")
        place.expect(len({answer.content for answer in answers}) == 1, "clients were given different fits")
        place.expect(
            query_database(server, "SELECT attempts FROM fits") == [(1,)], "it was more than one fit, or attempt"
        )
        place.expect(len(server.files()) == 1, f"{len(server.files())} files are kept")
        computed = max(len(seen), _computed(server))
        place.expect(computed == 1, f"{computed} processes computed one fit")
        server.stop()
    asked = f"{times} clients with one file: one blob, one fit"
    return place.row(asked, f"{len(server.files())} blob, {computed} computation")


def full_disk(place: Place) -> list[Row]:
    """Fill the disk while a fit runs, send more than there is room for, then make room, first through the service."""
    recovered = 0.0
    (model,) = place.models(TWO_LOBE_FIT)
    with _small_disk(place.folder / "disk") as disk, place.server(disk, min_free_mb="1") as server:
        server.start()
        for number in range(place.times):
            sha256, spare = (
                server.http.post("/v1/measurements", content=place.variant(variant)).json()["sha256"]
                for variant in (3 * number, 3 * number + 1)
            )
            fit_id = server.submit(sha256, prefer="respond-async", **TWO_LOBE_FIT).json()["id"]
            server.until_running(fit_id)
            filler = _fill(disk)
            _refusals(place, server, sha256)
            place.expect_soon(lambda: not server.workers(), 60.0, "a fit does not end on the full disk")
            begin = time.monotonic()
            deleted = server.http.delete(f"/v1/measurements/{spare}")
            place.expect(
                deleted.status_code == 204, f"a deletion on the full disk: {deleted.status_code} {deleted.text}"
            )
            fit = server.http.get(f"/v1/fits/{fit_id}?wait=60").json()
            recovered = max(recovered, time.monotonic() - begin)
            place.expect(fit["status"] == "succeeded", f"a fit that ended on the full disk: {fit}")
            exported = server.http.get(f"/v1/fits/{fit_id}/export?format=json")
            place.expect(same_bits(exported.text, model), "a model is not the library's, bit for bit")
            filler.unlink()
            again = server.http.post("/v1/measurements", content=place.variant(3 * number + 2))
            place.expect(again.status_code == 201, f"an upload after the full disk: {again.text}")
            place.expect_soon(lambda: server.http.get("/health/ready").is_success, 30.0, "it is not ready again")
            _clear(server)
        place.expect(not (left := leftovers(server)), f"left behind: {left}")
        place.expect(query_database(server, "PRAGMA integrity_check") == [("ok",)], "the database is damaged")
        server.stop()
    measured = f"{place.times} times full, at work again within {recovered:.1f} s"
    return place.row("disk full: 507, nothing lost, recovers", measured)


def _refusals(place: Place, server: Server, sha256: str) -> None:
    """Check that a server on a full disk refuses what needs room."""
    upload = server.http.post("/v1/measurements", content=place.variant(-1))
    place.expect(upload.status_code == 507, f"an upload to a full disk: {upload.status_code} {upload.text}")
    # The log of the database may have room for a few rows.
    statuses: list[int] = []
    while len(statuses) < 500 and 507 not in statuses:
        answer = server.submit(sha256, prefer="respond-async", **QUICK, mask=len(statuses) / 1000)
        statuses.append(answer.status_code)
    place.expect(set(statuses) <= {202, 507} and 507 in statuses, f"fits on a full disk: {Counter(statuses)}")
    place.expect(server.http.get("/v1/fits").status_code == 200, "fits are not listed on a full disk")
    # The response may be a second old.
    unready = "the service is ready although the disk is full"
    place.expect_soon(lambda: server.http.get("/health/ready").status_code == 503, 30.0, unready)


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
