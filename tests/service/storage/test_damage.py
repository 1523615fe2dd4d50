"""A file whose bytes are not its name's is never fitted or sent; one of another length is not drawn either."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from dsbrdf_service.client import Client
from tests.support.server import QUICK, Server, assert_problem

pytestmark = pytest.mark.slow


def flip(path: Path) -> None:
    """Change one bit, and set the file's time back."""
    before = path.stat()
    content = bytearray(path.read_bytes())
    content[20_000_000] ^= 1
    path.write_bytes(content)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1])


@pytest.fixture(scope="module")
def used(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> Iterator[tuple[Server, str, str]]:
    """A service with one measurement and a fit, and their ids; each test leaves the file whole."""
    with Server.running(tmp_path_factory.mktemp("damage") / "data") as server:
        fit = server.http.post("/v1/fits", params=QUICK, content=data).json()
        yield server, fit["measurement"], fit["id"]


HARMS: list[Callable[[Path], None]] = [Path.unlink, cut, flip]


@pytest.mark.parametrize("harm", HARMS)
def test_every_reader_refuses_a_damaged_file_in_the_same_way(
    used: tuple[Server, str, str], data: bytes, harm: Callable[[Path], None]
) -> None:
    server, sha256, fit = used
    options = QUICK | {"mask": 0.01 * HARMS.index(harm)}  # No other test has a fit with these.
    stored = f"/v1/measurements/{sha256}"
    url = f"{stored}/content"
    senders, drawers = [{}, {"If-None-Match": f'"{sha256}"'}], [f"{stored}/figures/sphere.png"]
    drawers += [f"/v1/fits/{fit}/figures/{figure}" for figure in ("parameters.svg", "residual.svg")]
    drawers += [f"{stored}/{array}.npy" for array in ("table", "figures/sphere")]
    assert server.http.get(url).content == data  # so it was right not long ago
    (path,) = server.files()
    harm(path)
    answers = [server.http.get(url, headers=headers) for headers in senders]
    answers += [server.http.get(drawer) for drawer in drawers]
    (said,) = {assert_problem(answer, 404, "measurement-damaged") for answer in answers}
    assert server.http.head(url).status_code == 404
    error = server.submit(sha256, **options).json()["error"]
    assert error == {"origin": "system", "type": "MeasurementDamaged", "message": said}
    with Client(str(server.http.base_url)) as client:
        assert client.upload(data) == sha256  # it asks whether one is needed
    assert server.http.get(url).content == data
    for drawer in drawers[::4] if harm is flip else []:
        assert server.http.get(drawer).is_success, drawer
    assert harm is not flip or server.submit(sha256, **options).json()["status"] == "succeeded"


def test_download_survives_the_deletion_of_its_file(used: tuple[Server, str, str], data: bytes) -> None:
    server, sha256, _ = used
    head = f"GET /v1/measurements/{sha256}/content HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    with server.connection(head.encode()) as connection:
        answer = bytearray(connection.recv(1000))
        assert server.http.delete(f"/v1/measurements/{sha256}").status_code == 204
        while piece := connection.recv(1 << 20):  # the connection did not hold it all
            answer += piece
    assert answer.endswith(data)
    assert server.http.post("/v1/measurements", content=data).status_code == 201
