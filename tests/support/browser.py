"""Pages of the service in a headless Chromium, and what the browser says of them; tests without one are skipped."""

import json
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest

from tests.support.webgl import CHROMIUM, SOFTWARE_RENDERER

if CHROMIUM is None:
    pytest.skip('"chromium" is not installed', allow_module_level=True)
pytest.importorskip("playwright", reason='"playwright" is not installed')

from playwright.sync_api import Browser, BrowserContext, FloatRect, Page, expect, sync_playwright

__all__ = ["PAINTED", "SPHERE", "FloatRect", "Page", "Visit", "Visitor", "expect", "new_context", "running_browser"]

SPHERE = ".sphere canvas"
PAINTED = f"{SPHERE}[data-painted]:not([data-drawing])"
_PATIENCE = 60_000  # milliseconds until what should appear on a page is given up, on a busy machine
_PAGE = re.compile(r"/(fits/\w+|measurements/\w+|compare|docs(/[\w.-]+)?|page/[\w.-]+|openapi\.json)?")
# The browser reports each answer above 399 itself; the page shows what it says.
_REPORTED = "Failed to load resource: the server responded with a status of 4"


@contextmanager
def running_browser() -> Iterator[Browser]:
    expect.set_options(timeout=_PATIENCE)
    with sync_playwright() as playwright:
        flags = ["--no-sandbox", "--disable-dev-shm-usage", *SOFTWARE_RENDERER]
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
        yield browser
        browser.close()


def new_context(browser: Browser, site: str, key: str | None, **options: Any) -> BrowserContext:
    """Return what keeps storage and files of its own in a browser, signed in if there is a key."""
    # Without a graphics card a sphere of many pixels takes seconds.
    options = {"device_scale_factor": 0.25, **options}
    context = browser.new_context(base_url=site, **options)
    context.set_default_timeout(_PATIENCE)
    if key is not None:
        context.add_init_script(f"sessionStorage.setItem({json.dumps(f'key of {site}/')}, {json.dumps(key)})")
    return context


Visit = Callable[..., "Visitor"]


class Visitor:
    """Someone who looks at pages of one site; `close` checks that nothing went wrong, nothing came from elsewhere, and
    all that came is static or described by the OpenAPI document.

    `requests` are what the page has asked for: method, address and type of the body.
    """

    def __init__(self, context: BrowserContext, site: str) -> None:
        self.site = site
        self.context = context
        self.page: Page = context.new_page()
        self.faults: list[str] = []
        self.requests: list[tuple[str, str, str]] = []
        self.page.on("console", self._on_console)
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.on("request", self._on_request)

    def _on_request(self, request: Any) -> None:
        self.requests.append((request.method, request.url, request.headers.get("content-type", "")))

    def _on_console(self, message: Any) -> None:
        # The tests cause stalls.
        expected = message.text.startswith(_REPORTED) or "GPU stall due to ReadPixels" in message.text
        if message.type in ("error", "warning") and not expected:
            self.faults.append(message.text)

    def close(self) -> None:
        self.page.close()
        assert self.faults == [], self.faults
        assert self.requests
        inner = ("data:", f"blob:{self.site}/")
        asked = [(method, url) for method, url, _ in self.requests if not url.startswith(inner)]
        assert [url for _, url in asked if not url.startswith(f"{self.site}/")] == []
        described = _described(self.site)
        for method, url in asked:
            path = urlsplit(url).path
            assert (method == "GET" and _PAGE.fullmatch(path)) or any(
                pattern.fullmatch(path) and method in methods for pattern, methods in described
            ), f"{method} {path} is not described"


def _described(site: str) -> list[tuple[re.Pattern[str], set[str]]]:
    paths: dict[str, dict[str, Any]] = httpx.get(f"{site}/openapi.json").json()["paths"]
    return [
        (re.compile(re.sub(r"\{\w+\}", r"[^/]+", path)), {name.upper() for name in methods} | {"HEAD"})
        for path, methods in paths.items()
    ]
