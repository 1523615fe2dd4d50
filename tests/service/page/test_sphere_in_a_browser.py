"""The sphere of a fit in a browser: what is painted, the light, views, zoom and what the address keeps."""

import base64
import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dsbrdf.data.measurement import Measurement
from dsbrdf.fitting.decomposition import decompose
from dsbrdf.model.environment import THREE_LIGHTS, EnvironmentMap
from dsbrdf.model.image_metrics import displayed, exposure
from dsbrdf.model.render import render_sphere, sphere_normals
from dsbrdf.output.sphere_panels import encode_png
from tests.service.page.conftest import Site
from tests.support.browser import PAINTED, SPHERE, Page, Visit, expect

pytestmark = pytest.mark.slow

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
    values = np.frombuffer(base64.b64decode(page.locator(SPHERE).evaluate(PIXELS)), np.uint8)
    size = round((values.size / 4) ** 0.5)
    return values.reshape(size, size, 4)[::-1] / 255.0


def repaint(page: Page, act: Callable[[], object]) -> np.ndarray:
    """What the canvas shows after an act that paints it again."""
    canvas = page.locator(SPHERE)
    before = canvas.get_attribute("data-painted") or ""
    act()
    expect(canvas).not_to_have_attribute("data-painted", before)
    return pixels(page)


def painted(visit: Visit, site: Site, **options: Any) -> Page:
    """The page of a fit whose sphere is there."""
    page: Page = visit(f"/fits/{site.fits['glossy']}", **options).page
    page.locator(PAINTED).wait_for()
    return page


def test_fit_and_measurement_are_shown_as_the_library_renders_them(
    visit: Visit, site: Site, plastic: Measurement
) -> None:
    page, model = painted(visit, site), site.model(site.fits["glossy"])
    shown = pixels(page)
    size = len(shown)
    _, mask = sphere_normals(size)
    expected = displayed(render_sphere(model, size=size), site.exposure(site.fits["glossy"]))
    assert np.abs(shown[..., :3] - expected)[mask].mean() < 0.5 / 255
    assert np.array_equal(shown[..., 3] == 1.0, mask)
    for lighting in ("three", "environment"):
        rendered = [render_sphere(s, lighting=LIGHTINGS[lighting], size=size) for s in (plastic, model)]
        factor = exposure(rendered[1], mask) if lighting == "environment" else site.exposure(site.fits["glossy"])
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


def test_line_between_the_halves_is_moved_by_mouse_and_keys(visit: Visit, site: Site) -> None:
    page = painted(visit, site)
    light = page.locator("[name=highlight]").input_value()
    repaint(page, page.get_by_label("half and half").check)
    page.locator(SPHERE).scroll_into_view_if_needed()
    canvas, stage = (page.locator(place).bounding_box() for place in (SPHERE, ".stage"))
    assert canvas is not None
    assert stage is not None
    middle = canvas["y"] + canvas["height"] / 2
    page.mouse.move(canvas["x"] + canvas["width"] / 2, middle)
    page.mouse.down()
    page.mouse.move(canvas["x"] + 0.7 * canvas["width"], middle)
    page.mouse.up()
    wipe = page.locator("[name=wipe]")
    dragged = float(wipe.input_value())
    assert dragged == pytest.approx(0.4, abs=0.02)
    page.locator(SPHERE).focus()
    page.keyboard.press("[")
    moved = float(wipe.input_value())
    assert moved == pytest.approx(dragged - 0.05)
    expect(page).to_have_url(re.compile(f"wipe={moved:g}"))
    assert page.locator("[name=highlight]").input_value() == light
    handle = page.locator(".handle").bounding_box()
    assert handle is not None
    assert handle["x"] + handle["width"] / 2 == pytest.approx(canvas["x"] + (1 + moved) / 2 * canvas["width"], abs=3)
    assert handle["y"] >= canvas["y"] + canvas["height"]
    assert handle["y"] + handle["height"] <= stage["y"] + stage["height"]


def test_address_keeps_light_exposure_view_and_zoom(visit: Visit, site: Site) -> None:
    page = painted(visit, site)
    page.locator("[data-component]").first.uncheck()
    page.get_by_label("one light only").check()
    page.get_by_label("measured", exact=True).check()
    page.get_by_label("theta_diff in degrees").fill("40")
    for name, value in (("exposure", "-1.5"), ("zoom", "1")):
        page.locator(f"[name={name}]").fill(value)
    repaint(page, lambda: page.locator(SPHERE).click(position={"x": 200, "y": 150}))
    expect(page).to_have_url(re.compile("highlight"))
    page.wait_for_timeout(600)  # the picture and the address are at rest
    before, address = pixels(page), page.url
    page.goto("/")
    page.goto(address)
    page.locator(PAINTED).wait_for()
    expect(page.locator("#profiles output")).to_have_text("40°")
    expect(page.locator("#exposure-value")).to_have_text("-1.5 EV")
    assert np.array_equal(pixels(page), before)
    repaint(page, page.get_by_role("button", name="Reset").click)
    expect(page.get_by_label("fit", exact=True)).to_be_checked()


def test_fewer_pixels_are_painted_while_the_light_is_dragged(visit: Visit, site: Site) -> None:
    page = painted(visit, site, device_scale_factor=1)
    canvas = page.locator(SPHERE)
    size = canvas.evaluate("canvas => canvas.width")
    box = canvas.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 200, box["y"] + 200)
    before = canvas.get_attribute("data-painted") or ""
    page.mouse.down()
    for step in range(6):
        page.mouse.move(box["x"] + 200 + 15 * step, box["y"] + 200)
    page.mouse.up()
    expect(canvas).not_to_have_attribute("data-painted", before)
    assert int(canvas.get_attribute("data-rough") or size) < 0.7 * size
    expect(canvas).to_have_js_property("width", size)  # the sharp picture comes when the light rests


def test_values_under_the_pointer_are_the_fits(visit: Visit, site: Site) -> None:
    page = painted(visit, site)
    page.locator(SPHERE).hover(position={"x": 150, "y": 180})
    hint = page.locator(".hint")
    expect(hint).to_contain_text("1/sr")
    found = re.match(r"θ_half ([\d.]+)°, θ_diff ([\d.]+)°: ([\d.]+),", hint.inner_text())
    assert found is not None
    half, diff, red = map(float, found.groups())
    box = page.locator(SPHERE).bounding_box()
    assert box is not None
    x, y = 2 * 150 / box["width"] - 1, 1 - 2 * 180 / box["height"]
    light = np.array(THREE_LIGHTS[0].direction)
    middle = light + np.array([0.0, 0.0, 1.0])
    normal = np.array([x, y, np.sqrt(1 - x * x - y * y)])
    assert half == pytest.approx(np.degrees(np.arccos(normal @ middle / np.linalg.norm(middle))), abs=0.2)
    assert diff == pytest.approx(20.0, abs=0.1)
    near = site.model(site.fits["glossy"]).evaluate(np.radians(half), np.radians(diff))
    assert red == pytest.approx(near[0], rel=0.1)  # phi_diff is another, the lobe hardly depends on it there


def test_light_exposure_and_components_are_under_mouse_and_keyboard(visit: Visit, site: Site) -> None:
    page = painted(visit, site)
    canvas = page.locator(SPHERE)
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
    alone = repaint(page, page.locator('[data-component="diffuse"]').check)
    diffuse = render_sphere(decompose(site.model(site.fits["glossy"]))["diffuse"], size=len(alone))
    expected = displayed(diffuse, site.exposure(site.fits["glossy"]))
    assert np.abs(alone[..., :3] - expected)[sphere_normals(len(alone))[1]].mean() < 0.5 / 255


def test_panorama_of_ones_own_lights_the_sphere(visit: Visit, site: Site, tmp_path: Path) -> None:
    rows, columns = np.mgrid[0:128, 0:256]
    levels = np.stack([rows + 40, columns // 2 + 20, np.where(columns < 60, 250, 30)], axis=-1) / 255.0
    file = tmp_path / "room.png"
    file.write_bytes(encode_png(levels))
    light = np.where(levels > 0.04045, ((levels + 0.055) / 1.055) ** 2.4, levels / 12.92)
    fit = site.fits["glossy"]
    visitor = visit(f"/fits/{fit}#lighting=panorama")
    page = visitor.page
    expect(page.locator(".hint")).to_contain_text("Choose a panorama")
    model = site.model(fit)
    page.locator("#panorama").set_input_files(file)
    page.locator(PAINTED).wait_for()
    shown = pixels(page)
    back = repaint(page, lambda: page.locator("[name=turn]").fill("90"))
    size = len(shown)
    _, mask = sphere_normals(size)
    for seen, columns_turned in ((shown, 0), (back, 64)):
        around = EnvironmentMap.from_pixels(np.roll(light, columns_turned, axis=1))
        rendered = render_sphere(model, lighting=around, size=size)
        expected = displayed(rendered, exposure(rendered, mask))
        assert np.abs(seen[..., :3] - expected)[mask].mean() < 1.5 / 255
    repaint(page, page.locator("[data-component]").first.uncheck)
    asked = [url.partition("&component=")[2] for _, url, _ in visitor.requests if "/figures/sphere.npy" in url]
    assert sorted(asked) == ["", "", "diffuse", "specular_lobe"]  # the whole fit for each turn
    other = tmp_path / "room.hdr"
    other.write_bytes(b"#?RADIANCE\n\n-Y 4 +X 8\n" + bytes(128))
    page.locator("#panorama").set_input_files(other)
    expect(page.locator("#said")).to_contain_text("save it as .exr")
