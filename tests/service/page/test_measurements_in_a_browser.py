"""Tables of samples in a browser, an example of one, and what axe finds on all pages."""

import re
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from tests.service.page.conftest import Site
from tests.support.browser import PAINTED, Visit, expect
from tests.support.guarded import Guarded

pytest.importorskip("axe_playwright_python", reason='"axe_playwright_python" is not installed')

from axe_playwright_python.sync_playwright import Axe  # type: ignore[import-untyped]

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def table_fit(site: Site) -> dict[str, Any]:
    """A fit of a table of samples in planes of incidence."""
    rows = ["theta_in,phi_in,theta_out,phi_out,red,green,blue"]
    for theta_in, theta_out in product((0, 30, 60), range(-80, 81, 4)):
        height = 0.1 + np.exp(-(((theta_out - theta_in) / 15) ** 2))
        rows.append(f"{theta_in},180,{abs(theta_out)},{0 if theta_out >= 0 else 180},{height},{height},{height / 2}")
    headers = site.header | {"Content-Type": "text/csv", "Prefer": "wait=60"}
    query = {"name": "table", "n_lobes": "1", "ring_lobes": "0"}
    fit: dict[str, Any] = site.http.post("/v1/fits", params=query, content="\n".join(rows), headers=headers).json()
    assert fit["status"] == "succeeded"
    return fit


def test_newcomer_tries_an_example(visit: Visit, guarded: Guarded) -> None:
    key = guarded.new_key("newcomer")["Authorization"].removeprefix("Bearer ")
    page = visit("/", key=key, webgl=False).page
    page.get_by_text("Options").click()
    page.get_by_label("n_lobes", exact=True).select_option("1")
    page.get_by_role("button", name="Try an example").click()
    page.wait_for_url("**/fits/*")
    expect(page.get_by_role("heading", name="example paint")).to_be_visible()
    expect(page.locator(".components")).to_contain_text("diffuse")
    alpha = page.locator(".components tr").filter(has_text="alpha").inner_text()
    assert float(alpha.split()[1]) == pytest.approx(0.15, rel=0.1)
    page.get_by_role("link", name="Fits").click()
    expect(page.locator(".card")).to_have_count(1)
    expect(page.get_by_role("button", name="Try an example")).to_be_hidden()


def test_samples_are_shown_beside_the_fit_and_before_it(visit: Visit, table_fit: dict[str, Any]) -> None:
    page = visit(f"/fits/{table_fit['id']}", webgl=False).page
    page.locator("#plots").scroll_into_view_if_needed()
    expect(page.locator("#profiles")).to_contain_text("Points are samples within 3°, full lines are the fit")
    expect(page.locator("#profiles .plot .point")).to_have_count(3)
    page.get_by_label("theta_in in degrees").fill("30")
    red = page.locator("#plane .plot .point").first
    expect(red).to_have_attribute("d", re.compile("M.*M"))
    page.get_by_label("theta_in in degrees").fill("85")
    expect(page.locator("#plane")).to_contain_text(re.compile("There are no samples here; most are at (0|30|60)°"))
    page.locator("#figures-title").click()
    expect(page.locator("#figures img").nth(1)).not_to_have_js_property("naturalWidth", 0)
    page.goto(f"/measurements/{table_fit['measurement']}")
    expect(page.locator("#its-fits a")).to_have_count(1)
    expect(page.locator(".columns")).to_contain_text("theta_out")
    page.locator("#profiles").scroll_into_view_if_needed()
    expect(page.locator("#profiles .plot .point")).to_have_count(3)
    expect(page.locator("#profiles .plot .curve")).to_have_count(0)
    page.get_by_text("Options").click()
    page.get_by_label("scale", exact=True).fill("10")
    page.get_by_label("scale", exact=True).blur()
    height = 10 * (0.1 + 1.0)
    expect(page.locator(".samples tr").filter(has_text="Largest")).to_contain_text(f"{height:g}")


def test_table_is_understood_before_it_is_sent(visit: Visit, guarded: Guarded, tmp_path: Path) -> None:
    header = guarded.new_key("laboratory")
    visitor = visit("/", key=header["Authorization"].removeprefix("Bearer "), webgl=False)
    page = visitor.page
    table = tmp_path / "tile.csv"
    angles = product((0, 30, 60), range(-80, 81, 5))
    rows = [f"{light},{seen},{100 * (0.1 + np.exp(-(((seen - light) / 15) ** 2)))}" for light, seen in angles]
    table.write_text("\n".join(["AOI,AOR,reflectance", *rows]))
    page.locator("#file").set_input_files(table)
    shown = page.locator("#table")
    expect(shown.get_by_role("alert")).to_contain_text("The table lacks columns for the values")
    button = page.get_by_role("button", name="Fit this table")
    expect(button).to_be_disabled()
    for name, value in (("columns", "value=reflectance"), ("scale", "0.01")):
        page.get_by_label(name, exact=True).fill(value)
        page.get_by_label(name, exact=True).blur()
    expect(shown.locator(".columns tr").last).to_have_text("reflectancevaluenone")
    expect(shown.locator(".samples tr").filter(has_text="Largest")).to_contain_text("1.1")
    expect(shown).to_contain_text("99 rows, 99 samples. The light comes at 0°, 30°, 60°. 100 % of the samples lie in")
    assert guarded.server.http.get("/v1/measurements", headers=header).json()["items"] == []
    page.get_by_label("n_lobes", exact=True).select_option("1")
    expect(button).to_be_enabled()
    button.click()
    page.wait_for_url("**/fits/*")
    expect(page.locator(".components")).to_contain_text("light")
    page.get_by_text("Options of the fit").click()
    expect(page.locator("#options div").filter(has_text="columns")).to_contain_text("value=reflectance")


def test_axe_finds_nothing_in_light_and_dark(visit: Visit, site: Site, table_fit: dict[str, Any]) -> None:
    glossy, rough = site.fits["glossy"], site.fits["rough"]
    page = visit("/", bypass_csp=True).page  # the policy of the pages keeps axe out too
    # Light and dark differ in colours only.
    schemes: list[tuple[Literal["light", "dark"], Any]] = [("light", None), ("dark", {"runOnly": ["cat.color"]})]
    measured = [f"/measurements/{one['measurement']}" for one in (table_fit, site.read(f"/v1/fits/{glossy}").json())]
    for path in ("/", f"/fits/{glossy}", f"/compare?fit={glossy}&fit={rough}", f"/fits/{'0' * 32}", *measured):
        page.goto(path)
        expect(page.locator("main")).not_to_have_attribute("aria-busy", "true")
        if glossy in path:
            page.locator(PAINTED).first.wait_for()
            for folded in page.locator("main details").all():
                folded.locator("summary").click()
        for scheme, rules in schemes:
            page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
            found = Axe().run(page, options=rules)
            assert found.violations_count == 0, f"{path}, {scheme}: {found.generate_report()}"
