"""What holds for all routes alike: HEAD, headers, addresses, and the words that refuse a request."""

from typing import Any

import pytest
from starlette.requests import Request

from dsbrdf_service.http.messages import preferred_wait
from tests.support.server import QUICK, Guarded, Server, StartServer, assert_problem, new_key


def test_every_resource_can_be_asked_for_with_head(server: Server, stored: str, fitted: str) -> None:
    fit, point = f"/v1/fits/{fitted}", "theta_half_deg=0&theta_diff_deg=0"
    parts = ["", f"/brdf?{point}", "/components", f"/components/diffuse/brdf?{point}", "/export?format=json", "/events"]
    paths = [f"{fit}{part}" for part in parts]
    paths += ["/v1/fits", "/v1/measurements", f"/v1/measurements/{stored}", f"/v1/measurements/{stored}/content"]
    paths += ["/health/live", "/health/ready", "/metrics", "/docs", "/openapi.json"]
    for path in paths:
        head, get = server.http.head(path), server.http.get(path)
        assert (head.status_code, get.status_code) == (200, 200), path
        assert head.content == b""
        assert head.headers["content-type"] == get.headers["content-type"]
    missing = server.http.head(f"/v1/fits/{'0' * 32}")
    assert (missing.status_code, missing.content) == (404, b"")


def test_what_the_client_has_is_not_sent_again(server: Server, stored: str, fitted: str) -> None:
    fit, measurement = f"/v1/fits/{fitted}", f"/v1/measurements/{stored}"
    pictures = f"{fit}/figures/sphere.png?size=16"
    for path in (fit, f"{fit}/components", pictures, measurement, f"{measurement}/content"):
        first = server.http.get(path)
        again = server.http.get(path, headers={"If-None-Match": first.headers["etag"]})
        assert (first.status_code, again.status_code, again.content) == (200, 304, b""), path
        assert again.headers["etag"] == first.headers["etag"]
        other = server.http.get(path, headers={"If-None-Match": '"another"'})
        assert (other.status_code, other.content) == (200, first.content)
        if "/measurements/" in path:  # the file and its document are at one address
            assert "Accept" in ", ".join(value for name, value in again.headers.multi_items() if name == "vary")


def test_unknown_query_parameters_are_refused_everywhere(server: Server, stored: str, fitted: str) -> None:
    fit, measurement = f"/v1/fits/{fitted}", f"/v1/measurements/{stored}"
    parts = [f"{fit}/{part}" for part in ("events", "components", "export", "brdf", "figures/thumbnail.png")]
    parts += [fit, measurement, f"{measurement}/brdf", "/v1/fits", "/v1/materials", "/v1/measurements"]
    parts += ["/health/live", "/health/ready", "/metrics"]
    requests = [("GET", path) for path in parts] + [("DELETE", path) for path in (fit, measurement)]
    requests += [("POST", f"{fit}/brdf"), ("POST", "/v1/measurements"), ("POST", "/v1/tables")]
    for method, path in requests:
        answer = server.http.request(method, path, params={"nonsense": "1"})
        assert "'nonsense'" in assert_problem(answer, 422, "invalid-argument"), (method, path)
    assert server.http.get(f"/v1/fits/{fitted}").status_code == 200


def test_forwarded_address_is_believed_only_if_proxies_are_named(own_server: StartServer) -> None:
    server = own_server(log_level="debug")
    server.http.get("/v1/fits", headers={"X-Forwarded-For": "203.0.113.9"})
    assert server.stop() == 0
    assert "/v1/fits" in server.log.read_text()
    assert "203.0.113.9" not in server.log.read_text()


@pytest.mark.parametrize(
    ("given", "expected"), [("/brdf", "/brdf"), ("/a/b/", "/a/b"), ("//evil.example", ""), ("/x y", ""), ("x", "")]
)
def test_addresses_begin_with_the_prefix_of_the_proxy(server: Server, stored: str, given: str, expected: str) -> None:
    headers = {"X-Forwarded-Prefix": given}
    table = "theta_in,theta_out,value\n" + "".join(f"{at % 60},{at},0.1\n" for at in range(80))
    sent = server.http.post("/v1/measurements", content=table, headers={**headers, "Content-Type": "text/csv"})
    assert sent.headers["location"] == f"{expected}/v1/measurements/{sent.json()['sha256']}"
    fit = server.http.post("/v1/fits", json={"measurement": stored, "options": QUICK}, headers=headers)
    assert fit.headers["location"] == f"{expected}/v1/fits/{fit.json()['id']}"
    page = server.http.get("/v1/fits?limit=1", headers=headers)
    assert page.headers["link"].startswith(f"<{expected}/v1/fits?limit=1&cursor=")


def test_metrics_of_all_are_shown_only_to_keys_made_for_it(guarded: Guarded) -> None:
    assert_problem(guarded.server.http.get("/metrics", headers=guarded.alice), 404, "not-found")
    header = new_key(guarded.server, "prometheus", metrics=True)[1]
    assert "dsbrdf_fits" in guarded.server.http.get("/metrics", headers=header).text


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


# Targets, in which {fit} is the path of a fit, and what the sentence has that refuses them.
OF_LISTS = ["limit=0", "limit=201", "limit=", "cursor=-1", "cursor=99999999999999999999", "cursor=%00"]
OF_WAITS = ["wait=-1", "wait=nan", "wait=1e999"]
WITH_NUMBERS = ["/v1/fits?limit", "{fit}?wait", "{fit}/figures/sphere.png?size", "{fit}/brdf?theta_half_deg"]
TARGETS = [(f"/v1/fits?{query}", query.partition("=")[0]) for query in OF_LISTS]
TARGETS += [(f"/v1/measurements?{query}", query.partition("=")[0]) for query in OF_LISTS]
TARGETS += [(f"{{fit}}?{query}", "wait") for query in OF_WAITS]
# What only Python takes for a number is none.
TARGETS += [(f"{name}={number}", name.partition("?")[2]) for name in WITH_NUMBERS for number in ("1_0", "%D9%A1%D9%A0")]
TARGETS += [(f"{{fit}}/export?component=diffuse&format={name}", "merl & layers") for name in ("json", "csv")]
TARGETS += [
    ("{fit}/export?component=diffuse&format=materialx", "merl & layers"),
    ("{fit}/export?component=ring&format=json", "'diffuse'"),
    ("{fit}/export?format=..%2f..%2fetc%2fpasswd", "'json'"),
    ("{fit}/export", "format"),
    ("{fit}/export?name=flat&format=glsl&sampling=true", "must not be a word of GLSL"),
    ("{fit}/export?name=paint&format=merl&sampling=true", "options of the format glsl"),
    ("{fit}/figures/sphere.png?size=1000", "256"),
    ("{fit}/figures/sphere.png?lighting=moon", "'environment'"),
    ("{fit}/figures/sphere.png?component=ring", "'diffuse'"),
    ("/v1/fits?limit=%201", "limit"),
    ("/v1/fits?limit=1&limit=2", "'limit' & more than once"),
    ("{fit}?wait=0&wait=1", "'wait' & more than once"),
]


@pytest.mark.parametrize(("target", "words"), TARGETS)
def test_invalid_query_is_named(server: Server, fitted: str, target: str, words: str) -> None:
    detail = assert_problem(server.http.get(target.format(fit=f"/v1/fits/{fitted}")), 422, "invalid-argument")
    assert [word for word in words.split(" & ") if word not in detail] == []


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"nlobes": 3}, "Unknown  & 'nlobes' & n_lobes & horizon_cutoff_deg"),
        ({"n_lobes": "many"}, 'n_lobes must be an integer from 1 to 10 or "auto" & many'),
        ({"horizon_cutoff_deg": "wide"}, "horizon_cutoff_deg must be a number above 0 and at most 90 & wide"),
        ({"robust": "perhaps"}, "robust must be true or false & perhaps"),
    ],
)
def test_bad_options_are_named(server: Server, stored: str, data: bytes, options: dict[str, Any], words: str) -> None:
    before = [fit["id"] for fit in server.http.get("/v1/fits").json()["items"]]
    query = {name: str(value) for name, value in options.items()}
    for answer in (server.submit(stored, **options), server.http.post("/v1/fits", params=query, content=data)):
        detail = assert_problem(answer, 422, "invalid-argument")
        assert [word for word in words.split(" & ") if word not in detail] == []
    assert [fit["id"] for fit in server.http.get("/v1/fits").json()["items"]] == before


NO_MEASUREMENT = b'{"measurement": "' + b"0" * 64 + b'", '
BODIES = [b"", b"[]", b"{}", b'{"measurement": 3}', b'{"measurement": "../../etc/passwd"}', b"\xff\xfe", b"[" * 20_000]
BODIES += [NO_MEASUREMENT + rest for rest in (b'"options": []}', b'"options": {"mask": 1, "mask": 2}}')]
BODIES += [NO_MEASUREMENT + b'"options": {"%b": "\\ud800"}}' % name for name in (b"method", b"\\udfff")]


@pytest.mark.parametrize("body", BODIES)
def test_invalid_documents_are_named(server: Server, body: bytes) -> None:
    answer = server.http.post("/v1/fits", content=body, headers={"Content-Type": "application/json"})
    assert_problem(answer, 422, "invalid-argument")


def test_a_document_without_a_type_is_told_the_type(server: Server) -> None:
    answer = server.http.post("/v1/fits", content=b'{"measurement": "%b"}' % (b"0" * 64))
    assert "needs Content-Type: application/json" in assert_problem(answer, 422, "measurement-format")


def test_content_types_are_checked(server: Server, fitted: str) -> None:
    files, batches = ("application/octet-stream", "text/csv"), ("application/x-npy", "application/json")
    for path, taken in (("/v1/fits", files), ("/v1/measurements", files), (f"/v1/fits/{fitted}/brdf", batches)):
        for sent in ({"content": b"x", "headers": {"Content-Type": "image/png"}}, {"files": {"file": b"x"}}):
            answer = server.http.post(path, **sent)
            detail = assert_problem(answer, 415, "unsupported-media-type")
            assert [kind for kind in taken if kind not in detail or kind not in answer.headers["accept-post"]] == []


def test_file_with_the_type_that_a_client_gives_it_is_told_the_right_one(server: Server, data: bytes) -> None:
    curl = server.http.post("/v1/fits", content=data, headers={"Content-Type": "application/x-www-form-urlencoded"})
    detail = assert_problem(curl, 415, "unsupported-media-type")
    assert "add --header 'Content-Type: application/octet-stream'" in detail
    for content, status, kind in ((data, 413, "too-large"), (data[:1000], 422, "invalid-argument")):
        answer = server.http.post("/v1/fits", content=content, headers={"Content-Type": "application/json"})
        assert "The body is a file, but its Content-Type is application/json" in assert_problem(answer, status, kind)


def test_query_options_for_a_stored_measurement_are_refused(server: Server, stored: str) -> None:
    answer = server.http.post("/v1/fits?n_lobes=2", json={"measurement": stored})
    assert "'options'" in assert_problem(answer, 422, "invalid-argument")


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
