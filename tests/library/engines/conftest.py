"""What Dask leaves behind does not end in another test."""

import gc
import warnings
from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True)
def sockets_that_dask_leaves() -> Iterator[None]:
    """Collect them here: a Dask client that is closed while it connects does not close its socket."""
    yield
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "unclosed <socket", ResourceWarning)
        gc.collect()
