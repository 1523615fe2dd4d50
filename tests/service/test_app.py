"""The application in the process of a test, as the page on HTTP recommends it."""

from pathlib import Path

import httpx
import pytest

from dsbrdf_service.app import create_app
from dsbrdf_service.settings import Settings


@pytest.mark.anyio
async def test_application_serves_httpx_without_a_server(tmp_path: Path, data: bytes) -> None:
    app = create_app(Settings(data_dir=tmp_path / "data"))
    client = httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://localhost")
    async with app.router.lifespan_context(app), client:
        stored = await client.post("/v1/measurements", content=data)
        assert stored.status_code == 201
        assert (await client.get(f"{stored.headers['location']}/content")).content == data
        assert (await client.get("/health/live")).json()["status"] == "live"
    app = create_app(Settings(data_dir=tmp_path / "data"))  # the folder is free again
    async with app.router.lifespan_context(app):
        assert app.state.context.store.measurement("", stored.json()["sha256"]).size == len(data)
