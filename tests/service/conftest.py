"""Fixtures of the service's tests; tests that are coroutines run with asyncio, as the service does."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from dsbrdf import DSBRDF
from dsbrdf.output import from_json
from dsbrdf_service.storage.store import Store
from tests.support.server import Server


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture(scope="session")
def model(server: Server, fitted: str) -> DSBRDF:
    return from_json(server.http.get(f"/v1/fits/{fitted}/export?format=json").text)[0]


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with closing(Store(tmp_path)) as opened:
        yield opened
