"""What the pages show of documents and values that are made up, and ask for, is what it has been before."""

import json
import re
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from difflib import ndiff
from itertools import groupby
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest

from tests.service.http.page.conftest import NO_PICTURE
from tests.support.browser import PAINTED, Page, Visit, Visitor
from tests.support.models import mixture, scattered_samples
from tests.support.reproduced import assert_reproduced, digest
from tests.support.server import npy

pytestmark = pytest.mark.slow
SCRIPT = Path(__file__).with_name("reproduced.js").read_text()
MADE_UP = json.loads(Path(__file__).with_name("made_up.json").read_text())
STORED = Path(__file__).parents[3] / "project/stored/1.0/dsbrdf.sqlite"
GRID = "a" * 64
TABLE = "b" * 64
TIME = "2026-01-02T03:04:05.678Z"
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def documents() -> dict[str, dict[str, Any]]:
    """Fits in each state by their ids."""
    with closing(sqlite3.connect(f"file:{STORED}?mode=ro&immutable=1", uri=True)) as db:
        (row,) = db.execute("SELECT metrics, options, result FROM fits").fetchall()
    metrics, options, result = map(json.loads, row)
    good = {"status": "succeeded", "progress": 1.0, "likeness": "very close (40.0 dB)"}
    kinds = {name: kind if "status" in kind else good | kind for name, kind in MADE_UP["fits"].items()}
    for kind in kinds.values():
        if kind["status"] == "succeeded":
            kind |= {"metrics": metrics | kind.get("metrics", {}), "options": options | kind.get("options", {})}
    plain = {"measurement": GRID, "metrics": None, "likeness": None, "error": None, "progress": 0.0, "options": options}
    plain |= {"created": TIME, "started": TIME, "finished": TIME, **result, "warnings": [], "measure_next": []}
    return {BY_NAME[name]: {"id": BY_NAME[name], "name": name, **plain, **kind} for name, kind in kinds.items()}


BY_NAME = {name: str(number) * 32 for number, name in enumerate(MADE_UP["fits"])}
FITS = documents()


def measurement(sha256: str) -> dict[str, Any]:
    on_grid = sha256 == GRID
    fits = [BY_NAME["glossy"], BY_NAME["running"]] if on_grid else []
    about = {"sha256": sha256, "name": "plate 7" if on_grid else None, "created": TIME, "fits": fits}
    return about | {"size": 34_992_012 if on_grid else 4321, "valid_nodes": 1_111_430 if on_grid else 0}


def value(path: str, half: float, diff: float, phi: float) -> list[float] | None:
    """A lobe for the whole, half of it for each component, and gaps in the measurement."""
    if "measurements" in path and (phi > 100 or half > 70):
        return None
    lobe = np.exp(-((half / 12) ** 2)) * (1 + diff / 60) * (1 + phi / 900) * (0.5 if "components" in path else 1.0)
    return [float(scale * lobe + 0.01) for scale in (1.0, 0.4, 0.0002)]


def values(path: str, points: dict[str, list[Any]]) -> list[list[float] | None]:
    if "omega_in" in points:
        sums = [[*map(float, np.add(*pair))] for pair in zip(*points.values(), strict=True)]
        return [None] * len(sums) if "measurements" in path else [*sums]
    return [value(path, *point) for point in zip(*points.values(), strict=True)]


def share_of(path: str) -> np.float32:
    """What a fit or a measurement is brighter than another."""
    return np.float32(1.0 + ord(path.split("/")[1][0]) % 16 / 8.0)


def array(path: str, query: str) -> bytes:
    if "table" in path:
        return npy(np.full((90, 90, 180, 3), -1.0, np.float16))
    if "samples" in path:
        samples = scattered_samples(mixture(2, 0), 300)
        return npy(np.hstack([samples.omega_in, samples.omega_out, samples.values]).astype(np.float32))
    (size,) = map(int, re.findall(r"size=(\d+)", query))
    ramp = np.linspace(0.0, 1.0, size, dtype=np.float32)
    blue = np.float32(0.3 + 0.2 * ("component" in query))
    return npy(share_of(path) * np.stack(np.broadcast_arrays(ramp, ramp[:, None], blue), -1))


def sums(text: str) -> str:
    """Sums over the numbers of a path instead of these."""
    numbers = [*map(float, NUMBER.findall(text))]
    return " ".join([str(len(numbers)), *(f"{mean:.1f}" for mean in digest(numbers)["means"])])


class Interface:
    """Answers of a made-up service, and what it has been asked for."""

    def __init__(self) -> None:
        self.fits: list[dict[str, Any]] = []
        self.refused: tuple[str, int] | None = None
        self.asked: set[str] = set()

    def answer(self, route: Any) -> None:
        request = route.request
        address, _, query = request.url.partition("?")
        path = address.partition("/v1/")[2]
        sent = request.post_data or ""
        points = json.loads(sent) if path.endswith("/brdf") else {}
        told = {name: digest(np.array(given, float))["means"] for name, given in points.items()}
        said = " ".join(f"{name} {np.round(means, 3)}" for name, means in told.items()) or sent[:300]
        accepts = " ".join(
            f"{name}: {request.headers[name]}" for name in ("content-type", "prefer") if name in request.headers
        )
        self.asked.add(" ".join(filter(None, [request.method, path, unquote(query), accepts, said])))
        first, *rest = path.split("/")
        if self.refused is not None and self.refused[0] in path:
            route.fulfill(status=self.refused[1], json={"title": "Refused", "detail": f"It answers {self.refused[1]}."})
        elif path == "fits" and request.method == "GET":
            older = {"Link": '</v1/fits?limit=9&cursor=3>; rel="next"'} if self.fits else {}
            route.fulfill(json={"items": self.fits}, headers=older)
        elif path == "materials":
            route.fulfill(json={"items": [FITS[BY_NAME["material"]]]})
        elif path == "tables":
            route.fulfill(json=MADE_UP["table"])
        elif path.endswith("/brdf"):
            route.fulfill(json={"values": values(path, points)})
        elif path.endswith(".npy"):
            route.fulfill(body=array(path, query))
        elif "/figures/" in path:
            route.fulfill(body=NO_PICTURE, content_type="image/svg+xml")
        elif path.endswith("/export"):
            name = {"Content-Disposition": 'attachment; filename="glossy.glsl"'}
            route.fulfill(body=" ".join(MADE_UP["glsl"]).replace("SHARE", f"{share_of(path):.3f}"), headers=name)
        elif path.endswith("/content"):
            route.fulfill(body="AOI,signal\n0,1\n")
        elif len(rest) == 1 and (first == "measurements" or rest[0] in FITS):
            route.fulfill(json=measurement(rest[0]) if first == "measurements" else FITS[rest[0]])
        else:
            route.fulfill(status=404, json={"title": "None", "detail": f"There is no {path}."})


class Look:
    """A page of the made-up service; `state` stores what it shows, and what it has asked for since the last state."""

    def __init__(self, visitor: Visitor) -> None:
        self.page: Page = visitor.page
        self.site, self.interface = visitor.site, Interface()
        self.page.route("**/v1/**", self.interface.answer)
        self.found: dict[str, Any] = {}
        self.shown: dict[str, Any] = {}

    def call(self, name: str, *arguments: str) -> Any:
        return self.page.evaluate(f"(given) => ({SCRIPT}).{name}(...given)", arguments)

    def settle(self) -> None:
        """Wait until nothing is asked for, drawn or put off any more."""
        for _ in range(200):
            before = len(self.interface.asked)
            if not self.call("restless") and len(self.interface.asked) == before:
                return
        raise AssertionError("the page has no rest")

    def open(self, path: str, *fits: str) -> None:
        self.interface.fits = [FITS[BY_NAME[name]] for name in fits]
        self.page.goto(path)
        self.shown = {}

    def state(self, name: str) -> None:
        """Note what is shown, or what has changed since the last state of the page."""
        self.settle()
        shown = self.call("drawn") | {"words": self.page.locator("body").aria_snapshot().splitlines()}
        shown = json.loads(re.sub(r"(\w)\1{31,}", r"\1...", json.dumps(shown).replace(self.site, "")))
        for plot in shown["plots"]:
            kinds = groupby(plot["paths"], lambda path: NUMBER.sub("", path.partition(" M")[0]))
            plot["paths"] = [f"{kind}: {sums(' '.join(paths))}" for kind, paths in kinds]
        changed = {key: part for key, part in shown.items() if part != self.shown.get(key)}
        if "plots" in changed:
            changed["plots"] = [plot for plot in shown["plots"] if plot not in self.shown.get("plots", [])]
        if self.shown and "words" in changed:
            lines = ndiff(self.shown["words"], shown["words"])
            changed["words"] = [line for line in lines if line[0] in "+-"]
        self.shown = shown
        asked = sorted(re.sub(r"(\w)\1{31,}", r"\1...", line) for line in self.interface.asked if "wait=1" not in line)
        self.found[name] = changed | {"pixels": self.call("pixels"), "asked": asked}
        self.interface.asked.clear()


@pytest.fixture
def look(visit: Visit) -> Iterator[Look]:
    made = Look(visit("/page/page.css", viewport={"width": 1100, "height": 900}))
    yield made
    made.page.unroute_all()


def test_list(look: Look, tmp_path: Path) -> None:
    page, files = look.page, [tmp_path / name for name in ("tile.csv", "a.b\u202e.binary", "c.binary")]
    for file in files:
        file.write_text("AOI,signal,note\n0,1,x\n")
    look.open("/")
    look.state("empty")
    page.locator("#upload summary").click()
    look.state("options")
    look.open("/?name=other&limit=9", *BY_NAME)
    look.state("all")
    for text in ("TAB", "zzz", ""):
        page.get_by_role("searchbox").fill(text)
        look.state(f"search {text}")
    for order in ("name", "likeness", "newest"):
        page.locator("#sort").select_option(order)
        look.state(f"by {order}")
    for name in ("glossy", "table"):
        page.get_by_label(f"compare {name}").check()
        look.state(f"{name} ticked")
    page.locator("#fits .menu summary").nth(3).click()
    page.get_by_role("button", name="Delete table").click()
    look.state("deleted")
    page.get_by_role("button", name="Undo").click()
    look.state("taken back")
    look.open("/", "glossy")
    page.locator("#file").set_input_files(files[0])
    look.state("table")
    page.get_by_label("Read note as").select_option("value")
    look.state("another column")
    look.interface.refused = "tables", 422
    page.get_by_label("Read AOI as").select_option("weight")
    look.state("table refused")
    look.interface.refused = "v1/fits?", 404
    look.call("upload", "It is no measurement.")
    page.get_by_label("Number of lobes").evaluate("(field) => { field.value = 3; }")
    page.locator("#file").set_input_files(files[1:])
    page.locator("#said:visible").wait_for()
    look.found["uploads"] = [
        re.sub("Bearer .*", "", line.replace(look.site, "")) for line in page.evaluate("window.told")
    ]
    look.state("upload refused")
    assert_reproduced("page/list", look.found, 2e-3)


def test_fit(look: Look) -> None:
    page = look.page
    look.open(f"/fits/{BY_NAME['glossy']}")
    page.locator(PAINTED).wait_for()
    page.locator("#plots").scroll_into_view_if_needed()
    page.locator("#plane .curve").first.wait_for()
    page.locator(".downloads").scroll_into_view_if_needed()
    look.state("whole")
    for name in ("Metrics", "Options of the fit", "Explain these numbers", "Parameters and residual", "More"):
        page.get_by_text(name, exact=True).click()
    look.state("opened")
    for panel, slider, place in (("#profiles", "theta-diff", "60"), ("#plane", "theta-in", "70")):
        page.locator(f"[name={slider}]").fill(place)
        page.locator(f"{panel} [name$=channel]").select_option("green")
        look.state(f"{panel} at {place}, green")
        page.locator(f"{panel} [name$=axis]").select_option("linear")
        for channel in ("red", "blue", "green"):
            page.locator(f"{panel} [name$=channel]").select_option(channel)
            look.state(f"{panel} linear, {channel}")
        for key in ("ArrowRight", "ArrowLeft", "ArrowLeft"):
            page.locator(f"{panel} .plot svg").press(key)
        look.state(f"{panel} told")
    page.locator("[name=range]").select_option("peak")
    look.state("the peak")
    choices = ("measured", "three_lights", "difference", "one", "half")
    for choice in choices:
        page.locator(f"#controls select:has([value={choice}])").select_option(choice)
        look.state(choice)
    for key in ("[", "]", "]", "+", "-", "-", "ArrowLeft", "ArrowUp", "Control+r"[-1]):
        page.locator(".sphere canvas").press(key)
        look.state(f"key {key} {len(look.found)}")
    for name, number in (("zoom", "1"), ("exposure", "1.5"), ("wipe", "0.5")):
        page.locator(f"[name={name}]").evaluate(f"(field) => {{ field.value = {number}; }}")
        page.locator(f"[name={name}]").dispatch_event("change", {"bubbles": True})
        look.state(f"{name} {number}")
    page.locator(".toggles input").first.uncheck()
    look.state("without the lobe")
    page.wait_for_timeout(300)  # The address follows after a while.
    look.found["kept"] = page.evaluate("[location.hash, sessionStorage.getItem(`light of ${location.origin}/`)]")
    assert_reproduced("page/fit", look.found, 2e-3)


@pytest.mark.parametrize("view", ["measurements", "compare", "fits"])
def test_others(look: Look, view: str) -> None:
    page, ids = look.page, {name: f"/fits/{identity}" for name, identity in BY_NAME.items()}
    pairs = [(BY_NAME[first], BY_NAME[second]) for first, second in (("glossy", "other_paint"), ("glossy", "running"))]
    paths = {
        "measurements": [f"/measurements/{GRID}", f"/measurements/{TABLE}"],
        "compare": [f"/compare?fit={first}&fit={second}" for first, second in pairs] + ["/compare?fit=a"],
        "fits": [*[path for name, path in ids.items() if name != "glossy"], "/fits/unknown"],
    }[view]
    for path in paths:
        look.open(path)
        page.locator("main:not([aria-busy])").wait_for()
        if page.locator("#plots").count():
            page.locator("#plots").scroll_into_view_if_needed()
            page.locator("#plots .plot svg").last.wait_for()
        look.state(path.replace(GRID, "grid"))
    if view == "fits":
        for status in (401, 403):
            look.interface.refused = "fits", status
            look.open(ids["glossy"])
            page.get_by_text("Sign in" if status == 401 else "It answers 403").first.wait_for()
            look.state(f"refused {status}")
        look.interface.refused = None
        look.open("/compare")
        page.get_by_text("Nothing to compare").wait_for()
        page.evaluate("sessionStorage.setItem(`key of ${location.origin}/`, 'a key')")
        look.found["functions"] = look.call("functions")
    assert_reproduced(f"page/{view}", look.found, 2e-3)
