"""Figures and thumbnails of fits, and the pages of the service with their files."""

import re
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from starlette.requests import Request

import dsbrdf_service
from dsbrdf import parse_merl, render_sphere
from dsbrdf.extras import MissingExtraError, require
from dsbrdf.output import from_json
from dsbrdf.rendering import displayed, exposure, sphere_normals
from dsbrdf_service.http.problems import KINDS, problem_of
from tests.support.merl_files import with_value
from tests.support.server import QUICK, Guarded, Server, assert_problem

pytestmark = pytest.mark.slow


def test_figures_are_drawn_and_names_are_no_formulas(server: Server, data: bytes) -> None:
    kind = {"Content-Type": "application/octet-stream", "Prefer": "wait=60"}
    query = {**QUICK, "em_iterations": 5, "name": "$$ and $x_{$"}
    own = with_value(data, 0.6)  # The measurement of other tests keeps its name.
    fit = server.http.post("/v1/fits", params=query, content=own, headers=kind).json()["id"]
    first = {}
    for figure in ("parameters", "residual"):
        url = f"/v1/fits/{fit}/figures/{figure}.svg"
        answer = server.http.get(url)
        assert (answer.status_code, answer.headers["content-type"]) == (200, "image/svg+xml")
        assert answer.content.startswith(b"<?xml")
        first[figure] = answer.content
        tag = answer.headers["etag"]
        assert server.http.get(url, headers={"If-None-Match": tag}).status_code == 304
    url = f"/v1/fits/{fit}/figures/residual.svg"
    dark, light = server.http.get(f"{url}?dark=true").content, server.http.get(url).content
    assert light == first["residual"]  # one tag, the same bytes
    assert b"#000000" in light
    assert b"#000000" not in dark  # no black marks
    assert b'z\n"/>' not in dark  # no areas without a colour, which are black
    server.http.patch(f"/v1/fits/{fit}", json={"name": "the title of the figure"})
    assert server.http.get(url, headers={"If-None-Match": tag}).status_code == 200
    for other in ("parameters.png", "profiles.svg", "sphere.svg"):
        assert_problem(server.http.get(f"/v1/fits/{fit}/figures/{other}"), 404, "not-found")


def test_a_missing_library_is_named() -> None:
    with pytest.raises(MissingExtraError) as raised:
        require("plot", "no_such_library", purpose="figures")
    problem = problem_of(Request({"type": "http", "path": "/", "headers": []}), raised.value)
    assert (KINDS[problem.kind].status, problem.kind) == (501, "not-installed")
    assert "pip install 'dsbrdf[plot]'" in problem.detail


PAGE = Path(dsbrdf_service.__file__).parent / "http" / "page"
PAGES = ("/", "/compare?fit=a&fit=b", f"/fits/{'0' * 32}", "/fits/unknown", f"/measurements/{'0' * 64}", "/docs")


def test_pages_load_nothing_from_other_hosts_and_run_no_script_of_their_own(server: Server) -> None:
    for path in PAGES:
        answer = server.http.get(path)
        assert (answer.status_code, answer.headers["x-frame-options"]) == (200, "DENY"), path
        policy = dict(part.split(" ", 1) for part in answer.headers["content-security-policy"].split("; "))
        allowed = {source for sources in policy.values() for source in sources.split()}
        assert allowed == {"'none'", "'self'", "blob:", "data:"}
        for name in ("default-src", "frame-ancestors", "base-uri", "form-action"):
            assert policy[name] == "'none'"
        assert (policy["script-src"], policy["style-src"], policy["connect-src"]) == ("'self'", "'self'", "'self'")
        assert re.findall(r"<script(?! (type=\"module\" )?src=)|<style| style=| on[a-z]+=", answer.text) == []
        for address in re.findall(r' (?:src|href|action)="([^"]+)"', answer.text):
            beside = "../" if answer.url.path.count("/") > 1 else "./"  # below the prefix of a proxy, too
            assert address.startswith((beside, "#", "data:")), address
            if re.search("/page/|/docs", address):
                assert server.http.get(answer.url.join(address)).status_code == 200


def test_pages_are_the_same_for_everyone(guarded: Guarded, server: Server) -> None:
    for path in PAGES:
        plain = server.http.get(path).content
        for headers in ({}, guarded.alice, {"Authorization": "Bearer x"}, {"Sec-Fetch-Site": "cross-site"}):
            answer = guarded.server.http.get(path, headers=headers)
            assert (answer.status_code, answer.content) == (200, plain)


def test_documentation_page_shows_the_openapi_document(server: Server) -> None:
    page, script = server.http.get("/docs"), server.http.get("/page/docs.js").text
    call = re.match(r'(\w+)\(\{ url: "([\w.]+)", dom_id: "#(\w+)"', script)
    assert call is not None
    assert f"{call[1]}=" in server.http.get("/docs/swagger-ui-bundle.js").text
    assert server.http.get(page.url.join(call[2])).json()["openapi"]
    assert f'id="{call[3]}"' in page.text


def test_static_files_are_small_guarded_and_cached(server: Server) -> None:
    paths = [f"/page/{file.name}" for file in PAGE.iterdir() if file.suffix in (".js", ".css")]
    for path in (*paths, "/docs/swagger-ui-bundle.js", "/docs/swagger-ui.css"):
        answer = server.http.get(path)
        kind = "text/css" if path.endswith("css") else "javascript"
        assert (answer.status_code, answer.headers["x-content-type-options"]) == (200, "nosniff"), path
        assert kind in answer.headers["content-type"]
        assert server.http.get(path, headers={"If-None-Match": answer.headers["etag"]}).status_code == 304
        assert server.http.get(path, headers={"Range": "bytes=9-1"}).content == answer.content  # RFC 9110, 14.2
    assert sum((PAGE / path.rpartition("/")[2]).stat().st_size for path in paths) < 150_000
    for path in ("/page/none.js", "/page/..%2fopenapi.py", "/docs/..%2fcore.py", "/docs/", "/fits/", "/fits/a/b"):
        assert_problem(server.http.get(path), 404, "not-found")


def test_thumbnail_is_the_fit_and_on_the_left_its_measurement_which_it_outlives(guarded: Guarded, data: bytes) -> None:
    http, own = guarded.server.http, guarded.new_key("alone")
    kind = {"Content-Type": "application/octet-stream", "Prefer": "wait=60"}
    fit = http.post("/v1/fits", params=QUICK, content=data, headers={**own, **kind}).json()
    thumbnail = f"/v1/fits/{fit['id']}/figures/thumbnail.png"
    answer = http.get(thumbnail, headers=own)
    shown = np.asarray(Image.open(BytesIO(answer.content)))[..., :3] / 255.0
    model = from_json(http.get(f"/v1/fits/{fit['id']}/export?format=json", headers=own).text)[0]
    size, half = len(shown), len(shown) // 2
    measured, fitted = (render_sphere(material, size=size) for material in (parse_merl(data), model))
    mask = sphere_normals(size)[1]
    expected = displayed(np.hstack([measured[:, :half], fitted[:, half:]]), exposure(fitted, mask))
    np.testing.assert_allclose(shown[mask], expected[mask], atol=0.51 / 255)
    http.delete(f"/v1/measurements/{fit['measurement']}", headers=own)
    again = http.get(thumbnail, headers=own)
    assert (again.content, again.headers["etag"]) == (answer.content, answer.headers["etag"])
