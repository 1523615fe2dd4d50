"""The pages as they are sent: what they say, what they load, and their errors."""

import re
from typing import Any

import httpx
import numpy as np
import pytest

import dsbrdf
from dsbrdf.data.merl import parse_merl
from dsbrdf_service.http.pages import STATIC_FILES
from tests.support.guarded import Guarded
from tests.support.server import QUICK, Server, assert_problem

MISSING = "0" * 32


def page_at(server: Server, path: str, status: int = 200) -> httpx.Response:
    answer = server.http.get(path)
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    return answer


def test_pages_load_nothing_from_other_hosts(server: Server, fitted: str) -> None:
    pages = ("/", f"/fits/{fitted}", f"/compare?fit={fitted}&fit={fitted}", "/sign-in", f"/fits/{MISSING}", "/docs")
    for path in pages:
        answer = server.http.get(path)
        policy = dict(part.split(" ", 1) for part in answer.headers["content-security-policy"].split("; "))
        assert {source for sources in policy.values() for source in sources.split()} == {"'none'", "'self'", "data:"}
        assert (policy["default-src"], policy["script-src"], policy["style-src"]) == ("'none'", "'self'", "'self'")
        assert re.findall(r"<script(?! (type=\"module\" )?src=)|<style| style=| on[a-z]+=", answer.text) == []
        for address in re.findall(r'(?:src|href|action)="([^"]+)"', answer.text):
            assert re.match(r"(\./|\.\./|#|data:,$)", address), address
        for address in re.findall(r'(?:src|href)="([^"]*(?:page|docs)/[^"]+)"', answer.text):
            assert server.http.get(answer.url.join(address)).status_code == 200


def test_documentation_page_shows_the_openapi_document(server: Server) -> None:
    page, script = server.http.get("/docs"), server.http.get("/page/docs.js").text
    call = re.match(r'(\w+)\(\{ url: "([\w.]+)", dom_id: "#(\w+)"', script)
    assert call is not None
    assert f"{call[1]}=" in server.http.get("/docs/swagger-ui-bundle.js").text
    assert server.http.get(page.url.join(call[2])).json()["openapi"]
    assert f'id="{call[3]}"' in page.text


def test_every_static_file_is_there_and_ours_are_small(server: Server) -> None:
    answers = {path: server.http.get(path) for path in STATIC_FILES}
    for path, answer in answers.items():
        assert answer.headers["content-type"].partition(";")[0] == STATIC_FILES[path][1].partition(";")[0]
        known = server.http.get(path, headers={"If-None-Match": answer.headers["etag"]})
        assert known.status_code == 304
    assert sum(len(answer.content) for path, answer in answers.items() if path.startswith("/page/")) < 100_000
    for path in ("/page/fit.html", "/docs/redoc.standalone.js", "/docs/..%2fcore.py", "/docs/"):
        assert_problem(server.http.get(path), 404, "not-found")


def test_errors_of_pages_are_pages(server: Server, fitted: str) -> None:
    assert f"There is no fit &#39;{MISSING}&#39;" in page_at(server, f"/fits/{MISSING}", 404).text
    assert "There is nothing at /fits/x" in page_at(server, "/fits/x", 404).text
    assert "tick two in the list, not 1" in page_at(server, f"/compare?fit={fitted}", 422).text
    assert "fit" in page_at(server, "/compare", 422).text
    assert "cursor" in page_at(server, "/?cursor=x", 422).text


def test_names_are_text_not_markup(server: Server, data: bytes) -> None:
    name = "<b>&'\"{{ 7 * 7 }}"
    kind = {"Content-Type": "application/octet-stream", "Prefer": "wait=60"}
    query = {"name": name, **QUICK, "em_iterations": 4}
    fit = server.http.post("/v1/fits", params=query, content=data, headers=kind).json()["id"]
    for path in ("/", f"/fits/{fit}", f"/compare?fit={fit}&fit={fit}"):
        text = page_at(server, path).text
        assert "&lt;b&gt;&amp;&#39;&#34;{{ 7 * 7 }}" in text
        assert "<b>" not in text


def assert_components_add_up(curves: dict[str, Any]) -> None:
    parts = [component["values"] for component in curves["components"]]
    assert len(parts) > 1
    assert np.sum(parts, axis=0) == pytest.approx(np.array(curves["fit"]), rel=2e-3, abs=1e-9)


def test_profile_has_the_measurement_and_components_that_add_up(server: Server, fitted: str) -> None:
    profile = server.http.get(f"/fits/{fitted}/profiles/30").json()
    assert profile["theta_diff_deg"] == 30.0
    assert_components_add_up(profile)
    peak, fit = profile["measured"][1][1], profile["fit"][1]
    assert 0.5 * peak < max(fit) < 2.0 * peak
    for angle in ("90", "1_0", "%D9%A1%D9%A0"):
        assert_problem(server.http.get(f"/fits/{fitted}/profiles/{angle}"), 404)


def test_plane_of_incidence_has_the_measurement_and_the_fit(
    server: Server, fitted: str, model: dsbrdf.DSBRDF, data: bytes
) -> None:
    polar = server.http.get(f"/fits/{fitted}/polar/40").json()
    table = parse_merl(data)
    # The mirror direction of 40 degrees is at node 0 of theta_half and of phi_diff, and node 40 of theta_diff.
    assert polar["theta_out_deg"][129] == 40
    assert [channel[129] for channel in polar["fit"]] == pytest.approx(model.evaluate(0.0, np.radians(40)), rel=1e-3)
    measured = table.values[:, 0, 40, 0]
    assert [channel[129] for channel in polar["measured"]] == pytest.approx(measured, rel=1e-3)
    # Towards the light theta_diff is 0.
    back = model.evaluate(np.radians(40), 0.0)
    assert [channel[49] for channel in polar["fit"]] == pytest.approx(back, rel=1e-3)
    assert_components_add_up(polar)
    diffuse = dsbrdf.decompose(model)["diffuse"].evaluate(0.0, np.radians(40))
    assert polar["components"][-1]["label"] == "diffuse"
    assert [channel[129] for channel in polar["components"][-1]["values"]] == pytest.approx(diffuse, rel=1e-3)
    for angle in (3, 90, "1_0", "%D9%A1%D9%A0"):  # the last two are numbers only for Python
        assert_problem(server.http.get(f"/fits/{fitted}/polar/{angle}"), 404)


def test_table_of_components_says_what_the_api_says(server: Server, fitted: str) -> None:
    text = page_at(server, f"/fits/{fitted}").text
    assert "method = paper, n_lobes = 2, em_iterations = 20" in text
    rows = {
        name: [re.findall(r"<span>([^<]*)</span>", cell) for cell in cells.split("<td>")[1:]]
        for name, cells in re.findall(r'<tr><th scope="row">([^<]+)</th>\s*(<td>.*?)</tr>', text, re.DOTALL)
        if "<span>" in cells
    }
    components = server.http.get(f"/v1/fits/{fitted}/components").json()["items"]
    assert re.findall(r'<th scope="col" .*?component=(\w+)', text) == [component["label"] for component in components]
    swatches = re.findall(r'class="swatch".*?fill="#(\w{6})"', text)
    for index, component in enumerate(components):
        linear = np.array(component["color"])
        srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)  # IEC 61966-2-1
        assert np.abs(np.array([*bytes.fromhex(swatches[index])]) - 255.0 * srgb).max() <= 0.51
        shown = {name: cells[index] for name, cells in rows.items()}
        low, high = component["ranges"]["light_share"]
        assert shown.pop("light") == [f"{component['light_share']:.0%} ({low:.0%} to {high:.0%})"]
        numbers = {
            name: [None if text == "–" else float(text.rstrip("°")) for text in texts] for name, texts in shown.items()
        }
        width, f0 = component["half_width_deg"], component["f0"]
        assert numbers == {
            "colour": pytest.approx(component["color"], abs=0.005),
            "albedo": pytest.approx(component["albedo"], abs=0.0005),
            "alpha": [None if width is None else pytest.approx(component["alpha"], rel=0.005)],
            "half width": [None if width is None else pytest.approx(width, rel=0.005)],
            "tail": [None if width is None else pytest.approx(component["kappa"], rel=0.05)],
            "F0": [None] if f0 is None else pytest.approx(f0, rel=0.005),
            "height in 1/sr": pytest.approx(component["lobe"]["height"][0], rel=0.005),
        }


def test_measured_and_fitted_have_pictures(server: Server, fitted: str) -> None:
    assert server.http.get(f"/fits/{fitted}/view").json()["pictures"] == ["fit", "measured", "difference"]
    assert server.http.get(f"/fits/{fitted}/spheres/difference.png").content.startswith(b"\x89PNG")
    missing = server.http.get(f"/fits/{fitted}/spheres/other.png")
    assert "there is fit, measured, difference" in assert_problem(missing, 404)


def test_fit_without_its_measurement_is_shown_alone(guarded: Guarded, data: bytes) -> None:
    own = guarded.new_key("alone")
    kind = {"Content-Type": "application/octet-stream", "Prefer": "wait=60"}
    fit = guarded.server.http.post("/v1/fits", params=QUICK, content=data, headers={**own, **kind}).json()
    measured = f"v1/measurements/{fit['measurement']}/figures/sphere.png"
    assert measured in guarded.server.http.get("/", headers=own).text
    guarded.server.http.delete(f"/v1/measurements/{fit['measurement']}", headers=own)
    listed = guarded.server.http.get("/", headers=own).text
    assert (f"v1/fits/{fit['id']}/figures/sphere.png" in listed, measured in listed) == (True, False)
    assert guarded.server.http.get(f"/fits/{fit['id']}/view", headers=own).json()["pictures"] == ["fit"]
    profile = guarded.server.http.get(f"/fits/{fit['id']}/profiles/0", headers=own).json()
    assert (profile["measured"], len(profile["fit"])) == (None, 3)
    assert guarded.server.http.get(f"/fits/{fit['id']}/polar/0", headers=own).json()["measured"] is None
    assert "figures/residual.svg" not in guarded.server.http.get(f"/fits/{fit['id']}", headers=own).text


def test_list_has_pages(server: Server, fitted: str, stored: str) -> None:
    server.submit(stored, **QUICK)
    first = page_at(server, "/?limit=1")
    found = re.search(r'href="\./\?(cursor=[0-9]+)">Older', first.text)
    assert found
    second = page_at(server, f"/?{found[1]}")
    assert re.findall(r'value="([0-9a-f]{32})"', first.text)[0] not in second.text
    assert re.search('id="no-match" class="note" >No fits found.*>nobody<', page_at(server, "/?name=nobody").text)
