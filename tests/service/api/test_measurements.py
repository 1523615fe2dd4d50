"""Stored measurements: downloads, parts of them, deletion."""

import hashlib

import dsbrdf
from dsbrdf.data import FILE_SIZE, encode_merl
from tests.support.server import Server, assert_problem


def test_downloaded_measurement_equals_the_upload(server: Server, data: bytes, stored: str) -> None:
    assert stored == hashlib.sha256(data).hexdigest()
    place = f"/v1/measurements/{stored}"
    url = f"{place}/content"
    got = server.http.get(url)
    assert got.content == data
    assert got.headers["etag"] == f'"{stored}"'
    head = server.http.head(url)
    assert (head.status_code, head.content) == (200, b"")
    assert int(head.headers["content-length"]) == FILE_SIZE
    assert head.headers["etag"] == f'"{stored}"'
    assert server.http.head(url, headers={"If-None-Match": f'W/"{stored}"'}).status_code == 304
    assert server.http.head(f"/v1/measurements/{'0' * 64}/content").status_code == 404
    named = server.http.get(place, headers={"Accept": "application/octet-stream, application/json;q=0.5"})
    assert (named.content, named.headers["etag"]) == (data, got.headers["etag"])
    again = server.http.post("/v1/measurements", content=data)
    assert again.status_code == 200
    assert again.json()["sha256"] == stored
    assert again.json()["valid_nodes"] == dsbrdf.parse_merl(data).valid.sum()
    assert again.headers["location"] == place


def test_measurement_is_deleted_unless_a_fit_uses_it(server: Server, matte: dsbrdf.Measurement) -> None:
    sha256 = server.http.post("/v1/measurements", content=encode_merl(matte)).json()["sha256"]
    url = f"/v1/measurements/{sha256}"
    fit_id = server.submit(sha256, prefer="respond-async", n_lobes=8).json()["id"]
    answer = server.http.delete(url)
    assert_problem(answer, 409, "measurement-in-use")
    assert server.http.get(f"/v1/fits/{fit_id}?wait=60").json()["status"] == "succeeded"
    assert server.http.delete(url).status_code == 204
    assert_problem(server.http.delete(url), 404, "not-found")
    assert_problem(server.http.get(url), 404, "not-found")
    assert sha256 not in [path.stem for path in server.files()]
    points = {"theta_half_deg": 1, "theta_diff_deg": 1}
    assert server.http.get(f"/v1/fits/{fit_id}/brdf", params=points).status_code == 200
    assert_problem(server.submit(sha256, n_lobes=2), 404, "not-found")


def test_measurement_has_a_document_with_its_fits(server: Server, matte: dsbrdf.Measurement) -> None:
    content = encode_merl(matte)[:-1] + b"\xc1"
    uploaded = server.http.post("/v1/measurements", params={"name": "paint"}, content=content).json()
    url = f"/v1/measurements/{uploaded['sha256']}"
    assert server.http.get(url).json() == {**uploaded, "fits": []}
    fits = [server.submit(uploaded["sha256"], n_lobes=n).json()["id"] for n in (1, 2)]
    answer = server.http.get(url, headers={"Accept": "text/html, */*"})
    assert answer.json() == {**uploaded, "fits": fits[::-1]}
    assert answer.json().keys() >= {"name", "size", "created"}
    head = server.http.head(url)
    for name in ("content-type", "content-length", "etag"):
        assert head.headers[name] == answer.headers[name]
    file = server.http.get(url, headers={"Accept": "application/octet-stream"})
    assert (file.content, file.headers["etag"]) == (content, f'"{uploaded["sha256"]}"')
    for either in (answer, file):
        assert "Accept" in either.headers["vary"]
    assert_problem(server.http.get(f"/v1/measurements/{'0' * 64}"), 404, "not-found")
    server.http.delete(url)
    assert_problem(server.http.get(url), 404, "not-found")
