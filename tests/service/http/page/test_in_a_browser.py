"""The pages in a browser: every state and control, no message of the browser, no request to another host."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from dsbrdf import render_sphere
from dsbrdf.rendering import displayed, psnr, sphere_normals
from tests.service.http.page.conftest import Site
from tests.support.browser import PAINTED, SPHERE, Visit, expect
from tests.support.server import ENDLESS, Guarded

pytestmark = pytest.mark.slow


def test_key_is_asked_for_kept_in_the_tab_and_forgotten(visit: Visit, site: Site) -> None:
    visitor = visit(f"/fits/{site.fits['glossy']}", header=None, webgl=False)
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
    expect(page.locator("img.fallback")).to_have_js_property("naturalWidth", 256)
    assert visitor.context.cookies() == []
    assert page.evaluate("localStorage.length") == 0
    assert [url for _, url, _ in visitor.requests if site.key in url] == []
    page.get_by_role("link", name="Fits").click()
    expect(page.locator("#fits .card").nth(1)).to_be_visible()
    page.get_by_role("button", name="Sign out").click()
    expect(dialog).to_be_visible()
    assert page.evaluate("sessionStorage.length") == 0


def test_file_is_hashed_then_sent_once_and_may_be_cancelled(visit: Visit, plastic_file: Path, guarded: Guarded) -> None:
    visitor = visit("/", header=guarded.new_key("first"), webgl=False)
    page = visitor.page
    expect(page.get_by_role("heading", name="Fit your first material")).to_be_visible()
    page.route("**/v1/fits?*", lambda route: route.continue_() if "json" in str(route.request.headers) else None)
    page.locator("#file").set_input_files([plastic_file, plastic_file])  # The second file is not sent.
    expect(page.get_by_role("status").filter(has_text="Sending plastic.binary, 35 MB")).to_be_visible()
    page.get_by_role("button", name="Cancel").click()
    expect(page.locator("#said span")).to_have_text("plastic.binary: The upload was cancelled.")
    cancel = "document.querySelector('#cancel-upload').click()"
    page.evaluate(f"crypto.subtle.digest = async () => {{ {cancel}; return new ArrayBuffer(32); }}")
    page.locator("#file").set_input_files(plastic_file)  # This file is cancelled while it is hashed.
    expect(page.locator("#said")).to_contain_text("plastic.binary: The upload was cancelled.")
    page.evaluate("delete crypto.subtle.digest")
    page.unroute_all()
    for _ in range(2):
        page.get_by_text("Options").click()
        page.get_by_text("More for fits").click()
        page.get_by_label("Number of lobes").select_option("1")
        page.get_by_label("Method", exact=True).select_option("paper")
        page.locator("#file").set_input_files(plastic_file)
        page.wait_for_url("**/fits/*")
        expect(page.get_by_role("heading", name="plastic")).to_be_visible()
        expect(page.get_by_text("Result:")).to_contain_text("dB")
        page.get_by_role("link", name="Fits").click()
    expect(page.locator("#fits .card")).to_have_count(1)
    sent = [kind.removeprefix("application/") for method, _, kind in visitor.requests if method == "POST"]
    assert sent == ["json", "octet-stream", "json", "json", "octet-stream", "json"]


def test_fit_without_a_result_says_why_and_is_deleted(visit: Visit, site: Site, guarded: Guarded, data: bytes) -> None:
    options = {name: ",".join(map(str, value)) if isinstance(value, list) else value for name, value in ENDLESS.items()}
    own = replace(site, header=guarded.new_key("unlucky"))
    failing = own.submit(data, "failing", method="paper", n_lobes=8, mask=10, horizon_cutoff_deg=2)
    endless = own.submit(data, "endless", prefer="respond-async", **options)
    visitor = visit(f"/fits/{endless}", header=own.header, webgl=False)
    page = visitor.page
    expect(page.locator("[data-text=state]")).to_have_text(re.compile("Fitting|Waiting for its turn"))
    running = own.read(f"/v1/fits/{endless}").json() | {"status": "running", "progress": 0.25}
    page.route("**/v1/fits/*?wait=1", lambda route: route.fulfill(json=running))
    expect(page.get_by_role("progressbar")).to_have_js_property("value", 0.25)
    expect(page.locator("[data-text=state]")).to_contain_text("Fitting: 25%")
    page.unroute_all()
    visitor.context.set_offline(True)
    expect(page.locator("#said")).to_contain_text("cannot be reached. This page waits for it.")
    visitor.context.set_offline(False)
    expect(page.locator("#said")).to_be_hidden()
    visitor.faults.clear()  # The browser reports each request without a connection.
    page.get_by_role("button", name="Cancel the fit").click()
    expect(page.get_by_text("This fit was cancelled.")).to_be_visible()
    page.get_by_role("button", name="Fit again").click()
    page.get_by_role("button", name="Cancel the fit").click()
    expect(page.get_by_text("This fit was cancelled.")).to_be_visible()
    page.goto(f"/fits/{failing}")
    expect(page.locator(".fault:visible")).to_have_text(own.read(f"/v1/fits/{failing}").json()["error"]["message"])
    expect(page.get_by_text("The measurement or the options do not allow a fit.")).to_be_visible()
    expect(page.get_by_role("progressbar")).to_be_hidden()
    expect(page.get_by_role("button", name="Fit again")).to_be_hidden()  # An equal request would fail again.
    page.get_by_role("button", name="Delete").click()
    page.get_by_role("button", name="Undo").click()
    assert own.read(f"/v1/fits/{failing}").status_code == 200
    page.get_by_role("button", name="Delete").click()
    page.get_by_role("button", name="Close").click()  # The message is read, so the time to undo is over.
    page.wait_for_url(f"{site.address}/")
    expect(page.locator("#fits .card-name")).to_have_text(["endless"])
    expect(page.get_by_role("button", name="Delete endless")).to_be_hidden()
    page.locator(".menu summary").click()
    page.get_by_role("button", name="Delete endless").click()
    page.reload()  # A page that is left deletes at once.
    expect(page.get_by_role("heading", name="Fit your first material")).to_be_visible()
    assert own.read("/v1/fits").json()["items"] == []


def test_page_of_a_fit_has_a_verdict_a_name_figures_and_downloads(visit: Visit, site: Site) -> None:
    fit = site.fits["glossy"]
    page = visit(f"/fits/{fit}").page
    expect(page.get_by_role("heading", name="Result:")).to_contain_text(site.read(f"/v1/fits/{fit}").json()["likeness"])
    expect(page.get_by_text("Mean absolute logarithmic error")).to_be_hidden()
    page.get_by_text("Metrics", exact=True).click()
    expect(page.get_by_text("Mean absolute logarithmic error")).to_be_visible()
    page.get_by_text("Explain these numbers").click()
    expect(page.get_by_text("Reflectance of its facets at normal incidence.")).to_be_visible()
    page.locator("#figures summary").click()
    for picture in page.locator(".drawn img").all():
        expect(picture).not_to_have_js_property("naturalWidth", 0)
    names = iter(("<b>matt & dry", "glossy"))
    page.on("dialog", lambda dialog: dialog.accept(next(names)))
    for name in ("<b>matt & dry", "glossy"):
        page.get_by_text("More", exact=True).click()
        page.get_by_role("button", name="Rename").click()
        expect(page.locator("h1")).to_have_text(name)
    page.evaluate("navigator.clipboard.writeText = async (text) => { window.copied = text; }")
    page.get_by_text("More", exact=True).click()
    page.get_by_role("button", name="Copy the link").click()
    expect(page.locator("#said")).to_contain_text("The link to this view is copied.")
    assert page.evaluate("window.copied") == page.url
    page.set_viewport_size({"width": 390, "height": 844})
    page.locator(PAINTED).wait_for()
    page.locator(".downloads").scroll_into_view_if_needed()
    with page.expect_download() as download:
        page.get_by_role("button", name="glsl").click()
    assert download.value.suggested_filename == "glossy.glsl"
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_two_fits_are_compared_as_they_are_seen(visit: Visit, site: Site) -> None:
    page = visit("/").page
    page.get_by_label("compare glossy").check()
    page.get_by_label("compare rough").check()
    page.get_by_role("button", name="Compare the two").click()
    expect(page.get_by_role("heading", level=1)).to_contain_text(" and ")
    expect(page.locator(PAINTED)).to_have_count(2)
    page.locator("#controls [name=lighting]").select_option("three_lights")
    heads = page.locator("table.components tr").first.get_by_role("columnheader")
    expect(heads.filter(has_text="diffuse")).to_have_text([re.compile("diffuse(glossy|rough)")] * 2)
    expect(page.locator("table.surfaces tr")).not_to_have_count(1)
    painted = page.locator(SPHERE).nth(1)
    page.locator("#plots").scroll_into_view_if_needed()
    expect(page.locator("#profiles .plot .curve")).to_have_count(2)
    expect(page.locator("#profiles .legend")).to_contain_text("glossy, measured")
    size = painted.evaluate("canvas => canvas.width")
    expect(page.locator("#between canvas")).to_have_js_property("width", size)
    fits = [site.fits[name] for name in ("glossy", "rough")]
    views = [site.exposure(fit) for fit in fits]
    assert max(views) > 1.1 * min(views)  # both have the lower one
    seen = [displayed(render_sphere(site.model(fit), size=size), min(views)) for fit in fits]
    expected = psnr(seen[0], seen[1], sphere_normals(size)[1])
    near = "|".join(f"{expected + more:.1f}" for more in (-0.05, 0.0, 0.05))
    expect(page.locator("#likeness")).to_contain_text(re.compile(rf"({near})\sdB"))
    before = painted.get_attribute("data-painted") or ""
    page.locator(SPHERE).first.click()
    expect(painted).not_to_have_attribute("data-painted", before)


def test_fit_asks_with_what_it_is_compared(visit: Visit, site: Site) -> None:
    page = visit(f"/fits/{site.fits['glossy']}", webgl=False).page
    delayed: list[Any] = []
    page.route(f"**/v1/fits/{site.fits['glossy']}", lambda route: delayed.append(route), times=1)
    page.reload()
    page.get_by_role("button", name="Compare with").click()  # The click comes before the fit's document.
    while not delayed:
        page.wait_for_timeout(10)
    delayed[0].continue_()
    dialog = page.get_by_role("dialog", name="Compare glossy with")
    expect(dialog.get_by_role("option")).to_contain_text(["rough", ", comes with dsbrdf"])
    dialog.get_by_role("button", name="Cancel").click()
    page.get_by_role("button", name="Compare with").click()
    dialog.get_by_role("button", name="Compare", exact=True).click()
    expect(page.get_by_role("heading", level=1)).to_have_text("glossy and rough")
    page.goto("/")
    material = page.locator("#atlas .card a").first
    material.evaluate("link => link.click()")  # Its list is folded.
    expect(page.get_by_text("A measured material that comes with dsbrdf.")).to_be_visible()
    page.get_by_text("More", exact=True).click()
    expect(page.get_by_role("button", name="Copy the link")).to_be_visible()
    for name in ("Rename", "Delete"):
        expect(page.get_by_role("button", name=name)).to_be_hidden()


def test_list_takes_several_files_names_wrong_ones_and_is_sorted(
    visit: Visit, guarded: Guarded, tmp_path: Path
) -> None:
    header = guarded.new_key("several")
    page = visit("/?name=zzz", header=header, webgl=False).page
    expect(page.get_by_text("No fits found for “zzz”.")).to_be_visible()
    rows = [f"{light},{seen},{1 + seen / 100}" for light in (0, 40) for seen in range(-75, 76, 5)]
    head = "theta_in,theta_out,value"
    contents = {"a.csv": [head, *rows], "bad.csv": ["a,b", "1,2"], f"b\u202e{'b' * 120}.csv": [head, *rows[1:]]}
    for name, lines in contents.items():
        (tmp_path / name).write_text("\n".join(lines))
    page.goto("/")
    browser, folder = (
        page.context.new_cdp_session(page),
        {"items": [], "files": [str(tmp_path)], "dragOperationsMask": 1},
    )
    page.locator("#upload").wait_for()
    for kind in ("dragEnter", "dragOver", "drop"):
        browser.send("Input.dispatchDragEvent", {"type": kind, "x": 200, "y": 200, "data": folder})
    expect(page.locator("#said")).to_contain_text("The browser cannot read it. Choose files")
    page.get_by_text("Options").click()
    page.locator("#option-n_lobes").select_option("1")
    page.locator("#file").set_input_files([tmp_path / name for name in contents])
    expect(page.locator("#said")).to_contain_text("bad.csv: The table lacks")
    expect(page.locator("#said")).to_contain_text("Sent: 2 of 3; reload")
    page.goto("/")
    names = page.locator("#fits .card-name")
    names.nth(1).wait_for()
    expect(page.locator("#fits .menu:visible")).to_have_count(0)  # Unfinished fits have no menu.
    for fit in guarded.server.http.get("/v1/fits", headers=header).json()["items"]:
        guarded.server.http.delete(f"/v1/fits/{fit['id']}?only=cancel", headers=header)
    expect(page.locator("#fits .card", has_text="cancelled")).to_have_count(2)  # The list follows its fits.
    expect(names).to_have_text([f"b {'b' * 98}", "a"])
    page.get_by_label("Sort by").select_option("name")
    expect(names).to_have_text(["a", f"b {'b' * 98}"])
    for card in page.locator("#fits .card").all():
        card.locator(".menu summary").click()
        card.get_by_role("button", name="Delete").click()
    expect(names).to_have_count(1)  # Only the last deletion can be taken back.
    page.get_by_role("button", name="Undo").click()
    (kept,) = guarded.server.http.get("/v1/fits", headers=header).json()["items"]
    assert kept["name"].startswith("b b")
    guarded.server.http.delete(f"/v1/fits/{kept['id']}", headers=header)  # as in another tab
    page.locator("#fits .menu summary").click()
    page.locator("#fits").get_by_role("button", name="Delete").click()
    page.locator("#said").get_by_role("button", name="Close").click()
    expect(names).to_have_count(0)


def test_without_a_connection_the_page_says_so(visit: Visit, site: Site, plastic_file: Path) -> None:
    visitor = visit("/", webgl=False, offline=False)
    page = visitor.page
    expect(page.locator("#fits .card").nth(1)).to_be_visible()
    cards = page.locator("#fits .card").count()
    visitor.context.set_offline(True)
    page.locator("#fits .card", has_text="glossy").locator(".menu summary").click()
    attempts: tuple[Callable[[], object], ...] = (
        page.get_by_role("button", name="Delete glossy").click,
        lambda: page.locator("#file").set_input_files(plastic_file),
    )
    for attempt in attempts:
        attempt()
        if attempt is attempts[0]:
            page.get_by_role("button", name="Close").click()
        expect(page.locator("#said")).to_contain_text("cannot be reached")
        page.get_by_role("button", name="Close").click()
        expect(page.locator("#said")).to_be_hidden()
    expect(page.locator("#fits .card:not(.gone)")).to_have_count(cards)
    visitor.context.set_offline(False)
    page.goto(f"/fits/{site.fits['glossy']}")
    folded = page.get_by_text("Options of the fit")
    expect(page.locator("img.fallback")).to_have_js_property("naturalWidth", 256)
    visitor.context.set_offline(True)
    folded.click()
    expect(page.locator("#said")).to_contain_text("cannot be reached")
    visitor.context.set_offline(False)
    folded.click()
    folded.click()  # what could not be had is asked for again
    expect(page.locator(".fitted-by")).to_contain_text("Number of lobes")
    assert all("ERR_INTERNET_DISCONNECTED" in fault for fault in visitor.faults)
    visitor.faults.clear()
    assert site.read(f"/v1/fits/{site.fits['glossy']}").status_code == 200
