"""Headers that protect whoever looks at an answer in a browser."""

import re
import socket

import httpx

from tests.support.guarded import Guarded
from tests.support.server import Server, assert_problem


def head_of_answer_to_noise(server: Server) -> list[tuple[str, str]]:
    """Return the headers that something gets that is not HTTP."""
    address = server.http.base_url
    with socket.create_connection((address.host, address.port), timeout=30) as connection:
        connection.sendall(b"noise\r\n\r\n")
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


def test_documentation_page_loads_nothing_from_other_hosts(guarded: Guarded) -> None:
    http_client = guarded.server.http
    page = http_client.get("/docs")
    policy = dict(part.split(" ", 1) for part in page.headers["content-security-policy"].split("; "))
    assert {source for sources in policy.values() for source in sources.split()} == {"'none'", "'self'", "data:"}
    assert (policy["default-src"], policy["script-src"], policy["style-src"]) == ("'none'", "'self'", "'self'")
    assert re.findall(r"<script(?! src=)|<style| style=| on[a-z]+=", page.text) == []
    named = re.findall(r'(?:src|href)="([^"]+)"', page.text)
    script = http_client.get("/docs/page.js").text
    named += re.findall(r'url: "([^"]+)"', script)
    named.remove("data:,")
    types = {}
    for address in named:
        assert re.fullmatch(r"[\w./-]+", address)  # relative, and so of this service
        answer = http_client.get(page.url.join(address))
        assert answer.status_code == 200
        types[address] = answer.headers["content-type"].partition(";")[0]
        known = http_client.get(page.url.join(address), headers={"If-None-Match": answer.headers.get("etag", "")})
        assert known.status_code == (304 if address.startswith("docs/") else 200)
    assert types == {
        "docs/swagger-ui.css": "text/css",
        "docs/swagger-ui-bundle.js": "text/javascript",
        "docs/page.js": "text/javascript",
        "openapi.json": "application/json",
    }
    call = re.match(r'(\w+)\(.*dom_id: "#(\w+)"', script)
    assert call is not None
    assert f'id="{call[2]}"' in page.text
    assert call[1] in http_client.get("/docs/swagger-ui-bundle.js").text
    assert ".swagger-ui" in http_client.get("/docs/swagger-ui.css").text
    for other in ("redoc.standalone.js", "favicon.png", "..%2fcore.py", ""):
        assert_problem(http_client.get(f"/docs/{other}", headers=guarded.alice), 404)
