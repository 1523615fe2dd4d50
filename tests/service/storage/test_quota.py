"""What a key may store, with uploads in progress among it."""

import asyncio
import threading
from contextlib import AsyncExitStack
from pathlib import Path

import pytest

from dsbrdf.data.merl_validation import FILE_SIZE
from service.errors import ProblemError
from service.storage.schema import ROW_SIZE, Caller, FitKey
from service.storage.store import Store
from service.storage.uploads import in_thread
from tests.support.stores import add


def test_uploads_in_progress_count_towards_the_quota_but_one_may_exceed_it(
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
                with pytest.raises(ProblemError, match=f"and {most} uploads? in progress, which take the rest"):
                    await stack.enter_async_context(store.uploads.incoming(caller))
            assert len(list((tmp_path / "tmp").iterdir())) == most  # nothing of what is refused is written
            await stack.enter_async_context(store.uploads.incoming(Caller("another", stored_bytes=0)))

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
