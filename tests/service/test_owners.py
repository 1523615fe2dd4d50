"""Owners: what is not yours does not exist."""

from collections.abc import Iterator, Mapping
from typing import Any

import httpx
import pytest

from tests.support.guarded import Guarded
from tests.support.server import QUICK

pytestmark = pytest.mark.slow


def shown(answer: httpx.Response, *names: str) -> str:
    """Return all that an answer tells, apart from what it was asked for by name and what differs with every answer."""
    head = [pair for pair in answer.headers.multi_items() if pair[0] not in ("date", "x-request-id")]
    text = repr((answer.status_code, head, answer.content))
    for name in names:
        text = text.replace(name, "...")
    return text


MISSING_FIT = "0123456789abcdef" * 2
MISSING_MEASUREMENT = "fedcba98" * 8
POINTS = {"theta_half_deg": [1.0], "theta_diff_deg": [2.0]}


def probes(fit: str, sha256: str, tags: Mapping[str, str]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield every way to ask for something by its name: method, path and arguments."""
    paths = ["", "/events", "/components", "/brdf?theta_half_deg=1&theta_diff_deg=2", "/brdf", "/brdf?theta_half_deg=x"]
    paths += ["?wait=0.1", "?wait=x", "/brdf?omega_in=0,0,1&omega_out=0,0,1", "/figures/residual.svg"]
    for label in ("diffuse", "no_label"):
        paths += [f"/components/{label}/brdf?theta_half_deg=1&theta_diff_deg=2"]
        paths += [f"/export?format=json&component={label}"]
    paths += [f"/export?format={name}" for name in ("json", "merl", "glsl", "none")]
    for path in paths:
        for method in ("GET", "HEAD", "DELETE", "PUT"):
            if (method, path) not in (("DELETE", ""), ("DELETE", "?wait=0.1"), ("DELETE", "?wait=x")):
                yield method, f"/v1/fits/{fit}{path}", {}
    for tag in (*tags.values(), "*"):
        for path in ("", "/components"):
            yield "GET", f"/v1/fits/{fit}{path}", {"headers": {"If-None-Match": tag}}
        for path in ("", "/content"):
            yield "GET", f"/v1/measurements/{sha256}{path}", {"headers": {"If-None-Match": tag}}
            yield "HEAD", f"/v1/measurements/{sha256}{path}", {"headers": {"If-None-Match": tag}}
    for path in ("/brdf", "/components/diffuse/brdf", "/components/no_label/brdf"):
        for accepted in ("*/*", "application/x-npy", "image/png"):
            yield "POST", f"/v1/fits/{fit}{path}", {"json": POINTS, "headers": {"Accept": accepted}}
        for media_type in ("application/json", "text/plain"):
            yield "POST", f"/v1/fits/{fit}{path}", {"content": b"nonsense", "headers": {"Content-Type": media_type}}
    for method in ("GET", "HEAD", "PUT", "PATCH", "POST", "DELETE"):
        yield method, f"/v1/measurements/{sha256}", {}
    for options in ({}, QUICK, {"n_lobes": 99}):
        yield "POST", "/v1/fits", {"json": {"measurement": sha256, "options": options}}
    yield "DELETE", f"/v1/fits/{fit}", {}
    yield "DELETE", f"/v1/fits/{fit}?wait=0.1", {}


def test_resources_of_other_owners_are_not_found(guarded: Guarded, data: bytes) -> None:
    server = guarded.server
    alice, bob = guarded.new_key("owner"), guarded.new_key("prober", requests_per_second=100_000)
    fitted = server.http.post("/v1/fits", params=QUICK, content=data, headers=alice)
    assert fitted.status_code == 201
    fit, sha256 = fitted.json()["id"], fitted.json()["measurement"]
    tags = {
        path: server.http.get(f"/v1/{path}", headers=alice).headers["etag"]
        for path in (f"fits/{fit}", f"fits/{fit}/components", f"measurements/{sha256}")
    }
    for (method, path, arguments), (_, other, _) in zip(
        probes(fit, sha256, tags), probes(MISSING_FIT, MISSING_MEASUREMENT, tags), strict=True
    ):
        headers = {**arguments.get("headers", {}), **bob}
        hidden = server.http.request(method, path, **{**arguments, "headers": headers})
        document = arguments.get("json", {})
        if "measurement" in document:
            arguments = {**arguments, "json": {**document, "measurement": MISSING_MEASUREMENT}}
        missing = server.http.request(method, other, **{**arguments, "headers": headers})
        assert shown(hidden, fit, sha256) == shown(missing, MISSING_FIT, MISSING_MEASUREMENT), (method, path)
        assert hidden.status_code in (404, 405, 415, 422), (method, path)
    for path in ("/v1/fits", "/v1/measurements"):
        for query in ("", "?limit=1", "?cursor=1000000", "?limit=200&cursor=5"):
            answer = server.http.get(f"{path}{query}", headers=bob)
            assert answer.json() == {"items": []}
            assert "link" not in answer.headers

    # All of it is still there for who owns it.
    assert server.http.get(f"/v1/fits/{fit}", headers=alice).json()["status"] == "succeeded"
    assert server.http.get(f"/v1/measurements/{sha256}/content", headers=alice).content == data
