"""Malformed files, compression bombs and hostile requests against one server: refused at once, at no cost, no leak.

How long an answer takes is bounded by the processor time that it costs, compared with that of a measurement that is
accepted: the machine that tests run on may be slow or busy.
"""

import json
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import httpx
import pytest

from tests.support import malformed_requests as hostile
from tests.support.decompression_bombs import BOMBS, JSON, MEASUREMENT, NPY
from tests.support.server import QUICK, Server

UPLOADS = 6.0
PATIENCE = 60.0
MEGABYTES = 64.0
MEGABYTES_OF_UPLOADS = 24.0
NOT_HTTP = b"Invalid HTTP request received."  # what the server says of it
LEAKS = ("Traceback", 'File "', "site-packages", ".py", "sqlite3.", "root:x:0")


class Target:
    """A server with one measurement and one fit, which have to be there afterwards, and nothing else."""

    def __init__(self, server: Server, data: bytes) -> None:
        self.server = server
        url = server.http.base_url
        self.address = (str(url.host), int(url.port or 0))
        spent = server.cpu_seconds()
        fit = server.http.post("/v1/fits", params=QUICK, content=data).json()
        self.limit = UPLOADS * (server.cpu_seconds() - spent)  # seconds of a processor, about one
        self.fit, self.measurement = fit["id"], fit["measurement"]
        # What any work takes once, the largest uploads and batches among it, is no cost of an attack.
        server.http.get(f"/v1/fits/{self.fit}/components")
        self.before = self.contents()
        self.memory = server.memory("VmHWM")
        self.spent = server.cpu_seconds()

    def contents(self) -> object:
        lists = [self.server.http.get(path).json() for path in ("/v1/fits", "/v1/measurements")]
        return lists, sorted(self.server.files())

    def grown(self) -> float:
        """How much larger the memory of the web process has been than before the attacks [MB]."""
        return self.server.memory("VmHWM") - self.memory

    def check(self, name: str, status: int, media_type: str, body: bytes, seconds: float) -> None:
        """One answer: 4xx, soon, a problem document, and nothing in it that is not for the client."""
        spent, self.spent = self.spent, self.server.cpu_seconds()
        cost = self.spent - spent
        assert 400 <= status < 500, (name, status, body[:500])
        if body != NOT_HTTP:
            self.check_problem(name, status, media_type, json.loads(body))
        assert seconds < PATIENCE, name
        assert cost < self.limit, name

    def check_problem(self, name: str, status: int, media_type: str, problem: dict[str, Any]) -> None:
        """Check a problem document."""
        assert media_type == "application/problem+json", (name, media_type)
        assert set(problem) == {"type", "title", "status", "detail", "instance"}, name
        assert problem["status"] == status, name
        text = json.dumps({**problem, "instance": ""})  # which is what the client has sent
        assert not [leak for leak in (*LEAKS, str(self.server.data_dir)) if leak in text], (name, text)
        assert "root:x:0" not in problem["instance"]

    def post(self, name: str, path: str, content: bytes | Iterator[bytes], **headers: str) -> httpx.Response:
        begin = time.monotonic()
        answer = self.server.http.post(path, content=content, headers=headers)
        media_type, seconds = answer.headers["content-type"], time.monotonic() - begin
        self.check(name, answer.status_code, media_type, answer.content, seconds)
        return answer

    def close(self) -> None:
        assert self.contents() == self.before
        assert self.grown() <= MEGABYTES
        self.spent = self.server.cpu_seconds()


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> Iterator[Target]:
    with Server.running(tmp_path_factory.mktemp("attacks") / "data") as server:
        yield Target(server, data)


def in_pieces(content: bytes) -> Iterator[bytes]:
    for start in range(0, len(content), 1 << 18):
        yield content[start : start + (1 << 18)]


def test_decompression_bombs_are_refused_cheaply(target: Target) -> None:
    paths = {
        MEASUREMENT: ["/v1/measurements"],
        JSON: ["/v1/fits", f"/v1/fits/{target.fit}/brdf"],
        NPY: [f"/v1/fits/{target.fit}/brdf"],
    }
    for name, (media_type, encoding, make) in BOMBS.items():
        bomb = make()
        for path in paths[media_type]:
            target.post(name, path, bomb, **{"Content-Type": media_type, "Content-Encoding": encoding})
        if media_type == MEASUREMENT:  # batches of points are kept whole
            assert target.grown() <= MEGABYTES_OF_UPLOADS, name
    target.close()


def test_malformed_requests_are_refused_cheaply(target: Target) -> None:
    for request in hostile.requests(target.fit, target.measurement):
        reply = hostile.ask(target.address, request)
        name = repr(request[:150])
        target.check(name, reply.status, reply.headers["content-type"], reply.body, reply.seconds)
        assert "x-evil" not in reply.headers, name
    target.close()


def test_request_with_two_lengths_is_refused(target: Target) -> None:
    body = b'{"theta_half_deg":[1],"theta_diff_deg":[1]}'
    chunked = b"%x\r\n%s\r\n0\r\n\r\n" % (len(body), body)
    smuggled = b"DELETE /v1/fits/%s HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" % target.fit.encode()
    for path in (f"/v1/fits/{target.fit}/brdf", "/health/live"):
        head = f"POST {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n".encode()
        for length in (0, 4, len(chunked), len(chunked) + len(smuggled)):
            two = b"Content-Length: %d\r\nTransfer-Encoding: chunked\r\n\r\n" % length
            with target.server.connection(head + two + chunked + smuggled) as connection:
                received = b""
                with suppress(ConnectionResetError):
                    while piece := connection.recv(1 << 16):
                        received += piece
            assert received.startswith(b"HTTP/1.1 400 ")
            assert received.count(b"HTTP/1.1 ") == 1
            assert received.endswith((b"}", NOT_HTTP))
    target.close()
