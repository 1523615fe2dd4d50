"""Nothing but a valid key lets anyone in, whatever the path or the header; what is not yours does not exist."""

import hashlib
import re
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import Any

import httpx
import pytest
from prometheus_client import Gauge

from dsbrdf_service.access import Access, Keys
from dsbrdf_service.errors import ProblemError
from dsbrdf_service.settings import Settings
from tests.support.merl_files import with_value
from tests.support.processes import wait_until
from tests.support.server import (
    ENDLESS,
    QUICK,
    Guarded,
    Server,
    StartServer,
    assert_problem,
    head_of_upload,
    keys_command,
    new_key,
)

OPEN = ("/health/live", "/health/ready", "/docs", "/page/docs.js", "/openapi.json")


def key_of(guarded: Guarded) -> str:
    return guarded.alice["Authorization"].removeprefix("Bearer ")


def bad_headers(key: str) -> dict[str, list[tuple[bytes, bytes]]]:
    """Authorization headers that must not let anyone in, made of a good key."""
    prefix, key_id, secret = key.split("_", 2)
    other = "A" if secret[0] != "A" else "B"

    def bearer(text: str) -> list[tuple[bytes, bytes]]:
        return [(b"Authorization", b"Bearer " + text.encode("latin-1"))]

    good = f"Bearer {key}".encode()
    return {
        "none": [],
        "no scheme": [(b"Authorization", key.encode())],
        "basic": [(b"Authorization", b"Basic " + key.encode())],
        "tab": [(b"Authorization", b"Bearer\t" + key.encode())],
        "a list": bearer(f"{key}, {key}"),
        "same header twice": [(b"Authorization", good), (b"Authorization", good)],
        "bad before good": [(b"authorization", b"Basic eDp4"), (b"AUTHORIZATION", good)],
        "another header": [(b"Proxy-Authorization", good), (b"X-Api-Key", key.encode()), (b"Cookie", b"key=" + good)],
        "wrong secret": bearer(f"{prefix}_{key_id}_{other}{secret[1:]}"),
        "cut off": bearer(key[:-1]),
        "unknown id": bearer(f"{prefix}_{'0' * 12}_{secret}"),
        "sql": bearer(f"{prefix}_' OR ''='' --_{secret}"),
        "not ascii": bearer(f"{key[:-1]}é"),
        "very long": bearer(key + "A" * 8000),
    }


@pytest.mark.parametrize("case", bad_headers("dsbrdf_0_secret"))
def test_request_without_valid_key_is_unauthorized(guarded: Guarded, case: str) -> None:
    key = key_of(guarded)
    answer = guarded.server.http.get("/v1/fits", headers=bad_headers(key)[case])
    assert "Authorization: Bearer" in assert_problem(answer, 401, "unauthorized")
    assert answer.headers["www-authenticate"].startswith("Bearer")
    assert key not in answer.text
    if case not in ("none", "another header"):  # what is wrong with a key is not told
        unknown = guarded.server.http.get("/v1/fits", headers=bad_headers(key)["unknown id"])
        assert answer.content == unknown.content


def test_valid_key_is_authorized(guarded: Guarded) -> None:
    for scheme in ("Bearer", "bearer", "BEARER"):
        header = {"authorization": f"{scheme}  {key_of(guarded)}"}
        assert guarded.server.http.get("/v1/fits", headers=header).status_code == 200


def test_every_route_requires_a_key(guarded: Guarded) -> None:
    paths: dict[str, dict[str, Any]] = guarded.server.http.get("/openapi.json").json()["paths"]
    assert len(paths) > 10
    for path, methods in paths.items():
        for method in {*methods, "get", "head", "post", "put", "patch", "delete", "options", "trace"}:
            filled = path.replace("{fit_id}", "0" * 32).replace("{sha256}", "0" * 64).replace("{label}", "diffuse")
            answer = guarded.server.http.request(method.upper(), filled)
            assert (answer.status_code == 401) is (path not in OPEN), (method, path, answer.status_code)
    for path in OPEN:
        assert guarded.server.http.get(path).status_code == 200


UNUSUAL_PATHS = """
    //v1/fits /v1/fits/ /V1/fits /v1/fits?/health/live /v1/fits;/health/live /v1/fits%00/health/live /health/live%0A
    /health/live/ //health/live /HEALTH/live /health/live/../../v1/fits /health/live%2f..%2f..%2fv1%2ffits /docs/
    /docs/../v1/fits /docs/page.js/ /docs/page.js/../../v1/fits /openapi.json/../v1/fits /%2e%2e/v1/fits /metrics
    http://localhost/v1/fits http://localhost/health/live/../../v1/fits *
"""


@pytest.mark.parametrize("path", UNUSUAL_PATHS.split())
def test_unusual_paths_do_not_bypass_authentication(guarded: Guarded, path: str) -> None:
    for method in ("GET", "DELETE"):
        with guarded.server.connection(f"{method} {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode()) as connection:
            assert connection.recv(1000).startswith(b"HTTP/1.1 401 ")


def test_connections_of_one_address_have_half_of_the_places_together() -> None:
    settings = Settings(limit_concurrency=8)
    access = Access(settings, Keys(settings), Gauge("requests", "", registry=None))
    for port in range(4):
        access.admit({"path": "/docs", "client": ("192.0.2.1", port)}, {})
    with pytest.raises(ProblemError, match="4 of your requests"):
        access.admit({"path": "/docs", "client": ("192.0.2.1", 4)}, {})
    assert access.admit({"path": "/docs", "client": ("192.0.2.2", 0)}, {}) == "192.0.2.2"


def test_what_a_key_has_begun_is_refused_when_it_is_revoked(own_server: StartServer, data: bytes) -> None:
    server = own_server(require_keys="true", workers="1")
    (key_id, header), (_, other) = (new_key(server, name, metrics=True) for name in ("brief", "lasting"))
    document = {"measurement": hashlib.sha256(data).hexdigest(), "options": ENDLESS}

    def submit(who: dict[str, str]) -> str:
        server.http.post("/v1/measurements", content=data, headers=who)
        fit: str = server.http.post("/v1/fits", json=document, headers={**who, "Prefer": "respond-async"}).json()["id"]
        return fit

    def poll() -> httpx.Response:
        return server.http.get(f"/v1/fits/{fit}?wait=2", headers=header)

    def follow(who: dict[str, str]) -> str:
        with server.http.stream("GET", f"/v1/fits/{fit}/events", headers=who) as answer:
            assert answer.status_code == 200
            return answer.read().decode()  # A connection that breaks off is an error.

    fit = submit(other)
    wait_until(lambda: server.http.get(f"/v1/fits/{fit}", headers=other).json()["status"] == "running")
    assert submit(header) == fit  # and it waits
    new, before = with_value(data, 0.5), server.files()
    head = head_of_upload(len(new), "/v1/fits", **header)
    with ThreadPoolExecutor(3) as pool, server.connection(head + new[:100_000]) as upload, ExitStack() as stack:
        stack.callback(server.http.delete, f"/v1/fits/{fit}", headers=other)  # A failure must not follow it for ever.
        polled, followed, lasting = pool.submit(poll), pool.submit(follow, header), pool.submit(follow, other)
        in_progress = re.compile(r"^dsbrdf_requests_in_progress 5.0$", re.MULTILINE)
        wait_until(lambda: bool(in_progress.search(server.http.get("/metrics", headers=other).text)))
        assert keys_command("revoke", key_id, "--data-dir", str(server.data_dir)).returncode == 0
        assert_problem(server.http.get("/v1/fits", headers=header), 401, "unauthorized")  # at once
        upload.sendall(new[100_000:])
        assert upload.recv(10_000).startswith(b"HTTP/1.1 401")
        assert server.files() == before
        assert_problem(polled.result(timeout=60), 401, "unauthorized")
        assert not lasting.done()
        assert server.http.delete(f"/v1/fits/{fit}", headers=other).json()["status"] == "cancelled"
        assert "event: cancelled" in lasting.result(timeout=60)
        assert followed.result(timeout=60).count("event: ") == 1  # Its turn had not come before the revocation.
    assert '"level": "error"' not in server.log.read_text()


def test_only_local_hosts_are_accepted_on_loopback(server: Server) -> None:
    for host in ("evil.example", "localhost.evil.example", "127.0.0.1.evil.example", "10.0.0.1", "evil."):
        for value in (host, f"{host}:{server.http.base_url.port}"):
            answer = server.http.get("/v1/fits", headers={"Host": value})
            assert "127.0.0.1" in assert_problem(answer, 421, "misdirected")
    for host in ("localhost", "LOCALHOST:80", "workstation", "127.0.0.1", "127.1.2.3:8000", "[::1]:8000"):
        assert server.http.get("/v1/fits", headers={"Host": host}).status_code == 200, host
        assert server.http.get("/v1/fits", headers={"Host": host, "Origin": f"http://{host}"}).status_code == 200, host


ORIGINS = ("https://evil.example", "null", "http://localhost:1", "", "127.0.0.1")


@pytest.mark.parametrize(
    ("name", "value"),
    [*(("Origin", origin) for origin in ORIGINS), ("Sec-Fetch-Site", "cross-site"), ("Sec-Fetch-Site", "same-site")],
)
def test_requests_of_pages_of_other_sites_are_refused(server: Server, name: str, value: str) -> None:
    for method, path in (("GET", "/v1/fits"), ("POST", "/v1/fits"), ("POST", "/v1/measurements")):
        answer = server.http.request(method, path, headers={name: value})
        assert "other sites" in assert_problem(answer, 403, "foreign-origin")


def test_invalid_key_is_refused_on_loopback_too(server: Server) -> None:
    _, header = new_key(server, "x")
    assert server.http.get("/v1/fits").status_code == 200
    assert server.http.get("/v1/fits", headers=header | {"Host": "any.example"}).status_code == 200
    for wrong in ("", "Bearer", "Bearer x", header["Authorization"] + "x"):
        assert_problem(server.http.get("/v1/fits", headers={"Authorization": wrong}), 401, "unauthorized")


def test_insecure_service_lets_everyone_in_under_any_name(own_server: StartServer) -> None:
    server = own_server(host="0.0.0.0", insecure="true")
    assert server.http.get("/v1/fits", headers={"Host": "any.example"}).status_code == 200


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


@pytest.mark.slow
def test_resources_of_other_owners_are_not_found(guarded: Guarded, data: bytes) -> None:
    server = guarded.server
    alice, bob = guarded.new_key("owner"), guarded.new_key("prober", requests_per_second=100_000)
    fitted = server.http.post("/v1/fits", params=QUICK, content=data, headers=alice)
    assert fitted.status_code == 201
    fit, sha256 = fitted.json()["id"], fitted.json()["measurement"]
    paths = (f"fits/{fit}", f"fits/{fit}/components", f"measurements/{sha256}")
    tags = {path: server.http.get(f"/v1/{path}", headers=alice).headers["etag"] for path in paths}
    both = probes(fit, sha256, tags), probes(MISSING_FIT, MISSING_MEASUREMENT, tags)
    for (method, path, arguments), (_, other, _) in zip(*both, strict=True):
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
