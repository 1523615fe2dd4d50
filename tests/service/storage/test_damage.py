"""A file whose bytes are not its name's is never served as if they were, whoever reads it."""

import hashlib
import os
import socket
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest

from service.client import Client
from tests.support.processes import wait_until
from tests.support.server import QUICK, Server, assert_problem


def flip(path: Path) -> None:
    """Change one bit, and set the file's time back."""
    before = path.stat()
    content = bytearray(path.read_bytes())
    content[20_000_000] ^= 1
    path.write_bytes(content)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def cut(path: Path) -> None:
    os.truncate(path, 1_000_000)


def lengthen(path: Path) -> None:
    with path.open("ab") as file:
        file.write(b"more")


def replace_by_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def replace_by_link(path: Path) -> None:
    path.unlink()
    path.symlink_to("/dev/zero")


@pytest.mark.parametrize("harm", [flip, cut, lengthen, Path.unlink, replace_by_pipe, replace_by_link])
def test_every_reader_refuses_a_damaged_file_in_the_same_way(
    own_server: Callable[..., Server], data: bytes, harm: Callable[[Path], None]
) -> None:
    server = own_server()
    fit = server.http.post("/v1/fits", params=QUICK, content=data).json()
    url = f"/v1/measurements/{fit['measurement']}"
    readers = {
        url: {},
        f"{url}#a part": {"Range": "bytes=0-11"},
        f"{url}/figures/sphere.png": {},
        f"/v1/fits/{fit['id']}/figures/profiles.png": {},
        f"/v1/fits/{fit['id']}/figures/residual.svg": {},
        f"/fits/{fit['id']}/view": {},
        f"/fits/{fit['id']}/spheres/measured.png": {},
        f"/fits/{fit['id']}/profiles/0": {},
    }
    assert server.http.get(url).content == data  # so it was right not long ago
    (path,) = server.files()
    harm(path)
    said = {
        assert_problem(server.http.get(reader, headers=headers), 404, "measurement-damaged")
        for reader, headers in readers.items()
    }
    assert server.http.head(url).status_code == 404
    answer = server.submit(fit["measurement"], n_lobes=2).json()
    assert answer["error"]["type"] == "MeasurementDamaged"
    assert said == {answer["error"]["message"]}
    with Client(str(server.http.base_url)) as client:
        assert client.upload(data) == fit["measurement"]  # it asks whether one is needed
    for reader, headers in readers.items():
        assert server.http.get(reader, headers=headers).is_success, reader
    assert server.submit(fit["measurement"], n_lobes=2).json()["status"] == "succeeded"


def test_download_of_a_file_that_changes_meanwhile_is_broken_off(
    own_server: Callable[..., Server], data: bytes
) -> None:
    server = own_server(fits=False)
    sha256 = server.http.post("/v1/measurements", content=data).json()["sha256"]
    url = server.http.base_url
    (path,) = server.files()
    with socket.create_connection((url.host, url.port or 80), timeout=60) as connection:
        connection.sendall(f"GET /v1/measurements/{sha256} HTTP/1.1\r\nHost: {url.host}\r\n\r\n".encode())
        answer = bytearray(connection.recv(1000))
        with path.open("r+b") as file:  # the connection does not hold as much as that
            file.seek(-9, os.SEEK_END)
            file.write(b"\1")
        while piece := connection.recv(1 << 20):
            answer += piece
    head, _, body = bytes(answer).partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 200 ")
    assert len(body) < len(data)
    assert data.startswith(body)
    wait_until(lambda: "has changed while it was sent" in server.log.read_text())
    assert "Traceback" not in server.log.read_text()
    assert_problem(server.http.get(f"/v1/measurements/{sha256}"), 404, "measurement-damaged")


def test_download_is_whole_where_nothing_has_changed(server: Server, stored: str) -> None:
    answer = httpx.get(server.http.base_url.join(f"/v1/measurements/{stored}"))
    assert hashlib.sha256(answer.content).hexdigest() == stored
