"""What holds for all routes alike: HEAD, headers, addresses, and the words that refuse a request."""

import pytest
from starlette.requests import Request

from dsbrdf_service.http.messages import preferred_wait
from tests.support.server import Guarded, StartServer


def test_forwarded_address_is_believed_only_if_proxies_are_named(own_server: StartServer) -> None:
    server = own_server(log_level="debug")
    server.http.get("/v1/fits", headers={"X-Forwarded-For": "203.0.113.9"})
    assert server.stop() == 0
    assert "/v1/fits" in server.log.read_text()
    assert "203.0.113.9" not in server.log.read_text()


def test_every_response_has_security_headers(guarded: Guarded) -> None:
    http_client = guarded.server.http
    answers = {
        "open": http_client.get("/health/live"),
        "documentation": http_client.get("/docs"),
        "script": http_client.get("/docs/swagger-ui-bundle.js"),
        "without key": http_client.get("/v1/fits"),
        "with key": http_client.get("/v1/fits", headers=guarded.alice),
        "missing": http_client.get("/nothing", headers=guarded.alice),
        "wrong method": http_client.put("/v1/fits", headers=guarded.alice),
        "with a slash": http_client.get("/v1/fits/", headers=guarded.alice),
        "too long a head": http_client.get("/v1/fits", headers={"X-Long": "x" * 9000}),
    }
    assert answers["wrong method"].headers["allow"] == "GET, HEAD, POST"
    for name, answer in answers.items():
        assert answer.headers["x-content-type-options"] == "nosniff", name
        assert answer.headers["x-frame-options"] == "DENY"
        assert answer.headers["referrer-policy"] == "no-referrer"
        assert answer.headers["cross-origin-resource-policy"] == "same-origin"
        assert "Authorization" in answer.headers["vary"]
        assert answer.headers["cache-control"] == "private, no-cache"
        policy = answer.headers["content-security-policy"]
        assert policy.startswith("default-src 'none'; ")
        assert "frame-ancestors 'none'" in policy
        assert ("script-src" in policy) is (name == "documentation")


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
