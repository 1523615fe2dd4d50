"""Models that are kept in memory, and the ones that are not."""

import asyncio
import threading
from pathlib import Path

import numpy as np
import pytest

import dsbrdf
from dsbrdf import DSBRDF
from dsbrdf.output.serialize import to_json
from service.errors import FitNotFoundError
from service.jobs.results import ModelCache
from service.storage.schema import FitKey
from service.storage.store import Store
from tests.support.stores import LOCAL, add


@pytest.mark.anyio
async def test_model_that_is_read_before_its_deletion_is_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store(tmp_path)
    key = store.add_fit(LOCAL, add(store), {}, 1)[0].key
    store.start_fit(key)
    model = DSBRDF(np.zeros(1), np.ones((3, 1, 1)), np.ones((1, 1, 1)), np.full((1, 1, 1), 0.2))
    store.complete_fit(key, to_json(model, None, dsbrdf.decompose(model)), {})
    read, deleted, result = threading.Event(), threading.Event(), store.result

    def read_slowly(key: FitKey) -> str | None:
        document = result(key)
        read.set()
        assert deleted.wait(60.0)
        return document

    monkeypatch.setattr(store, "result", read_slowly)
    models = ModelCache(store, 8)

    reading = asyncio.create_task(models.get(key))
    async with asyncio.timeout(60.0):
        while not read.is_set():
            await asyncio.sleep(0.001)
    assert store.remove_fit(key)
    models.forget(key)
    deleted.set()
    assert np.array_equal((await reading).model.kappa, model.kappa)  # it was there when it was asked for
    with pytest.raises(FitNotFoundError):
        await models.get(key)
    store.close()
