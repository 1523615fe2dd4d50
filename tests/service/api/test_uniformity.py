"""What holds for all routes alike: HEAD, unknown parameters, headers, forwarded addresses, who sees the metrics."""

import pytest

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
    parts = [f"{fit}/{part}" for part in ("events", "components", "export", "brdf")]
    parts += [fit, measurement, "/v1/fits", "/v1/measurements", "/health/live", "/health/ready", "/metrics"]
    requests = [("GET", path) for path in parts] + [("DELETE", path) for path in (fit, measurement)]
    requests += [("POST", f"{fit}/brdf"), ("POST", "/v1/measurements")]
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
