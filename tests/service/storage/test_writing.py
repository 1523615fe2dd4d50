"""Quotas: what is being written counts, and a key says who is let in, how often, and with how much."""

import asyncio
import resource
import sqlite3
import threading
from contextlib import AsyncExitStack, closing
from pathlib import Path

import pytest

import dsbrdf
from dsbrdf.data import FILE_SIZE
from dsbrdf_service import access as keys_module
from dsbrdf_service.access import Keys
from dsbrdf_service.errors import InvalidKeyError, ProblemError
from dsbrdf_service.settings import Settings
from dsbrdf_service.storage import files
from dsbrdf_service.storage.database import RESERVE, Database
from dsbrdf_service.storage.files import Incoming
from dsbrdf_service.storage.health import check_rows
from dsbrdf_service.storage.keys import add_key, revoke_key
from dsbrdf_service.storage.maintenance import purge_folder
from dsbrdf_service.storage.schema import Caller
from dsbrdf_service.storage.store import Store
from tests.support.server import LOCAL, Guarded, add, assert_problem, keys_command, receive


def test_uploads_in_progress_count_towards_the_quota_but_one_may_exceed_it(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def most_at_once(caller: Caller, most: int) -> None:
        async with AsyncExitStack() as stack:
            with monkeypatch.context() as broken:
                broken.setattr(files, "Incoming", lambda _: 1 / 0)
                with pytest.raises(ZeroDivisionError):  # Nothing is reserved.
                    await stack.enter_async_context(store.writing.incoming(caller))
            for _ in range(most):
                await stack.enter_async_context(store.writing.incoming(caller))
            for _ in range(2):
                with pytest.raises(ProblemError, match=f"and {most} uploads and answers in progress take"):
                    await stack.enter_async_context(store.writing.incoming(caller))
            assert len(list((tmp_path / "tmp").iterdir())) == most  # nothing of what is refused is written
            await stack.enter_async_context(store.writing.incoming(Caller("another", stored_bytes=0)))

    for stored_bytes, most in ((0, 1), (FILE_SIZE - 1, 1), (2 * FILE_SIZE, 2), (3 * FILE_SIZE - 1, 2)):
        for _ in range(2):
            asyncio.run(most_at_once(Caller(str(stored_bytes), stored_bytes=stored_bytes), most))
    with pytest.raises(pytest.fail.Exception):
        asyncio.run(most_at_once(Caller(), 100))
    assert list((tmp_path / "tmp").iterdir()) == []


def test_answers_that_nobody_reads_count_as_uploads_do(store: Store, tmp_path: Path) -> None:
    async def answers() -> None:
        caller = Caller("a", stored_bytes=1500)
        first = await store.writing.answer_with(caller, b"1" * 1000)
        with pytest.raises(ProblemError, match="read or close those answers") as caught:
            await store.writing.answer_with(caller, b"2" * 1000)
        assert caught.value.kind == "too-many-at-once"
        second = await store.writing.answer_with(caller, b"2" * 500)
        assert (first.read(9, 995), second.size) == (b"11111", 500)
        del first
        assert ["upload-" in str(path.resolve()) for path in Path("/proc/self/fd").iterdir()].count(True) == 1
        await store.writing.answer_with(caller, b"3" * 1000)
        with pytest.raises(ZeroDivisionError):
            async with store.writing.answer(caller, 1000) as (_, path):
                path.write_bytes(bytes(1 // 0))
        await store.writing.answer_with(caller, b"4" * 1000)
        async with store.writing.answer(caller, 1000) as (short, path):
            path.write_bytes(b"5" * 500)
        await store.writing.answer_with(caller, b"6" * 500)  # An answer counts with the bytes that it has.
        assert short.size == 500

    asyncio.run(answers())
    assert not list((tmp_path / "tmp").iterdir())


def test_file_of_which_only_a_part_can_be_written_is_an_error(store: Store) -> None:
    incoming, usual = Incoming(store.blobs.temporary), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, usual[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            incoming.write(bytes(1500))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)
        incoming.discard()


def test_unfinished_fit_of_another_algorithm_fails_and_says_so(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    sha256 = add(store, b"content")
    with monkeypatch.context() as older:
        older.setattr(dsbrdf, "ALGORITHM_VERSION", "older")
        old, _ = store.add_fit(LOCAL, sha256, {}, 9)
        store.start_fit(old.key)
    other = Caller("other")
    add(store, b"content", other)
    oldest_first = [store.add_fit(caller, sha256, {}, 9)[0].key for caller in (other, LOCAL)]
    assert store.resume() == oldest_first
    error = store.fit(old.key).error
    assert error is not None
    assert (error["type"], error["origin"]) == ("OtherRelease", "system")
    assert dsbrdf.ALGORITHM_VERSION in error["message"]


def test_check_of_the_database_waits_for_nobody_who_writes(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    add(store, b"content")
    with store.database.transaction():
        checked = threading.Thread(target=check_rows, args=(store.database,))
        checked.start()
        checked.join(2.0)
        assert not checked.is_alive()
        monkeypatch.setattr("dsbrdf_service.storage.database.monotonic", lambda: 1e12)
        with pytest.raises(sqlite3.OperationalError, match="a transaction takes too long"):
            check_rows(store.database)


def test_reserve_gives_its_room_on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Store(tmp_path).close()
    assert (tmp_path / RESERVE).stat().st_size == 1 << 22
    monkeypatch.setattr("dsbrdf_service.storage.maintenance.is_full", lambda _: True)
    purge_folder(tmp_path, None)
    assert not (tmp_path / RESERVE).exists()
    Store(tmp_path).close()
    monkeypatch.setattr("dsbrdf_service.storage.database.is_full", lambda _: True)
    there = []
    monkeypatch.setattr(
        "dsbrdf_service.storage.database.check_integrity", lambda folder: there.append((folder / RESERVE).exists())
    )
    Store(tmp_path).close()
    assert there == [False]


def test_secrets_are_neither_stored_nor_printed(guarded: Guarded, data: bytes) -> None:
    server = guarded.server
    header = guarded.new_key("for a search")
    key = header["Authorization"].removeprefix("Bearer ")
    secret = key.split("_", 2)[2]
    assert server.http.post("/v1/measurements", content=data, headers=header).status_code == 201
    assert server.http.get("/v1/fits?cursor=x", headers=header).status_code == 422
    assert server.http.get("/v1/fits", headers=header | {"Authorization": f"Bearer {key}x"}).status_code == 401
    assert server.http.get(f"/v1/fits/{'0' * 32}", headers=header).status_code == 404
    texts = {path.name: path.read_bytes() for path in server.data_dir.glob("dsbrdf.sqlite*")}
    assert "dsbrdf.sqlite-wal" in texts
    texts["log"] = server.log.read_bytes()
    for kind in ([], ["--json"]):
        texts[str(kind)] = keys_command("list", *kind, "--data-dir", str(server.data_dir)).stdout.encode()
        assert b"for a search" in texts[str(kind)]
    assert b"for a search" in b"".join(text for name, text in texts.items() if name.startswith("dsbrdf"))
    for name, text in texts.items():
        assert secret.encode() not in text, name


def test_locked_database_is_reported_in_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dsbrdf_service.storage.database._BUSY_TIMEOUT_S", 0.1)
    with closing(Database(tmp_path)) as database, database.transaction():
        busy = keys_command("add", "x", "--data-dir", str(tmp_path))
    assert busy.returncode in (1, 2)
    assert (busy.stderr.count("\n"), busy.stdout) == (1, "")
    assert "locked" in busy.stderr


def test_keys_without_limits_of_their_own_have_those_of_the_settings(tmp_path: Path) -> None:
    settings = Settings(key_requests_per_second=3.0, key_stored_mb=40, key_queued_fits=5)
    with closing(Database(tmp_path)) as database:
        (usual, usual_key), (own, own_key) = add_key(database, "a"), add_key(database, "b", stored_mb=6, queued_fits=7)
        keys = Keys(settings)
        keys.open(database)
        found = [keys.find(key.encode()) for key in (usual_key, own_key)]
    assert found == [
        Caller(usual, stored_bytes=40_000_000, queued_fits=5, metrics=False, requests_per_second=3.0),
        Caller(own, stored_bytes=6_000_000, queued_fits=7, metrics=False, requests_per_second=3.0),
    ]


def test_revoked_key_stores_nothing_and_its_waiting_fits_are_cancelled(tmp_path: Path) -> None:
    with closing(Store(tmp_path)) as store:
        key, other = (add_key(store.database, name)[0] for name in ("revoked", "other"))
        fits = {}
        for owner in (key, other):
            sha256 = add(store, b"content", Caller(owner))
            fits[owner] = [store.add_fit(Caller(owner), sha256, {"n_lobes": n}, 10)[0].key for n in range(3)]
            store.start_fit(fits[owner][0])
        incoming = receive(store, b"sent meanwhile")
        revoke_key(store.database, key)
        keys = Keys(Settings())
        keys.open(store.database)
        assert [keys.allows(Caller(owner)) for owner in (key, other, "0" * 12, "")] == [False, True, False, True]
        assert [store.fit(fit).status for fit in fits[key]] == ["running", "cancelled", "cancelled"]
        assert [store.fit(fit).status for fit in fits[other]] == ["running", "accepted", "accepted"]
        with pytest.raises(InvalidKeyError):
            store.add_measurement(Caller(key), incoming)
        assert not store.blobs.path(incoming.sha256).exists()
        with pytest.raises(InvalidKeyError):
            store.add_fit(Caller(key), sha256, {"n_lobes": 4}, 10)
        assert store.add_measurement(Caller(other), incoming)[1]


def test_requests_of_five_seconds_may_come_at_once_and_more_at_their_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 1000.0
    monkeypatch.setattr(keys_module, "monotonic", lambda: now)
    keys, key, slow = Keys(Settings()), Caller("a", requests_per_second=4.0), Caller("b", requests_per_second=0.01)
    assert [keys.wait(key) for _ in range(20)] == [0.0] * 20
    assert keys.wait(key) == pytest.approx(0.25)
    now += 0.2
    assert keys.wait(key) == pytest.approx(0.05)
    now += 0.05 + 1e-9
    assert keys.wait(key) == 0.0
    assert keys.wait(key) > 0.0
    now += 1e6
    assert [keys.wait(key) for _ in range(20)] == [0.0] * 20
    assert keys.wait(key) > 0.0
    assert keys.wait(slow) == 0.0
    assert keys.wait(slow) == pytest.approx(100.0)


def test_rate_limit_counts_each_key_alone(guarded: Guarded) -> None:
    header = guarded.new_key("slow", requests_per_second=0.02)  # and its one request is made
    answer = guarded.server.http.get("/v1/fits", headers=header)
    assert "0.02 requests per second" in assert_problem(answer, 429, "rate-limited")
    assert 1 <= int(answer.headers["retry-after"]) <= 50
    assert [guarded.server.http.get("/v1/fits", headers=guarded.bob).status_code for _ in range(20)] == [200] * 20
    assert guarded.server.http.get("/v1/fits", headers=header).status_code == 429
