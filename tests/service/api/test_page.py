"""The files of the web page, and the resources that were made for it."""

import io
import re
from pathlib import Path

import httpx
import numpy as np
import pytest
from PIL import Image

import dsbrdf_service
from dsbrdf import Measurement, parse_merl, render_sphere
from dsbrdf.output import from_json
from dsbrdf.rendering import displayed, exposure, sphere_normals
from tests.support.guarded import Guarded
from tests.support.points import npy
from tests.support.server import QUICK, Server, assert_problem

NPY = {"Content-Type": "application/x-npy", "Accept": "application/x-npy"}
PAGE = Path(dsbrdf_service.__file__).parent / "http" / "page"
PAGES = ("/", "/compare?fit=a&fit=b", f"/fits/{'0' * 32}", "/fits/unknown", f"/measurements/{'0' * 64}", "/docs")


def array(answer: httpx.Response) -> np.ndarray:
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "application/x-npy"
    loaded: np.ndarray = np.load(io.BytesIO(answer.content))
    return loaded


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
            assert re.match(r"(\./|\.\./|#|data:)", address), address
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
    assert sum((PAGE / path.rpartition("/")[2]).stat().st_size for path in paths) < 150_000
    for path in ("/page/none.js", "/page/..%2fopenapi.py", "/docs/..%2fcore.py", "/docs/", "/fits/", "/fits/a/b"):
        assert_problem(server.http.get(path), 404, "not-found")


def test_thumbnail_outlives_its_measurement(guarded: Guarded, data: bytes) -> None:
    http, own = guarded.server.http, guarded.new_key("alone")
    kind = {"Content-Type": "application/octet-stream", "Prefer": "wait=60"}
    fit = http.post("/v1/fits", params=QUICK, content=data, headers={**own, **kind}).json()
    thumbnail = f"/v1/fits/{fit['id']}/figures/thumbnail.png"
    small = http.get(thumbnail, headers=own)
    http.delete(f"/v1/measurements/{fit['measurement']}", headers=own)
    again = http.get(thumbnail, headers=own)
    assert again.content == small.content  # half of it is the measurement: it is stored with the fit
    assert again.headers["etag"] == small.headers["etag"]


def test_thumbnail_is_the_fit_and_on_the_left_its_measurement(server: Server, data: bytes) -> None:
    fit = server.http.post("/v1/fits", params=QUICK | {"em_iterations": 4}, content=data).json()["id"]
    answer = server.http.get(f"/v1/fits/{fit}/figures/thumbnail.png")
    shown = np.asarray(Image.open(io.BytesIO(answer.content)))[..., :3] / 255.0
    model = from_json(server.http.get(f"/v1/fits/{fit}/export?format=json").text)[0]
    size, half = len(shown), len(shown) // 2
    measured, fitted = (render_sphere(material, size=size) for material in (parse_merl(data), model))
    mask = sphere_normals(size)[1]
    expected = displayed(np.hstack([measured[:, :half], fitted[:, half:]]), exposure(fitted, mask))
    np.testing.assert_allclose(shown[mask], expected[mask], atol=0.51 / 255)


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (b"\0" * 12, "not a whole .npy file"),
        (npy(np.zeros((8, 8, 3))), "it must be (rows, 2 rows, 3)"),
        (npy(np.zeros((8, 16, 3), "i4")), "must hold float64 or float32"),
        (npy(np.full((8, 16, 3), np.nan)), "values from 0 to 1e+10"),
        (npy(np.full((8, 16, 3), 1e30)), "values from 0 to 1e+10"),
        (npy(np.zeros((8, 16, 3))), "is black"),
    ],
)
def test_panorama_that_is_none_is_refused(server: Server, fitted: str, stored: str, body: bytes, said: str) -> None:
    for path in (f"/v1/fits/{fitted}", f"/v1/measurements/{stored}"):
        answer = server.http.post(f"{path}/figures/sphere.npy", content=body, headers=NPY)
        assert said in assert_problem(answer, 422, "invalid-argument")


def test_table_is_the_measurement_without_gaps(server: Server, stored: str, plastic: Measurement) -> None:
    table = array(server.http.get(f"/v1/measurements/{stored}/table.npy"))
    assert table.shape == (90, 90, 180, 3)
    assert table.dtype.name == "float16"
    i, j, k = (np.array(index) for index in ((0, 30, 60), (45, 10, 80), (0, 90, 179)))
    angles = np.radians(i**2 / 90.0), np.radians(j), np.radians(k)
    expected = plastic.interpolated.evaluate(*angles)
    assert np.exp(table[i, j, k].astype(float)) - 1e-6 == pytest.approx(expected, rel=5e-3, abs=1e-6)


def test_likeness_is_said_in_words(server: Server, fitted: str) -> None:
    fit = server.http.get(f"/v1/fits/{fitted}").json()
    assert fit["likeness"].endswith(f"({fit['metrics']['psnr']:.1f} dB)")
    assert fit["likeness"] in [item["likeness"] for item in server.http.get("/v1/fits").json()["items"]]
