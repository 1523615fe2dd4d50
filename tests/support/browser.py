"""Pages of the service in a headless Chromium, and what the browser says of them; tests without one are skipped."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from tests.support.webgl import CHROMIUM, SOFTWARE_RENDERER

if CHROMIUM is None:
    pytest.skip('"chromium" is not installed', allow_module_level=True)
pytest.importorskip("playwright", reason='"playwright" is not installed')

from playwright.sync_api import Browser, BrowserContext, Page, expect, sync_playwright

__all__ = ["PAINTED", "Page", "Visit", "Visitor", "expect", "new_context", "running_browser"]

PAINTED = "canvas[data-painted]"
_PATIENCE = 60_000  # milliseconds until what should appear on a page is given up, on a busy machine
# The browser reports each answer above 399 itself; the page shows what it says.
_REPORTED = "Failed to load resource: the server responded with a status of 4"


@contextmanager
def running_browser() -> Iterator[Browser]:
    """Start the browser that is installed."""
    expect.set_options(timeout=_PATIENCE)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--disable-dev-shm-usage", *SOFTWARE_RENDERER]
        )
        yield browser
        browser.close()


def new_context(browser: Browser, site: str, key: str | None, **options: Any) -> BrowserContext:
    """Return what keeps cookies and files of its own in a browser, signed in if there is a key."""
    # Without a graphics card a sphere of many pixels takes seconds.
    options = {"device_scale_factor": 0.25, **options}
    context = browser.new_context(base_url=site, **options)
    context.set_default_timeout(_PATIENCE)
    if key is not None:
        cookie = {"name": "dsbrdf_key", "value": key, "url": site, "httpOnly": True, "sameSite": "Strict"}
        context.add_cookies([cookie])  # type: ignore[list-item]  # a dict with these members
    return context


Visit = Callable[..., "Visitor"]


class Visitor:
    """Someone who looks at pages of one site; `close` checks that nothing went wrong and nothing came from elsewhere.

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
        self.page.on(
            "request",
            lambda request: self.requests.append(
                (request.method, request.url, request.headers.get("content-type", ""))
            ),
        )

    def _on_console(self, message: Any) -> None:
        expected = message.text.startswith(_REPORTED) or "GPU stall due to ReadPixels" in message.text  # by the tests
        if message.type in ("error", "warning") and not expected:
            self.faults.append(message.text)

    def close(self) -> None:
        self.page.close()
        assert self.faults == []
        assert self.requests
        elsewhere = [url for _, url, _ in self.requests if not url.startswith((f"{self.site}/", "data:"))]
        assert elsewhere == []
