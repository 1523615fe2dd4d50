"""The pages in a browser: every state and control, no message of the browser, no request to another host."""

import re
from pathlib import Path

import numpy as np
import pytest

from dsbrdf.data.merl import write_merl
from dsbrdf.data.synthetic import synthetic_measurement
from dsbrdf.model.image_metrics import displayed, psnr
from dsbrdf.model.render import render_sphere, sphere_normals
from tests.service.page.conftest import Site
from tests.support.browser import PAINTED, SPHERE, Browser, Visit, expect, new_context
from tests.support.guarded import Guarded
from tests.support.server import ENDLESS

pytestmark = pytest.mark.slow


def test_key_is_asked_for_kept_in_the_tab_and_forgotten(visit: Visit, site: Site) -> None:
    visitor = visit(f"/fits/{site.fits['glossy']}", key=None, webgl=False)
    page = visitor.page
    dialog = page.get_by_role("dialog", name="Sign in")
    expect(dialog).to_be_visible()
    page.keyboard.press("Escape")
    for wrong in ("dsbrdf_wrong", "schlüssel €"):
        page.get_by_label("API key").fill(wrong)
        page.get_by_role("button", name="Sign in").click()
        expect(dialog.get_by_role("alert")).to_contain_text("no valid key")
    page.get_by_label("API key").fill(site.key)
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="glossy")).to_be_visible()
    expect(dialog).to_be_hidden()
    expect(page.locator("img.fallback")).to_have_js_property("naturalWidth", 128)
    assert visitor.context.cookies() == []
    assert page.evaluate("localStorage.length") == 0
    assert [url for _, url, _ in visitor.requests if site.key in url] == []
    page.get_by_role("link", name="Fits").click()
    expect(page.locator(".card").nth(1)).to_be_visible()
    page.get_by_role("button", name="Sign out").click()
    expect(dialog).to_be_visible()
    assert page.evaluate("sessionStorage.length") == 0


def test_key_of_another_sees_nothing_and_other_sites_get_nothing(
    visit: Visit, site: Site, browser: "Browser", guarded: Guarded
) -> None:
    fit = site.fits["glossy"]
    other = guarded.new_key("other")["Authorization"].removeprefix("Bearer ")
    page = visit(f"/fits/{fit}", key=other, webgl=False).page
    expect(page.get_by_role("alert")).to_contain_text("There is no fit")
    page.goto("/")
    expect(page.get_by_role("heading", name="Fit your first material")).to_be_visible()
    before = len(site.read("/v1/fits").json()["items"])
    # A page of another origin, in the browser of someone who has signed in and has cookies that were planted.
    context = new_context(browser, site.address, site.key)
    context.add_cookies([{"name": name, "value": site.key, "url": site.address} for name in ("key", "dsbrdf_key")])
    foreign = context.new_page()
    foreign.route(
        "http://elsewhere.example/*", lambda route: route.fulfill(body="<!doctype html>", content_type="text/html")
    )
    foreign.goto("http://elsewhere.example/")
    found = foreign.evaluate(
        """async ([site, fit]) => {
          const frame = document.createElement("iframe");
          frame.src = `${site}/fits/${fit}`;
          document.body.append(frame);
          const get = (path, options) => fetch(site + path, { credentials: "include", ...options })
            .then((answer) => [answer.type, answer.status], () => "refused");
          const text = { method: "POST", headers: { "Content-Type": "text/plain" }, body: "{}" };
          const answers = [get(`/v1/fits/${fit}`), get("/v1/fits", text), get(`/v1/fits/${fit}`, { method: "DELETE" }),
            get(`/v1/fits/${fit}`, { mode: "no-cors" })];
          const got = await Promise.all(answers);
          await new Promise((resolve) => { frame.onload = resolve; setTimeout(resolve, 2000); });
          try { got.push(frame.contentDocument?.body.textContent ?? "closed"); } catch { got.push("closed"); }
          return got;
        }""",
        [site.address, fit],
    )
    context.close()
    assert found[:3] == ["refused"] * 3
    assert found[3] in ("refused", ["opaque", 0])
    assert found[4] in ("closed", "")
    assert site.read(f"/v1/fits/{fit}").json()["status"] == "succeeded"
    assert len(site.read("/v1/fits").json()["items"]) == before


def test_file_is_hashed_then_sent_once(visit: Visit, plastic_file: Path, guarded: Guarded) -> None:
    key = guarded.new_key("first")["Authorization"].removeprefix("Bearer ")
    visitor = visit("/", key=key, webgl=False)
    page = visitor.page
    expect(page.get_by_role("heading", name="Fit your first material")).to_be_visible()
    for number in (1, 2):
        page.get_by_text("Options").click()
        page.get_by_label("n_lobes", exact=True).select_option(str(number))
        page.get_by_label("method", exact=True).select_option("paper")
        page.locator("#file").set_input_files(plastic_file)
        page.wait_for_url("**/fits/*")
        expect(page.get_by_role("heading", name="plastic")).to_be_visible()
        expect(page.locator("[data-text=model]")).to_contain_text(f"The model has {number} lobe")
        page.get_by_role("link", name="Fits").click()
    sent = [(method, kind) for method, url, kind in visitor.requests if method in ("HEAD", "POST")]
    assert sent == [("HEAD", ""), ("POST", "application/octet-stream"), ("HEAD", ""), ("POST", "application/json")]


def test_running_fit_shows_its_progress_and_can_be_cancelled(visit: Visit, site: Site, data: bytes) -> None:
    options = {name: ",".join(map(str, value)) if isinstance(value, list) else value for name, value in ENDLESS.items()}
    fit = site.submit(data, "endless", prefer="respond-async", **options)
    page = visit(f"/fits/{fit}", webgl=False).page
    expect(page.locator("[data-text=state]")).to_have_text(re.compile("Fitting|Waiting for its turn"))
    expect(page.get_by_role("progressbar")).to_be_visible()
    page.get_by_role("button", name="Cancel the fit").click()
    expect(page.get_by_text("This fit was cancelled.")).to_be_visible()


def test_profiles_follow_the_slider_and_a_picture_stands_where_webgl_is_missing(visit: Visit, site: Site) -> None:
    page = visit(f"/fits/{site.fits['glossy']}", webgl=False).page
    expect(page.get_by_text("This browser has no WebGL 2")).to_be_visible()
    expect(page.locator("img.fallback")).to_have_js_property("naturalWidth", 128)
    for control in (SPHERE, ".toggles"):
        expect(page.locator(control)).to_be_hidden()
    page.locator("#plots").scroll_into_view_if_needed()  # plots are drawn when they are seen
    curves, points = page.locator("#profiles .plot .curve"), page.locator("#profiles .plot .point")
    components = page.locator("[data-component]").count()
    assert components > 1
    expect(curves).to_have_count(3 + 3 * components)
    expect(points).to_have_count(3)
    expect(page.locator("#profiles [data-label]")).to_have_count(6 + components)
    before = curves.first.get_attribute("d")
    page.get_by_label("theta_diff in degrees").fill("60")
    expect(page.locator("#profiles .plot svg")).to_have_attribute(
        "aria-label", re.compile("theta_diff 60 degrees, log")
    )
    assert curves.first.get_attribute("d") != before
    page.locator("#profiles").get_by_label("green").check()
    expect(page.locator("#profiles [data-label]")).to_have_count(components + 2)  # measured, and the fit
    expect(page.locator("#profiles .legend")).to_contain_text("diffuse")
    drawn = page.locator("#profiles .plot .curve").evaluate_all(
        "curves => curves.map(curve => getComputedStyle(curve).stroke)"
    )
    named = page.locator(".components .name").evaluate_all(
        "names => names.map(name => getComputedStyle(name).borderBottomColor)"
    )
    assert drawn[:-1] == named
    assert len(set(drawn)) == components + 1
    page.locator("#profiles").get_by_label("linear").check()
    expect(page.locator("#profiles .plot svg")).to_have_attribute("aria-label", re.compile("linear axis"))
    page.locator("#profiles").get_by_label("the peak").check()
    expect(page.locator("#profiles .plot")).not_to_contain_text("90°")


def test_plane_of_incidence_and_figures_are_drawn(visit: Visit, site: Site) -> None:
    fit = site.fits["glossy"]
    page = visit(f"/fits/{fit}", webgl=False).page
    page.locator("#plots").scroll_into_view_if_needed()
    for panel, unit in (("#profiles", "θ_half"), ("#plane", "θ_out")):
        page.locator(f"{panel} .plot svg").hover(position={"x": 200, "y": 100})
        expect(page.locator(f"{panel} .legend")).to_contain_text(f"at {unit}")
        expect(page.locator(f'{panel} .legend [data-label="red, fit"] b')).to_have_text(re.compile(r" [\d.e-]+$"))
    place = re.search(r"at θ_out (-?[\d.]+)°", page.locator("#plane .legend").inner_text())
    assert place is not None
    seen, light = np.radians(np.rint(float(place[1]))), np.radians(45.0)
    directions = ([-np.sin(light), 0.0, np.cos(light)], [np.sin(seen), 0.0, np.cos(seen)])
    expected = site.model(fit).evaluate_directions(*map(np.array, directions))[0]
    told = page.locator('#plane .legend [data-label="red, fit"] b').inner_text()
    assert float(told) == pytest.approx(expected, rel=0.02)
    curves = page.locator("#plane .plot .curve")
    components = page.locator("[data-component]").count()
    expect(curves).to_have_count(3 + 3 * components)
    expect(page.locator("#plane .plot .point")).to_have_count(3)
    before = curves.first.get_attribute("d")
    page.get_by_label("theta_in in degrees").fill("70")
    expect(page.locator("#plane .plot svg")).to_have_attribute("aria-label", re.compile("light at 70 degrees, log"))
    assert curves.first.get_attribute("d") != before
    page.locator("#plane").get_by_label("linear").check()
    expect(page.locator("#plane .plot svg")).to_have_attribute("aria-label", re.compile("linear axis"))
    page.locator("#plane").get_by_label("blue").check()
    expect(curves).to_have_count(1 + components)
    expect(page.locator("#plane .legend")).to_contain_text("diffuse")
    expect(page.locator("#pictures span")).to_have_count(3 + components)
    expect(page.locator("#pictures img")).to_have_js_property("naturalWidth", (3 + components) * 128)
    for folded in ("The model's own lobes", "Parameters and residual"):
        page.get_by_text(folded).click()
    for picture in page.locator(".drawn img").all():
        expect(picture).not_to_have_js_property("naturalWidth", 0)


def test_page_of_a_fit_has_a_verdict_pictures_themes_and_downloads(visit: Visit, site: Site) -> None:
    fit = site.fits["glossy"]
    page = visit(f"/fits/{fit}").page
    value = site.read(f"/v1/fits/{fit}").json()["metrics"]["psnr"]
    expect(page.locator("#metrics-title")).to_have_text(re.compile(rf"^[A-Z][a-z ]+ \({value:.1f} dB\)$"))
    expect(page.get_by_text("Mean absolute logarithmic error")).to_be_hidden()
    page.get_by_text("More metrics").click()
    expect(page.get_by_text("Mean absolute logarithmic error")).to_be_visible()
    page.get_by_text("The model's own lobes").click()
    for scheme, inversion in (("light", "none"), ("dark", "invert")):
        page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]  # one of these words
        shown = page.locator(".drawn img").first.evaluate("image => getComputedStyle(image).filter")
        assert shown.startswith(inversion)
    page.set_viewport_size({"width": 390, "height": 844})
    expect(page.locator("#pictures span").nth(3)).to_be_visible()
    for name in ("measured", "fitted", "difference × 4"):
        expect(page.locator("#pictures")).to_contain_text(name)
    page.locator(PAINTED).wait_for()
    page.locator(".downloads").scroll_into_view_if_needed()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    with page.expect_download() as download:
        page.get_by_role("button", name="glsl").click()
    assert download.value.suggested_filename == "glossy.glsl"


def test_list_is_searched_and_two_fits_are_compared(visit: Visit, site: Site) -> None:
    page = visit("/").page
    cards = page.locator(".card:visible")
    cards.nth(1).wait_for()
    search = page.get_by_role("searchbox")
    search.fill("GLOS")
    expect(cards).to_have_count(1)
    search.fill("nothing like it")
    expect(page.get_by_text("No fits found for “nothing like it”.")).to_be_visible()
    search.fill("")
    button = page.get_by_role("button", name="Compare two")
    expect(button).to_be_disabled()
    page.get_by_label("compare glossy").check()
    page.get_by_label("compare rough").check()
    button.click()
    expect(page.get_by_role("heading", level=1)).to_contain_text(" and ")
    expect(page.locator(PAINTED)).to_have_count(2)
    expect(page.locator("table.components")).to_have_count(2)
    painted = page.locator(SPHERE).nth(1)
    page.locator("#plots").scroll_into_view_if_needed()
    expect(page.locator("#profiles .plot .curve")).to_have_count(2)
    expect(page.locator("#profiles .legend")).to_contain_text("glossy, measured")
    before = painted.get_attribute("data-painted") or ""
    page.locator(SPHERE).first.click()
    expect(painted).not_to_have_attribute("data-painted", before)


def test_likeness_of_two_spheres_is_that_of_their_pictures(visit: Visit, site: Site, tmp_path: Path) -> None:
    file = tmp_path / "dark.binary"
    write_merl(file, synthetic_measurement(diffuse=(0.02, 0.05, 0.02)))
    fits = [site.fits["glossy"], site.submit(file.read_bytes(), "dark", method="paper", n_lobes=1)]
    page = visit(f"/compare?fit={fits[0]}&fit={fits[1]}").page
    expect(page.locator(PAINTED)).to_have_count(2)
    expect(page.locator("#likeness")).to_contain_text("dB")
    size = page.locator(SPHERE).first.evaluate("canvas => canvas.width")
    views = [site.exposure(fit) for fit in fits]
    assert max(views) > 1.05 * min(views)
    images = [render_sphere(site.model(fit), size=size) for fit in fits]
    for factors in ([min(views)] * 2, views):
        if factors is views:
            page.get_by_label("each its own exposure").check()
        seen = [displayed(image, factor) for image, factor in zip(images, factors, strict=True)]
        expected = psnr(seen[0], seen[1], sphere_normals(size)[1])
        expect(page.locator("#likeness")).to_contain_text(
            re.compile(f"({expected:.1f}|{expected + 0.05:.1f}|{expected - 0.05:.1f}) dB")
        )


def test_list_takes_several_files_and_is_sorted_and_shortened(
    visit: Visit, plastic_file: Path, guarded: Guarded, tmp_path: Path
) -> None:
    header = guarded.new_key("several")
    page = visit("/?name=zzz", key=header["Authorization"].removeprefix("Bearer "), webgl=False).page
    expect(page.get_by_text("No fits found for “zzz”.")).to_be_visible()
    copies = [tmp_path / name for name in ("b.binary", "a.binary")]
    for roughness, copy in zip((0.2, 0.4), copies, strict=True):
        write_merl(copy, synthetic_measurement(roughness=roughness))
    page.goto("/")
    page.get_by_text("Options").click()
    page.get_by_label("n_lobes", exact=True).select_option("1")
    page.get_by_label("method", exact=True).select_option("paper")
    page.locator("#file").set_input_files([*copies, plastic_file])
    names = page.locator(".card-name")
    expect(names).to_have_text(["plastic", "a", "b"])
    page.wait_for_load_state()  # its scripts run
    page.get_by_label("Sort by").select_option("name")
    expect(names).to_have_text(["a", "b", "plastic"])
    http = guarded.server.http
    for fit in http.get("/v1/fits", headers=header).json()["items"]:
        assert http.get(f"/v1/fits/{fit['id']}?wait=30", headers=header).json()["status"] == "succeeded"
    page.reload()
    page.once("dialog", lambda dialog: dialog.accept())
    page.get_by_role("button", name="Delete plastic").click()
    expect(names).to_have_text(["a", "b"])


def test_upload_is_refused_in_the_services_words_or_cancelled(
    visit: Visit, plastic_file: Path, guarded: Guarded, tmp_path: Path
) -> None:
    key = guarded.new_key("cancel")["Authorization"].removeprefix("Bearer ")
    page = visit("/", key=key).page
    fault, drop = page.locator("#said"), page.get_by_text("Drop measurements here")
    bad = tmp_path / "bad.binary"
    bad.write_bytes(bytes(1000))
    page.locator("#file").set_input_files(bad)
    expect(fault).to_contain_text(re.compile(r"dimensions|bytes"))
    expect(drop).to_be_visible()
    page.route("**/v1/fits?*", lambda route: None)  # never answered
    page.locator("#file").set_input_files(plastic_file)
    expect(page.locator("#sending-title")).to_contain_text(re.compile("Sending|Checking"))
    page.get_by_role("button", name="Cancel").click()
    expect(fault).to_contain_text("The upload was cancelled.")
    expect(drop).to_be_visible()


def test_fit_is_renamed(visit: Visit, site: Site) -> None:
    page = visit(f"/fits/{site.fits['rough']}").page
    names = iter(("<b>matt & dry", "rough"))
    page.on("dialog", lambda dialog: dialog.accept(next(names)))
    for name in ("<b>matt & dry", "rough"):
        page.locator("#controls").wait_for()  # the page's script has run
        page.get_by_role("button", name="Rename").click()
        expect(page.locator("h1")).to_have_text(name)


def test_without_a_connection_the_page_says_so(visit: Visit, site: Site, plastic_file: Path) -> None:
    visitor = visit("/", webgl=False, key=site.key, offline=False)
    page = visitor.page
    expect(page.locator(".card").nth(1)).to_be_visible()
    cards = page.locator(".card").count()
    visitor.context.set_offline(True)
    page.once("dialog", lambda dialog: dialog.accept())
    for deletes in (True, False):
        if deletes:
            page.get_by_role("button", name="Delete glossy").click()
        else:
            page.locator("#file").set_input_files(plastic_file)
        expect(page.locator("#said")).to_contain_text("cannot be reached")
        page.get_by_role("button", name="Close").click()
        expect(page.locator("#said")).to_be_hidden()
    expect(page.locator(".card")).to_have_count(cards)
    visitor.context.set_offline(False)
    page.goto(f"/fits/{site.fits['glossy']}")
    folded = page.get_by_text("Options of the fit")
    expect(page.locator("#pictures img")).not_to_have_js_property("naturalWidth", 0)
    visitor.context.set_offline(True)
    folded.click()
    expect(page.locator("#said")).to_contain_text("cannot be reached")
    visitor.context.set_offline(False)
    folded.click()
    folded.click()  # what could not be had is asked for again
    expect(page.locator("#options")).to_contain_text("n_lobes")
    assert all("ERR_INTERNET_DISCONNECTED" in fault for fault in visitor.faults)
    visitor.faults.clear()
    assert site.read(f"/v1/fits/{site.fits['glossy']}").status_code == 200
