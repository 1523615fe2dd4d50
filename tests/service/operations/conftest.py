"""One service whose log and metrics are looked at."""

from collections.abc import Iterator

import pytest

from tests.support.server import Server


@pytest.fixture(scope="session")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A service whose log and metrics nobody else fills."""
    with Server.running(tmp_path_factory.mktemp("watched") / "data", workers="1") as running:
        yield running
