"""Authentication: nothing but a valid key lets anyone in, whatever the path, the header or the host.

On the page, the key in a cookie serves pages of the service itself and nobody else.
"""

import hashlib
import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import pytest

from dsbrdf_service.routes import page
from tests.support.application import application
from tests.support.guarded import Guarded, keys_command, new_key
from tests.support.merl_files import with_value
from tests.support.processes import wait_until
from tests.support.server import ENDLESS, Server, assert_problem

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
        "longer scheme": [(b"Authorization", b"Bearerx " + key.encode())],
        "tab": [(b"Authorization", b"Bearer\t" + key.encode())],
        "a list": bearer(f"{key}, {key}"),
        "same header twice": [(b"Authorization", good), (b"Authorization", good)],
        "bad before good": [(b"authorization", b"Basic eDp4"), (b"AUTHORIZATION", good)],
        "another header": [(b"Proxy-Authorization", good), (b"X-Api-Key", key.encode()), (b"Cookie", b"key=" + good)],
        "wrong secret": bearer(f"{prefix}_{key_id}_{other}{secret[1:]}"),
        "cut off": bearer(key[:-1]),
        "longer": bearer(f"{key}A"),
        "unknown id": bearer(f"{prefix}_{'0' * 12}_{secret}"),
        "upper case": bearer(key.upper()),
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
    / //v1/fits /v1/fits/ /V1/fits /v1/fits?/health/live /v1/fits;/health/live /v1/fits%00/health/live /health/live%0A
    /health/live/ //health/live /HEALTH/live /health/live/../../v1/fits /health/live%2f..%2f..%2fv1%2ffits /docs/
    /docs/../v1/fits /docs/page.js/ /docs/page.js/../../v1/fits /openapi.json/../v1/fits /%2e%2e/v1/fits /metrics
    http://localhost/v1/fits http://localhost/health/live/../../v1/fits *
"""


@pytest.mark.parametrize("path", UNUSUAL_PATHS.split())
def test_unusual_paths_do_not_bypass_authentication(guarded: Guarded, path: str) -> None:
    for method in ("GET", "DELETE"):
        with guarded.server.connection(f"{method} {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode()) as connection:
            assert connection.recv(1000).startswith(b"HTTP/1.1 401 ")


def test_upload_without_key_is_refused_before_its_body_is_read(guarded: Guarded, data: bytes) -> None:
    before = guarded.server.files()
    for headers in ({}, {"Authorization": "Bearer x"}):
        for path in ("/v1/measurements", "/v1/fits"):
            try:
                answer = guarded.server.http.post(path, content=data, headers=headers)
            except (httpx.NetworkError, httpx.RemoteProtocolError):  # closed while it was being sent, which is as good
                continue
            assert_problem(answer, 401, "unauthorized")
    assert guarded.server.files() == before


def test_what_a_key_has_begun_is_refused_when_it_is_revoked(own_server: Callable[..., Server], data: bytes) -> None:
    server = own_server(require_keys="true", workers="1")
    (key_id, header), (_, other) = (new_key(server, name, metrics=True) for name in ("brief", "lasting"))
    document = {"measurement": hashlib.sha256(data).hexdigest(), "options": ENDLESS}

    def submit(who: dict[str, str]) -> str:
        server.http.post("/v1/measurements", content=data, headers=who)
        fit: str = server.http.post("/v1/fits", json=document, headers={**who, "Prefer": "respond-async"}).json()["id"]
        return fit

    def poll() -> httpx.Response:
        return server.http.get(f"/v1/fits/{fit}?wait=3", headers=header)

    def follow(who: dict[str, str]) -> str:
        with server.http.stream("GET", f"/v1/fits/{fit}/events", headers=who) as answer:
            assert answer.status_code == 200
            return answer.read().decode()  # to an end: a connection that breaks off is an error

    fit = submit(other)
    wait_until(lambda: server.http.get(f"/v1/fits/{fit}", headers=other).json()["status"] == "running")
    assert submit(header) == fit  # and it waits
    new, before = with_value(data, 0.5), server.files()
    head = f"POST /v1/fits HTTP/1.1\r\nHost: x\r\nAuthorization: {header['Authorization']}\r\n"
    head += f"Content-Length: {len(new)}\r\n\r\n"
    with ThreadPoolExecutor(3) as pool, server.connection(head.encode() + new[:100_000]) as upload:
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
        assert "event: running" not in followed.result(timeout=60)  # its turn has come, and it had been cancelled
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
    for method, path in (("GET", "/v1/fits"), ("GET", "/"), ("POST", "/v1/fits"), ("POST", "/v1/measurements")):
        answer = server.http.request(method, path, headers={name: value})
        assert "other sites" in assert_problem(answer, 403, "foreign-origin")


def test_page_that_a_person_opens_is_answered(server: Server) -> None:
    link = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Dest": "document"}
    for sent in ({"Sec-Fetch-Site": "none"}, {"Sec-Fetch-Site": "same-origin"}, link):
        assert server.http.get("/", headers=sent).status_code == 200


def test_invalid_key_is_refused_on_loopback_too(server: Server) -> None:
    _, header = new_key(server, "x")
    assert server.http.get("/v1/fits").status_code == 200
    assert server.http.get("/v1/fits", headers=header | {"Host": "any.example"}).status_code == 200
    for wrong in ("", "Bearer", "Bearer x", header["Authorization"] + "x"):
        assert_problem(server.http.get("/v1/fits", headers={"Authorization": wrong}), 401, "unauthorized")


FORM = {"Content-Type": "application/x-www-form-urlencoded"}


def address_of(guarded: Guarded) -> str:
    return str(guarded.server.http.base_url).rstrip("/")


def cookie_of(guarded: Guarded) -> dict[str, str]:
    return {"Cookie": f"other=1; dsbrdf_key={key_of(guarded)}"}


def sign_in(guarded: Guarded, origin: str, wanted: str = "/") -> httpx.Response:
    headers = {**FORM, "Origin": origin}
    body = f"key={key_of(guarded)}&wanted={wanted}"
    # Not with the client that tests share, which would keep the cookie.
    return httpx.post(f"{address_of(guarded)}/sign-in", content=body, headers=headers)


def test_key_in_a_cookie_reads_as_one_in_the_header(guarded: Guarded) -> None:
    read = guarded.server.http.get
    assert read("/v1/fits", headers=cookie_of(guarded)).content == read("/v1/fits", headers=guarded.alice).content
    assert read("/", headers=cookie_of(guarded)).status_code == 200


@pytest.mark.parametrize("value", ["", "x", "dsbrdf_000000000000_" + "A" * 43])
def test_cookie_without_a_valid_key_counts_for_nothing(guarded: Guarded, value: str) -> None:
    answer = guarded.server.http.get("/v1/fits", headers={"Cookie": f"dsbrdf_key={value}"})
    assert_problem(answer, 401, "unauthorized")


def test_cookie_of_another_page_of_the_host_does_not_hide_the_key(guarded: Guarded) -> None:
    planted = f"dsbrdf_key=planted; {cookie_of(guarded)['Cookie']}; dsbrdf_key=x"
    assert guarded.server.http.get("/v1/fits", headers={"Cookie": planted}).status_code == 200
    page = guarded.server.http.get("/", headers={"Cookie": planted})
    assert page.status_code == 200
    assert "sign-out" in page.text


def test_cookie_changes_something_for_pages_of_the_service_only(guarded: Guarded) -> None:
    own, path = {"Origin": address_of(guarded)}, f"/v1/fits/{'0' * 32}"
    foreign = [{}, {"Origin": "null"}, {"Origin": "http://elsewhere.example"}]
    foreign += [{**own, "Sec-Fetch-Site": site} for site in ("same-site", "cross-site", "none")]
    for sent in foreign:
        answer = guarded.server.http.delete(path, headers={**cookie_of(guarded), **sent})
        assert "pages of the service itself" in assert_problem(answer, 403, "foreign-origin")
    for sent in (own, {"Sec-Fetch-Site": "same-origin"}):
        assert_problem(guarded.server.http.delete(path, headers={**cookie_of(guarded), **sent}), 404, "not-found")


def test_sign_in_sets_a_cookie_that_scripts_cannot_read_and_is_secure_under_https(guarded: Guarded) -> None:
    answer = sign_in(guarded, address_of(guarded), f"/fits/{'0' * 32}")
    assert (answer.status_code, answer.headers["location"]) == (303, f"./fits/{'0' * 32}")
    assert answer.headers["set-cookie"] == f"dsbrdf_key={key_of(guarded)}; HttpOnly; Path=/; SameSite=strict"
    origin = address_of(guarded).replace("http:", "https:")
    assert "; Secure" in sign_in(guarded, origin).headers["set-cookie"]


@pytest.mark.parametrize("wanted", ["//elsewhere.example", "https://elsewhere.example/", "/v1/fits", "/fits/..", ""])
def test_sign_in_leads_to_pages_of_the_service_only(guarded: Guarded, wanted: str) -> None:
    assert sign_in(guarded, address_of(guarded), wanted).headers["location"] == "./"


def test_sign_in_from_another_site_or_with_a_wrong_key_sets_nothing(guarded: Guarded) -> None:
    wrong = guarded.server.http.post("/sign-in", content="key=x", headers={**FORM, "Origin": address_of(guarded)})
    for answer, status in ((sign_in(guarded, "http://elsewhere.example"), 403), (wrong, 401)):
        assert answer.status_code == status
        assert "set-cookie" not in answer.headers
        assert 'role="alert"' in answer.text
        assert key_of(guarded) not in answer.text


@pytest.mark.anyio
async def test_form_that_does_not_arrive_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "_FORM_SECONDS", 0.05)
    async with application(tmp_path, monkeypatch) as running:
        answer = await running.ask("/sign-in", "", "POST", b"key=x", stalled=True).end()
        assert answer.status == 408
        assert b"longer than the 0.05 s" in answer.body


def test_sign_out_removes_the_cookie_but_not_for_pages_of_other_sites(guarded: Guarded) -> None:
    for sent in ({"Sec-Fetch-Site": "cross-site"}, {"Origin": "http://elsewhere.example"}):
        answer = guarded.server.http.post("/sign-out", headers={**cookie_of(guarded), **sent})
        assert_problem(answer, 403, "foreign-origin")
        assert "set-cookie" not in answer.headers
    answer = guarded.server.http.post("/sign-out", headers=cookie_of(guarded))
    assert answer.status_code == 303
    assert 'dsbrdf_key=""; ' in answer.headers["set-cookie"]
    assert "Max-Age=0" in answer.headers["set-cookie"]


def test_page_without_a_key_asks_for_it_and_the_api_answers_as_ever(guarded: Guarded) -> None:
    read = guarded.server.http.get
    page = read("/")
    assert (page.status_code, page.headers["www-authenticate"]) == (401, "Bearer")
    assert "<h1>Sign in</h1>" in page.text
    assert_problem(read("/", headers={"Authorization": "Bearer x"}), 401, "unauthorized")
    assert_problem(read(f"/fits/{'0' * 32}/view"), 401, "unauthorized")
