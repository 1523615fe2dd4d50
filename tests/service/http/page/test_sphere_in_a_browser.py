"""Sphere and plots of a fit in a browser: what is drawn, the light, views, zoom and what the address keeps."""

import base64
import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dsbrdf import EnvironmentMap, Measurement, decompose, render_sphere
from dsbrdf.output.sphere_panels import encode_png
from dsbrdf.rendering import THREE_LIGHTS, displayed, exposure, sphere_normals
from tests.service.http.page.conftest import Site
from tests.support.browser import PAINTED, SPHERE, FloatRect, Page, Visit, expect

pytestmark = pytest.mark.slow

BOXES = ".toggles input"
DIFFERENCES = np.array([[0, 0, 0], [0.35, 0.06, 0.43], [0.84, 0.25, 0.31], [0.98, 0.6, 0.1], [1, 0.92, 0.55]])
"""Colours of a difference whose square root is 0, 1/4, ... 1."""
PIXELS = """canvas => {
  const gl = canvas.getContext("webgl2"), pixels = new Uint8Array(4 * canvas.width * canvas.height);
  gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  let text = "";
  for (let i = 0; i < pixels.length; i += 4096) text += String.fromCharCode(...pixels.subarray(i, i + 4096));
  return btoa(text);
}"""


def pixels(page: Page) -> np.ndarray:
    """What the canvas shows, shape (size, size, 4), from the top, in [0, 1]."""
    values = np.frombuffer(base64.b64decode(page.locator(SPHERE).evaluate(PIXELS)), np.uint8)
    size = round((values.size / 4) ** 0.5)
    return values.reshape(size, size, 4)[::-1] / 255.0


def repaint(page: Page, act: Callable[[], object]) -> np.ndarray:
    """What the canvas shows at rest after an act that paints it again, perhaps several times."""
    canvas = page.locator(SPHERE)
    before = canvas.get_attribute("data-painted") or ""
    act()
    expect(canvas).not_to_have_attribute("data-painted", before)
    expect(canvas).not_to_have_attribute("data-drawing", "")
    return pixels(page)


def choose(page: Page, name: str, option: str) -> np.ndarray:
    return repaint(page, lambda: page.locator(f"#controls [name={name}]").select_option(option))


def box_of(page: Page, selector: str) -> "FloatRect":
    page.locator(SPHERE).scroll_into_view_if_needed()
    box = page.locator(selector).bounding_box()
    assert box is not None
    return box


def painted(visit: Visit, site: Site, **options: Any) -> Page:
    """The page of a fit whose sphere is there, under the lights that move."""
    page: Page = visit(f"/fits/{site.fits['glossy']}#lighting=three_lights", **options).page
    page.locator(PAINTED).wait_for()
    return page


def test_spheres_are_shown_as_the_library_renders_them(visit: Visit, site: Site, plastic: Measurement) -> None:
    page, model = painted(visit, site), site.model(site.fits["glossy"])
    shown = pixels(page)
    size = len(shown)
    _, mask = sphere_normals(size)
    expected = displayed(render_sphere(model, size=size), site.exposure(site.fits["glossy"]))
    assert np.abs(shown[..., :3] - expected)[mask].mean() < 0.5 / 255
    assert np.array_equal(shown[..., 3] == 1.0, mask)
    for lighting in ("three_lights", "environment"):
        rendered = [render_sphere(material, lighting=lighting, size=size) for material in (plastic, model)]
        factor = exposure(rendered[1], mask) if lighting == "environment" else site.exposure(site.fits["glossy"])
        measured, fitted = (displayed(image, factor) for image in rendered)
        if lighting != "three_lights":
            choose(page, "lighting", lighting)
        middle = size // 2
        whole, half, differing = (choose(page, "show", shown)[..., :3] for shown in ("measured", "half", "difference"))
        tolerance = (0.5 if lighting == "three_lights" else 1.5) / 255  # pictures of 256 pixels under environment light
        assert np.abs(whole - measured)[mask].mean() < tolerance
        assert np.array_equal(half[:, : middle - 2], whole[:, : middle - 2])
        assert np.abs(half - fitted)[:, middle + 2 :][mask[:, middle + 2 :]].mean() < tolerance
        difference = np.abs(measured - fitted).max(axis=-1)
        place = np.sqrt(difference) * (len(DIFFERENCES) - 1)
        expected = np.stack([np.interp(place, range(len(DIFFERENCES)), channel) for channel in DIFFERENCES.T], axis=-1)
        clear = mask & (difference > 0.02)  # the square root enlarges the rounding of smaller ones
        assert np.count_nonzero(clear) > 100
        assert np.abs(differing - expected)[clear].mean() < 6 * tolerance
    choose(page, "show", "half")
    for side in ("measured", "fit"):
        expect(page.locator(".stage span").get_by_text(side, exact=True)).to_be_visible()
    assert not np.array_equal(repaint(page, lambda: page.locator("[name=wipe]").fill("0.5")), half)


def test_light_line_and_exposure_are_under_mouse_and_keyboard(visit: Visit, site: Site) -> None:
    page = painted(visit, site)
    first, canvas, box = pixels(page), page.locator(SPHERE), box_of(page, SPHERE)
    middle = box["y"] + box["height"] / 2
    dragged = repaint(page, lambda: page.mouse.click(box["x"] + 0.6 * box["width"], middle - 0.1 * box["height"]))
    assert np.abs(dragged - first).mean() > 0.01
    canvas.focus()
    light, wipe = (page.locator(f"[name={name}]") for name in ("highlight", "wipe"))
    x, y = map(float, light.input_value().split(","))
    page.keyboard.press("ArrowUp")
    assert not np.array_equal(repaint(page, lambda: page.keyboard.press("ArrowLeft")), dragged)
    assert [*map(float, light.input_value().split(","))] == pytest.approx([x - 0.05, y + 0.05], abs=1e-3)
    page.keyboard.press("Control+-")  # The browser's zoom changes nothing here.
    darker = repaint(page, lambda: page.keyboard.press("-"))
    expect(page.locator("#controls")).to_contain_text("-0.5 EV")
    assert darker.mean() < dragged.mean()
    assert choose(page, "lighting", "one").mean() < darker.mean()
    canvas.focus()
    sky = repaint(page, lambda: page.keyboard.press("r"))
    expect(page.locator("[name=lighting]")).to_have_value("environment")
    assert not np.array_equal(sky, first)
    repaint(page, lambda: page.keyboard.press("ArrowLeft"))  # The sky does not move, so lights replace it.
    expect(page.locator("[name=lighting]")).to_have_value("three_lights")
    before = light.input_value()
    choose(page, "show", "half")
    page.mouse.move(box["x"] + box["width"] / 2, middle)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.7 * box["width"], middle)
    page.mouse.up()
    moved = float(wipe.input_value())
    assert moved == pytest.approx(0.4, abs=0.02)
    canvas.press("[")
    assert float(wipe.input_value()) == pytest.approx(moved - 0.05)
    expect(page).to_have_url(re.compile(f"wipe={moved - 0.05:g}"))
    assert light.input_value() == before
    handle, stage = box_of(page, ".handle"), box_of(page, ".stage")
    assert handle["x"] + handle["width"] / 2 == pytest.approx(box["x"] + (0.95 + moved) / 2 * box["width"], abs=3)
    assert handle["y"] >= box["y"] + box["height"]
    assert handle["y"] + handle["height"] <= stage["y"] + stage["height"]


def test_address_keeps_light_exposure_view_and_zoom(visit: Visit, site: Site) -> None:
    page = painted(visit, site)
    page.locator(BOXES).first.uncheck()
    choose(page, "lighting", "one")
    page.get_by_label("theta_diff in degrees").fill("40")
    for name, value in (("exposure", "-1.5"), ("zoom", "1")):
        page.locator(f"[name={name}]").fill(value)
    repaint(page, lambda: page.locator(SPHERE).click(position={"x": 200, "y": 150}))
    expect(page).to_have_url(re.compile("highlight"))
    before, address = pixels(page), page.url
    page.goto("/health/live")
    page.goto(f"/fits/{site.fits['glossy']}")  # The light stays, what is shown does not.
    page.locator(PAINTED).wait_for()
    expect(page.locator("[name=lighting]")).to_have_value("one")
    expect(page.locator("#controls")).to_contain_text("-1.5 EV")
    expect(page.locator(BOXES).first).to_be_checked()
    page.goto("/health/live")
    page.goto(address)
    page.locator(PAINTED).wait_for()
    expect(page.get_by_label("theta_diff in degrees")).to_have_value("40")
    expect(page.locator("#controls")).to_contain_text("-1.5 EV")
    assert np.array_equal(pixels(page), before)
    repaint(page, page.get_by_role("button", name="Reset").click)
    expect(page.locator("[name=lighting]")).to_have_value("environment")


def test_values_under_the_pointer_are_the_fits(visit: Visit, site: Site) -> None:
    page = painted(visit, site)
    page.locator(SPHERE).hover(position={"x": 150, "y": 180})
    expect(page.locator(".hint")).to_contain_text("1/sr")
    found = re.match(r"θ_half ([\d.]+)°, θ_diff ([\d.]+)°: ([\d.]+),", page.locator(".hint").inner_text())
    assert found is not None
    half, diff, red = map(float, found.groups())
    box = box_of(page, SPHERE)
    x, y = 2 * 150 / box["width"] - 1, 1 - 2 * 180 / box["height"]
    light = np.array(THREE_LIGHTS[0].direction)
    middle = light + np.array([0.0, 0.0, 1.0])
    normal = np.array([x, y, np.sqrt(1 - x * x - y * y)])
    assert half == pytest.approx(np.degrees(np.arccos(normal @ middle / np.linalg.norm(middle))), abs=0.2)
    assert diff == pytest.approx(20.0, abs=0.1)
    near = site.model(site.fits["glossy"]).evaluate(np.radians(half), np.radians(diff))
    assert red == pytest.approx(near[0], rel=0.1)  # phi_diff is another, the lobe hardly depends on it there
    choose(page, "show", "half")
    with page.expect_request("**/v1/measurements/*/brdf"):
        page.locator(SPHERE).hover(position={"x": 150, "y": 181})  # left of the line


def test_components_are_hidden_and_shown(visit: Visit, site: Site) -> None:
    page = painted(visit, site)
    parts = [pixels(page)] + [repaint(page, box.uncheck) for box in page.locator(BOXES).all()]
    assert len(parts) > 2
    assert all(part.mean() < whole.mean() for whole, part in pairwise(parts))
    assert parts[-1][..., :3].max() == 0.0
    alone = repaint(page, page.locator(f"{BOXES}[value=diffuse]").check)
    diffuse = render_sphere(decompose(site.model(site.fits["glossy"]))["diffuse"], size=len(alone))
    expected = displayed(diffuse, site.exposure(site.fits["glossy"]))
    assert np.abs(alone[..., :3] - expected)[sphere_normals(len(alone))[1]].mean() < 0.5 / 255


def test_panorama_of_ones_own_lights_the_sphere(visit: Visit, site: Site, plastic: Measurement, tmp_path: Path) -> None:
    levels = np.full((256, 512, 3), 0.2)
    levels[:, 256:, :2] = 0.8
    room, square = (tmp_path / name for name in ("room.png", "square.png"))
    room.write_bytes(encode_png(levels))
    square.write_bytes(encode_png(levels[:, 128:384]))
    page, own = painted(visit, site), "#panorama"
    sky = choose(page, "lighting", "environment")
    seen = [repaint(page, lambda: page.set_input_files(own, room)), choose(page, "show", "measured")]
    _, mask = sphere_normals(len(sky))
    around = EnvironmentMap.from_pixels(((levels[::2, ::2] + 0.055) / 1.055) ** 2.4)
    sources = site.model(site.fits["glossy"]), plastic
    rendered = [render_sphere(one, lighting=around, size=len(sky)) for one in sources]
    for shown, expected in zip(seen, rendered, strict=True):
        assert np.abs(shown[..., :3] - displayed(expected, exposure(rendered[0], mask)))[mask].mean() < 1.5 / 255
    choose(page, "show", "fit")
    lobe = page.locator(f"{BOXES}[value=specular_lobe]")
    assert repaint(page, lobe.uncheck).mean() < seen[0].mean()
    repaint(page, lobe.check)
    assert np.array_equal(repaint(page, lambda: page.set_input_files(own, square)), sky)
    expect(page.locator("#said")).to_contain_text("square.png is no panorama: choose a .png or .jpg picture twice as")


def test_picture_stands_where_webgl_is_missing(visit: Visit, site: Site) -> None:
    page = visit(f"/fits/{site.fits['glossy']}", webgl=False).page
    expect(page.get_by_text("This browser has no WebGL 2")).to_be_visible()
    expect(page.locator("img.fallback")).to_have_js_property("naturalWidth", 256)
    expect(page.locator(".work")).to_be_empty()
    for control in (SPHERE, ".toggles"):
        expect(page.locator(control)).to_be_hidden()


def test_plots_tell_values_by_pointer_and_keys(visit: Visit, site: Site) -> None:
    fit = site.fits["glossy"]
    page = visit(f"/fits/{fit}", webgl=False).page
    expect(page.locator("img.fallback")).to_have_js_property("naturalWidth", 256)  # It moves the plots down.
    page.locator("#plots").scroll_into_view_if_needed()
    picture, legend, seen = page.locator("#plane .plot svg"), page.locator("#plane .legend"), list[int]()
    picture.hover(position={"x": 300, "y": 100})
    expect(legend).to_contain_text("at θ_out")
    for key in ("ArrowRight", "Tab"):
        place = re.search(r"at θ_out (-?[\d.]+)°", legend.inner_text())
        assert place is not None
        seen.append(round(float(place[1])))
        into, to = np.radians((-45, seen[-1]))
        directions = (np.array([np.sin(angle), 0.0, np.cos(angle)]) for angle in (into, to))
        told = float(legend.locator('[data-label="red, fit"] b').inner_text())
        assert told == pytest.approx(site.model(fit).evaluate_directions(*directions)[0], rel=0.02)
        picture.press(key)
    assert seen[1] == seen[0] + 2
    expect(legend).not_to_contain_text("at θ_out")
