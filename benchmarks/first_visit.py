"""The path of a newcomer: from a clone to a shared link of a material under one's own light, steps and seconds.

The first table times each step: clone, installation, service, and then what is done in a browser, headless and without
a graphics card. The second says what the browser has received to show the home page and the page of the fit for the
first time: requests and bytes. The shared link must show the same picture to another browser, or the exit code is 1.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from playwright.sync_api import Page, expect

from dsbrdf.data.merl import write_merl
from dsbrdf.data.synthetic import synthetic_measurement
from tests.support.browser import new_context, running_browser
from tests.support.processes import free_port, wait_until

_T = TypeVar("_T")
PROJECT = Path(__file__).parent.parent
SPHERE = ".sphere canvas"
PAINTED = f"{SPHERE}[data-painted]"
PICTURE = "canvas => canvas.toDataURL()"


def main(argv: Sequence[str] | None = None) -> int:
    """Walk the path once; print both tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks first_visit", description=__doc__)
    parser.add_argument("--file", type=Path, metavar="MERL", help="a measurement, instead of a generated one")
    file = parser.parse_args(argv).file
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if file is None:
            file = folder / "glossy.binary"
            write_merl(file, synthetic_measurement().values)
        clone = folder / "dsbrdf"
        print("| step | seconds |\n|---|---|")
        timed("git clone", lambda: run("git", "clone", "--quiet", str(PROJECT), str(clone)))
        timed("make: environment with all packages", lambda: run("make", "--silent", ".venv/.ready", cwd=clone))
        port = free_port()
        command = [str(clone / ".venv/bin/dsbrdf"), "serve", "--port", str(port), "--data-dir", str(folder / "data")]
        with subprocess.Popen(command, cwd=clone, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as service:
            try:
                return walk(f"http://127.0.0.1:{port}", file)
            finally:
                service.terminate()


def walk(site: str, file: Path) -> int:
    """Open the page, drop a file, move the light, share the address."""
    with running_browser() as browser:
        page = new_context(browser, site, None, device_scale_factor=1).new_page()
        received: list[int] = []
        page.on("requestfinished", lambda request: received.append(request.sizes()["responseBodySize"]))
        timed("dsbrdf serve, until the page opens", lambda: wait_until(lambda: opened(page)))
        home = weight(page, received)
        choose = "choose a file, until its material is lit on a sphere"
        page.set_input_files("#file", file)
        timed(choose, lambda: page.wait_for_selector(PAINTED))
        fit = weight(page, received)
        timed("drag the light, until the sharp picture", lambda: drag(page))
        page.wait_for_url("**#*highlight=*")
        other = new_context(browser, site, None, device_scale_factor=1).new_page()
        timed("open the shared link elsewhere", lambda: other.goto(page.url) and other.wait_for_selector(PAINTED))
        other.wait_for_load_state("networkidle")
        same = page.locator(SPHERE).evaluate(PICTURE) == other.locator(SPHERE).evaluate(PICTURE)
    print(f"\n| first view | requests | kB |\n|---|---|---|\n| home page | {home} |\n| page of the fit | {fit} |")
    print(f"\nThe shared link shows {'the same picture' if same else 'ANOTHER PICTURE'}.")
    return 0 if same else 1


def timed(step: str, act: Callable[[], _T]) -> None:
    """Print how long a step takes."""
    begin = time.perf_counter()
    act()
    print(f"| {step} | {time.perf_counter() - begin:.1f} |", flush=True)


def run(*command: str, cwd: Path | None = None) -> None:
    """Run a command that must succeed."""
    subprocess.run(command, check=True, cwd=cwd, stdout=subprocess.DEVNULL)


def opened(page: Page) -> bool:
    """Whether the home page can be opened yet."""
    try:
        page.goto("/")
    except Exception:  # the browser's words for a refused connection
        return False
    return True


def drag(page: Page) -> None:
    """Drag the light across the sphere and wait for the picture of all pixels."""
    canvas = page.locator(SPHERE)
    before = canvas.get_attribute("data-painted") or ""
    box = canvas.bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + box["width"] / 5, y + box["height"] / 5, steps=10)
    page.mouse.up()
    expect(canvas).not_to_have_attribute("data-painted", before)
    page.wait_for_timeout(500)  # after it the page has written the light into its address


def weight(page: Page, received: list[int]) -> str:
    """What a view has received until nothing more comes: two cells of the table; forgets them."""
    page.wait_for_load_state("networkidle")
    cells = f"{len(received)} | {sum(received) / 1e3:.0f}"
    received.clear()
    return cells


if __name__ == "__main__":
    sys.exit(main())
