"""What requests compute: nothing for clients that have left, nothing twice, and the keys take turns."""

import asyncio
import errno
import json
import os
import signal
import sqlite3
import tempfile
from collections.abc import AsyncIterator, Callable
from concurrent.futures import Future
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from dsbrdf.engines import Fault, Processes
from dsbrdf.engines.engine import MEMORY_LIMIT
from dsbrdf_service.api import measurements, pictures, results, values
from dsbrdf_service.compute import steps
from dsbrdf_service.http.messages import PIECE_BYTES
from dsbrdf_service.storage.health import measurement_bytes
from dsbrdf_service.storage.schema import Caller
from tests.support.application import FIT, Application, Blocked, application, until
from tests.support.processes import wait_until
from tests.support.server import QUICK, StartServer, add

pytestmark = pytest.mark.anyio
Block = Callable[[object, str], Blocked]
FIT_PATH = f"/v1/fits/{FIT}"
EXPORT = f"{FIT_PATH}/export?format=bsdf"
SPHERE = f"{FIT_PATH}/figures/sphere.png?size=16"
COMPONENTS = ("specular_spike", "specular_lobe", "diffuse")
LONG_BATCH = json.dumps({"theta_half_deg": [1.25] * 10_000, "theta_diff_deg": [2.25] * 10_000}).encode()


@pytest.fixture
async def running(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Application]:
    async with application(tmp_path, monkeypatch) as started:
        yield started


@pytest.fixture
def key(running: Application) -> str:
    return running.new_key()


@pytest.fixture
def block(monkeypatch: pytest.MonkeyPatch) -> Block:
    """Replace a function of a module by one that returns when it may."""

    def replace(place: object, name: str) -> Blocked:
        blocked = Blocked(getattr(place, name))
        monkeypatch.setattr(place, name, lambda *arguments, **named: blocked(*arguments, **named))
        return blocked

    return replace


@pytest.mark.parametrize(
    ("place", "name", "targets"),
    [
        (results, "export_step", [EXPORT, *(f"{EXPORT}&component={label}" for label in COMPONENTS)]),
        (pictures, "sphere_step", [SPHERE, *(f"{SPHERE}&component={label}" for label in COMPONENTS)]),
    ],
)
async def test_what_nobody_waits_for_is_not_computed(
    running: Application, key: str, block: Block, place: object, name: str, targets: list[str]
) -> None:
    blocked = block(place, name)
    asked = [running.ask(target, key) for target in targets]
    await blocked.until_called()
    await asyncio.gather(*(one.leave() for one in asked))  # at once, though the first is being computed
    blocked.may_return.set()
    again = await running.ask(targets[-1], key).end()
    assert again.status == 200
    assert len(blocked.calls) <= 2


async def test_a_long_computation_holds_up_no_other(running: Application, key: str, block: Block) -> None:
    blocked = block(measurements, "conversion_step")
    upload = running.ask("/v1/measurements", key, "POST", b"a table".ljust(1 << 17), "text/csv")
    await blocked.until_called()
    others = [running.ask(target, key) for target in (EXPORT, SPHERE)]
    others.append(running.ask(f"{FIT_PATH}/brdf", key, "POST", LONG_BATCH))
    short = "theta_in,theta_out,value\n" + "".join(f"{at % 60},{at},0.1\n" for at in range(80))
    others.append(running.ask("/v1/tables", key, "POST", short.encode(), "text/csv"))
    assert [(await one.end()).status for one in others] == [200] * 4
    blocked.may_return.set()
    assert (await upload.end()).status == 422


async def test_unread_answers_wait_in_files_and_hold_up_no_other(running: Application, key: str) -> None:
    unread = [running.ask(f"{FIT_PATH}/brdf", key, "POST", LONG_BATCH, unread=True) for _ in range(20)]
    await until(lambda: all(len(one.messages) >= 2 for one in unread))
    assert {len(one.messages[1]["body"]) for one in unread} == {PIECE_BYTES}
    assert int(unread[0].headers["content-length"]) > 4 * PIECE_BYTES
    assert (await running.ask(FIT_PATH, key).end()).status == 200
    for one in unread:
        await one.leave()


async def test_what_is_asked_for_together_is_not_mixed_up(running: Application, key: str) -> None:
    spheres = [SPHERE, SPHERE.replace("16", "17"), f"{SPHERE}&component=diffuse", f"{SPHERE}&lighting=environment"]
    shader = f"{FIT_PATH}/export?format=glsl"
    shaders = [shader, *(f"{shader}&{query}" for query in ("component=diffuse", "name=paint", "name=cloth"))]
    asked = [running.ask(target, key) for target in (*spheres, *shaders)]
    answers = [await one.end() for one in asked]
    assert [one.status for one in answers] == [200] * len(answers)
    assert len({one.body for one in answers}) == len(answers)


async def test_measurement_that_is_deleted_before_it_is_drawn_is_not_found(
    running: Application, key: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    caller = Caller(key.split("_")[1])
    sha256 = add(running.store, b"a measurement", caller)

    def delete_and_draw(*arguments: Any) -> bytes:
        assert running.store.remove_measurement(caller.owner, sha256)
        return steps.sphere_step(*arguments)

    monkeypatch.setattr(pictures, "sphere_step", delete_and_draw)
    answer = await running.ask(f"/v1/measurements/{sha256}/figures/sphere.png", key).end()
    assert answer.status == 404
    assert "There is no measurement" in json.loads(answer.body)["detail"]


async def test_keys_take_turns_with_long_batches(running: Application, key: str, block: Block) -> None:
    blocked, alice, bob = block(values, "from_json"), key, running.new_key()
    of_alice = [running.ask(f"{FIT_PATH}/brdf", alice, "POST", LONG_BATCH) for _ in range(6)]
    await blocked.until_called()
    of_bob = running.ask(f"{FIT_PATH}/brdf", bob, "POST", LONG_BATCH[:-2] + b",1]}")
    await until(lambda: len(running.app.state.context.computations._unfinished) >= 7)
    blocked.may_return.set()
    await asyncio.gather(*(one.end() for one in (*of_alice, of_bob)))
    assert [one.status for one in of_alice] == [200] * 6
    bodies = [arguments[0] for arguments in blocked.calls]
    assert bodies.index(LONG_BATCH[:-2] + b",1]}") <= 2


async def test_a_stop_cancels_what_is_being_computed(
    running: Application, key: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    endless: Future[Any] = Future()
    monkeypatch.setattr(Processes, "call", lambda *_: endless)
    running.ask(EXPORT, key)
    computations = running.app.state.context.computations
    await until(lambda: bool(computations._unfinished))
    await asyncio.wait_for(computations.close(), 5.0)
    assert endless.cancelled()


async def test_full_disk_is_507(running: Application, key: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        with closing(sqlite3.connect(":memory:")) as database:
            database.executescript("PRAGMA max_page_count = 1; CREATE TABLE more (a)")

    monkeypatch.setattr(results, "export_step", lambda *_: Path("/dev/full").write_bytes(b"a table"))
    monkeypatch.setattr(running.store, "rename_fit", full)
    renaming = running.ask(FIT_PATH, key, "PATCH", b'{"name": "a"}')
    for request in (running.ask(f"{FIT_PATH}/export?format=merl", key), renaming):
        answer = await request.end()
        assert (answer.status, json.loads(answer.body)["type"]) == (507, "urn:dsbrdf:problem:disk-full")
        assert "retry-after" in answer.headers


async def test_export_without_a_folder_for_its_file_is_a_problem(running: Application, key: str) -> None:
    async def status(file_format: str) -> int:
        return (await running.ask(f"{FIT_PATH}/export?format={file_format}", key).end()).status

    folder = running.store.folder / "tmp"
    folder.rmdir()
    assert (await status("merl"), await status("json")) == (503, 200)
    folder.mkdir()
    assert await status("merl") == 200
    assert not list(folder.iterdir())


async def test_head_of_a_stream_ends_once(running: Application, key: str) -> None:
    exchange = await running.ask(f"{FIT_PATH}/events", key, "HEAD").end()
    assert [message["type"] for message in exchange.messages] == ["http.response.start", "http.response.body"]


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT])
async def test_without_inodes_what_writes_is_507_and_what_reads_works(
    running: Application, key: str, data: bytes, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(code, os.strerror(code))

    async def status(target: str, method: str = "GET", body: bytes = b"") -> int:
        return (await running.ask(target, key, method, body, "application/octet-stream").end()).status

    for place, name in ((Path, "mkdir"), (tempfile, "TemporaryFile"), (tempfile, "mkstemp")):
        monkeypatch.setattr(place, name, full)
        assert await status("/v1/measurements", "POST", data) == 507
        assert measurement_bytes(running.store.database) == 0
        paths = running.store.folder.rglob("*")
        assert not [path for path in paths if path.suffix == ".binary" or "upload" in path.name]
    assert await status("/v1/fits", "POST", data) == 507
    assert await status(f"{FIT_PATH}/export?format=merl") == 507
    assert await status("/health/ready") == 503
    assert await status(f"{FIT_PATH}/export?format=json") == 200
    assert await status("/v1/fits") == 200


@pytest.mark.parametrize(
    ("fault", "status", "asks_again"),
    [
        (Fault("compute", "ProcessorLimit", "."), 422, False),
        (MEMORY_LIMIT, 422, False),
        (Fault("compute", "InternalError", "."), 500, False),
        (Fault("compute", "TimeLimit", "."), 503, True),
        (Fault("system", "ProcessLost", "."), 503, True),
    ],
)
async def test_only_what_may_succeed_is_to_be_asked_for_again(
    running: Application, key: str, monkeypatch: pytest.MonkeyPatch, fault: Fault, status: int, *, asks_again: bool
) -> None:
    def fail(*_: object) -> Future[Fault]:
        future: Future[Fault] = Future()
        future.set_result(fault)
        return future

    monkeypatch.setattr(Processes, "call", fail)
    for address in (EXPORT, SPHERE):
        answer = await running.ask(address, key).end()
        assert answer.status == status
        assert ("retry-after" in answer.headers) == (b"try again" in answer.body) == asks_again


def test_process_of_an_export_ends_when_its_client_leaves(own_server: StartServer, data: bytes) -> None:
    server = own_server()
    fit = server.http.post("/v1/fits", params=QUICK, content=data).json()["id"]
    request = f"GET /v1/fits/{fit}/export?format=materialx HTTP/1.1\r\nHost: localhost\r\n\r\n".encode()
    with closing(server.connection(request)):
        wait_until(lambda: bool(server.workers()))
        (worker,) = server.workers()
        os.kill(worker, signal.SIGSTOP)  # It does not end by itself any more.
    wait_until(lambda: worker not in server.workers(), 20.0)  # before its time is up
