"""One browser, one service that wants keys, one key with two fits: for all tests of the pages."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import httpx
import pytest

from tests.support.guarded import Guarded
from tests.support.webgl import CHROMIUM

if CHROMIUM is not None:
    from playwright.sync_api import Browser

    from tests.support.browser import Visitor, running_browser


@dataclass(frozen=True)
class Site:
    """A service, the header and the key of one user, and the ids of their fits by name."""

    http: httpx.Client
    header: dict[str, str]
    fits: dict[str, str]

    @property
    def key(self) -> str:
        return self.header["Authorization"].removeprefix("Bearer ")

    def submit(self, data: bytes, name: str, *, prefer: str = "wait=60", **options: Any) -> str:
        kind = {"Content-Type": "application/octet-stream", "Prefer": prefer}
        answer = self.http.post(
            "/v1/fits", params={"name": name, **options}, content=data, headers={**self.header, **kind}
        )
        fit: str = answer.json()["id"]
        return fit


@pytest.fixture(scope="module")
def site(guarded: Guarded, data: bytes) -> Site:
    made = Site(guarded.server.http, guarded.new_key("page"), {})
    for name, options in (("glossy", {"n_lobes": 2}), ("rough", {"method": "paper", "n_lobes": 1})):
        made.fits[name] = made.submit(data, name, **options)
    return made


@pytest.fixture(scope="module")
def browser() -> "Iterator[Browser]":
    if CHROMIUM is None:
        pytest.skip('"chromium" is not installed')
    with running_browser() as running:
        yield running


@pytest.fixture
def visit(browser: "Browser", site: Site) -> "Iterator[Callable[..., Visitor]]":
    """Open a page in a browser of its own; afterwards nothing may have gone wrong."""
    visitors: list[Visitor] = []

    def open_page(path: str, *, key: str | None = site.key, **options: Any) -> "Visitor":
        visitors.append(Visitor(browser, str(site.http.base_url), key, **options))
        visitors[-1].page.goto(path)
        return visitors[-1]

    yield open_page
    for visitor in visitors:
        visitor.close()
