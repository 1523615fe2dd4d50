"""Requests that no honest client sends, as the bytes that go over the wire; each has to be answered with 4xx."""

import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from email.message import Message
from http.client import HTTPResponse

_MARK = "@"  # stands for an id that exists

_OUT_OF_THE_FOLDER = """
    .. ../../etc/passwd ..%2f..%2f..%2fetc%2fpasswd %2e%2e/%2e%2e/dsbrdf.sqlite ..%5c..%5cwindows ..\\..\\windows
    %252e%252e%252fetc%252fpasswd ..%c0%af..%c0%afetc%c0%afpasswd %e0%80%ae%e0%80%ae/ %uff0e%uff0e/ ..;/..;/etc/passwd
    .%00./.%00./ %2fetc%2fpasswd //etc/passwd file:///etc/passwd ~root @/../@ @/..%2f@ ..%2fblobs%2f@ @%2f..%2f@
"""
_NEARLY_AN_ID = """
    @%00 %00@ @%0a @%0d%0aX-Evil:%20yes @%20 %20@ @. @/ @// @;x=y @%3f @%23 @%ef%bb%bf @%e2%80%8b @0 0@ @@ @,@ @.json
    @: @%2e @'-- @%25
"""
_OTHER_WORDS = """
    0 -1 1e9 null NaN * {fit_id} [0] _ . % %zz %80 %ff%fe %ed%a0%80 %F0%9F%92%A9 $(id) `id` @%7Cid %7B%7B7*7%7D%7D
    '%20OR%20'1'='1 1;DROP%20TABLE%20fits $%7Bjndi:ldap:%2f%2fx%7D %3Cscript%3Ealert(1)%3C%2fscript%3E %1b%5b2J
    %0aINFO%20fake
"""
_LONG = ["%D9%A3" * 32, "%F0%9D%9F%98" * 32, "a" * 31, "a" * 33, "a" * 63, "a" * 65, "%61" * 4000, "A" * 32, "g" * 32]
_LONG += ["G" * 64, "_" * 32, "%25" * 32]
_IDS = [*_OUT_OF_THE_FOLDER.split(), *_NEARLY_AN_ID.split(), *_OTHER_WORDS.split(), *_LONG]

_TARGETS = [
    ("GET", "/v1/fits/{id}"),
    ("GET", "/v1/measurements/{id}"),
    ("DELETE", "/v1/fits/{id}"),
    ("DELETE", "/v1/measurements/{id}"),
    ("GET", "/v1/fits/{id}/brdf?theta_half_deg=1&theta_diff_deg=1"),
    ("GET", "/v1/fits/@/components/{id}/brdf?theta_half_deg=1&theta_diff_deg=1"),
]

_ODD_PATHS = """
    //v1/fits /v1//fits /v1/fits/ /./v1/fits /v1/../v1/fits /v1/fits/../measurements /V1/fits /v1/fits;x=y /v1/fits%20
    /v1/fits%00 /v1/fits%0a /v1/fits%3Flimit=1 /v1/fits%23 /v1 /v2/fits /%2fv1/fits /v1/fits/@/ /v1/fits/@//brdf
    /v1/fits/@/nothing /v1/fits/@/export/ /v1/fits/@/events/.. /.env /dsbrdf.sqlite /data/dsbrdf.sqlite /blobs /run
    /cgi-bin/../../bin/sh /openapi.json/ /docs/.. /static/../../etc/passwd /health/
    //evil.example/v1/fits v1/fits * ? \\v1\\fits
"""
_PATHS = [
    *_ODD_PATHS.split(),
    "/" + "a" * 60_000,
    "/" + "../" * 5000 + "etc/passwd",
    "/v1/fits?" + "x=" * 20_000,
    "/v1/fits/" + "%2e" * 20_000,
]

_OF_LISTS = """
    limit=9999999999999999999999 limit=1%20OR%201=1 limit= limit[]=1 limit=%D9%A3 cursor=1;DROP%20TABLE%20fits
    cursor=%00 cursor=1%0a cursor=%D9%A3 cursor= __proto__=1
"""
_OF_A_FIT = """
    ?wait=1e999 ?wait= ?waits=1 /export?format=..%2f..%2fetc%2fpasswd /export?format=json&component=..
    /export?format=json%00 /export?format=JSON /brdf?theta_half_deg=-1e-9&theta_diff_deg=1
    /brdf?theta_half_deg=1e999&theta_diff_deg=1 /brdf?theta_half_deg=__import__('os')&theta_diff_deg=1
    /brdf?theta_half_deg=%00&theta_diff_deg=1 /brdf?omega_in=0,0,1&theta_diff_deg=1
    /brdf?theta_half_deg=%D9%A3&theta_diff_deg=1
"""
_QUERIES = [
    *(f"/v1/fits?{query}" for query in _OF_LISTS.split()),
    *(f"/v1/fits/@{query}" for query in _OF_A_FIT.split()),
    "/v1/measurements?order=created",
    "/v1/fits/@/brdf?" + "theta_half_deg=1&" * 3000,
]

_ODD_METHODS = "PUT PATCH TRACE OPTIONS CONNECT PROPFIND get Post FOO DELETE POST/x %47ET"
_METHODS = [*_ODD_METHODS.split(), "G" * 5000, "GET\t"]

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
_HEADS = [f"{_LINE}\r\n{head}".removesuffix("\r\n") for head in _GET_HEADS]
_HEADS += [f"{_POST}\r\n{_HOST}\r\n{head}" for head in _POST_HEADS]
_HEADS += [
    f"{_LINE.replace(*change)}\r\n{_HOST}"
    for change in (("1.1", "9.9"), (" HTTP/1.1", ""), ("HTTP/1.1", "HTTP/1.1 x"), ("GET ", "GET  "), ("HTTP", "HTCPCP"))
]
_HEADS += ["\x16\x03\x01\x02\0\x01\0\x01\xfc\x03\x03", "SSH-2.0-x", "\0" * 50, "\xff" * 50]


@dataclass(frozen=True)
class Reply:
    """What came back, and after how long."""

    status: int
    headers: Message
    body: bytes
    seconds: float


def requests(fit: str, measurement: str) -> Iterator[bytes]:
    """Every hostile request, with ids that exist in the places of the mark."""
    for method, target in _TARGETS:
        known = measurement if "measurements" in target else fit
        for hostile in _IDS:
            part = "spike" if target.endswith("@") else known
            yield _request(method, target.replace("{id}", hostile.replace(_MARK, part)).replace(_MARK, fit))
    for path in (*_PATHS, *_QUERIES):
        yield _request("GET", path.replace(_MARK, fit))
    for method in _METHODS:
        yield _request(method, "/v1/fits")
    for head in _HEADS:
        yield head.encode("latin-1") + b"\r\n\r\n"


def _request(method: str, target: str) -> bytes:
    return f"{method} {target} HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n".encode()


def ask(address: tuple[str, int], request: bytes) -> Reply:
    """Send bytes and read the answer."""
    begin = time.monotonic()
    with socket.create_connection(address, timeout=20) as connection:
        # The server may answer and close before it has read all of an overlong request.
        with suppress(ConnectionError):
            connection.sendall(request)
        answer = HTTPResponse(connection)
        answer.begin()
        return Reply(answer.status, answer.headers, answer.read(), time.monotonic() - begin)
