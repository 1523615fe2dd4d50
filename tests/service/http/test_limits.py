"""Slow senders, too many requests, and heads that are too long or not clear."""

import asyncio
import json
import resource
import signal
import socket
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import ExitStack, closing, suppress

import httpx
import pytest

from dsbrdf.data import FILE_SIZE
from tests.support.processes import wait_until
from tests.support.server import ENDLESS, Server, StartServer, assert_problem, head_of_upload, in_progress, new_key

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def impatient(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A service that soon gives slow clients up, and has few places."""
    settings = {"max_idle_seconds": "1", "min_upload_bytes_per_second": "100000", "limit_concurrency": "4"}
    with Server.running(tmp_path_factory.mktemp("impatient") / "data", workers="1", **settings) as running:
        yield running


def rest(connection: socket.socket) -> bytes:
    """Everything that comes until the service closes the connection, perhaps before it has read all that was sent."""
    parts = []
    with suppress(ConnectionResetError):
        while part := connection.recv(1 << 16):
            parts.append(part)
    return b"".join(parts)


def problem(answer: bytes) -> tuple[int, str]:
    head, _, body = answer.partition(b"\r\n\r\n")
    assert b"application/problem+json" in head
    assert b"connection: close" in head.lower()
    document = json.loads(body)
    assert document["status"] == int(head.split()[1])
    return document["status"], document["type"].removeprefix("urn:dsbrdf:problem:")


def trickle(connection: socket.socket, data: bytes) -> bytes:
    """Send a byte every 0.05 s, 20 s of never being silent, and return what is answered before the last one."""
    connection.settimeout(0.05)
    for byte in data:
        try:
            connection.sendall(bytes([byte]))
            answer = connection.recv(1 << 16)
        except TimeoutError:
            continue
        connection.settimeout(20)
        return answer + rest(connection)
    raise AssertionError("a client may be as slow as it likes")


@pytest.mark.parametrize(
    ("path", "media_type", "length", "sent_at_once"),
    [
        ("/v1/measurements", "application/octet-stream", FILE_SIZE, 1_000_000),
        ("/v1/measurements", "application/octet-stream", FILE_SIZE, 0),
        ("/v1/fits", "application/json", 1000, 0),
    ],
)
def test_stalled_or_too_slow_body_times_out(
    impatient: Server, data: bytes, path: str, media_type: str, length: int, sent_at_once: int
) -> None:
    before = impatient.files()
    head = head_of_upload(length, path, content_type=media_type)
    with impatient.connection(head + data[:sent_at_once]) as connection:
        answer = rest(connection) if sent_at_once else trickle(connection, data[:400])
        assert problem(answer) == (408, "request-timeout")
    wait_until(lambda: impatient.files() == before)


def test_answer_that_nobody_reads_is_given_up(impatient: Server, data: bytes) -> None:
    sha256 = impatient.http.post("/v1/measurements", content=data).json()["sha256"]
    head = f"GET /v1/measurements/{sha256}/content HTTP/1.1\r\nHost: x\r\n\r\n"
    with impatient.connection(head.encode()) as connection:
        wait_until(lambda: impatient.log.read_text().count("gave up") == 1, 20.0)
        assert len(rest(connection)) < len(data)
    assert "Traceback" not in impatient.log.read_text()


def test_steady_body_may_take_longer_than_the_idle_timeout(own_server: StartServer, data: bytes) -> None:
    patience = 2.0  # seconds, for a client that is held up by a busy machine
    server = own_server(max_idle_seconds=str(patience), min_upload_bytes_per_second="100000")
    step = len(data) // 8

    async def in_steps() -> AsyncIterator[bytes]:
        for start in range(0, len(data), step):
            await asyncio.sleep(0.15 * patience)
            yield data[start : start + step]

    async def upload() -> httpx.Response:
        async with httpx.AsyncClient(base_url=server.http.base_url, timeout=60) as client:
            return await client.post("/v1/measurements", content=in_steps())

    assert asyncio.run(upload()).status_code == 201


def follow_until_refused(stack: ExitStack, server: Server, path: str, headers: dict[str, str]) -> int:
    """Open streams of a fit's events until one is refused; return how many there are."""
    sent = "".join(f"{name}: {value}\r\n" for name, value in {"Host": "x", **headers}.items())
    for number in range(100):
        answer = stack.enter_context(closing(server.connection(f"GET {path}/events HTTP/1.1\r\n{sent}\r\n".encode())))
        if b" 429 " in answer.recv(20):
            return number
    raise AssertionError("no stream was refused")


def test_no_caller_can_take_all_places(own_server: StartServer, data: bytes) -> None:
    server = own_server(require_keys="true", limit_concurrency="8", workers="1", max_wait_seconds="0.5")
    alice, bob = (new_key(server, name)[1] for name in ("alice", "bob"))
    head = head_of_upload(100, "/v1/fits") + b"slow"
    with ExitStack() as stack:  # who has no key is refused at once, and takes no place with a slow body
        for _ in range(12):
            assert b" 401 " in stack.enter_context(server.connection(head)).recv(100)
        assert server.http.get("/v1/fits", headers=bob).status_code == 200
    sha256 = server.http.post("/v1/measurements", content=data, headers=alice).json()["sha256"]
    wanted = {"measurement": sha256, "options": ENDLESS}
    begun = server.http.post("/v1/fits", json=wanted, headers={**alice, "Prefer": "wait=600"}, timeout=20)
    path = f"/v1/fits/{begun.json()['id']}"
    assert server.http.get(f"{path}?wait=600", headers=alice, timeout=60).json()["status"] in ("accepted", "running")
    with ExitStack() as stack:
        assert follow_until_refused(stack, server, path, alice) == 2
        assert server.http.get("/v1/fits", headers=alice).status_code == 200
        assert server.http.get(f"{path}?wait=600", headers=alice).json()["status"] in ("accepted", "running")
        slow = head_of_upload(35_000_000, **alice)

        def is_full_with_another() -> bool:
            stack.enter_context(closing(server.connection(slow)))
            return server.http.get("/v1/fits", headers=alice).status_code == 429

        wait_until(is_full_with_another, 60.0)
        refused = server.http.get("/v1/fits", headers=alice)
        assert "4 of your requests" in assert_problem(refused, 429, "too-many-at-once")
        assert refused.headers["retry-after"] == "5"
        for _ in range(10):
            assert server.http.get("/v1/fits", headers=bob).status_code == 200
            assert server.http.get("/health/live").status_code == 200
    wait_until(lambda: server.http.get("/v1/fits", headers=alice).status_code == 200)
    server.http.delete(path, headers=alice)


@pytest.mark.parametrize(
    ("target", "headers", "status", "kind"),
    [
        ("/health/live", ["Host: x", f"X-Long: {'x' * 8187}"], 431, "head-too-long"),
        ("/health/live", ["Host: x", *(f"X-{number}: y" for number in range(100))], 431, "head-too-long"),
        (f"/v1/fits?name={'x' * 8192}", ["Host: x"], 431, "head-too-long"),
        ("/health/live", ["Host: x", "Host: x"], 400, "bad-request"),
        ("/health/live", [], 400, "bad-request"),
    ],
)
def test_head_that_is_too_long_or_not_clear_is_refused(
    impatient: Server, target: str, headers: list[str], status: int, kind: str
) -> None:
    with impatient.connection("\r\n".join([f"GET {target} HTTP/1.1", *headers, "", ""]).encode()) as connection:
        assert problem(rest(connection)) == (status, kind)


def test_longest_head_that_is_allowed_is_answered(impatient: Server) -> None:
    longest = ["Host: x", f"X-Long: {'x' * 8186}", *(f"X-{number}: y" for number in range(97)), "Connection: close"]
    with impatient.connection("\r\n".join(["GET /health/live HTTP/1.1", *longest, "", ""]).encode()) as connection:
        assert rest(connection).startswith(b"HTTP/1.1 200 ")


IN_CHUNKS = b"POST /v1/fits HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nTransfer-Encoding: chunked\r\n\r\n"


@pytest.mark.parametrize(
    ("begin", "rest_of_head"),
    [
        (b"GET / HTTP/1.1\r\n", b"a:b\r\n" * 600_000),
        (b"GET / HTTP/1.1\r\na: ", b"x" * 3_000_000),
        (b"GET /", b"x" * 3_000_000),
        (IN_CHUNKS + b"2\r\n{}\r\n0\r\na: ", b"x" * 3_000_000),
    ],
    ids=["short lines", "one line", "address", "trailer"],
)
def test_endless_head_is_refused_while_it_arrives(impatient: Server, begin: bytes, rest_of_head: bytes) -> None:
    before = impatient.memory()
    with impatient.connection(begin, 20.0) as connection, suppress(ConnectionError):
        connection.sendall(rest_of_head)
        answer = rest(connection)
        assert not answer or problem(answer)[0] in (422, 431)
    assert impatient.memory() - before < 4


def test_client_that_sends_many_requests_and_reads_no_answer_is_disconnected(impatient: Server) -> None:
    before = impatient.memory()
    requests = b"GET /v1/fits HTTP/1.1\r\nHost: x\r\n\r\n" * 20_000
    with impatient.connection() as connection, suppress(ConnectionError):
        connection.sendall(requests)
        assert rest(connection).count(b"HTTP/1.1 200") < 1000
    assert impatient.memory() - before < 16


def test_process_that_was_stopped_refuses_no_body_that_came_meanwhile(own_server: StartServer) -> None:
    server = own_server(max_idle_seconds="2")
    body = b'{"measurement": "%s"}' % (b"0" * 64)
    head = head_of_upload(len(body), "/v1/fits", content_type="application/json")
    with server.connection(head + body[:40]) as connection:
        wait_until(lambda: in_progress(server) == 2)
        server.process.send_signal(signal.SIGSTOP)
        connection.sendall(body[40:])
        time.sleep(2.2)
        server.process.send_signal(signal.SIGCONT)
        assert connection.recv(12) == b"HTTP/1.1 404"


def test_too_many_open_files_take_one_line_of_the_log_each_second(own_server: StartServer) -> None:
    server, begin = own_server(), time.monotonic()
    resource.prlimit(server.process.pid, resource.RLIMIT_NOFILE, (48, 48))
    with ExitStack() as stack:
        for _ in range(60):
            stack.enter_context(server.connection())
        wait_until(lambda: "no connection can be accepted" in server.log.read_text())
    n_lines, seconds = server.log.read_text().count("no connection can be accepted"), time.monotonic() - begin
    assert n_lines <= 1 + seconds
    assert "Traceback" not in server.log.read_text()
    assert server.http.get("/health/live", timeout=30).status_code == 200


def test_fields_behind_a_body_are_no_headers(own_server: StartServer) -> None:
    server = own_server(require_keys="true")
    key = new_key(server, "alice")[1]["Authorization"]
    body = b'{"measurement": "%s"}' % (b"0" * 64)
    head = b"POST /v1/fits HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nTransfer-Encoding: chunked\r\n"
    in_chunks = b"\r\n%x\r\n%b\r\n0\r\n" % (len(body), body)
    field = f"Authorization: {key}\r\n".encode()
    answers = []
    for sent in (head + field + in_chunks + b"\r\n", head + in_chunks + field + b"\r\n"):  # each in one piece
        with server.connection(sent) as connection:
            answers.append(connection.recv(12))
    assert answers == [b"HTTP/1.1 404", b"HTTP/1.1 401"]


def test_connections_over_eight_times_the_limit_are_refused(own_server: StartServer) -> None:
    server = own_server(limit_concurrency="4")
    server.http.close()
    with ExitStack() as stack:
        for _ in range(32):
            stack.enter_context(closing(server.connection()))
        with server.connection(b"GET /health/live HTTP/1.1\r\nHost: x\r\n\r\n") as connection:
            assert rest(connection).startswith(b"HTTP/1.1 503 ")
    wait_until(lambda: httpx.get(f"{server.http.base_url}/health/live", timeout=20).status_code == 200)
