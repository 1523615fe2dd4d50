"""The service behind nginx with the configuration of docker/, both real processes on loopback."""

import re
import shutil
import socket
import ssl
import subprocess
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import httpx
import numpy as np
import pytest

from service.http.problems import KINDS, TYPE_PREFIX
from service.settings import Settings
from service.wire.points import NPY
from tests.support.points import npy
from tests.support.processes import free_port, wait_until
from tests.support.server import ENDLESS, QUICK, Server

CONFIGURATION = Path(__file__).parents[2] / "docker" / "nginx.conf"
BINARY = {"Content-Type": "application/octet-stream"}

pytestmark = pytest.mark.skipif(shutil.which("nginx") is None, reason="nginx is not installed")


class Proxy:
    """One nginx process; `changes` replaces words of its configuration, each of which has to be there."""

    def __init__(self, folder: Path, upstream: str, **changes: str) -> None:
        self.port = free_port()
        self.log = folder / "access.log"
        text = CONFIGURATION.read_text()
        own = {
            "service:8000": upstream,
            "listen 8080": f"listen 127.0.0.1:{self.port}",
            "/tmp/": f"{folder}/",
            "/dev/stdout": str(self.log),
            "worker_processes 2": "worker_processes 1",
        }
        for old, new in {**own, **changes}.items():
            assert old in text
            text = text.replace(old, new)
        (folder / "nginx.conf").write_text(text)
        command = ["nginx", "-e", "stderr", "-c", str(folder / "nginx.conf"), "-g", "daemon off;"]
        self.errors = folder / "error.log"
        with self.errors.open("wb") as errors:
            self.process = subprocess.Popen(command, stderr=errors)
        self.http = httpx.Client(base_url=f"http://127.0.0.1:{self.port}", timeout=60)
        wait_until(self._answers)

    def _answers(self) -> bool:
        assert self.process.poll() is None, self.errors.read_text()
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0

    def send(self, data: bytes) -> bytes:
        """Send bytes as they are and return what comes back."""
        answer = b""
        with (
            socket.create_connection(("127.0.0.1", self.port), timeout=60) as connection,
            suppress(ConnectionResetError),
        ):
            connection.sendall(data)
            while not answer.endswith(b"}") and (part := connection.recv(65536)):
                answer += part
        return answer

    def close(self) -> None:
        self.http.close()
        self.process.terminate()
        self.process.wait(timeout=20)


def address_of(server: Server) -> str:
    return f"127.0.0.1:{server.http.base_url.port}"


@pytest.fixture(scope="module")
def proxy(server: Server, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Proxy]:
    """The shared service behind nginx as it is shipped."""
    running = Proxy(tmp_path_factory.mktemp("proxy"), address_of(server))
    try:
        yield running
    finally:
        running.close()


@pytest.fixture
def own_proxy(tmp_path: Path) -> Iterator[Callable[..., Proxy]]:
    """Start an nginx whose configuration is changed."""
    started: list[Proxy] = []

    def start(upstream: str, **changes: str) -> Proxy:
        started.append(Proxy(tmp_path, upstream, **changes))
        return started[-1]

    try:
        yield start
    finally:
        for running in started:
            running.close()


def assert_problem(answer: httpx.Response, kind: str) -> None:
    status, title, *_ = KINDS[kind]
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"
    document = answer.json()
    assert (document["type"], document["title"], document["status"]) == (TYPE_PREFIX + kind, title, status)
    assert document["detail"].endswith(".")


def test_upload_is_passed_on_unbuffered(proxy: Proxy, server: Server, data: bytes) -> None:
    """The service refuses a wrong header before the rest of the file has been sent."""
    head = (
        f"POST /v1/measurements HTTP/1.1\r\nHost: localhost\r\nContent-Length: {len(data)}\r\nConnection: close\r\n\r\n"
    )
    begin = time.perf_counter()
    answer = proxy.send(head.encode() + b"\x01" * (1 << 20))
    assert b" 422 " in answer.splitlines()[0]
    assert b"urn:dsbrdf:problem:measurement-format" in answer
    assert time.perf_counter() - begin < 20


@pytest.mark.parametrize(("path", "length"), [("/v1/measurements", 40_000_000), ("/v1/fits/0/brdf", 300_000_000)])
def test_too_long_body_is_refused_by_nginx(proxy: Proxy, path: str, length: int) -> None:
    head = f"POST {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n"
    answer = proxy.send(head.encode())
    assert b" 413 " in answer.splitlines()[0]
    assert b"urn:dsbrdf:problem:too-large" in answer
    assert b"34992012" in answer


@pytest.mark.parametrize("part", ["", "components/diffuse/"])
def test_batches_may_be_longer_than_a_measurement(proxy: Proxy, fitted: str, part: str) -> None:
    points = npy(np.zeros((900_000, 6)))  # no unit vectors, as the service says when it has all of them
    answer = proxy.http.post(f"/v1/fits/{fitted}/{part}brdf", content=points, headers={"Content-Type": NPY})
    assert_problem(answer, "invalid-argument")


def test_bad_heads_are_refused_by_nginx(proxy: Proxy) -> None:
    for answer in (
        proxy.http.get("/v1/fits", headers={"X-Long": "x" * 10_000}),
        proxy.http.get("/v1/fits?cursor=" + "x" * 10_000),
    ):
        assert_problem(answer, "bad-request")
    assert b"urn:dsbrdf:problem:bad-request" in proxy.send(b"GET / HTTP/1.1\r\nHost: a b\r\nbad header\r\n\r\n")


def test_slow_head_times_out(server: Server, own_proxy: Callable[..., Proxy]) -> None:
    proxy = own_proxy(address_of(server), **{"client_header_timeout 10s": "client_header_timeout 1s"})
    assert proxy.send(b"GET /health/live HTTP/1.1\r\nHost") == b""


def test_stalled_body_times_out_in_the_service(
    own_server: Callable[..., Server], own_proxy: Callable[..., Proxy], data: bytes
) -> None:
    proxy = own_proxy(address_of(own_server(fits=False, idle_timeout="1")))
    head = f"POST /v1/measurements HTTP/1.1\r\nHost: localhost\r\nContent-Length: {len(data)}\r\n\r\n"
    assert b"urn:dsbrdf:problem:request-timeout" in proxy.send(head.encode() + data[:1000])


def test_nginx_body_timeout_exceeds_that_of_the_service() -> None:
    seconds = re.search(r"client_body_timeout (\d+)s;", CONFIGURATION.read_text())
    assert seconds
    assert int(seconds[1]) > Settings().idle_timeout


def test_request_rate_of_an_address_is_limited(server: Server, own_proxy: Callable[..., Proxy]) -> None:
    proxy = own_proxy(address_of(server), **{"rate=100r/s": "rate=1r/s", "burst=200": "burst=5"})
    answers = [proxy.http.get("/health/live") for _ in range(30)]
    refused = [answer for answer in answers if answer.status_code != 200]
    assert 30 - len(refused) >= 6
    assert refused
    for answer in refused:
        assert_problem(answer, "rate-limited")
        assert int(answer.headers["retry-after"]) >= 1


def test_open_requests_of_an_address_are_limited(server: Server, own_proxy: Callable[..., Proxy]) -> None:
    proxy = own_proxy(address_of(server), **{"limit_conn connections 64": "limit_conn connections 2"})
    head = b"POST /v1/measurements HTTP/1.1\r\nHost: localhost\r\nContent-Length: 34992012\r\n\r\n"
    held = [socket.create_connection(("127.0.0.1", proxy.port)) for _ in range(2)]
    for connection in held:
        connection.sendall(head)
    try:
        wait_until(lambda: proxy.http.get("/health/live").status_code == 429)
        assert_problem(proxy.http.get("/health/live"), "rate-limited")
    finally:
        for connection in held:
            connection.close()
    wait_until(lambda: proxy.http.get("/health/live").status_code == 200)


def test_the_service_can_be_shown_below_a_path(
    server: Server, own_proxy: Callable[..., Proxy], stored: str, fitted: str
) -> None:
    header = 'proxy_set_header X-Forwarded-Prefix "";'
    changes = {header: "rewrite ^/brdf(/.*)$ $1; proxy_set_header X-Forwarded-Prefix /brdf;"}
    proxy = own_proxy(address_of(server), **changes)
    answer = proxy.http.post("/brdf/v1/fits", json={"measurement": stored, "options": QUICK})
    assert answer.headers["location"] == f"/brdf/v1/fits/{answer.json()['id']}"
    points = npy(np.tile([0.0, 0.0, 1.0], (800_000, 2)))  # longer than other bodies may be
    batch = proxy.http.post(f"/brdf/v1/fits/{fitted}/brdf", content=points, headers={"Content-Type": NPY})
    assert batch.status_code == 200, batch.text


def test_event_stream_is_passed_on_unbuffered(
    own_server: Callable[..., Server], own_proxy: Callable[..., Proxy], data: bytes
) -> None:
    server = own_server()
    proxy = own_proxy(address_of(server))
    sha256 = proxy.http.post("/v1/measurements", content=data, headers=BINARY).json()["sha256"]
    fit_id = server.submit(sha256, "respond-async", **ENDLESS).json()["id"]
    with proxy.http.stream("GET", f"/v1/fits/{fit_id}/events") as events:
        assert events.headers["content-type"].startswith("text/event-stream")
        first = next(line for line in events.iter_lines() if line.startswith("event:"))
        assert first.removeprefix("event:").strip() in ("accepted", "running")
        assert server.status(fit_id) in ("accepted", "running")
    server.http.delete(f"/v1/fits/{fit_id}")


def test_response_to_a_slow_client_is_not_buffered_on_disk(
    server: Server, own_proxy: Callable[..., Proxy], fitted: str
) -> None:
    """Its /tmp is 64 MB of memory; two tables of 35 MB there would break off both answers."""
    proxy = own_proxy(address_of(server))
    with proxy.http.stream("GET", f"/v1/fits/{fitted}/export?format=merl") as answer:
        parts = answer.iter_raw(1 << 16)
        received = len(next(parts))
        time.sleep(0.5)  # the service could have sent all of it by now
        received += sum(map(len, parts))
    assert received == 34_992_012
    assert "temporary file" not in proxy.errors.read_text()


def test_nginx_serves_tls_with_a_certificate(
    server: Server, own_proxy: Callable[..., Proxy], tmp_path: Path, data: bytes
) -> None:
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    port, folder = free_port(), tmp_path / "tls"
    folder.mkdir()
    certificate, key = folder / "fullchain.pem", folder / "key.pem"
    make = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost"]
    names = ["-addext", "subjectAltName=IP:127.0.0.1,DNS:localhost"]
    subprocess.run([*make, *names, "-keyout", key, "-out", certificate], check=True, capture_output=True)
    text = (CONFIGURATION.parent / "tls" / "tls.conf").read_text()
    text = text.replace("listen 8443", f"listen 127.0.0.1:{port}").replace("/etc/nginx/tls", str(folder))
    (folder / "tls.conf").write_text(text)
    own_proxy(address_of(server), **{"/etc/nginx/tls/*.conf": f"{folder}/*.conf"})
    trusted = ssl.create_default_context(cafile=certificate)
    with httpx.Client(base_url=f"https://127.0.0.1:{port}", verify=trusted, timeout=60) as client:
        answer = client.post("/v1/fits?method=paper&n_lobes=1", content=data, headers=BINARY)
        assert answer.json()["status"] == "succeeded"
        assert answer.headers["strict-transport-security"] == "max-age=31536000"
        with pytest.raises(httpx.ConnectError, match="CERTIFICATE_VERIFY_FAILED"):
            httpx.get(f"https://127.0.0.1:{port}/health/live", timeout=60)
    old = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    old.load_verify_locations(certificate)
    old.set_ciphers("DEFAULT@SECLEVEL=0")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        old.minimum_version = old.maximum_version = ssl.TLSVersion.TLSv1_1
    with pytest.raises(httpx.ConnectError):
        httpx.get(f"https://127.0.0.1:{port}/health/live", verify=old, timeout=60)
    assert_problem(httpx.get(f"http://127.0.0.1:{port}/health/live", timeout=60), "bad-request")


def test_unreachable_or_silent_service_is_a_problem_document(own_proxy: Callable[..., Proxy]) -> None:
    answer = own_proxy(f"127.0.0.1:{free_port()}").http.get("/health/ready")
    assert (answer.status_code, answer.json()["status"]) == (502, 502)
    assert answer.headers["content-type"] == "application/problem+json"
    assert "retry-after" in answer.headers
    with socket.create_server(("127.0.0.1", 0)) as silent:
        changes = {"proxy_read_timeout 330s": "proxy_read_timeout 1s"}
        answer = own_proxy(f"127.0.0.1:{silent.getsockname()[1]}", **changes).http.get("/health/ready")
    assert (answer.status_code, answer.json()["status"]) == (504, 504)


def test_forwarded_headers_are_those_of_nginx(own_proxy: Callable[..., Proxy]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener, ThreadPoolExecutor(1) as pool:
        heard = pool.submit(heard_and_answered, listener)
        proxy = own_proxy(f"127.0.0.1:{listener.getsockname()[1]}")
        names = ("For", "Proto", "Host", "Prefix")
        claims = dict.fromkeys((*(f"X-Forwarded-{name}" for name in names), "X-Real-IP", "Forwarded"), "10.1.2.3")
        proxy.http.get("/", headers={**claims, "X-Request-ID": "mine-1", "Authorization": "Bearer key"})
        head = heard.result().lower()
    assert b"10.1.2.3" not in head
    assert b"x-forwarded-for: 127.0.0.1\r\n" in head
    assert b"x-forwarded-proto: http\r\n" in head
    assert b"x-request-id: mine-1\r\n" in head
    assert b"authorization: bearer key\r\n" in head


def heard_and_answered(listener: socket.socket) -> bytes:
    connection, _ = listener.accept()
    with connection:
        head = connection.recv(65536)
        connection.sendall(b"HTTP/1.1 204 No Content\r\n\r\n")
    return head


def test_proxy_log_has_the_request_id_of_the_service(proxy: Proxy) -> None:
    answer = proxy.http.get("/health/live")
    assert "/" not in answer.headers.get("server", "")  # no version
    wait_until(lambda: answer.headers["x-request-id"] in proxy.log.read_text())
