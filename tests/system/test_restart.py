"""Ends and beginnings of the server: nothing accepted is lost, nothing stays behind."""

import os
import resource
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from service.__main__ import main
from tests.support.commands import run_main
from tests.support.processes import alive, wait_until
from tests.support.server import ENDLESS, QUICK, Server


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_accepted_fits_finish_after_a_restart(
    own_server: Callable[..., Server], data: bytes, number: signal.Signals
) -> None:
    server = own_server(workers="2")
    sha256 = server.http.post("/v1/measurements", content=data).json()["sha256"]
    wanted = [{**ENDLESS, "mask": 0.1}, {**ENDLESS, "mask": 0.2}, QUICK, {**QUICK, "mask": 0.1}]
    answers = [server.submit(sha256, prefer="respond-async", **options) for options in wanted]
    assert [answer.status_code for answer in answers] == [202] * 4
    endless, in_the_way, *fits = (answer.json()["id"] for answer in answers)
    server.until_running(endless)
    server.until_running(in_the_way)
    others = server.workers() | server.helpers()
    leftover = server.data_dir / "tmp" / "upload-of-a-client"
    leftover.write_bytes(b"part of a file")
    server.stop(number)
    wait_until(lambda: not any(alive(pid) for pid in others))

    server.start()
    assert not leftover.exists()
    server.until_running(endless)
    server.http.delete(f"/v1/fits/{in_the_way}")
    for fit_id in fits:
        fit = server.http.get(f"/v1/fits/{fit_id}?wait=60").json()
        assert fit["status"] == "succeeded"
        assert fit["components"] is not None
    assert {fit["id"] for fit in server.http.get("/v1/fits").json()["items"]} == {endless, in_the_way, *fits}


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_temporary_folders_are_empty_after_each_stop(
    tmp_path: Path, data: bytes, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    deep = tmp_path / ("x" * 100) / ("y" * 100)  # a socket's own path has at most 107 characters
    deep.mkdir(parents=True)
    monkeypatch.setenv("TMPDIR", str(elsewhere))
    with Server.running(deep / "data", workers="1") as server:
        assert server.http.post("/v1/fits", params=QUICK, content=data).json()["status"] == "succeeded"
        code = server.stop(number)
        assert code == (-number if number == signal.SIGKILL else 0)
        server.start()
        server.stop(signal.SIGTERM)
        assert not list(elsewhere.iterdir())
        for folder in ("tmp", "run"):
            assert not list((server.data_dir / folder).iterdir())
        assert "Traceback" not in server.log.read_text()


def test_lost_fork_server_is_replaced(own_server: Callable[..., Server], data: bytes) -> None:
    server = own_server(workers="1")
    sha256 = server.http.post("/v1/measurements", content=data).json()["sha256"]
    for pid in server.helpers():
        os.kill(pid, signal.SIGKILL)
    assert server.submit(sha256, n_lobes=2).json()["status"] == "succeeded"


@pytest.mark.parametrize(
    ("setting", "value", "fault"), [("fit_memory_mb", "200", "MemoryLimit"), ("fit_seconds", "0.2", "TimeLimit")]
)
def test_a_fit_has_the_limits_of_the_settings(
    own_server: Callable[..., Server], data: bytes, setting: str, value: str, fault: str
) -> None:
    server = own_server(**{setting: value})
    sha256 = server.http.post("/v1/measurements", content=data).json()["sha256"]
    answer = server.submit(sha256, **ENDLESS)
    assert (answer.status_code, answer.json()["status"]) == (201, "failed")
    assert (answer.json()["error"]["origin"], answer.json()["error"]["type"]) == ("compute", fault)
    wait_until(lambda: not server.workers())
    assert server.http.get("/health/ready").status_code == 200


def test_start_that_could_harm_is_refused(server: Server, tmp_path: Path) -> None:
    folder = tmp_path / "data"
    for host in ("0.0.0.0", "::", "example.org", "10.0.0.1"):  # that others can reach, without keys
        refused = run_main(main, "--host", host, "--port", "0", "--data-dir", str(folder))
        assert (refused.returncode, "--insecure" in refused.stderr, folder.exists()) == (2, True, False)
    refused = run_main(main, "--port", "0", "--data-dir", str(server.data_dir))
    assert (refused.returncode, "in use" in refused.stderr) == (2, True)
    assert server.http.get("/health/ready").status_code == 200


def test_limit_of_the_whole_service_is_the_limit_of_each_fit(own_server: Callable[..., Server], data: bytes) -> None:
    server = own_server()
    server.http.post("/v1/fits", params=QUICK, content=data)  # the helpers have imported all that they will
    for limit_mb, fault in ((1024, None), (200, ("compute", "MemoryLimit"))):  # both less than the service allows
        for pid in server.helpers():  # from which the processes of fits have it, as if the service were started with it
            resource.prlimit(pid, resource.RLIMIT_AS, (limit_mb << 20, limit_mb << 20))
        fit = server.http.post("/v1/fits", params={**QUICK, "em_iterations": limit_mb // 10}, content=data).json()
        assert (fit["error"] and (fit["error"]["origin"], fit["error"]["type"])) == fault
    assert "Traceback" not in server.log.read_text()
