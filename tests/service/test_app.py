"""The application in the process of a test, as the page on HTTP recommends it."""

import json
from pathlib import Path

import httpx
import pytest

import dsbrdf
from dsbrdf_service.app import create_app
from dsbrdf_service.settings import Settings
from dsbrdf_service.storage.store import Store
from dsbrdf_service.wire import to_wire
from tests.support.stores import LOCAL, add


@pytest.mark.anyio
async def test_stored_result_is_sent_without_being_parsed(tmp_path: Path) -> None:
    store = Store(tmp_path / "data")
    row, _ = store.add_fit(LOCAL, add(store), to_wire(dsbrdf.FitOptions()), queue_limit=1)
    store.start_fit(row.key)
    store.complete_fit(row.key, '{"model": no JSON}', {})
    app = create_app(Settings(data_dir=tmp_path / "data"), store)
    client = httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://localhost")
    async with app.router.lifespan_context(app), client:
        answer = await client.get(f"/v1/fits/{row.id}")
    state, _, result = answer.text.partition(',"model": ')
    assert json.loads(state + "}")["status"] == "succeeded"
    assert result == "no JSON}"
