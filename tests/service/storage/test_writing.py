"""What is being written counts in the quota of its key, and a digest is computed once for each file."""

import asyncio
import hashlib
import sqlite3
import threading
from contextlib import AsyncExitStack
from pathlib import Path

import pytest

import dsbrdf
from dsbrdf.data import FILE_SIZE
from dsbrdf_service.errors import MeasurementDamagedError, ProblemError
from dsbrdf_service.storage import files
from dsbrdf_service.storage.database import RESERVE
from dsbrdf_service.storage.schema import Caller
from dsbrdf_service.storage.store import Store
from tests.support.stores import add

LOCAL = Caller()


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
        await store.writing.answer_with(caller, b"3" * 1000)
        with pytest.raises(ZeroDivisionError):
            async with store.writing.answer(caller, 1000) as (_, path):
                path.write_bytes(bytes(1 // 0))
        await store.writing.answer_with(caller, b"4" * 1000)

    asyncio.run(answers())
    assert not list((tmp_path / "tmp").iterdir())


def test_digest_of_a_file_is_computed_once_until_the_file_changes(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    computed, file_digest = [], hashlib.file_digest

    def counted(*arguments: object) -> object:
        computed.append(arguments)
        return file_digest(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(hashlib, "file_digest", counted)
    sha256 = add(store, b"content")
    path = store.measurement_file("", sha256)[1]
    assert not computed  # The upload was hashed while it was written.
    path.write_bytes(b"contenX")
    for _ in range(2):
        with pytest.raises(MeasurementDamagedError, match="its sha256 is another one"):
            store.measurement_file("", sha256)
    path.write_bytes(b"content")
    for _ in range(9):
        assert store.measurement_file("", sha256)[1] == path
    assert len(computed) == 3


def test_unfinished_fit_of_another_algorithm_fails_and_says_so(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    sha256 = add(store, b"content")
    with monkeypatch.context() as older:
        older.setattr(dsbrdf, "ALGORITHM_VERSION", "older")
        old, _ = store.add_fit(LOCAL, sha256, {}, 9)
        store.start_fit(old.key)
    new, _ = store.add_fit(LOCAL, sha256, {}, 9)
    assert store.resume() == [new.key]
    error = store.fit(old.key).error
    assert error is not None
    assert (error["type"], error["origin"]) == ("OtherRelease", "system")
    assert dsbrdf.ALGORITHM_VERSION in error["message"]


def test_check_of_the_database_waits_for_nobody_who_writes(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    add(store, b"content")
    with store.database.transaction():
        checked = threading.Thread(target=store.check)
        checked.start()
        checked.join(2.0)
        assert not checked.is_alive()
        monkeypatch.setattr("dsbrdf_service.storage.database.monotonic", lambda: 1e12)
        with pytest.raises(sqlite3.OperationalError, match="a transaction takes too long"):
            store.check()


def test_reserve_gives_its_room_on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Store(tmp_path).close()
    assert (tmp_path / RESERVE).stat().st_size == 1 << 22
    monkeypatch.setattr("dsbrdf_service.storage.database._is_full", lambda _: True)
    there = []
    monkeypatch.setattr(
        "dsbrdf_service.storage.database.check_integrity", lambda folder: there.append((folder / RESERVE).exists())
    )
    Store(tmp_path).close()
    assert there == [False]
