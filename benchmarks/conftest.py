"""The material of most tests."""

import pytest

from dsbrdf import Measurement
from tests.support.merl_files import glossy_plastic


@pytest.fixture(scope="session")
def plastic() -> Measurement:
    """A glossy coloured plastic with 2 % noise."""
    return glossy_plastic()
