"""What views of the page cost a browser that has never been there: requests, bytes, and seconds to the first sphere.

The browser is headless and draws without a graphics card. The list has ten fits that have just been made; it is there
when each of its spheres is drawn. Times are medians of several new browser profiles.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from playwright.sync_api import Browser, Request

from dsbrdf.data import encode_merl, synthetic_measurement
from tests.support.browser import new_context, running_browser
from tests.support.server import QUICK, Server

_FIRST_SPHERE = "() => document.querySelector('.sphere canvas[data-painted], .sphere img[src]:not([hidden])')"
_LIST = """() => {
  const spheres = [...document.querySelectorAll("main img")];
  return spheres.length >= 10 && spheres.every((sphere) => sphere.src && sphere.complete);
}"""


def main(argv: Sequence[str] | None = None) -> int:
    """Print one line a view."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks page_views", description=__doc__)
    parser.add_argument("--runs", type=int, default=5, help="new profiles for each view (default: 5)")
    runs = parser.parse_args(argv).runs
    content = encode_merl(synthetic_measurement())
    with (
        tempfile.TemporaryDirectory() as name,
        Server.running(Path(name) / "data") as server,
        running_browser() as browser,
    ):
        site = str(server.http.base_url).rstrip("/")
        print("| view | requests | kB | seconds |\n|---|---|---|---|")
        show(browser, site, "/", "no fits", "true", runs)
        fit = server.http.post("/v1/fits", content=content, headers={"Content-Type": "application/octet-stream"}).json()
        show(browser, site, f"/fits/{fit['id']}", "a fit, to its first sphere", _FIRST_SPHERE, runs)
        for number in range(1, 10):
            server.submit(fit["measurement"], **QUICK, mask=1.0 - number / 100)
        show(browser, site, "/", "ten fits, the very first time", _LIST, 1, height=2400)
        show(browser, site, "/", "ten fits, in a new profile", _LIST, runs, height=2400)
    return 0


def show(browser: Browser, site: str, path: str, view: str, awaited: str, runs: int, height: int = 720) -> None:
    """Open a view in new profiles, and print what it took."""
    seconds, weights = [], []
    for _ in range(runs):
        context = new_context(browser, site, None, device_scale_factor=1, viewport={"width": 1280, "height": height})
        page, received = context.new_page(), list[Request]()
        page.on("requestfinished", partial(list[Request].append, received))
        begin = time.perf_counter()
        page.goto(path)
        page.wait_for_function(awaited)
        seconds.append(time.perf_counter() - begin)
        page.wait_for_load_state("networkidle")
        sizes = [request.sizes()["responseBodySize"] for request in received if request.url.startswith(site)]
        weights.append((len(sizes), sum(sizes) / 1e3))
        context.close()
    requests, size = np.median(weights, axis=0)
    print(f"| {view} | {requests:.0f} | {size:.0f} | {np.median(seconds):.2f} |", flush=True)


if __name__ == "__main__":
    sys.exit(main())
