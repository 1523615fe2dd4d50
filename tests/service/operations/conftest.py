"""One service whose log and metrics are looked at."""

from collections.abc import Iterator

import pytest

from tests.support.server import Server


@pytest.fixture(scope="session")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A service whose log and metrics nobody else fills."""
    with Server.running(tmp_path_factory.mktemp("watched") / "data", workers="1") as running:
        yield running


@pytest.fixture(scope="session")
def sha256(watched: Server, data: bytes) -> str:
    answer = watched.http.post("/v1/measurements", content=data)
    assert answer.status_code == 201
    identity: str = answer.json()["sha256"]
    return identity
