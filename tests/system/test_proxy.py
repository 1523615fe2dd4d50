"""The service behind nginx with the configuration of docker/, both real processes on loopback."""

import re
import shutil
import socket
import ssl
import subprocess
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from pathlib import Path

import httpx
import numpy as np
import pytest

from dsbrdf_service.http.messages import NPY
from dsbrdf_service.http.problems import KINDS, TYPE_PREFIX
from dsbrdf_service.settings import Settings
from tests.support.processes import free_port, wait_until
from tests.support.server import ENDLESS, QUICK, Server, StartServer, head_of_upload, npy

CONFIGURATION = Path(__file__).parents[2] / "docker" / "nginx.conf"

pytestmark = pytest.mark.skipif(shutil.which("nginx") is None, reason="nginx is not installed")


class Proxy:
    """One nginx process; `changes` replaces words of its configuration, each of which has to be there."""

    def __init__(self, folder: Path, upstream: int | None, **changes: str) -> None:
        self.port = free_port()
        self.log = folder / "access.log"
        text = CONFIGURATION.read_text()
        own = {
            "service:8000": f"127.0.0.1:{upstream}",
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


@pytest.fixture(scope="module")
def proxy(server: Server, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Proxy]:
    """The shared service behind nginx as it is shipped."""
    with closing(Proxy(tmp_path_factory.mktemp("proxy"), server.http.base_url.port)) as running:
        yield running


@pytest.fixture
def own_proxy(server: Server, tmp_path: Path) -> Iterator[Callable[..., Proxy]]:
    """Start an nginx whose configuration is changed, before the shared service or another port."""
    with ExitStack() as stack:
        yield lambda port=server.http.base_url.port, **changes: stack.enter_context(
            closing(Proxy(tmp_path, port, **changes))
        )


def assert_problem(answer: httpx.Response, kind: str) -> None:
    status, title, *_ = KINDS[kind]
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"
    document = answer.json()
    assert (document["type"], document["title"], document["status"]) == (TYPE_PREFIX + kind, title, status)
    assert document["detail"].endswith(".")


def test_upload_is_passed_on_unbuffered(proxy: Proxy, data: bytes) -> None:
    """The service refuses a wrong header before the rest of the file has been sent."""
    answer = proxy.send(head_of_upload(len(data)) + b"\x01" * (1 << 20))
    assert b" 422 " in answer.splitlines()[0]
    assert b"urn:dsbrdf:problem:measurement-format" in answer


def test_too_long_body_is_refused_by_nginx(proxy: Proxy) -> None:
    answer = proxy.send(head_of_upload(40_000_000))
    assert b" 413 " in answer.splitlines()[0]
    assert b"urn:dsbrdf:problem:too-large" in answer
    assert b"34992012" in answer


def test_bad_heads_are_refused_by_nginx(proxy: Proxy) -> None:
    for query, headers in (("", {"X-Long": "x" * 10_000}), ("?cursor=" + "x" * 10_000, {})):
        assert_problem(proxy.http.get(f"/v1/fits{query}", headers=headers), "head-too-long")
    assert b"urn:dsbrdf:problem:bad-request" in proxy.send(b"GET / HTTP/1.1\r\nHost: a b\r\nbad header\r\n\r\n")


def test_stalled_body_times_out_in_the_service_before_it_does_in_nginx(
    own_server: StartServer, own_proxy: Callable[..., Proxy], data: bytes
) -> None:
    proxy = own_proxy(own_server(max_idle_seconds="1").http.base_url.port)
    assert b"urn:dsbrdf:problem:request-timeout" in proxy.send(head_of_upload(len(data)) + data[:1000])
    seconds = re.search(r"client_body_timeout (\d+)s;", CONFIGURATION.read_text())
    assert seconds
    assert int(seconds[1]) > Settings().max_idle_seconds


def test_request_rate_of_an_address_is_limited(own_proxy: Callable[..., Proxy]) -> None:
    proxy = own_proxy(**{"rate=100r/s": "rate=1r/s", "burst=200": "burst=5"})
    answers = [proxy.http.get("/health/live") for _ in range(30)]
    refused = [answer for answer in answers if answer.status_code != 200]
    assert 1 <= len(refused) <= 24
    for answer in refused:
        assert_problem(answer, "rate-limited")
        assert int(answer.headers["retry-after"]) >= 1


def test_open_requests_of_an_address_are_limited(own_proxy: Callable[..., Proxy]) -> None:
    proxy = own_proxy(**{"limit_conn connections 64": "limit_conn connections 2"})
    with ExitStack() as held:
        for _ in range(2):
            connection = held.enter_context(socket.create_connection(("127.0.0.1", proxy.port)))
            connection.sendall(head_of_upload(34_992_012))
        wait_until(lambda: proxy.http.get("/health/live").status_code == 429)
        assert_problem(proxy.http.get("/health/live"), "rate-limited")
    wait_until(lambda: proxy.http.get("/health/live").status_code == 200)


def test_the_service_can_be_shown_below_a_path(own_proxy: Callable[..., Proxy], stored: str, fitted: str) -> None:
    header = 'proxy_set_header X-Forwarded-Prefix "";'
    proxy = own_proxy(**{header: "rewrite ^/brdf(/.*)$ $1; proxy_set_header X-Forwarded-Prefix /brdf;"})
    answer = proxy.http.post("/brdf/v1/fits", json={"measurement": stored, "options": QUICK})
    assert answer.headers["location"] == f"/brdf/v1/fits/{answer.json()['id']}"
    points = npy(np.tile([0.0, 0.0, 1.0], (100_000, 2)))
    batch = proxy.http.post(f"/brdf/v1/fits/{fitted}/brdf", content=points, headers={"Content-Type": NPY})
    assert batch.status_code == 200, batch.text


def test_event_stream_is_passed_on_unbuffered(proxy: Proxy, server: Server, stored: str) -> None:
    fit_id = server.submit(stored, "respond-async", mask=0.16, **ENDLESS).json()["id"]
    with proxy.http.stream("GET", f"/v1/fits/{fit_id}/events") as events:
        assert events.headers["content-type"].startswith("text/event-stream")
        first = next(line for line in events.iter_lines() if line.startswith("event:"))
        assert first.removeprefix("event:").strip() in ("accepted", "running")
        assert server.status(fit_id) in ("accepted", "running")
    server.http.delete(f"/v1/fits/{fit_id}")


def test_response_to_a_slow_client_is_not_buffered_on_disk(own_proxy: Callable[..., Proxy], fitted: str) -> None:
    """Its /tmp is 64 MB of memory; two tables of 35 MB there would break off both answers."""
    proxy = own_proxy()
    with proxy.http.stream("GET", f"/v1/fits/{fitted}/export?format=merl") as answer:
        parts = answer.iter_raw(1 << 16)
        received = len(next(parts))
        time.sleep(0.5)  # the service could have sent all of it by now
        received += sum(map(len, parts))
    assert received == 34_992_012
    assert "temporary file" not in proxy.errors.read_text()


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
def test_nginx_serves_tls_with_a_certificate(own_proxy: Callable[..., Proxy], tmp_path: Path) -> None:
    port, folder = free_port(), tmp_path / "tls"
    folder.mkdir()
    certificate, key = folder / "fullchain.pem", folder / "key.pem"
    make = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost"]
    names = ["-addext", "subjectAltName=IP:127.0.0.1,DNS:localhost"]
    subprocess.run([*make, *names, "-keyout", key, "-out", certificate], check=True, capture_output=True)
    text = (CONFIGURATION.parent / "tls" / "tls.conf").read_text()
    assert "ssl_protocols TLSv1.2 TLSv1.3;" in text
    text = text.replace("listen 8443", f"listen 127.0.0.1:{port}").replace("/etc/nginx/tls", str(folder))
    (folder / "tls.conf").write_text(text)
    own_proxy(**{"/etc/nginx/tls/*.conf": f"{folder}/*.conf"})
    trusted = ssl.create_default_context(cafile=certificate)
    with httpx.Client(base_url=f"https://127.0.0.1:{port}", verify=trusted, timeout=60) as client:
        answer = client.get("/health/ready")
        assert answer.status_code == 200
        assert answer.headers["strict-transport-security"] == "max-age=31536000"
        with pytest.raises(httpx.ConnectError, match="CERTIFICATE_VERIFY_FAILED"):
            httpx.get(f"https://127.0.0.1:{port}/health/live", timeout=60)
    assert_problem(httpx.get(f"http://127.0.0.1:{port}/health/live", timeout=60), "bad-request")


def test_unreachable_or_silent_service_is_a_problem_document(own_proxy: Callable[..., Proxy]) -> None:
    answer = own_proxy(free_port()).http.get("/health/ready")
    assert (answer.status_code, answer.json()["status"]) == (502, 502)
    assert answer.headers["content-type"] == "application/problem+json"
    assert "retry-after" in answer.headers
    with socket.create_server(("127.0.0.1", 0)) as silent:
        changes = {"proxy_read_timeout 330s": "proxy_read_timeout 1s"}
        answer = own_proxy(silent.getsockname()[1], **changes).http.get("/health/ready")
    assert (answer.status_code, answer.json()["status"]) == (504, 504)


def test_forwarded_headers_are_those_of_nginx(own_proxy: Callable[..., Proxy]) -> None:
    def heard_and_answered(listener: socket.socket) -> bytes:
        connection, _ = listener.accept()
        with connection:
            head = connection.recv(65536)
            connection.sendall(b"HTTP/1.1 204 No Content\r\n\r\n")
        return head

    with socket.create_server(("127.0.0.1", 0)) as listener, ThreadPoolExecutor(1) as pool:
        heard = pool.submit(heard_and_answered, listener)
        proxy = own_proxy(listener.getsockname()[1])
        names = ("For", "Proto", "Host", "Prefix")
        claims = dict.fromkeys((*(f"X-Forwarded-{name}" for name in names), "X-Real-IP", "Forwarded"), "10.1.2.3")
        proxy.http.get("/", headers={**claims, "X-Request-ID": "mine-1", "Authorization": "Bearer key"})
        head = heard.result().lower()
    assert b"10.1.2.3" not in head
    assert b"x-forwarded-for: 127.0.0.1\r\n" in head
    assert b"x-forwarded-proto: http\r\n" in head
    assert b"x-request-id: mine-1\r\n" in head
    assert b"authorization: bearer key\r\n" in head


def test_proxy_log_has_the_request_id_of_the_service(proxy: Proxy) -> None:
    answer = proxy.http.get("/health/live")
    assert "/" not in answer.headers.get("server", "")  # no version
    wait_until(lambda: answer.headers["x-request-id"] in proxy.log.read_text())
