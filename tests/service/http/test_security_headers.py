"""Headers that protect whoever looks at an answer in a browser."""

import httpx

from tests.support.guarded import Guarded
from tests.support.server import Server


def head_of_answer_to_noise(server: Server) -> list[tuple[str, str]]:
    """Return the headers that something gets that is not HTTP."""
    with server.connection(b"noise\r\n\r\n") as connection:
        status, *head = connection.recv(10_000).decode().partition("\r\n\r\n")[0].split("\r\n")
    assert " 400 " in status
    return [(name, value) for name, _, value in (line.partition(": ") for line in head)]


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
        "no HTTP": httpx.Response(400, headers=head_of_answer_to_noise(guarded.server)),
    }
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
