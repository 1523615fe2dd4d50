"""What comes in: checked while it is written, never held whole, and nothing stays of what is not acceptable.

Clients that stop in the middle of a body or an answer cost next to no memory, however many they are.
"""

import hashlib
import json
import secrets
import select
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from pathlib import Path

import httpx
import pytest

from dsbrdf.data import FILE_SIZE
from tests.support.merl_files import with_value
from tests.support.processes import wait_until
from tests.support.server import QUICK, Server, StartServer, assert_problem, head_of_upload, in_progress, new_key

pytestmark = pytest.mark.slow


def contents(server: Server) -> tuple[list[Path], list[object]]:
    return sorted(server.files()), [server.http.get(path).json() for path in ("/v1/fits", "/v1/measurements")]


def test_batch_may_have_sixteen_megabytes(server: Server, fitted: str) -> None:
    document = b'{"theta_half_deg": [1], "theta_diff_deg": [1]}'
    for length, status in ((16_000_000, 200), (16_000_001, 413)):
        headers = {"Content-Type": "application/json", "Content-Encoding": "identity"}
        answer = server.http.post(f"/v1/fits/{fitted}/brdf", content=document.ljust(length), headers=headers)
        assert answer.status_code == status, answer.text


def test_uploads_take_little_memory(own_server: StartServer, data: bytes, plastic_file: Path) -> None:
    server = own_server()
    before = server.memory("VmHWM")
    with plastic_file.open("rb") as file:
        answer = server.http.post("/v1/measurements", content=file)
    assert answer.status_code == 201
    assert server.memory("VmHWM") - before < 8

    contents = [with_value(data, 0.25 + i) for i in range(3)]
    with ThreadPoolExecutor(3) as pool:
        url = server.http.base_url.join("/v1/measurements")
        answers = list(pool.map(lambda content: httpx.post(url, content=content, timeout=60), contents))
    assert [answer.status_code for answer in answers] == [201] * 3
    assert {answer.json()["sha256"] for answer in answers} == {hashlib.sha256(c).hexdigest() for c in contents}
    assert server.memory("VmHWM") - before < 24


def test_wrong_length_is_refused_by_the_first_bytes_or_at_the_end(server: Server, data: bytes) -> None:
    with server.connection(head_of_upload(FILE_SIZE - 8) + data[:12]) as connection:
        assert b" 422 " in connection.recv(20)
    cut_off = server.http.post("/v1/measurements", content=iter([data[:-8]]))  # Its length is not declared.
    assert f"has only {FILE_SIZE - 8} bytes" in assert_problem(cut_off, 422, "measurement-format")


def test_interrupted_upload_stores_nothing(server: Server, data: bytes) -> None:
    before = contents(server)
    for share in (0, 12, 100_000, FILE_SIZE - 1):
        with server.connection(head_of_upload(FILE_SIZE, "/v1/fits") + data[:share]):
            if share > 20_000_000:
                wait_until(lambda: contents(server)[0] != before[0])
    wait_until(lambda: contents(server) == before)


@pytest.mark.parametrize(
    ("path", "media_type"),
    [
        ("/v1/fits", "application/octet-stream"),
        ("/v1/fits", "application/json"),
        ("/v1/fits/{}/brdf", "application/x-npy"),
    ],
)
def test_interrupted_upload_is_logged_as_client_error(server: Server, fitted: str, path: str, media_type: str) -> None:
    request_id = secrets.token_hex(8)
    head = head_of_upload(1000, path.format(fitted), content_type=media_type, x_request_id=request_id)
    server.connection(head + b"{").close()

    def lines() -> list[str]:
        return [line for line in server.log.read_text().splitlines() if request_id in line]

    wait_until(lambda: bool(lines()), 60)
    assert [json.loads(line)["status"] for line in lines()] == [400]


def test_stalled_client_takes_half_a_megabyte(own_server: StartServer, data: bytes) -> None:
    """So 240 uploads take 120 MB, and the service 250 MB with them."""
    server = own_server(max_idle_seconds="600", min_upload_bytes_per_second="0")
    path = f"/v1/fits/{server.http.post('/v1/fits', params=QUICK, content=data).json()['id']}"
    server.http.get(f"{path}/export?format=merl")  # what any work takes once is no cost of the clients
    requests = [f"GET {path}/export?format=merl HTTP/1.1\r\nHost: x\r\n\r\n".encode()] * 4
    requests += [head_of_upload(len(data)) + data[:600_000]] * 48
    before = server.memory()
    with ExitStack() as stack:
        for request in requests:
            stack.enter_context(closing(server.connection(request)))
        wait_until(lambda: in_progress(server) > len(requests))
        arriving = server.data_dir / "tmp"
        wait_until(lambda: sum(path.stat().st_size > 460_000 for path in arriving.iterdir()) >= 48)
        assert server.memory() - before < 0.5 * len(requests)
        assert server.http.get(f"{path}/brdf?theta_half_deg=0&theta_diff_deg=0").status_code == 200
    wait_until(lambda: in_progress(server) == 1)
    wait_until(lambda: not list(arriving.iterdir()))


def test_bodies_of_one_caller_take_limited_memory_and_no_disk(own_server: StartServer, data: bytes) -> None:
    server = own_server(max_idle_seconds="600", min_upload_bytes_per_second="0", require_keys="true")
    alice, bob = (new_key(server, name)[1] for name in ("alice", "bob"))
    path = f"/v1/fits/{server.http.post('/v1/fits', params=QUICK, content=data, headers=alice).json()['id']}/brdf"
    head = head_of_upload(16_000_000, path, content_type="application/json", **alice)
    before = server.memory()
    with ExitStack() as stack:
        connections = [stack.enter_context(closing(server.connection(head))) for _ in range(5)]
        for connection in connections:
            with suppress(ConnectionError):  # the one that is refused, whichever it is
                connection.sendall(bytes(15_900_000))
        answering, _, _ = select.select(connections, [], [], 60)
        assert [connection.recv(12) for connection in answering] == [b"HTTP/1.1 429"]
        assert server.memory() - before < 160
        assert not list((server.data_dir / "tmp").iterdir())
        assert server.http.get("/v1/fits", headers=bob).status_code == 200
    document = json.dumps({"theta_half_deg": [1], "theta_diff_deg": [1]}).ljust(16_000_000)
    headers = {**alice, "Content-Type": "application/json"}
    wait_until(lambda: server.http.post(path, content=document, headers=headers).status_code == 200, 60)
