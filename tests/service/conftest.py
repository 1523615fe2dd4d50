"""Services to test against, one shared and others for one test alone."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from service.access.keys import KeyLimits, add_key
from service.storage.database import Database
from tests.service.running import Server, wait_until


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A service that tests share: they must not rely on what else is in it."""
    running = Server(tmp_path_factory.mktemp("service") / "data")
    try:
        yield running.start()
    finally:
        running.close()


@pytest.fixture
def own_server(tmp_path: Path) -> Iterator[Callable[..., Server]]:
    """Start services that one test has for itself, with settings of its own."""
    started: list[Server] = []

    def start(**environment: str) -> Server:
        started.append(Server(tmp_path / f"data{len(started)}", **environment))
        return started[-1].start()

    try:
        yield start
    finally:
        for running in started:
            running.close()


@pytest.fixture(scope="session")
def data(plastic_file: Path) -> bytes:
    """The bytes of an acceptable measurement."""
    return plastic_file.read_bytes()


@pytest.fixture(scope="session")
def stored(server: Server, data: bytes) -> str:
    """The sha256 of a measurement that the shared service has."""
    answer = server.http.post("/v1/measurements", content=data)
    assert answer.status_code in (200, 201)
    sha256: str = answer.json()["sha256"]
    return sha256


@pytest.fixture(scope="session")
def fitted(server: Server, stored: str) -> str:
    """The id of a fit with two lobes that has succeeded."""
    answer = server.submit(stored, n_lobes=2, em_iterations=20)
    assert answer.json()["status"] == "succeeded", answer.text
    fit_id: str = answer.json()["id"]
    return fit_id


@dataclass(frozen=True)
class Guarded:
    """A service that wants keys, and the headers that hold the keys of two users."""

    server: Server
    alice: dict[str, str]
    bob: dict[str, str]

    def new_key(self, name: str = "another", **limits: Any) -> dict[str, str]:
        """Return the header of a further key, when the service knows it."""
        return new_key(self.server, name, **limits)[1]


def new_key(server: Server, name: str, **limits: Any) -> tuple[str, dict[str, str]]:
    """Make a key beside a running service, and use it once; return its id and the header that holds it."""
    database = Database(server.data_dir, exclusive=False)
    row, key = add_key(database, name, KeyLimits(**limits))
    database.close()
    header = {"Authorization": f"Bearer {key}"}
    wait_until(lambda: server.http.get("/metrics", headers=header).status_code == 200)
    return row.id, header


@pytest.fixture(scope="session")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    """A service that wants keys, for tests to share."""
    running = Server(tmp_path_factory.mktemp("guarded") / "data", require_keys="true", workers="2")
    try:
        running.start()
        alice, bob = (new_key(running, name)[1] for name in ("alice", "bob"))
        yield Guarded(running, alice, bob)
    finally:
        running.close()
