"""One browser, one service that wants keys, one key with two fits: for all tests of the pages."""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import Any

import httpx
import pytest

from dsbrdf import DSBRDF, render_sphere
from dsbrdf.data import encode_merl, synthetic_measurement
from dsbrdf.output import from_json
from dsbrdf.rendering import exposure, sphere_normals
from tests.support.server import Guarded
from tests.support.webgl import CHROMIUM

if CHROMIUM is not None and find_spec("playwright"):
    from playwright.sync_api import Browser, BrowserContext

    from tests.support.browser import Visitor, new_context, running_browser


NO_WEBGL = "HTMLCanvasElement.prototype.getContext = () => null"
"""A page whose spheres are pictures of the service takes a quarter of the time."""
DRAWN = re.compile(r"/figures/(\w+\.svg|sphere\.png\?(size=112&)?lighting=environment)")
NO_PICTURE = '<svg xmlns="http://www.w3.org/2000/svg" width="1" height="1"/>'
"""Instead of figures and small spheres that take the service seconds to draw; the tests of their routes have them."""


@dataclass(frozen=True)
class Site:
    """A service, the header and the key of one user, and the ids of their fits by name."""

    http: httpx.Client
    header: dict[str, str]
    fits: dict[str, str]

    @property
    def address(self) -> str:
        return str(self.http.base_url).rstrip("/")

    @property
    def key(self) -> str:
        return self.header["Authorization"].removeprefix("Bearer ")

    def read(self, path: str) -> httpx.Response:
        return self.http.get(path, headers=self.header)

    def model(self, fit: str) -> DSBRDF:
        return from_json(self.read(f"/v1/fits/{fit}/export?format=json").text)[0]

    def exposure(self, fit: str) -> float:
        """What the page multiplies the radiance of a fit by: its sphere of 64 pixels gives it."""
        return exposure(render_sphere(self.model(fit), size=64), sphere_normals(64)[1])

    def submit(self, data: bytes, name: str, *, prefer: str = "wait=60", **options: Any) -> str:
        headers = {**self.header, "Content-Type": "application/octet-stream", "Prefer": prefer}
        answer = self.http.post("/v1/fits", params={"name": name, **options}, content=data, headers=headers)
        fit: str = answer.json()["id"]
        return fit


@pytest.fixture(scope="session")
def site(guarded: Guarded, data: bytes) -> Site:
    made = Site(guarded.server.http, guarded.new_key("page"), {})
    made.fits["glossy"] = made.submit(data, "glossy", n_lobes=2)
    dark = encode_merl(synthetic_measurement(diffuse=(0.02, 0.05, 0.02)))
    made.fits["rough"] = made.submit(dark, "rough", method="paper", n_lobes=1)
    return made


@pytest.fixture(scope="package")
def browser() -> "Iterator[Browser]":
    """A browser for the tests of the folder: while it is there, no other test of the process can have an event loop."""
    with running_browser() as running:
        yield running


def _context(browser: "Browser", site: Site, webgl: bool, key: str | None, **options: Any) -> "BrowserContext":
    context = new_context(browser, site.address, key, **options)
    if not webgl:
        context.add_init_script(NO_WEBGL)
    context.route(DRAWN, lambda route: route.fulfill(body=NO_PICTURE, content_type="image/svg+xml"))
    return context


@pytest.fixture(scope="package")
def signed_in(browser: "Browser", site: Site) -> "Mapping[bool, BrowserContext]":
    """The user's browser with WebGL and without; the user looks at all pages in it, each picture is drawn once."""
    return {webgl: _context(browser, site, webgl, site.key) for webgl in (True, False)}


@pytest.fixture
def visit(
    browser: "Browser", site: Site, signed_in: "Mapping[bool, BrowserContext]"
) -> "Iterator[Callable[..., Visitor]]":
    """Open a page, for a header or with options of its own in a browser with storage of its own.

    Afterwards nothing may have gone wrong.
    """
    visitors: list[Visitor] = []

    def open_page(
        path: str, *, header: dict[str, str] | None = site.header, webgl: bool = True, **options: Any
    ) -> "Visitor":
        context = signed_in[webgl]
        if header != site.header or options:
            key = replace(site, header=header).key if header else None
            context = _context(browser, site, webgl, key, **options)
        visitors.append(Visitor(context, site.address))
        visitors[-1].page.goto(path)
        return visitors[-1]

    yield open_page
    for visitor in visitors:
        visitor.close()
        if visitor.context not in signed_in.values():
            visitor.context.close()
