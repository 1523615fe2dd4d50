"""A series of restores: a data folder is put back wrongly, or damaged, and a server is started on it."""

import hashlib
import os
import re
import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import httpx

from benchmarks.server.runner import Place, Row
from dsbrdf_service.storage.database import FILE_NAME
from tests.support.processes import wait_until
from tests.support.server import QUICK, Server, new_key

_FITS: tuple[dict[str, Any], ...] = ({}, {"n_lobes": 2}, {"n_lobes": 3})
_REFUSED = 2  # exit code
_PAGE = 4096


class _Original:
    """A folder in which everything is right, an older copy of its database, and what a server says of it."""

    def __init__(self, place: Place) -> None:
        folder = place.folder / "original"
        folder.mkdir()
        self.folder, self.older = folder / "data", folder / "older"
        self.bodies = {hashlib.sha256(body).hexdigest(): body for body in map(place.variant, range(3))}
        self.models: dict[str, bytes] = {}
        with place.server(folder, workers="2") as server:
            for number, body in enumerate(self.bodies.values()):
                server.start()
                for options in _FITS:
                    fit = server.http.post("/v1/fits", params={**QUICK, **options}, content=body).json()["id"]
                    self.models[fit] = server.http.get(f"/v1/fits/{fit}/export?format=json").content
                new_key(server, f"key {number}")
                server.stop()
                if number == 0:
                    shutil.copy(self.folder / FILE_NAME, self.older)

    def copy(self, folder: Path) -> None:
        """Make a copy; its measurements are links to the same files, which are not to be written to."""
        shutil.copytree(self.folder, folder, ignore=shutil.ignore_patterns("*.binary"))
        for path in self.folder.glob("blobs/*/*"):
            os.link(path, folder / path.relative_to(self.folder))


def restored(place: Place) -> list[Row]:
    """Damage copies of a folder at random, and look at what a server makes of each."""
    original = _Original(place)
    ends: Counter[str] = Counter()
    for number in range(place.times):
        folder = place.folder / f"copy{number}"
        folder.mkdir()
        original.copy(folder / "data")
        done = [_damage_database(place, original, folder / "data")]
        done += [_damage_file(place, folder / "data") for _ in range(place.random.randrange(3))]
        found = len(place.faults)
        with place.server(folder) as server:
            before = _contents(folder)
            ends[_look(place, original, server)] += 1
            after = _contents(folder)
            for path, digest in before.items():
                kept = after.get(path) in (digest, path.stem)  # as it was, or mended by an upload
                place.expect(kept, f"the file {path.name} is gone, or is another one")
        place.faults[found:] = [f"restore {number} ({', '.join(done)}): {fault}" for fault in place.faults[found:]]
        shutil.rmtree(folder)
    asked = f"{place.times} damaged folders: no file gone, no wrong byte, one sentence or a working service"
    return place.row(asked, f"{ends['working']} working, {ends['refused']} refused")


def _damage_database(place: Place, original: _Original, folder: Path) -> str:
    """Put an older database in its place, or damage it; return what was done."""
    path, random = folder / FILE_NAME, place.random
    kind = random.choice(("nothing", "older", "older and zeroed", "zeroed", "swapped", "swapped", "cut"))
    if kind.startswith("older"):
        shutil.copy(original.older, path)
    content = path.read_bytes()
    pages = [content[at : at + _PAGE] for at in range(0, len(content), _PAGE)]
    if kind.endswith("zeroed"):
        for _ in range(random.randint(1, 3)):
            pages[random.randrange(len(pages))] = bytes(_PAGE)
    elif kind == "swapped":
        one, other = random.sample(range(1, len(pages)), 2)
        pages[one], pages[other] = pages[other], pages[one]
    elif kind == "cut":
        del pages[random.randrange(1, len(pages)) :]
    path.write_bytes(b"".join(pages))
    return f"database {kind}"


def _damage_file(place: Place, folder: Path) -> str:
    """Damage a measurement's file; return what was done."""
    random = place.random
    files = sorted(folder.glob("blobs/*/*.binary"))
    path, other = random.choice(files), random.choice(files)
    kind = random.choice(("cut", "flipped", "names swapped", "renamed", "linked", "removed"))
    if kind in ("cut", "flipped") and path.exists():  # it may be a link that leads nowhere
        content = bytearray(path.read_bytes())
        path.unlink()  # the original has the same file
        content[random.randrange(len(content))] ^= 1 << random.randrange(8)
        path.write_bytes(content[: random.randrange(len(content))] if kind == "cut" else content)
    elif kind == "names swapped" and other != path:
        path.rename(folder / "between")
        other.rename(path)
        (folder / "between").rename(other)
    elif kind == "renamed":
        path.rename(path.with_name(f"{random.randbytes(32).hex()}.binary"))
    elif kind == "linked":
        path.unlink()
        path.symlink_to(other if other != path else "nothing")
    else:
        path.unlink()
    return f"file {kind}"


def _look(place: Place, original: _Original, server: Server) -> str:
    """Start the server; it works or refuses to; return which."""
    begin = server.launch()
    wait_until(lambda: server.process.poll() is not None or b"Uvicorn running on" in server.log.read_bytes()[begin:])
    if server.process.poll() is not None:
        said = server.log.read_text()
        one_sentence = said.startswith("dsbrdf: ") and said.count("\n") == 1
        place.expect(server.process.poll() == _REFUSED and one_sentence, f"the server did not start: {said[-500:]}")
        return "refused"
    server.connect(begin)
    for sha256, body in original.bodies.items():
        _read(place, server.http, f"/v1/measurements/{sha256}/content", body)
    for fit, model in original.models.items():
        _read(place, server.http, f"/v1/fits/{fit}/export?format=json", model)
        place.expect(server.http.get(f"/v1/fits/{fit}").status_code < 500, "a fit cannot be shown")
    for sha256, body in original.bodies.items():
        answer = server.http.post("/v1/measurements", content=body)
        place.expect(answer.is_success, f"an upload: {answer.status_code} {answer.text}")
        place.expect(
            server.http.get(f"/v1/measurements/{sha256}/content").content == body, "an upload has mended nothing"
        )
    place.expect(server.stop() == 0, "the server did not end well")
    place.expect("Traceback" not in server.log.read_text(), f"a traceback: {server.log.read_text()[-1000:]}")
    return "working"


def _read(place: Place, http: httpx.Client, url: str, right: bytes) -> None:
    """Expect the right bytes, or a problem that is no fault of the service's code; HEAD says the same."""
    answer, head = http.get(url), http.head(url)
    if answer.is_success:
        place.expect(_lasting(answer.content) == _lasting(right), f"{url}: wrong bytes")
    else:
        problem = answer.headers["content-type"] == "application/problem+json" and answer.status_code in (404, 409)
        place.expect(problem, f"{url}: {answer.status_code} {answer.text}")
    place.expect(head.is_success == answer.is_success, f"HEAD {url} says {head.status_code}, not as GET")


def _lasting(content: bytes) -> bytes:
    """Return a document without its timings: a fit that an old page calls unfinished is computed once more."""
    return re.sub(rb'"timings": *\{[^}]*\}', b"", content)


def _contents(folder: Path) -> dict[Path, str]:
    """Return the digests of all files that could be those of measurements."""
    files = [path for path in (folder / "data/blobs").rglob("*") if path.is_file()]
    return {path: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
