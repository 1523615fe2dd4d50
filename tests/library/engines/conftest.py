from pathlib import Path

import pytest

from tests.support.mixtures import mixture, samples_table, scattered_samples


@pytest.fixture(scope="session")
def samples_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table of a few samples; tests must not change it."""
    path = tmp_path_factory.mktemp("samples") / "samples.csv"
    path.write_bytes(samples_table(scattered_samples(mixture(1, 0), 60)))
    return path
