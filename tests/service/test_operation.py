"""Readiness, slow clients, too many of them, and settings that are wrong."""

import asyncio
import json
import resource
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import cast

import httpx
import pytest

from dsbrdf.data.merl import FILE_SIZE
from dsbrdf.engines.engine import Engine
from service.__main__ import main
from service.operations import readiness
from service.operations.readiness import Readiness
from service.settings import Settings, unknown_settings
from service.storage.database import FILE_NAME
from service.storage.store import Store
from tests.service.running import ENDLESS, QUICK, Server, assert_problem, wait_until

PATIENCE = 1.0  # seconds that the service has with slow clients here


@pytest.fixture(scope="module")
def impatient(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A service that soon gives slow clients up, and has few places."""
    settings = {"header_timeout": "1", "idle_timeout": "1", "least_upload_rate": "100000", "limit_concurrency": "4"}
    running = Server(tmp_path_factory.mktemp("impatient") / "data", workers="1", **settings)
    try:
        yield running.start()
    finally:
        running.close()


def connect(server: Server, sent: bytes = b"") -> socket.socket:
    url = server.http.base_url
    connection = socket.create_connection((url.host, url.port or 80), timeout=20)
    connection.sendall(sent)
    return connection


def rest(connection: socket.socket) -> bytes:
    """Everything that comes until the service closes the connection."""
    parts = []
    while part := connection.recv(1 << 16):
        parts.append(part)
    return b"".join(parts)


def problem(answer: bytes) -> tuple[int, str]:
    """Status and kind of a problem document that came over a plain connection."""
    head, _, body = answer.partition(b"\r\n\r\n")
    assert b"application/problem+json" in head
    assert b"connection: close" in head.lower()
    document = json.loads(body)
    assert document["status"] == int(head.split()[1])
    return document["status"], document["type"].removeprefix("urn:dsbrdf:problem:")


def head_of_upload(length: int) -> bytes:
    return f"POST /v1/measurements HTTP/1.1\r\nHost: x\r\nContent-Length: {length}\r\n\r\n".encode()


def trickle(connection: socket.socket, data: bytes) -> bytes:
    """Send a byte every 0.05 s, 400 of them being 20 s of never being silent, and return what is answered."""
    connection.settimeout(0.05)
    answer = b""
    for byte in data:
        try:
            connection.sendall(bytes([byte]))
            answer = connection.recv(1 << 16)
            break
        except TimeoutError:
            continue
    connection.settimeout(20)
    return answer + rest(connection)


def test_a_body_that_stops_is_given_up(impatient: Server, data: bytes) -> None:
    with connect(impatient, head_of_upload(len(data)) + data[:1_000_000]) as connection:
        wait_until(lambda: bool(impatient.files()))
        assert problem(rest(connection)) == (408, "request-timeout")
    wait_until(lambda: not impatient.files())


@pytest.mark.parametrize(
    ("path", "media_type", "length"),
    [("/v1/measurements", "application/octet-stream", FILE_SIZE), ("/v1/fits", "application/json", 1000)],
)
def test_a_body_that_trickles_is_given_up(
    impatient: Server, data: bytes, path: str, media_type: str, length: int
) -> None:
    head = f"POST {path} HTTP/1.1\r\nHost: x\r\nContent-Type: {media_type}\r\nContent-Length: {length}\r\n\r\n"
    with connect(impatient, head.encode()) as connection:
        assert problem(trickle(connection, data[:400])) == (408, "request-timeout")
    wait_until(lambda: not impatient.files())


def test_a_body_that_is_fast_enough_may_take_longer_than_the_patience(
    own_server: Callable[..., Server], data: bytes
) -> None:
    patience = 3 * PATIENCE  # for a client that is held up by a busy machine
    server = own_server(idle_timeout=str(patience), least_upload_rate="100000")
    step = len(data) // 8

    async def in_steps() -> AsyncIterator[bytes]:
        for start in range(0, len(data), step):
            await asyncio.sleep(0.15 * patience)
            yield data[start : start + step]

    async def upload() -> httpx.Response:
        async with httpx.AsyncClient(base_url=server.http.base_url, timeout=60) as client:
            return await client.post("/v1/measurements", content=in_steps())

    assert asyncio.run(upload()).status_code == 201


@pytest.mark.parametrize("sent", [b"", b"GET /health/live HT", b"GET /health/live HTTP/1.1\r\nHost: x\r\nX-Slow: "])
def test_a_head_that_does_not_end_is_given_up(impatient: Server, sent: bytes) -> None:
    with connect(impatient, sent) as connection:
        assert problem(rest(connection)) == (408, "request-timeout")


def test_a_head_that_trickles_is_given_up(impatient: Server) -> None:
    first = b"GET /health/live HTTP/1.1\r\nHost: x\r\n\r\n"
    with connect(impatient, first) as connection:
        connection.settimeout(0.05)
        answered = b""
        while b'"live"' not in answered:
            try:
                answered += connection.recv(1 << 16)
            except TimeoutError:
                continue
        # The second request of the connection.
        assert problem(trickle(connection, first[:10] * 40)) == (408, "request-timeout")


def test_an_answer_that_nobody_reads_is_given_up(impatient: Server, data: bytes) -> None:
    sha256 = impatient.http.post("/v1/measurements", content=data).json()["sha256"]
    with connect(impatient, f"GET /v1/measurements/{sha256} HTTP/1.1\r\nHost: x\r\n\r\n".encode()) as connection:
        assert connection.recv(1000)
        time.sleep(5 * PATIENCE)
        received = 0
        try:
            while part := connection.recv(1 << 20):
                received += len(part)
        except ConnectionResetError:
            pass
        assert received < len(data)  # what the sockets' buffers held


@pytest.mark.parametrize(
    "sent",
    [b"nonsense\r\n\r\n", b"GET /" + b"x" * 100_000 + b" HTTP/1.1\r\n\r\n", b"\0" * 99],
)
def test_what_is_not_http_gets_a_problem_document(impatient: Server, sent: bytes) -> None:
    with connect(impatient, sent) as connection:
        assert problem(rest(connection)) == (400, "bad-request")


def test_requests_beyond_the_limit_are_refused(impatient: Server, data: bytes) -> None:
    sha256 = impatient.http.post("/v1/measurements", content=data).json()["sha256"]
    fit = impatient.submit(sha256, prefer="respond-async", **ENDLESS).json()["id"]
    last = impatient.submit(sha256, prefer="respond-async", **{**ENDLESS, "em_iterations": 9_999}).json()["id"]
    poll = f"GET /v1/fits/{last}?wait=60 HTTP/1.1\r\nHost: x\r\n\r\n".encode()
    polls = [connect(impatient, poll) for _ in range(4)]
    try:
        with httpx.Client(base_url=impatient.http.base_url, timeout=20) as client:
            wait_until(lambda: client.get("/v1/fits").status_code == 503)
            refused = client.get("/v1/fits")
            assert_problem(refused, 503, "overloaded")
            assert refused.headers["retry-after"] == "1"
            assert client.get("/health/live").status_code == 200
    finally:
        for connection in polls:
            connection.close()
        for name in (last, fit):
            wait_until(lambda: impatient.http.delete(f"/v1/fits/{name}").status_code in (200, 204, 404))  # noqa: B023
    wait_until(lambda: impatient.http.get("/v1/fits").status_code == 200)


def test_connections_beyond_twice_the_limit_are_refused(own_server: Callable[..., Server]) -> None:
    server = own_server(limit_concurrency="4")
    server.http.close()
    idle = [connect(server) for _ in range(8)]
    try:
        with connect(server, b"GET /health/live HTTP/1.1\r\nHost: x\r\n\r\n") as connection:
            assert problem(rest(connection)) == (503, "overloaded")
    finally:
        for connection in idle:
            connection.close()
    wait_until(lambda: httpx.get(f"{server.http.base_url}/health/live", timeout=20).status_code == 200)


def test_a_database_that_hangs_is_not_ready_but_alive(own_server: Callable[..., Server], data: bytes) -> None:
    server = own_server()
    with closing(sqlite3.connect(server.data_dir / FILE_NAME, isolation_level=None)) as db:
        db.execute("BEGIN IMMEDIATE")
        wait_until(lambda: server.http.get("/health/ready").status_code == 503)
        # It has not answered, or has given up.
        assert "The database " in assert_problem(server.http.get("/health/ready"), 503, "not-ready")
        took = []
        for _ in range(3):
            begin = time.monotonic()
            assert server.http.get("/health/live").status_code == 200
            took.append(time.monotonic() - begin)
        assert min(took) < readiness.LIMIT
        db.execute("ROLLBACK")
    wait_until(lambda: server.http.get("/health/ready").status_code == 200)


def test_a_data_folder_that_vanishes_takes_nothing_until_it_is_back(
    own_server: Callable[..., Server], data: bytes
) -> None:
    server = own_server()
    sha256 = server.http.post("/v1/measurements", content=data).json()["sha256"]
    elsewhere = server.data_dir.with_name("elsewhere")
    server.data_dir.rename(elsewhere)
    wait_until(lambda: server.http.get("/health/ready").status_code == 503)
    for part in ("blobs", "tmp"):  # an empty folder in its place, as when a disk is not mounted
        (server.data_dir / part).mkdir(parents=True)
    wait_until(lambda: "The folder" not in server.http.get("/health/ready").text)
    detail = assert_problem(server.http.get("/health/ready"), 503, "not-ready")
    assert detail.startswith("The database is not ready: its file has been removed or replaced")
    assert str(server.data_dir) not in detail
    assert_problem(server.submit(sha256, **QUICK), 503, "not-ready")
    assert_problem(server.http.post("/v1/measurements", content=data), 503, "not-ready")
    assert server.http.get("/metrics").status_code == 200
    assert not server.files()
    shutil.rmtree(server.data_dir)
    elsewhere.rename(server.data_dir)
    wait_until(lambda: server.http.get("/health/ready").status_code == 200)
    assert server.submit(sha256, **QUICK).json()["status"] == "succeeded"


def test_a_database_that_is_damaged_meanwhile_is_not_ready(own_server: Callable[..., Server]) -> None:
    server = own_server()
    server.stop()  # what it has written is in the file, and no longer in its memory
    server.start()
    database = server.data_dir / FILE_NAME
    with database.open("r+b") as file:
        file.write(b"\xff" * database.stat().st_size)
    wait_until(lambda: server.http.get("/health/ready").status_code == 503)
    assert_problem(server.http.get("/v1/fits"), 503, "not-ready")
    assert "dsbrdf_requests_total" in server.http.get("/metrics").text
    server.stop(signal.SIGKILL)
    again = subprocess.run(
        [sys.executable, "-m", "service", "--port", "0", "--data-dir", str(server.data_dir)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert again.returncode == 2
    assert again.stderr.startswith("dsbrdf: the database ")
    assert again.stderr.count("\n") == 1


def test_what_cannot_be_started_is_told_in_one_sentence(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        for words, code, sentence in (
            (["--data-dir", str(file)], 2, f"{file} cannot be the data folder: File exists."),
            (["--port", str(port)], 1, f"port {port} of 127.0.0.1 cannot be listened on: Address already in use."),
        ):
            command = [sys.executable, "-m", "service", "--data-dir", str(tmp_path / "data"), *words]
            refused = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
            assert (refused.returncode, refused.stdout, refused.stderr) == (code, "", f"dsbrdf: {sentence}\n")


def test_a_disk_that_is_nearly_full_is_not_ready(tmp_path: Path) -> None:
    server = Server(tmp_path / "data", min_free_mb="1000000000")
    try:
        begin = server.launch()
        wait_until(lambda: b"Uvicorn running on " in server.log.read_bytes()[begin:], seconds=60)
        address = server.log.read_text().partition("Uvicorn running on ")[2].split()[0]
        answer = httpx.get(f"{address}/health/ready", timeout=20)
        assert "the service wants 1000000000 MB" in assert_problem(answer, 503, "not-ready")
        assert answer.headers["retry-after"]
    finally:
        server.close()


class Asked:
    """An engine that counts how often it is asked whether it is ready."""

    def __init__(self) -> None:
        self.times = 0
        self.fault: str | None = None
        self.hangs = asyncio.Event()
        self.hangs.set()

    async def check(self) -> None:
        self.times += 1
        await self.hangs.wait()
        if self.fault is not None:
            raise RuntimeError(self.fault)


@contextmanager
def with_engine(folder: Path, engine: Asked) -> Iterator[Readiness]:
    with closing(Store(folder)) as store:
        yield Readiness(store, cast("Engine", engine), Settings(data_dir=folder))


def test_asking_often_asks_the_parts_once_a_second(tmp_path: Path) -> None:
    async def ask() -> None:
        engine = Asked()
        with with_engine(tmp_path, engine) as ready:
            assert set(await asyncio.gather(*(ready.fault() for _ in range(50)))) == {None}
            assert engine.times == 1
            engine.fault = "No worker is there"
            await asyncio.sleep(1.1)
            assert await ready.fault() == "The engine is not ready: No worker is there."
            assert engine.times == 2
            ready.stop()
            assert await ready.fault() == "The service is shutting down."

    asyncio.run(ask())


def test_a_part_that_hangs_is_not_asked_again_beside_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(readiness, "LIMIT", 0.5)

    async def ask() -> None:
        engine = Asked()
        with with_engine(tmp_path, engine) as ready:
            engine.hangs.clear()
            for _ in range(4):
                fault = await ready.fault()
                assert fault is not None
                assert "The engine has not answered" in fault
            assert engine.times == 1
            engine.hangs.set()
            while await ready.fault() is not None:
                await asyncio.sleep(0.01)

    asyncio.run(ask())


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("DSBRDF_PORT", "eighty"),
        ("DSBRDF_LOG_LEVEL", "loud"),
        ("DSBRDF_WORKERS", "0"),
        ("DSBRDF_HEADER_TIMEOUT", "-1"),
        ("DSBRDF_ACCESS_LOG", "perhaps"),
    ],
)
def test_a_wrong_setting_is_one_sentence_that_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str, value: str
) -> None:
    monkeypatch.setenv(name, value)
    assert main(["--data-dir", str(tmp_path / "data")]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"dsbrdf: {name}: ")
    assert repr(value) in said
    assert said.count("\n") == 1
    assert not (tmp_path / "data").exists()


def test_a_variable_that_is_no_setting_is_told_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DSBRDF_WORKER", "2")
    monkeypatch.setenv("DSBRDF_KEY", "of-the-client")
    assert unknown_settings() == [
        "The environment variable DSBRDF_WORKER is no setting and has no effect; did you mean DSBRDF_WORKERS?"
    ]
    server = Server(tmp_path / "data")
    try:
        server.start()
        (told,) = [line for line in server.log.read_text().splitlines() if "DSBRDF_" in line]
        assert json.loads(told)["level"] == "warning"
    finally:
        server.close()


def test_an_empty_variable_is_no_setting(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in Settings.model_fields:
        monkeypatch.setenv(f"DSBRDF_{name.upper()}", "")
    assert Settings() == Settings(_env_prefix="NOTHING_")  # type: ignore[call-arg]


def test_a_service_without_free_descriptors_recovers_and_does_not_fill_the_log(
    own_server: Callable[..., Server],
) -> None:
    server = own_server(workers="1")
    resource.prlimit(server.process.pid, resource.RLIMIT_NOFILE, (40, 40))
    url = server.http.base_url
    server.http.close()
    with ExitStack() as stack:
        for _ in range(60):
            stack.enter_context(closing(connect(server)))
        wait_until(lambda: "out of system resource" in server.log.read_text())
        time.sleep(1.5)  # it tries again every second
        assert server.log.read_text().count("out of system resource") <= 3
    wait_until(lambda: httpx.get(f"{url}/health/ready", timeout=30).status_code == 200, 30)


def test_every_setting_is_described() -> None:
    for name, field in Settings.model_fields.items():
        assert field.description, name
        assert field.description.endswith("."), name
    assert Settings().shutdown_seconds < 10
