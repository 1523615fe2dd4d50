"""Requests that no honest client sends, as the bytes that go over the wire; each has to be answered with 4xx."""

import re
import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

from tests.support.malformed_targets import IDS, MARK, METHODS, PATHS, QUERIES, TARGETS

_LINE = "GET /v1/fits/00000000000000000000000000000000 HTTP/1.1"
_POST = "POST /v1/measurements HTTP/1.1"

# Heads with something odd in them; an empty string stands for a Host that is right.
HEADS = [
    f"{_LINE}",
    f"{_LINE}\r\nHost: 127.0.0.1\r\nHost: evil.example",
    f"{_LINE}\r\nHost: evil.example",
    f"{_LINE}\r\nHost: 127.0.0.1@evil.example",
    f"{_LINE}\r\nHost: a b",
    f"{_LINE}\r\nHost:",
    f"{_LINE}\r\nHost : 127.0.0.1",
    f"{_LINE}\r\n Host: 127.0.0.1",
    f"{_LINE}\r\nHost: 127.0.0.1\r\nX: \0",
    f"{_LINE}\r\nHost: 127.0.0.1\r\nX\0: y",
    f"{_LINE}\r\nHost: 127.0.0.1\r\n: y",
    f"{_LINE}\r\nHost: 127.0.0.1\r\nX y: z",
    f"{_LINE}\r\nHost: 127.0.0.1\r\nno colon",
    f"{_LINE}\r\nHost: 127.0.0.1\r\nX: {'a' * 100_000}",
    f"{_LINE}\r\nHost: 127.0.0.1" + "".join(f"\r\nX-{i}: y" for i in range(10_000)),
    f"{_LINE}\r\nHost: 127.0.0.1\r\n{'X' * 70_000}: y",
    f"{_LINE}\r\nHost: 127.0.0.1\r\nOrigin: http://evil.example",
    f"{_LINE}\r\nHost: 127.0.0.1\r\nOrigin: null",
    f"{_LINE}\r\nHost: 127.0.0.1\r\nAuthorization: Bearer x",
    f"{_LINE}\r\nHost: 127.0.0.1\r\nAuthorization: Basic cm9vdDpyb290",
    f"{_LINE}\r\nHost: 127.0.0.1\r\nAuthorization:",
    f"{_LINE}\r\nHost: 127.0.0.1\r\nAuthorization: Bearer dsbrdf_0_{'A' * 5000}",
    f"{_LINE}\r\nHost: 127.0.0.1\r\nAuthorization: Bearer dsbrdf_%00_x",
    f"{_LINE}\r\nHost: 127.0.0.1\r\nX-Original-URL: /v1/fits\r\nX-Rewrite-URL: /v1/fits",
    f"{_LINE}\r\nHost: 127.0.0.1\r\nX-HTTP-Method-Override: DELETE",
    f"{_LINE}\r\nHost: 127.0.0.1\r\nX-Forwarded-For: 127.0.0.1\r\nX-Forwarded-Host: evil.example",
    f"{_LINE}\r\nHost: 127.0.0.1\r\nX-Request-ID: %0d%0aX-Evil: y",
    f"{_LINE}\r\nHost: 127.0.0.1\r\nIf-None-Match: *",
    f"{_LINE}\r\nHost: 127.0.0.1\r\nRange: bytes={'0-1,' * 10_000}",
    f"{_LINE}\r\nHost: 127.0.0.1\r\nExpect: 999-nothing",
    f"{_LINE.replace('1.1', '9.9')}\r\nHost: 127.0.0.1",
    f"{_LINE.replace('HTTP/1.1', 'HTTP/1.1.1')}\r\nHost: 127.0.0.1",
    f"{_LINE.replace(' HTTP/1.1', '')}",
    f"{_LINE} x\r\nHost: 127.0.0.1",
    f"{_LINE.replace('GET ', 'GET  ')}\r\nHost: 127.0.0.1",
    f"{_LINE.replace('HTTP', 'HTCPCP')}\r\nHost: 127.0.0.1",
    "PRI * HTTP/2.0",
    "\x16\x03\x01\x02\0\x01\0\x01\xfc\x03\x03",
    "SSH-2.0-x",
    "\0" * 50,
    "\xff" * 50,
    f"{_POST}\r\nHost: 127.0.0.1\r\nContent-Length: -1",
    f"{_POST}\r\nHost: 127.0.0.1\r\nContent-Length: +5",
    f"{_POST}\r\nHost: 127.0.0.1\r\nContent-Length: 0x10",
    f"{_POST}\r\nHost: 127.0.0.1\r\nContent-Length: 1e3",
    f"{_POST}\r\nHost: 127.0.0.1\r\nContent-Length: {'9' * 5000}",
    f"{_POST}\r\nHost: 127.0.0.1\r\nContent-Length: {'9' * 19}\r\n\r\n0123456789ab",
    f"{_POST}\r\nHost: 127.0.0.1\r\nContent-Length:",
    f"{_POST}\r\nHost: 127.0.0.1\r\nContent-Length: 5\r\nContent-Length: 6",
    f"{_POST}\r\nHost: 127.0.0.1\r\nContent-Length: 5, 6",
    f"{_POST}\r\nHost: 127.0.0.1\r\nTransfer-Encoding: gzip",
    f"{_POST}\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked, identity",
    f"{_POST}\r\nHost: 127.0.0.1\r\nTransfer-Encoding: xchunked",
    f"{_POST}\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\nTransfer-Encoding: chunked",
    f"{_POST}\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n\r\nZZZ",
    f"{_POST}\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n\r\n-1",
    f"{_POST}\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n\r\n{'F' * 30}",
    f"{_POST}\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n\r\n5\r\nabcdefgh\r\n0",
    f"{_POST}\r\nHost: 127.0.0.1\r\nContent-Length: 3\r\nTransfer-Encoding: chunked\r\n\r\n0",
    f"{_POST}\r\nHost: 127.0.0.1\r\nContent-Length: 0\r\nContent-Type: application/x-python-pickle",
    f"{_POST}\r\nHost: 127.0.0.1\r\nContent-Length: 0\r\nContent-Type: multipart/form-data; boundary=x",
    f"{_POST}\r\nHost: 127.0.0.1\r\nContent-Length: 0\r\nContent-Encoding: br",
    f"{_POST}\r\nHost: 127.0.0.1\r\nContent-Length: 0\r\nContent-Encoding: gzip, gzip",
    f"{_POST}\r\nHost: 127.0.0.1\r\nContent-Length: 0\r\nContent-Encoding: ../x",
]


@dataclass(frozen=True)
class Reply:
    """What came back, if anything."""

    status: int
    headers: dict[str, str]
    body: bytes
    seconds: float


def requests(fit: str, measurement: str) -> Iterator[bytes]:
    """Every hostile request, with ids that exist in the places of the mark."""
    for method, target in TARGETS:
        known = measurement if "measurements" in target else fit
        for hostile in IDS:
            part = "spike" if target.endswith("@") else known
            yield _request(method, target.replace("{id}", hostile.replace(MARK, part)).replace(MARK, fit))
    for path in (*PATHS, *QUERIES):
        yield _request("GET", path.replace(MARK, fit))
    for method in METHODS:
        yield _request(method, "/v1/fits")
    for head in HEADS:
        yield head.encode("latin-1") + b"\r\n\r\n"


def ask(address: tuple[str, int], request: bytes) -> Reply:
    """Send bytes and read the answer."""
    begin = time.monotonic()
    received = b""
    with socket.create_connection(address, timeout=20) as connection:
        # The server may answer and close before it has read all of an overlong request.
        with suppress(ConnectionError):
            connection.sendall(request)
        with suppress(ConnectionError):
            while not _complete(received) and (piece := connection.recv(1 << 16)):
                received += piece
    return _parse(received, time.monotonic() - begin)


def _complete(received: bytes) -> bool:
    head, end, body = received.partition(b"\r\n\r\n")
    length = re.search(rb"(?i)\r\ncontent-length: *([0-9]+)", head)
    return bool(end) and length is not None and len(body) >= int(length[1])


def _request(method: str, target: str) -> bytes:
    return f"{method} {target} HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n".encode()


def _parse(received: bytes, seconds: float) -> Reply:
    head, _, body = received.partition(b"\r\n\r\n")
    first, *lines = head.decode("latin-1").split("\r\n")
    assert first.startswith("HTTP/1.1 "), received[:200]
    headers = {name.lower(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
    return Reply(int(first.split()[1]), headers, body, seconds)
