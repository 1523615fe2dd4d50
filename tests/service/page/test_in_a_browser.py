"""The pages in a browser: every state and control, no message of the browser, no request to another host."""

import base64
import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from dsbrdf.data.merl import read_merl, write_merl
from dsbrdf.data.synthetic import synthetic_measurement
from dsbrdf.model.environment import THREE_LIGHTS
from dsbrdf.model.image_metrics import displayed, exposure, psnr
from dsbrdf.model.render import render_sphere, sphere_normals
from dsbrdf.output.serialize import from_json
from tests.service.page.conftest import Site
from tests.support.guarded import Guarded
from tests.support.server import ENDLESS
from tests.support.webgl import CHROMIUM

if CHROMIUM is None:
    pytest.skip('"chromium" is not installed', allow_module_level=True)

from axe_playwright_python.sync_playwright import Axe  # type: ignore[import-untyped]
from playwright.sync_api import Page, expect

from tests.support.browser import Visitor

Visit = Callable[..., Visitor]
PAINTED = "canvas[data-painted]"
LIGHTINGS = {"three": "three_lights", "environment": "environment"}
PIXELS = """canvas => {
  const gl = canvas.getContext("webgl2"), pixels = new Uint8Array(4 * canvas.width * canvas.height);
  gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  let text = "";
  for (let i = 0; i < pixels.length; i += 4096) text += String.fromCharCode(...pixels.subarray(i, i + 4096));
  return btoa(text);
}"""


def pixels(page: Page) -> np.ndarray:
    """What the canvas shows, shape (size, size, 4), from the top, in [0, 1]."""
    values = np.frombuffer(base64.b64decode(page.locator("canvas").evaluate(PIXELS)), np.uint8)
    size = round((values.size / 4) ** 0.5)
    return values.reshape(size, size, 4)[::-1] / 255.0


def repaint(page: Page, act: Callable[[], object]) -> np.ndarray:
    """What the canvas shows after an act that paints it again."""
    canvas = page.locator("canvas")
    before = canvas.get_attribute("data-painted") or ""
    act()
    expect(canvas).not_to_have_attribute("data-painted", before)
    return pixels(page)


def test_sign_in_keeps_the_key_in_a_cookie_and_out_of_addresses(visit: Visit, site: Site) -> None:
    wanted = f"/fits/{site.fits['glossy']}"
    visitor = visit(wanted, key=None)
    page = visitor.page
    expect(page.get_by_role("heading", name="Sign in")).to_be_visible()
    page.get_by_label("API key").fill("dsbrdf_wrong")
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_role("alert")).to_contain_text("no valid key")
    page.goto(wanted)
    page.get_by_label("API key").fill(site.key)
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="glossy")).to_be_visible()
    (cookie,) = visitor.context.cookies()
    assert (cookie["value"], cookie["httpOnly"], cookie["sameSite"]) == (site.key, True, "Strict")
    assert page.evaluate("document.cookie") == ""
    assert [url for _, url, _ in visitor.requests if site.key in url] == []
    page.get_by_role("button", name="Sign out").click()
    expect(page.get_by_role("heading", name="Sign in")).to_be_visible()
    assert visitor.context.cookies() == []


def test_file_is_hashed_then_sent_once(visit: Visit, plastic_file: Path, guarded: Guarded) -> None:
    key = guarded.new_key("first")["Authorization"].removeprefix("Bearer ")
    visitor = visit("/", key=key)
    page = visitor.page
    expect(page.get_by_role("heading", name="Fit your first material")).to_be_visible()
    for number in (1, 2):
        page.get_by_text("Options").click()
        page.get_by_label("Lobes").select_option(str(number))
        page.get_by_label("Method").select_option("paper")
        page.locator("#file").set_input_files(plastic_file)
        page.wait_for_url("**/fits/*")
        expect(page.locator(PAINTED)).to_have_count(1)
        expect(page.get_by_role("heading", name="plastic")).to_be_visible()
        expect(page.locator("#model-lobes")).to_contain_text(f"The model has {number} lobe")
        page.get_by_role("link", name="Fits").click()
    sent = [(method, kind) for method, url, kind in visitor.requests if method in ("HEAD", "POST")]
    assert sent == [("HEAD", ""), ("POST", "application/octet-stream"), ("HEAD", ""), ("POST", "application/json")]


def test_faults_of_a_file_are_told_in_the_services_words(visit: Visit, tmp_path: Path) -> None:
    page = visit("/").page
    bad = tmp_path / "bad.binary"
    bad.write_bytes(bytes(1000))
    page.locator("#file").set_input_files(bad)
    expect(page.locator("#upload-fault")).to_contain_text(re.compile(r"dimensions|bytes"))
    expect(page.get_by_text("Drop measurements here")).to_be_visible()


def test_running_fit_shows_its_progress_and_can_be_cancelled(visit: Visit, site: Site, data: bytes) -> None:
    options = {name: ",".join(map(str, value)) if isinstance(value, list) else value for name, value in ENDLESS.items()}
    fit = site.submit(data, "endless", prefer="respond-async", **options)
    page = visit(f"/fits/{fit}").page
    expect(page.locator("#state")).to_have_text(re.compile("Fitting|Waiting for its turn"))
    expect(page.get_by_role("progressbar")).to_be_visible()
    page.get_by_role("button", name="Cancel the fit").click()
    expect(page.get_by_text("This fit was cancelled.")).to_be_visible()


def test_sphere_shows_the_fit_as_the_library_renders_it(visit: Visit, site: Site) -> None:
    fit = site.fits["glossy"]
    page = visit(f"/fits/{fit}", device_scale_factor=0.5).page
    page.locator(PAINTED).wait_for()
    model, _ = from_json(site.http.get(f"/v1/fits/{fit}/export?format=json", headers=site.header).text)
    factor = site.http.get(f"/fits/{fit}/view", headers=site.header).json()["exposure"]
    shown = pixels(page)
    size = len(shown)
    _, mask = sphere_normals(size)
    expected = displayed(render_sphere(model, size=size), factor)
    assert np.abs(shown[..., :3] - expected)[mask].mean() < 0.5 / 255
    assert np.array_equal(shown[..., 3] == 1.0, mask)


def test_measurement_is_shown_beside_the_fit(visit: Visit, site: Site, plastic_file: Path) -> None:
    fit = site.fits["glossy"]
    page = visit(f"/fits/{fit}", device_scale_factor=0.5).page
    page.locator(PAINTED).wait_for()
    model, _ = from_json(site.http.get(f"/v1/fits/{fit}/export?format=json", headers=site.header).text)
    measurement = read_merl(plastic_file)
    size = len(pixels(page))
    _, mask = sphere_normals(size)
    for lighting in ("three", "environment"):
        rendered = [render_sphere(s, lighting=LIGHTINGS[lighting], size=size) for s in (measurement, model)]
        factor = exposure(rendered[lighting == "environment"], mask)
        measured, fitted = (displayed(image, factor) for image in rendered)
        page.get_by_label("fit", exact=True).check()
        repaint(page, page.locator(f"[value={lighting}]").check) if lighting != "three" else None
        middle = size // 2
        whole = repaint(page, page.get_by_label("measured", exact=True).check)[..., :3]
        half = repaint(page, page.get_by_label("half and half").check)[..., :3]
        differing = repaint(page, page.get_by_label("difference × 4").check)[..., :3]
        tolerance = (0.5 if lighting == "three" else 1.5) / 255  # pictures of 256 pixels under environment light
        assert np.abs(whole - measured)[mask].mean() < tolerance
        assert np.array_equal(half[:, : middle - 2], whole[:, : middle - 2])
        assert np.abs(half - fitted)[:, middle + 2 :][mask[:, middle + 2 :]].mean() < tolerance
        expected = np.clip(4.0 * np.abs(measured - fitted), 0.0, 1.0)
        assert np.abs(differing - expected)[mask].mean() < 4 * tolerance
    page.get_by_label("half and half").check()
    assert not np.array_equal(repaint(page, lambda: page.locator("[name=wipe]").fill("0.5")), half)


def test_address_keeps_light_exposure_view_and_zoom(visit: Visit, site: Site) -> None:
    page = visit(f"/fits/{site.fits['glossy']}").page
    page.locator(PAINTED).wait_for()
    page.locator("[data-component]").first.uncheck()
    page.get_by_label("one light only").check()
    page.get_by_label("measured", exact=True).check()
    page.get_by_label("theta_diff in degrees").fill("40")
    for name, value in (("exposure", "-1.5"), ("zoom", "1")):
        page.locator(f"[name={name}]").fill(value)
    repaint(page, lambda: page.locator("canvas").click(position={"x": 200, "y": 150}))
    page.wait_for_function("location.hash.includes('highlight')")
    page.wait_for_timeout(600)  # the picture and the address are at rest
    before, address = pixels(page), page.url
    page.goto("/")
    page.goto(address)
    page.locator(PAINTED).wait_for()
    expect(page.locator("#theta-diff-value")).to_have_text("40°")
    expect(page.locator("#exposure-value")).to_have_text("-1.5 EV")
    assert np.array_equal(pixels(page), before)
    repaint(page, page.get_by_role("button", name="Reset").click)
    expect(page.get_by_label("fit", exact=True)).to_be_checked()


def test_fewer_pixels_are_painted_while_the_light_is_dragged(visit: Visit, site: Site) -> None:
    page = visit(f"/fits/{site.fits['glossy']}", device_scale_factor=2).page
    canvas = page.locator(PAINTED)
    canvas.wait_for()
    size = canvas.evaluate("canvas => canvas.width")
    box = canvas.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 200, box["y"] + 200)
    before = canvas.get_attribute("data-painted") or ""
    page.mouse.down()
    for step in range(20):
        page.mouse.move(box["x"] + 200 + 5 * step, box["y"] + 200)
    page.mouse.up()
    expect(canvas).not_to_have_attribute("data-painted", before)
    assert int(canvas.get_attribute("data-rough") or size) < 0.7 * size
    assert canvas.evaluate("canvas => canvas.width") == size


def test_values_under_the_pointer_are_the_fits(visit: Visit, site: Site) -> None:
    fit = site.fits["glossy"]
    page = visit(f"/fits/{fit}").page
    page.locator(PAINTED).wait_for()
    page.locator("canvas").hover(position={"x": 150, "y": 180})
    hint = page.locator(".hint")
    expect(hint).to_contain_text("1/sr")
    found = re.match(r"θ_half ([\d.]+)°, θ_diff ([\d.]+)°: ([\d.]+),", hint.inner_text())
    assert found is not None
    half, diff, red = map(float, found.groups())
    box = page.locator("canvas").bounding_box()
    assert box is not None
    x, y = 2 * 150 / box["width"] - 1, 1 - 2 * 180 / box["height"]
    light = np.array(THREE_LIGHTS[0].direction)
    middle = light + np.array([0.0, 0.0, 1.0])
    normal = np.array([x, y, np.sqrt(1 - x * x - y * y)])
    assert half == pytest.approx(np.degrees(np.arccos(normal @ middle / np.linalg.norm(middle))), abs=0.2)
    assert diff == pytest.approx(20.0, abs=0.1)
    query = {"theta_half_deg": half, "theta_diff_deg": diff}
    near = site.http.get(f"/v1/fits/{fit}/brdf", params=query, headers=site.header).json()["values"][0]
    assert red == pytest.approx(near[0], rel=0.1)  # phi_diff is another, the lobe hardly depends on it there


def test_light_exposure_and_components_are_under_mouse_and_keyboard(visit: Visit, site: Site) -> None:
    page = visit(f"/fits/{site.fits['glossy']}").page
    canvas = page.locator(PAINTED)
    canvas.wait_for()
    first = pixels(page)
    box = canvas.bounding_box()
    assert box is not None
    dragged = repaint(page, lambda: page.mouse.click(box["x"] + 0.6 * box["width"], box["y"] + 0.6 * box["height"]))
    assert np.abs(dragged - first).mean() > 0.01
    canvas.focus()
    assert not np.array_equal(repaint(page, lambda: page.keyboard.press("ArrowLeft")), dragged)
    darker = repaint(page, lambda: page.keyboard.press("-"))
    expect(page.locator("#exposure-value")).to_have_text("-0.5 EV")
    assert darker.mean() < dragged.mean()
    assert repaint(page, lambda: page.get_by_label("one light only").check()).mean() < darker.mean()
    canvas.focus()
    assert np.array_equal(repaint(page, lambda: page.keyboard.press("r")), first)
    boxes = page.locator("[data-component]").all()
    parts = [first] + [repaint(page, box.uncheck) for box in boxes]
    assert len(parts) > 2
    assert all(part.mean() < whole.mean() for whole, part in pairwise(parts))
    assert parts[-1][..., :3].max() == 0.0


def test_red_paint_has_a_neutral_highlight_on_a_red_ground(visit: Visit, site: Site, tmp_path: Path) -> None:
    paint = {"roughness": 0.06, "diffuse": (0.40, 0.16, 0.10)}
    file = tmp_path / "red.binary"
    write_merl(file, synthetic_measurement(**paint, specular=(0.04,) * 3, noise=0.02))  # type: ignore[arg-type]
    fit = site.submit(file.read_bytes(), "red paint")
    page = visit(f"/fits/{fit}").page
    page.locator(PAINTED).wait_for()
    shown = pixels(page)[..., :3]
    boxes = {label: page.locator(f'[data-component="{label}"]') for label in ("specular_spike", "diffuse")}
    expect(page.locator("[data-component]")).to_have_count(len(boxes))
    ground = repaint(page, boxes["specular_spike"].uncheck)[..., :3]
    repaint(page, boxes["specular_spike"].check)
    highlight = repaint(page, boxes["diffuse"].uncheck)[..., :3]
    size = len(highlight)
    row, column = (np.indices((size, size)) + 0.5) / (0.5 * size) - 1.0
    trusted = np.hypot(row, column) < np.sin(np.radians(80.0))  # nearer to the horizon than the default cutoff: no data
    bright = trusted & (highlight.max(axis=2) > 0.3)
    assert np.ptp(highlight[bright], axis=1).max() < 0.03  # neutral
    peak = highlight.min(axis=2) > 0.9
    assert peak.any()
    assert shown[peak].min() > 0.9
    assert ground[peak].max() < 0.8  # gone with the specular component
    # The ground is that of the paint without its highlight, and nothing is left or missing where that was.
    factor = site.http.get(f"/fits/{fit}/view", headers=site.header).json()["exposure"]
    bare = synthetic_measurement(**paint, specular=(0.0,) * 3)  # type: ignore[arg-type]
    expected = displayed(0.96 * render_sphere(bare, size=len(ground)), factor)
    normals, mask = sphere_normals(len(ground))
    facing = np.zeros_like(mask)
    facing[mask] = normals[:, 2] > 0.85  # farther out, what has no highlight at normal incidence has one
    assert (bright & facing).sum() > 50
    assert np.abs(ground - expected)[bright & facing].max() < 0.03


def test_profiles_follow_the_slider_and_the_choices(visit: Visit, site: Site) -> None:
    page = visit(f"/fits/{site.fits['glossy']}").page
    curves, points = page.locator("#plot .curve"), page.locator("#plot .point")
    components = page.locator("[data-component]").count()
    assert components > 1
    expect(curves).to_have_count(3 + 3 * components)
    expect(points).to_have_count(3)
    expect(page.locator("#plot-legend li")).to_have_count(6 + components)
    before = curves.first.get_attribute("d")
    page.get_by_label("theta_diff in degrees").fill("60")
    expect(page.locator("#plot svg")).to_have_attribute("aria-label", re.compile("theta_diff 60 degrees, log"))
    assert curves.first.get_attribute("d") != before
    page.locator("#profiles").get_by_label("green").check()
    expect(page.locator("#plot-legend li")).to_have_count(components + 2)  # measured, and the fit
    expect(page.locator("#plot-legend")).to_contain_text("diffuse")
    page.locator("#profiles").get_by_label("linear").check()
    expect(page.locator("#plot svg")).to_have_attribute("aria-label", re.compile("linear axis"))
    page.get_by_label("the peak").check()
    expect(page.locator("#plot")).not_to_contain_text("90°")


def test_plane_of_incidence_and_figures_are_drawn(visit: Visit, site: Site) -> None:
    page = visit(f"/fits/{site.fits['glossy']}").page
    curves = page.locator("#polar-plot .curve")
    components = page.locator("[data-component]").count()
    expect(curves).to_have_count(3 + 3 * components)
    expect(page.locator("#polar-plot .point")).to_have_count(3)
    before = curves.first.get_attribute("d")
    page.get_by_label("theta_in in degrees").fill("70")
    expect(page.locator("#polar-plot svg")).to_have_attribute("aria-label", re.compile("light at 70 degrees, log"))
    assert curves.first.get_attribute("d") != before
    page.locator("#polar").get_by_label("linear").check()
    expect(page.locator("#polar-plot svg")).to_have_attribute("aria-label", re.compile("linear axis"))
    page.locator("#polar").get_by_label("blue").check()
    expect(curves).to_have_count(1 + components)
    expect(page.locator("#polar-plot-legend")).to_contain_text("diffuse")
    assert page.locator(".components img").count() == components
    page.locator("#model-lobes summary").click()
    assert page.locator("#model-lobes img").count() == 1
    page.locator("#figures-title").click()
    for picture in page.locator(".drawn img, .components img").all():
        picture.scroll_into_view_if_needed()
        expect(picture).to_have_js_property("complete", value=True)
        assert picture.evaluate("image => image.naturalWidth") > 100


def test_page_of_a_fit_has_pictures_and_downloads(visit: Visit, site: Site) -> None:
    page = visit(f"/fits/{site.fits['glossy']}").page
    page.set_viewport_size({"width": 390, "height": 844})
    expect(page.locator("#pictures img")).to_have_count(3)
    for name in ("measured", "fitted", "difference × 4"):
        expect(page.locator("#pictures")).to_contain_text(name)
    page.locator(PAINTED).wait_for()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    with page.expect_download() as download:
        page.get_by_role("link", name="glsl").click()
    assert download.value.suggested_filename == "glossy.glsl"


def test_picture_of_the_service_stands_where_webgl_is_missing(visit: Visit, site: Site) -> None:
    page = visit(None).page
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    page.goto(f"/fits/{site.fits['glossy']}")
    expect(page.get_by_text("This browser has no WebGL 2")).to_be_visible()
    picture = page.locator("img.fallback")
    expect(picture).to_be_visible()
    assert picture.evaluate("image => image.naturalWidth") == 256
    expect(page.locator("canvas")).to_be_hidden()
    expect(page.locator(".toggles")).to_be_hidden()
    expect(page.locator("#pictures img")).to_have_count(3)


def test_list_is_searched_and_two_fits_are_compared(visit: Visit, site: Site) -> None:
    page = visit("/").page
    cards = page.locator(".card:visible")
    assert cards.count() >= 2
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
    painted = page.locator("canvas").nth(1)
    expect(page.locator("#plot .curve")).to_have_count(2)
    expect(page.locator("#plot-legend")).to_contain_text("glossy, measured")
    before = painted.get_attribute("data-painted") or ""
    page.locator("canvas").first.click()
    expect(painted).not_to_have_attribute("data-painted", before)


def test_likeness_of_two_spheres_is_that_of_their_pictures(visit: Visit, site: Site, tmp_path: Path) -> None:
    file = tmp_path / "dark.binary"
    write_merl(file, synthetic_measurement(diffuse=(0.02, 0.05, 0.02)))
    fits = [site.fits["glossy"], site.submit(file.read_bytes(), "dark", method="paper", n_lobes=1)]
    page = visit(f"/compare?fit={fits[0]}&fit={fits[1]}", device_scale_factor=0.5).page
    expect(page.locator(PAINTED)).to_have_count(2)
    expect(page.locator("#likeness")).to_contain_text("dB")
    size = page.locator("canvas").first.evaluate("canvas => canvas.width")
    views = [site.http.get(f"/fits/{fit}/view", headers=site.header).json()["exposure"] for fit in fits]
    documents = [site.http.get(f"/v1/fits/{fit}/export?format=json", headers=site.header).text for fit in fits]
    assert max(views) > 1.05 * min(views)
    images = [render_sphere(from_json(text)[0], size=size) for text in documents]
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
    page = visit("/?name=zzz", key=header["Authorization"].removeprefix("Bearer ")).page
    expect(page.get_by_text("No fits found for “zzz”.")).to_be_visible()
    copies = [tmp_path / name for name in ("b.binary", "a.binary")]
    for roughness, copy in zip((0.2, 0.4), copies, strict=True):
        write_merl(copy, synthetic_measurement(roughness=roughness))
    page.goto("/")
    page.get_by_text("Options").click()
    page.get_by_label("Lobes").select_option("1")
    page.get_by_label("Method").select_option("paper")
    page.locator("#file").set_input_files([*copies, plastic_file])
    names = page.locator(".card-name")
    expect(names).to_have_text(["plastic", "a", "b"])
    page.get_by_label("Sort by").select_option("name")
    expect(names).to_have_text(["a", "b", "plastic"])
    http = guarded.server.http
    for fit in http.get("/v1/fits", headers=header).json()["items"]:
        assert http.get(f"/v1/fits/{fit['id']}?wait=30", headers=header).json()["status"] == "succeeded"
    page.reload()
    page.once("dialog", lambda dialog: dialog.accept())
    page.get_by_role("button", name="Delete plastic").click()
    expect(names).to_have_text(["a", "b"])


def test_upload_is_cancelled(visit: Visit, plastic_file: Path, guarded: Guarded) -> None:
    key = guarded.new_key("cancel")["Authorization"].removeprefix("Bearer ")
    page = visit("/", key=key).page
    page.route("**/v1/fits?*", lambda route: None)  # never answered
    page.locator("#file").set_input_files(plastic_file)
    expect(page.locator("#sending-title")).to_contain_text(re.compile("Sending|Checking"))
    page.get_by_role("button", name="Cancel").click()
    expect(page.locator("#upload-fault")).to_have_text("The upload was cancelled.")
    expect(page.get_by_text("Drop measurements here")).to_be_visible()


def test_values_under_the_pointer_stand_in_the_legend(visit: Visit, site: Site) -> None:
    fit = site.fits["glossy"]
    page = visit(f"/fits/{fit}").page
    for panel, unit in (("#plot", "θ_half"), ("#polar-plot", "θ_out")):
        page.locator(f"{panel} svg").hover(position={"x": 200, "y": 100})
        expect(page.locator(f"{panel}-legend")).to_contain_text(f"at {unit}")
        expect(page.locator(f'{panel}-legend [data-label="red, fit"] b')).to_have_text(re.compile(r" [\d.e-]+$"))
    curve = site.http.get(f"/fits/{fit}/polar/45", headers=site.header).json()
    place = re.search(r"at θ_out (-?[\d.]+)°", page.locator("#polar-plot-legend").inner_text())
    assert place is not None
    at = np.abs(np.array(curve["theta_out_deg"]) - float(place[1])).argmin()
    told = page.locator('#polar-plot-legend [data-label="red, fit"] b').inner_text()
    assert float(told) == pytest.approx(curve["fit"][0][at], rel=0.01)


def test_verdict_stands_before_the_metrics(visit: Visit, site: Site) -> None:
    fit = site.fits["glossy"]
    page = visit(f"/fits/{fit}").page
    value = site.http.get(f"/v1/fits/{fit}", headers=site.header).json()["metrics"]["psnr"]
    expect(page.locator("#metrics-title")).to_have_text(re.compile(rf"[A-Z][a-z ]+: {value:.1f} dB"))
    expect(page.get_by_text("Mean absolute logarithmic error")).to_be_hidden()
    page.get_by_text("More metrics").click()
    expect(page.get_by_text("Mean absolute logarithmic error")).to_be_visible()


def test_figures_follow_the_dark_theme(visit: Visit, site: Site) -> None:
    page = visit(f"/fits/{site.fits['glossy']}").page
    filters = []
    schemes: list[Literal["light", "dark"]] = ["light", "dark"]
    for scheme in schemes:
        page.emulate_media(color_scheme=scheme)
        filters.append(page.locator(".drawn img").first.evaluate("image => getComputedStyle(image).filter"))
    assert filters[0] == "none"
    assert filters[1].startswith("invert")


def test_axe_finds_nothing_in_light_and_dark(visit: Visit, site: Site) -> None:
    glossy, rough = site.fits["glossy"], site.fits["rough"]
    page = visit("/", bypass_csp=True).page  # the policy of the pages keeps axe out too
    # Light and dark differ in colours only.
    schemes: list[tuple[Literal["light", "dark"], Any]] = [("light", None), ("dark", {"runOnly": ["cat.color"]})]
    for path in ("/", "/sign-in", f"/fits/{glossy}", f"/compare?fit={glossy}&fit={rough}", f"/fits/{'0' * 32}"):
        page.goto(path)
        if glossy in path:
            page.locator(PAINTED).first.wait_for()
            for folded in page.locator("main details").all():
                folded.locator("summary").click()
        for scheme, rules in schemes:
            page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
            found = Axe().run(page, options=rules)
            assert found.violations_count == 0, f"{path}, {scheme}: {found.generate_report()}"
