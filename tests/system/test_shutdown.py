"""Ends and beginnings of the service: soon, whatever is open; nothing accepted is lost, nothing stays behind."""

import json
import os
import re
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from itertools import cycle
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest

from dsbrdf_service.admin import serve
from tests.support.command_line import run_main
from tests.support.dask_cluster import DaskCluster
from tests.support.processes import alive, command, free_port, until, wait_until
from tests.support.server import ENDLESS, QUICK, Server, StartServer, head_of_upload
from tests.support.soak import repeats

pytestmark = pytest.mark.slow

SOON = 10.0  # seconds; what is asked for, on a machine that does much else


def start_fits(server: Server, data: bytes, number: int) -> list[str]:
    """Begin endless fits that all differ; return their ids when the first one is being computed."""
    sha256 = server.http.post("/v1/measurements", content=data).json()["sha256"]
    asked = [{**ENDLESS, "mask": index / 100} for index in range(number)]
    fits = [server.submit(sha256, prefer="respond-async", **options).json()["id"] for options in asked]
    server.until_running(fits[0])
    return fits


def follow(server: Server, fit: str, following: threading.Barrier) -> list[str]:
    """Read a stream of events to its end; an end that is none raises."""
    with server.http.stream("GET", f"/v1/fits/{fit}/events") as stream:
        events = stream.iter_lines()
        told = [next(events)]
        following.wait()
        return told + list(events)


def test_sigterm_answers_waiting_requests_and_stops(own_server: StartServer, data: bytes) -> None:
    server = own_server(workers="1", shutdown_seconds="40")
    fits = start_fits(server, data, 3)
    sha256 = server.http.get("/v1/measurements").json()["items"][0]["sha256"]
    others = server.helpers() | server.workers()
    following = threading.Barrier(3, timeout=30)
    document = {"measurement": sha256, "options": {**ENDLESS, "mask": 0.99}}
    with ThreadPoolExecutor(8) as threads:
        streams = [threads.submit(follow, server, fit, following) for fit in fits[:2]]
        polls = [threads.submit(server.http.get, f"/v1/fits/{fit}?wait=60") for fit in fits]
        post = threads.submit(server.http.post, "/v1/fits", json=document, headers={"Prefer": "wait=60"})
        following.wait()
        waiting = f"\ndsbrdf_requests_in_progress {len([*streams, *polls, post]) + 1.0}\n"  # and the one that asks
        wait_until(lambda: waiting in server.http.get("/metrics").text)
        server.process.send_signal(signal.SIGTERM)
        code = server.process.wait(timeout=40)  # Open requests are given that long here: none had to be cut off.
        answers = [poll.result() for poll in polls]
        accepted = post.result()
        told = [stream.result() for stream in streams]
    assert code == 0
    assert [answer.status_code for answer in answers] == [200, 200, 200]
    assert {answer.json()["status"] for answer in answers} <= {"running", "accepted"}
    assert accepted.status_code == 202
    assert all(lines[0] in ("event: running", "event: accepted") for lines in told)
    wait_until(lambda: not any(map(alive, others)))
    assert "Traceback" not in server.log.read_text()
    with pytest.raises(httpx.ConnectError):
        server.http.get("/health/live")
    server.start()
    rows = server.http.get("/v1/fits").json()["items"]
    assert {row["id"] for row in rows} == {*fits, accepted.json()["id"]}
    assert {row["status"] for row in rows} <= {"running", "accepted"}


def test_repeated_signals_are_harmless(own_server: StartServer, data: bytes) -> None:
    server = own_server(workers="1")
    (fit,) = start_fits(server, data, 1)
    begin, numbers = time.monotonic(), cycle((signal.SIGHUP, signal.SIGINT))
    while server.process.poll() is None and time.monotonic() < begin + SOON:
        server.process.send_signal(next(numbers))
        time.sleep(0.02)
    assert server.process.wait(timeout=60) == 0
    assert "Traceback" not in server.log.read_text()
    server.start()
    assert server.status(fit) in ("accepted", "running")


def test_sigterm_to_all_processes_fails_no_fit_and_cuts_off_no_answer(own_server: StartServer, data: bytes) -> None:
    """As a service manager does it that signals every process; an upload keeps the service from ending at once."""
    server = own_server(workers="2", fit_attempts="1", shutdown_seconds="3")
    fits = start_fits(server, data, 2)
    wait_until(lambda: len(server.workers()) == 2)
    everyone, stored = [*server.workers(), *server.helpers(), server.process.pid], server.files()
    with server.connection(head_of_upload(len(data)) + data[:1_000_000], 20.0) as connection:  # The rest does not come.
        wait_until(lambda: len(server.files()) > len(stored))
        for pid in everyone:
            os.kill(pid, signal.SIGTERM)
        head_of_answer, _, body = connection.makefile("rb").read().partition(b"\r\n\r\n")
    assert head_of_answer.startswith(b"HTTP/1.1 503 ")
    assert json.loads(body)["type"] == "urn:dsbrdf:problem:shutting-down"
    assert server.process.wait(timeout=20) == 0
    assert server.files() == stored
    assert all(json.loads(line) for line in server.log.read_text().splitlines())
    assert "Finished server process" in server.log.read_text()
    server.start()
    for fit in fits:
        assert server.status(fit) in ("accepted", "running", "succeeded")


def test_sigterm_with_unread_answers_ends_with_zero(own_server: StartServer, data: bytes) -> None:
    server = own_server(shutdown_seconds="1")
    sha256 = server.http.post("/v1/measurements", content=data).json()["sha256"]
    request = f"GET /v1/measurements/{sha256}/content HTTP/1.1\r\nHost: x\r\n\r\n".encode()
    with ExitStack() as stack:
        unread = [stack.enter_context(closing(server.connection(request))) for _ in range(20)]
        assert [connection.recv(12) for connection in unread] == [b"HTTP/1.1 200"] * 20
        assert server.stop() == 0
    assert "Traceback" not in server.log.read_text()


def pipes(pid: int) -> int:
    links = [link for link in Path(f"/proc/{pid}/fd").iterdir() if link.is_symlink()]
    return sum(str(link.readlink()).startswith("pipe:") for link in links)


@pytest.mark.soak
def test_killed_server_leaves_no_fit_on_a_dask_cluster_and_resumes_it(
    own_server: StartServer, cluster: DaskCluster, data: bytes
) -> None:
    server = own_server(engine="dask", scheduler=cluster.address, workers="1")
    sha256 = server.http.post("/v1/measurements", content=data).json()["sha256"]
    # One takes long enough to be interrupted, and one waits for it.
    asked: list[dict[str, Any]] = [{"n_lobes": 4, "em_iterations": 100}, QUICK]
    fits = [server.submit(sha256, prefer="respond-async", **options).json()["id"] for options in asked]
    victims = until(cluster.fitting, bool)
    server.stop(signal.SIGKILL)
    wait_until(lambda: not any(alive(pid) for pid in victims))
    server.start()
    before = server.memory()
    for fit in fits:
        assert server.http.get(f"/v1/fits/{fit}?wait=60").json()["status"] == "succeeded"
    assert server.memory() - before < 24  # neither the file (35 MB) nor what is made of it


def test_hanging_fork_server_does_not_block_shutdown(own_server: StartServer, data: bytes) -> None:
    server = own_server(constants={f"{serve.__name__}._CLEANUP_TIMEOUT_S": 1.0}, workers="1", shutdown_seconds="1")
    sha256 = server.http.post("/v1/measurements", content=data).json()["sha256"]
    (fork_server,) = (pid for pid in server.helpers() if b"forkserver" in command(pid))
    os.kill(fork_server, signal.SIGSTOP)
    before = pipes(server.process.pid)
    try:
        fit = server.submit(sha256, prefer="respond-async", **ENDLESS).json()["id"]
        wait_until(lambda: pipes(server.process.pid) > before)  # it waits for the server, to which it has sent the fit
        server.process.send_signal(signal.SIGTERM)
        assert server.process.wait(timeout=60) == 1
    finally:
        os.kill(fork_server, signal.SIGKILL)
    assert "Timeout (0:00:02)!" in server.log.read_text()
    server.start()
    assert server.status(fit) in ("accepted", "running", "succeeded")


def until_it_takes_ctrl_c(server: Server, begin: int) -> None:
    """Wait until the process is past the start of its interpreter, which the service cannot change.

    Its log has the names of what it imports from `begin` on.
    """

    def begun() -> bool:
        if b" dsbrdf_service\n" not in server.log.read_bytes()[begin:]:  # signals may not even have handlers
            return False
        status = Path(f"/proc/{server.process.pid}/status").read_text()
        masks = re.findall(r"^Sig(?:Ign|Cgt):\s*(\w+)", status, re.MULTILINE)
        return not any(int(mask, 16) >> (signal.SIGINT - 1) & 1 for mask in masks)  # the service's first line

    wait_until(begun, 20.0)


def test_ctrl_c_while_the_service_starts_prints_no_traceback(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPROFILEIMPORTTIME", "1")
    starts, longest = repeats(2, 60), 2.0
    server = Server(tmp_path / "data")
    server.own_interpreter = True
    try:
        for number in range(starts):
            until_it_takes_ctrl_c(server, server.launch())
            time.sleep(longest * number / starts)  # no moment is wrong, however fast the machine
            assert server.stop(signal.SIGINT) in (0, -signal.SIGINT)
            assert "Traceback" not in server.log.read_text()
            wait_until(lambda: not server.processes())
    finally:
        server.close()


def test_service_heeds_what_it_inherits(tmp_path: Path) -> None:
    """A closed output, a log that nobody reads, few open files, and SIGHUP ignored as by nohup."""
    port, (read, write) = free_port(), os.pipe()
    command = [sys.executable, "-m", "dsbrdf_service", "--port", str(port), "--data-dir", str(tmp_path / "data")]
    shell = ["sh", "-c", 'trap "" HUP; ulimit -Sn 256; exec "$@" 1>&-', "sh"]
    environment = {**os.environ, "DSBRDF_LOG_LEVEL": "debug"}
    with (
        subprocess.Popen([*shell, *command], stderr=write, env=environment) as process,
        closing(SimpleNamespace(close=process.kill)),
        httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=20) as client,
    ):
        os.close(write)

        def answers() -> bool:
            with suppress(httpx.ConnectError):
                return client.get("/health/live").status_code == 200
            return False

        wait_until(answers, 60)
        process.send_signal(signal.SIGHUP)
        with ExitStack() as stack:
            for _ in range(400):  # idle connections, which leave descriptors for others
                stack.enter_context(socket.create_connection(("127.0.0.1", port)))
            for _ in range(300):  # a pipe takes 64 kB, some 200 lines
                assert client.get("/health/live", headers={"X-Request-ID": "x" * 64}).status_code == 200
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=30) == 0
    os.close(read)


def test_accepted_fits_finish_after_a_kill(own_server: StartServer, data: bytes) -> None:
    server = own_server(workers="1")
    sha256 = server.http.post("/v1/measurements", content=data).json()["sha256"]
    asked = [server.submit(sha256, prefer="respond-async", **options) for options in (ENDLESS, QUICK)]
    endless, quick = (answer.json()["id"] for answer in asked)
    server.until_running(endless)
    others = server.workers() | server.helpers()
    leftover = server.data_dir / "tmp" / "upload-of-a-client"
    leftover.write_bytes(b"part of a file")
    server.stop(signal.SIGKILL)
    wait_until(lambda: not any(alive(pid) for pid in others))

    server.start()
    assert not leftover.exists()
    server.until_running(endless)
    server.http.delete(f"/v1/fits/{endless}")
    fit = server.http.get(f"/v1/fits/{quick}?wait=60").json()
    assert fit["status"] == "succeeded"
    assert fit["components"] is not None
    assert {fit["id"] for fit in server.http.get("/v1/fits").json()["items"]} == {endless, quick}


def test_temporary_folders_are_empty_after_stops(tmp_path: Path, data: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    deep = tmp_path / ("x" * 100) / ("y" * 100)  # a socket's own path has at most 107 characters
    deep.mkdir(parents=True)
    monkeypatch.setenv("TMPDIR", str(elsewhere))
    with Server.running(deep / "data", workers="1") as server:
        for pid in server.helpers():  # one of them is replaced: the server from which fits are forked
            os.kill(pid, signal.SIGKILL)
        assert server.http.post("/v1/fits", params=QUICK, content=data).json()["status"] == "succeeded"
        assert server.stop(signal.SIGINT) == 0
        for number in (signal.SIGKILL, signal.SIGTERM):
            server.start()
            server.stop(number)
        assert not list(elsewhere.iterdir())
        for folder in ("tmp", "run"):
            assert not list((server.data_dir / folder).iterdir())
        assert "Traceback" not in server.log.read_text()


def test_fit_has_the_memory_limit_of_the_settings(own_server: StartServer, data: bytes) -> None:
    memory_mb = 768
    server = own_server(fit_memory_mb=str(memory_mb))
    sha256 = server.http.post("/v1/measurements", content=data).json()["sha256"]
    assert server.submit(sha256, n_lobes=1).json()["status"] == "succeeded"
    fit = server.submit(sha256, "respond-async", **ENDLESS).json()["id"]

    def limits() -> list[int]:
        return [resource.prlimit(pid, resource.RLIMIT_AS)[0] for pid in server.workers()]

    wait_until(lambda: limits() == [memory_mb << 20])
    assert server.http.delete(f"/v1/fits/{fit}").json()["status"] == "cancelled"


def test_a_fit_has_the_time_limit_of_the_settings(own_server: StartServer, data: bytes) -> None:
    server = own_server(fit_seconds="0.2")
    sha256 = server.http.post("/v1/measurements", content=data).json()["sha256"]
    answer = server.submit(sha256, **ENDLESS)
    assert (answer.status_code, answer.json()["status"]) == (201, "failed")
    assert (answer.json()["error"]["origin"], answer.json()["error"]["type"]) == ("compute", "TimeLimit")
    wait_until(lambda: not server.workers())
    assert server.http.get("/health/ready").status_code == 200


def test_start_that_could_harm_is_refused(server: Server, tmp_path: Path) -> None:
    folder = tmp_path / "data"
    for host in ("0.0.0.0", "::", "example.org", "10.0.0.1"):  # Others can reach these, without keys.
        refused = run_main(serve.main, "--host", host, "--port", "0", "--data-dir", str(folder))
        assert (refused.returncode, "--insecure" in refused.stderr, folder.exists()) == (2, True, False)
    refused = run_main(serve.main, "--port", "0", "--data-dir", str(server.data_dir))
    assert (refused.returncode, "in use" in refused.stderr) == (2, True)
    assert server.http.get("/health/ready").status_code == 200
