"""Readiness: what is missing is named, and asking costs next to nothing."""

import asyncio
import shutil
import sqlite3
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from pathlib import Path
from typing import cast

import pytest

import dsbrdf
from dsbrdf.engines import Engine
from dsbrdf_service.http import monitoring
from dsbrdf_service.http.monitoring import Readiness
from dsbrdf_service.settings import Settings
from dsbrdf_service.storage import database
from dsbrdf_service.storage.database import FILE_NAME
from dsbrdf_service.storage.store import Store
from tests.support.application import application
from tests.support.processes import wait_until
from tests.support.server import QUICK, StartServer, assert_problem

pytestmark = [pytest.mark.slow, pytest.mark.anyio]


def test_locked_database_is_not_ready_but_known_fits_are_answered(own_server: StartServer, data: bytes) -> None:
    limit = 0.5  # [s] The service's own limits are several seconds.
    constants = f"{database.__name__}._BUSY_TIMEOUT_S", f"{monitoring.__name__}.READY_TIMEOUT_S"
    server = own_server(constants=dict.fromkeys(constants, limit))
    first = server.http.post("/v1/fits", params=QUICK, content=data).json()
    with closing(sqlite3.connect(server.data_dir / FILE_NAME, isolation_level=None)) as db:
        db.execute("BEGIN IMMEDIATE")
        with ThreadPoolExecutor(2) as pool:  # an upload is written, a known fit read
            uploads = [pool.submit(server.http.post, f"/v1/{noun}", content=data) for noun in ("fits", "measurements")]
            assert server.submit(first["measurement"], **QUICK).json()["id"] == first["id"]
        assert [upload.result().status_code for upload in uploads] == [503, 503]
        wait_until(lambda: server.http.get("/health/ready").status_code == 503)
        # It has not answered, or has given up.
        assert "The database " in assert_problem(server.http.get("/health/ready"), 503, "not-ready")
        live = [server.http.get("/health/live").raise_for_status() for _ in range(3)]
        assert min(answer.elapsed.total_seconds() for answer in live) < monitoring.READY_TIMEOUT_S
        db.execute("ROLLBACK")
    wait_until(lambda: server.http.get("/health/ready").status_code == 200)
    assert not list((server.data_dir / "tmp").iterdir())


def test_missing_data_folder_is_not_ready_until_it_is_back(own_server: StartServer, data: bytes) -> None:
    server = own_server()
    sha256 = server.http.post("/v1/measurements", content=data).json()["sha256"]
    elsewhere = server.data_dir.with_name("elsewhere")
    server.data_dir.rename(elsewhere)
    wait_until(lambda: server.http.get("/health/ready").status_code == 503)
    for part in ("blobs", "tmp"):  # an empty folder in its place, as when a disk is not mounted
        (server.data_dir / part).mkdir(parents=True)
    detail = assert_problem(server.http.get("/health/ready"), 503, "not-ready")
    assert detail.startswith(f"The database is not ready: {FILE_NAME} has been removed or replaced")
    assert str(server.data_dir) not in detail
    assert_problem(server.submit(sha256, **QUICK), 503, "not-ready")
    assert_problem(server.http.post("/v1/measurements", content=data), 503, "not-ready")
    assert server.http.get("/metrics").status_code == 200
    assert not server.files()
    shutil.rmtree(server.data_dir)
    elsewhere.rename(server.data_dir)
    wait_until(lambda: server.http.get("/health/ready").json()["status"] == "ready")
    assert server.submit(sha256, **QUICK).json()["status"] == "succeeded"


def test_removed_socket_of_fork_server_is_not_ready_until_next_start(own_server: StartServer, data: bytes) -> None:
    server = own_server()
    sha256 = server.http.post("/v1/measurements", content=data).json()["sha256"]
    shutil.rmtree(server.data_dir / "run")
    wait_until(lambda: server.http.get("/health/ready").status_code == 503)
    detail = assert_problem(server.http.get("/health/ready"), 503, "not-ready")
    assert "socket has been removed; start this program again" in detail
    assert server.http.get("/health/live").json() == {"status": "live", "version": dsbrdf.__version__}
    fit = server.submit(sha256, prefer="respond-async", **QUICK).json()["id"]
    server.stop()
    server.start()
    assert server.http.get(f"/v1/fits/{fit}?wait=60").json()["status"] == "succeeded"


async def test_full_disk_and_damaged_database_are_not_ready(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise sqlite3.DatabaseError("database disk image is malformed")

    async with application(tmp_path, monkeypatch, min_free_mb=10**9) as running:
        key = running.new_key()
        monkeypatch.setattr(running.store.database, "rows", fail)
        for path in ("/health/ready", "/v1/fits"):
            answer = await running.ask(path, key).end()
            assert (answer.status, "retry-after" in answer.headers) == (503, True)
            for fault in (b"the service needs 1000000000 MB", b"disk image is malformed"):
                assert (fault in answer.body) is (path == "/health/ready")


class Asked:
    """An engine that counts how often it is asked whether it is ready."""

    def __init__(self) -> None:
        self.times = 0
        self.fault: str | None = None
        self.hangs = threading.Event()
        self.hangs.set()

    def check(self) -> None:
        self.times += 1
        self.hangs.wait()
        if self.fault is not None:
            raise RuntimeError(self.fault)


@contextmanager
def with_engine(folder: Path, engine: Asked) -> Iterator[Readiness]:
    with closing(Store(folder)) as store:
        yield Readiness(store, cast("Engine", engine), Settings(data_dir=folder))


async def test_checks_run_once_for_all_who_ask_together(tmp_path: Path) -> None:
    engine = Asked()
    with with_engine(tmp_path, engine) as ready:
        assert set(await asyncio.gather(*(ready.fault() for _ in range(50)))) == {None}
        assert engine.times == 1
        engine.fault = "No worker is there"
        assert await ready.fault() == "The engine is not ready: No worker is there."
        assert engine.times == 2
        ready.stop()
        assert await ready.fault() == "The service is shutting down."


async def test_hanging_check_is_not_started_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(monitoring, "READY_TIMEOUT_S", 0.2)
    engine = Asked()
    with with_engine(tmp_path, engine) as ready:
        engine.hangs.clear()
        for _ in range(4):
            assert "The engine has not answered" in str(await ready.fault())
        assert engine.times == 1
        engine.hangs.set()
        while await ready.fault() is not None:
            await asyncio.sleep(0.01)
