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

_HOST = "Host: 127.0.0.1"

# Heads with something odd in them, lines after the first one.
_GET_HEADS = [
    "",
    f"{_HOST}\r\nHost: evil.example",
    "Host: evil.example",
    "Host: 127.0.0.1@evil.example",
    "Host: a b",
    "Host:",
    "Host : 127.0.0.1",
    " Host: 127.0.0.1",
]
_GET_HEADS += [
    f"{_HOST}\r\n{line}"
    for line in (
        "X: \0",
        "X\0: y",
        ": y",
        "X y: z",
        "no colon",
        f"X: {'a' * 100_000}",
        "\r\n".join(f"X-{i}: y" for i in range(10_000)),
        f"{'X' * 70_000}: y",
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
    )
]
_CHUNKED = "Transfer-Encoding: chunked"
_POST_HEADS = [
    *(f"Content-Length: {length}" for length in ("-1", "+5", "0x10", "1e3", "9" * 5000, "", "5, 6")),
    f"Content-Length: {'9' * 19}\r\n\r\n0123456789ab",
    "Content-Length: 5\r\nContent-Length: 6",
    *(f"Transfer-Encoding: {coding}" for coding in ("gzip", "chunked, identity", "xchunked")),
    f"{_CHUNKED}\r\n{_CHUNKED}",
    *(f"{_CHUNKED}\r\n\r\n{chunk}" for chunk in ("ZZZ", "-1", "F" * 30, "5\r\nabcdefgh\r\n0")),
    f"Content-Length: 3\r\n{_CHUNKED}\r\n\r\n0",
    *(f"Content-Length: 0\r\nContent-Type: {kind}" for kind in ("application/x-python-pickle", "multipart/form-data")),
    *(f"Content-Length: 0\r\nContent-Encoding: {coding}" for coding in ("br", "gzip, gzip", "../x")),
]
HEADS = [f"{_LINE}\r\n{head}".removesuffix("\r\n") for head in _GET_HEADS]
HEADS += [f"{_POST}\r\n{_HOST}\r\n{head}" for head in _POST_HEADS]
HEADS += [
    f"{_LINE.replace(*change)}\r\n{_HOST}"
    for change in (("1.1", "9.9"), (" HTTP/1.1", ""), ("HTTP/1.1", "HTTP/1.1 x"), ("GET ", "GET  "), ("HTTP", "HTCPCP"))
]
HEADS += ["PRI * HTTP/2.0", "\x16\x03\x01\x02\0\x01\0\x01\xfc\x03\x03", "SSH-2.0-x", "\0" * 50, "\xff" * 50]


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
