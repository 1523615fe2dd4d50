"""The model of the fit that tests share."""

import pytest

from dsbrdf import DSBRDF
from dsbrdf.output import from_json
from tests.support.server import Server


@pytest.fixture(scope="session")
def model(server: Server, fitted: str) -> DSBRDF:
    """The model of the fit, without loss."""
    return from_json(server.http.get(f"/v1/fits/{fitted}/export?format=json").text)[0]
