from pathlib import Path

import pytest

import dsbrdf
from dsbrdf import FitResult


@pytest.fixture(scope="session")
def model_file(two_lobe_fit: FitResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What ``dsbrdf fit`` stores for the plastic; tests must not change it."""
    path = tmp_path_factory.mktemp("models") / "plastic.json"
    dsbrdf.save(two_lobe_fit, path)
    return path
