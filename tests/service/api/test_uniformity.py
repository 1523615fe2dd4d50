"""What holds for all routes alike: which address is believed, and how long an answer may wait."""

import pytest
from starlette.requests import Request

from dsbrdf_service.http.messages import preferred_wait
from tests.support.server import StartServer


def test_forwarded_address_is_believed_only_if_proxies_are_named(own_server: StartServer) -> None:
    server = own_server(log_level="debug")
    server.http.get("/v1/fits", headers={"X-Forwarded-For": "203.0.113.9"})
    assert server.stop() == 0
    assert "/v1/fits" in server.log.read_text()
    assert "203.0.113.9" not in server.log.read_text()


@pytest.mark.parametrize(
    ("header", "seconds"),
    [
        (None, 30.0),
        ("wait=5", 5.0),
        ("WAIT = 5", 5.0),
        ("return=minimal, wait=5; x=y", 5.0),
        ("respond-async", 0.0),
        ("respond-async, wait=5", 5.0),
        ("respond-async, wait=x", 0.0),
        ("wait=5, wait=6", 5.0),
        ("wait=1000", 60.0),
        ("wait=-1", 30.0),
        ("=;,,", 30.0),
    ],
)
def test_prefer_header_sets_the_wait(header: str | None, seconds: float) -> None:
    headers = [] if header is None else [(b"prefer", header.encode())]
    request = Request({"type": "http", "headers": headers})
    assert preferred_wait(request, 30.0, 60.0) == seconds
