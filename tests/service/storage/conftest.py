"""A store on a folder of its own."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from dsbrdf_service.storage.store import Store


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    """A store whose folder is `tmp_path`."""
    with closing(Store(tmp_path)) as opened:
        yield opened
