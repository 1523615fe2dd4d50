"""Hostile requests against one server: refused at once, at no cost, no leak.

How long an answer takes is bounded by the processor time that it costs, compared with that of a measurement that is
accepted: the machine that tests run on may be slow or busy.
"""

import json
from collections.abc import Iterator
from contextlib import suppress
from http.client import HTTPResponse

import pytest

from tests.support.processes import wait_until
from tests.support.server import QUICK, Server

UPLOADS = 6.0
MEGABYTES = 64.0
LEAKS = ("Traceback", 'File "', "site-packages", ".py", "sqlite3.", "root:x:0")


class Target:
    """A server with one measurement and one fit, which have to be there afterwards, and nothing else."""

    def __init__(self, server: Server, data: bytes) -> None:
        self.server = server
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

    def check(self, name: str, status: int, media_type: str | None, body: bytes) -> None:
        """One answer: 4xx, soon, a problem document, and nothing in it that is not for the client."""
        spent, self.spent = self.spent, self.server.cpu_seconds()
        assert 400 <= status < 500, (name, status, body[:500])
        assert self.spent - spent < self.limit, name
        problem = json.loads(body)
        assert media_type == "application/problem+json", (name, media_type)
        assert set(problem) == {"type", "title", "status", "detail", "instance"}, name
        assert problem["status"] == status, name
        text = json.dumps({**problem, "instance": ""})  # The client has sent it.
        assert not [leak for leak in (*LEAKS, str(self.server.data_dir)) if leak in text], (name, text)
        assert "root:x:0" not in problem["instance"]

    def close(self) -> None:
        wait_until(lambda: self.contents() == self.before, 20.0)  # What was sent last may still be put away.
        assert self.grown() <= MEGABYTES
        self.spent = self.server.cpu_seconds()


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> Iterator[Target]:
    with Server.running(tmp_path_factory.mktemp("attacks") / "data") as server:
        yield Target(server, data)


BOMBS = {
    "deep JSON": b"[" * 16_000_000,
    "many JSON numbers": b'{"theta_half_deg": [' + b"0," * 7_900_000,
    "many JSON names": json.dumps({f"n{i}": i for i in range(4000)}).encode(),
    "a long JSON number": b'{"theta_half_deg": [' + b"9" * 1_000_000 + b"]}",
}


def test_hostile_json_is_refused_cheaply(target: Target) -> None:
    for name, bomb in BOMBS.items():
        target.spent = target.server.cpu_seconds()
        for path in ("/v1/fits", f"/v1/fits/{target.fit}/brdf"):
            answer = target.server.http.post(path, content=bomb, headers={"Content-Type": "application/json"})
            target.check(name, answer.status_code, answer.headers["content-type"], answer.content)
    target.close()


MARK = "@"  # stands for an id that exists
HOSTILE_IDS = """
    .. ../../etc/passwd ..%2f..%2f..%2fetc%2fpasswd %2e%2e/%2e%2e/dsbrdf.sqlite ..%5c..%5cwindows ..\\..\\windows
    %252e%252e%252fetc%252fpasswd ..%c0%af..%c0%afetc%c0%afpasswd %uff0e%uff0e/ .%00./.%00./ //etc/passwd
    file:///etc/passwd @/../@ @/..%2f@ ..%2fblobs%2f@ @%2f..%2f@ @%00 %00@ @%0a @%0d%0aX-Evil:%20yes @%20 @. @/ @;x=y
    @%3f @%23 @%ef%bb%bf @0 @@ @.json @'-- 0 -1 null * {fit_id} %zz %ff%fe %F0%9F%92%A9 $(id) 1;DROP%20TABLE%20fits
    $%7Bjndi:ldap:%2f%2fx%7D %3Cscript%3Ealert(1)%3C%2fscript%3E %1b%5b2J %0aINFO%20fake
"""
LONG_IDS = ["%D9%A3" * 32, "%61" * 4000, "g" * 32, *("a" * length for length in (31, 33, 63, 65))]
IDS = [*HOSTILE_IDS.split(), *LONG_IDS]
TARGETS = [
    ("GET", "/v1/fits/{id}"),
    ("DELETE", "/v1/fits/{id}"),
    ("DELETE", "/v1/measurements/{id}"),
    ("GET", "/v1/fits/@/components/{id}/brdf?theta_half_deg=1&theta_diff_deg=1"),
]
ODD_PATHS = """
    //v1/fits /v1//fits /v1/fits/ /./v1/fits /v1/../v1/fits /v1/fits/../measurements /V1/fits /v1/fits;x=y /v1/fits%20
    /v1/fits%00 /v1/fits%0a /v1/fits%3Flimit=1 /v1/fits%23 /v1 /v2/fits /%2fv1/fits /v1/fits/@/ /v1/fits/@//brdf
    /v1/fits/@/nothing /v1/fits/@/export/ /v1/fits/@/events/.. /.env /dsbrdf.sqlite /data/dsbrdf.sqlite /blobs /run
    /cgi-bin/../../bin/sh /openapi.json/ /docs/.. /static/../../etc/passwd /health/
    //evil.example/v1/fits v1/fits * ? \\v1\\fits
"""
LONG_PATHS = ["/" + "a" * 60_000, "/" + "../" * 5000 + "etc/passwd", "/v1/fits?" + "x=" * 20_000]
METHODS = ["PUT", "PATCH", "TRACE", "OPTIONS", "CONNECT", "PROPFIND", "get", "Post", "FOO", "DELETE", "POST/x", "%47ET"]
# Lines after the first one of a request; its syntax is the matter of the parser, which has tests of its own.
HEADS = [
    "no colon",
    f"X: {'a' * 100_000}",
    "\r\n".join(f"X-{i}: y" for i in range(10_000)),
    "Origin: null",
    "Authorization:",
    f"Authorization: Bearer dsbrdf_0_{'A' * 5000}",
    "Authorization: Bearer dsbrdf_%00_x",
    "X-Original-URL: /v1/fits\r\nX-Rewrite-URL: /v1/fits",
    "X-HTTP-Method-Override: DELETE",
    "X-Forwarded-For: 127.0.0.1\r\nX-Forwarded-Host: evil.example",
    "X-Request-ID: %0d%0aX-Evil: y",
    f"Range: bytes={'0-1,' * 10_000}",
    "Expect: 999-nothing",
]
HEADS_OF_UPLOADS = [
    *(f"Content-Length: {length}" for length in ("-1", "9" * 5000, "", "5, 6")),
    *(f"Transfer-Encoding: {coding}" for coding in ("gzip", "chunked, identity", "chunked\r\n\r\nZZZ")),
    *(f"Content-Length: 0\r\nContent-Type: {kind}" for kind in ("application/x-python-pickle", "multipart/form-data")),
    *(f"Content-Length: 0\r\nContent-Encoding: {coding}" for coding in ("br", "gzip, gzip", "../x")),
    "Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0",
]


def requests(fit: str, measurement: str) -> Iterator[bytes]:
    for method, target in TARGETS:
        known = measurement if "measurements" in target else fit
        for hostile in IDS:
            yield request(f"{method} {target.replace('{id}', hostile.replace(MARK, known)).replace(MARK, fit)}")
    for path in (*ODD_PATHS.split(), *LONG_PATHS):
        yield request(f"GET {path.replace(MARK, fit)}")
    yield from (request(f"{method} /v1/fits") for method in METHODS)
    yield from (request(f"GET /v1/fits/{'0' * 32}", head) for head in HEADS)
    yield from (request("POST /v1/measurements", head) for head in HEADS_OF_UPLOADS)
    yield from (b"\x16\x03\x01\x02\0\x01\0\x01\xfc\x03\x03\r\n\r\n", b"\xff" * 50 + b"\r\n\r\n")


def request(line: str, head: str = "Connection: close") -> bytes:
    return f"{line} HTTP/1.1\r\nHost: 127.0.0.1\r\n{head}\r\n\r\n".encode("latin-1")


def test_malformed_requests_are_refused_cheaply(target: Target) -> None:
    for hostile in requests(target.fit, target.measurement):
        with target.server.connection() as connection:
            with suppress(ConnectionError):  # the server may answer and close before it has read all of a long one
                connection.sendall(hostile)
            answer = HTTPResponse(connection)
            answer.begin()
            target.check(repr(hostile[:150]), answer.status, answer.headers["content-type"], answer.read())
        assert "x-evil" not in answer.headers
    target.close()
