"""What a key may store, with uploads in progress among it."""

import asyncio
import socket
import threading
from collections.abc import Callable
from contextlib import AsyncExitStack
from pathlib import Path

import httpx
import pytest

from dsbrdf.data.merl_validation import FILE_SIZE
from service.errors import ProblemError
from service.storage.schema import ROW_SIZE, Caller, FitKey
from service.storage.store import Store
from service.storage.uploads import in_thread
from tests.support.guarded import new_key
from tests.support.processes import wait_until
from tests.support.server import Server, assert_problem
from tests.support.stores import add


def begin_upload(server: Server, header: dict[str, str], data: bytes) -> socket.socket:
    """Send a part of an upload and leave it in progress."""
    lines = ["POST /v1/measurements HTTP/1.1", "Host: x", f"Content-Length: {len(data)}"]
    lines += [f"{name}: {value}" for name, value in header.items()]
    return server.connection("\r\n".join([*lines, "", ""]).encode() + data[:200_000])


def test_uploads_in_progress_count_towards_the_quota(own_server: Callable[..., Server], data: bytes) -> None:
    server = own_server(fits=False, require_keys="true")
    (_, header), (_, other) = new_key(server, "two files", stored_mb=74), new_key(server, "another")

    def upload(who: dict[str, str]) -> httpx.Response:
        return server.http.post("/v1/measurements", content=data, headers=who)

    first, second = (begin_upload(server, header, data) for _ in range(2))
    with first, second:
        wait_until(lambda: len(server.files()) == 2)
        detail = assert_problem(upload(header), 403, "storage-quota")
        assert "2 uploads in progress" in detail
        assert len(server.files()) == 2  # nothing of what is refused is written
        assert upload(other).status_code == 201
    wait_until(lambda: upload(header).status_code == 201)  # as soon as those two are known to have ended
    assert upload(header).status_code == 200


def test_one_upload_at_a_time_may_exceed_a_full_quota(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def most_at_once(caller: Caller, most: int) -> None:
        async with AsyncExitStack() as stack:
            with monkeypatch.context() as broken:
                broken.setattr(store.blobs, "incoming", lambda: 1 / 0)
                with pytest.raises(ZeroDivisionError):  # which reserves nothing
                    await stack.enter_async_context(store.uploads.incoming(caller))
            for _ in range(most):
                await stack.enter_async_context(store.uploads.incoming(caller))
            for _ in range(2):
                with pytest.raises(ProblemError, match="in progress"):
                    await stack.enter_async_context(store.uploads.incoming(caller))

    for stored_bytes, most in ((0, 1), (FILE_SIZE - 1, 1), (2 * FILE_SIZE, 2), (3 * FILE_SIZE - 1, 2)):
        for _ in range(2):
            asyncio.run(most_at_once(Caller(str(stored_bytes), stored_bytes=stored_bytes), most))
    with pytest.raises(pytest.fail.Exception):
        asyncio.run(most_at_once(Caller(), 100))
    assert list((tmp_path / "tmp").iterdir()) == []


def test_uploads_share_few_threads() -> None:
    async def meet(number: int) -> None:
        together = threading.Barrier(number, timeout=0.3)
        await asyncio.gather(*(in_thread(together.wait) for _ in range(number)))

    asyncio.run(meet(4))
    with pytest.raises(threading.BrokenBarrierError):
        asyncio.run(meet(5))


def test_cancelled_fits_and_results_count_as_stored_bytes(store: Store) -> None:
    sha256 = add(store, b"12345", Caller("a"))

    def submit(mask: int, most: int) -> FitKey:
        return store.add_fit(Caller("a", stored_bytes=most), sha256, {"mask": mask}, 10)[0].key

    first, stored = submit(0, 6), 5 + ROW_SIZE + 2
    store.start_fit(first)
    store.complete_fit(first, "é", {})
    with pytest.raises(ProblemError, match=r"has stored 0\.0 of 0\.0 MB"):
        submit(1, stored)
    store.cancel_fit(submit(1, stored + 1))
    with pytest.raises(ProblemError):
        submit(2, stored + ROW_SIZE)
    assert store.remove_fit(first)
    submit(2, stored + ROW_SIZE)  # there is room again
