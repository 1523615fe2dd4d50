"""Tables of samples in a browser, an example of one, and what axe finds on all pages."""

import re
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from tests.service.http.page.conftest import Site
from tests.support.browser import PAINTED, Visit, expect
from tests.support.server import Guarded

pytest.importorskip("axe_playwright_python", reason='"axe_playwright_python" is not installed')

from axe_playwright_python.sync_playwright import Axe  # type: ignore[import-untyped]

pytestmark = pytest.mark.slow

FIT_PATIENCE_MS = 600_000  # A fit of a table takes seconds, and beyond a minute on a machine with ten times the work.


def test_newcomer_tries_an_example_and_sees_its_samples(visit: Visit, guarded: Guarded) -> None:
    header = guarded.new_key("newcomer")
    page = visit("/", header=header, webgl=False).page
    page.get_by_text("Options").click()
    page.get_by_text("More for fits").click()
    for title, value in (("Number of lobes", "3"), ("Number of ring lobes", "0")):
        page.get_by_label(title).select_option(value)
    expect(page.locator("#about-n_lobes")).to_contain_text("lobes")
    page.get_by_role("button", name="Try an example").click()
    page.wait_for_url("**/fits/*")
    expect(page.get_by_role("heading", name="example paint")).to_be_visible()
    expect(page.locator(".components")).to_contain_text("diffuse", timeout=FIT_PATIENCE_MS)
    expect(page.locator(".surfaces tr")).not_to_have_count(1)
    (fit,) = guarded.server.http.get("/v1/fits", headers=header).json()["items"]
    said = re.search(r"error probably below ([\d.]+)%", page.get_by_role("heading", name="Result:").inner_text())
    assert said is not None
    assert float(said[1]) == pytest.approx(100 * fit["metrics"]["relative_rms_expected"], rel=0.05)
    alpha = page.locator(".surfaces td").first.inner_text()
    assert float(alpha.split()[0]) == pytest.approx(0.15, rel=0.1)
    page.locator("#plots").scroll_into_view_if_needed()
    expect(page.locator("#profiles .legend")).to_contain_text("red, samples within 3°")
    expect(page.locator("#profiles .plot .point")).to_have_count(3)
    samples = page.locator("#plane .plot .point").first
    expect(samples).to_have_attribute("d", re.compile("M.*M"))
    marks = re.findall(r"M([\d.]+) ([\d.]+)h", samples.get_attribute("d") or "")
    highest = min(marks, key=lambda mark: float(mark[1]))
    assert float(highest[0]) > 800  # The highlight is opposite to the light, which comes from the left.
    page.get_by_label("theta_diff in degrees").fill("89")
    expect(page.locator("#profiles")).to_contain_text(re.compile(r"There are no samples here; most are at \d+°"))
    page.locator("#figures summary").click()
    expect(page.locator("#residual")).not_to_have_js_property("naturalWidth", 0)
    page.get_by_role("link", name="Its measurement").click()
    expect(page.locator("#its-fits a")).to_have_count(1)
    expect(page.locator(".columns")).to_contain_text("theta_in")
    page.locator("#profiles").scroll_into_view_if_needed()
    expect(page.locator("#profiles .plot .point")).to_have_count(3)
    expect(page.locator("#profiles .plot .curve")).to_have_count(0)
    expect(page.locator("#profiles")).not_to_contain_text("components")
    expect(page.locator(".samples tr").filter(has_text="Largest")).to_be_visible()
    page.locator("#fit-it summary").first.click()
    for title, value in (("Number of lobes", "3"), ("Number of ring lobes", "0")):
        page.get_by_label(title).evaluate("(field, value) => { field.value = value; }", value)
    page.get_by_role("button", name="Fit this measurement").click()
    page.wait_for_url(f"**/fits/{fit['id']}")  # An equal fit is not computed again.
    page.get_by_role("link", name="Fits").click()
    expect(page.locator("#fits .card")).to_have_count(1)
    expect(page.get_by_role("button", name="Try an example")).to_be_hidden()


def test_table_is_understood_before_it_is_sent(visit: Visit, guarded: Guarded, tmp_path: Path) -> None:
    header = guarded.new_key("laboratory")
    visitor = visit("/", header=header, webgl=False)
    page = visitor.page
    table = tmp_path / "tile.csv"
    angles = product((0, 30, 60), range(-80, 81, 5))
    rows = [f"{light},{seen},{100 * (0.1 + np.exp(-(((seen - light) / 15) ** 2)))}" for light, seen in angles]
    table.write_text("\n".join(["AOI,AOR,signal", *rows]))
    page.locator("#file").set_input_files(table)
    shown = page.locator("#table")
    expect(shown.get_by_role("alert")).to_contain_text("name it with “Meaning of columns”")
    button = page.get_by_role("button", name="Fit this table")
    expect(button).to_be_disabled()
    page.get_by_label("Read signal as").select_option("value")
    expect(button).to_be_enabled()
    page.get_by_text("Options").click()
    expect(page.get_by_label("Meaning of columns")).to_have_value("value=signal")
    page.get_by_label("Multiply all values by").fill("0.01")
    page.get_by_label("Multiply all values by").blur()
    expect(page.get_by_label("Read AOI as")).to_have_value("theta_in")
    expect(shown.locator(".samples tr").filter(has_text="Largest")).to_contain_text("1.1")
    expect(shown).to_contain_text("99 rows, 99 samples. The angles of incidence are 0°, 30°, 60°. 100% of the samples")
    assert guarded.server.http.get("/v1/measurements", headers=header).json()["items"] == []
    expect(button).to_be_enabled()
    button.click()
    page.wait_for_url("**/fits/*")
    page.get_by_role("button", name="Cancel the fit").click()
    expect(page.get_by_text("This fit was cancelled.")).to_be_visible()
    (fit,) = guarded.server.http.get("/v1/fits", headers=header).json()["items"]
    assert "scale" not in fit["options"]  # it belongs to the measurement
    page.set_viewport_size({"width": 390, "height": 844})
    page.get_by_role("link", name="Its measurement").click()
    page.get_by_text("More", exact=True).click()
    expect(page.get_by_role("button", name="Delete")).to_be_in_viewport(ratio=1)
    page.locator("#profiles").scroll_into_view_if_needed()
    expect(page.locator("#profiles .plot .point")).to_have_count(1)  # All channels are equal.
    page.get_by_role("link", name="Fits").click()
    table.write_text(table.read_text().replace("signal", "value"))
    page.locator("#file").set_input_files(table)
    expect(shown.locator(".samples")).to_be_visible()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_axe_finds_nothing_in_light_and_dark(visit: Visit, site: Site, data: bytes) -> None:
    glossy, rough = site.fits["glossy"], site.fits["rough"]
    failed = site.submit(data, "failing", method="paper", n_lobes=8, mask=10, horizon_cutoff_deg=2)
    table = "theta_in,theta_out,value\n" + "\n".join(f"{a},{b},1" for a, b in product((0, 40), range(-80, 81, 5)))
    sent = site.http.post("/v1/measurements", content=table, headers={**site.header, "Content-Type": "text/csv"})
    page = visit("/", bypass_csp=True).page  # the policy of the pages keeps axe out too
    # Light and dark differ in colours only.
    brief: dict[str, Any] = {"resultTypes": ["violations"]}
    schemes: list[tuple[Literal["light", "dark"], dict[str, Any]]] = [
        ("light", brief),
        ("dark", brief | {"runOnly": ["cat.color"]}),
    ]
    fits = [f"/fits/{fit}" for fit in (glossy, failed, "0" * 32)]
    for path in ("/", *fits, f"/compare?fit={glossy}&fit={rough}", f"/measurements/{sent.json()['sha256']}"):
        page.goto(path)
        expect(page.locator("main")).not_to_have_attribute("aria-busy", "true")
        if glossy in path:
            page.locator(PAINTED).first.wait_for()
        for folded in page.locator("main details:not([hidden])").all():
            folded.locator("> summary").click()
        for scheme, rules in schemes if path in ("/", *fits[:2]) else schemes[:1]:
            page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
            found = Axe().run(page, options=rules)
            assert found.violations_count == 0, f"{path}, {scheme}: {found.generate_report()}"
