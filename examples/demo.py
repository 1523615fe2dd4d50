"""From a measurement over HTTP to components, and a figure that ends with lit spheres: ``make demo``.

The service runs in a process of its own, as for any other client, and is used through httpx only.
"""

import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from numpy.typing import NDArray

import dsbrdf
from dsbrdf.data.geometry import CHANNELS, THETA_DIFF, THETA_HALF
from dsbrdf.data.rgl import read_rgl
from dsbrdf.output.figure_panels import encode_figure
from dsbrdf.output.figures import overview_figure
from dsbrdf.output.report_text import component_surfaces_table, components_table, metrics_lines
from dsbrdf.output.serialize import from_json
from dsbrdf.output.sphere_panels import compare_spheres

Array = NDArray[np.float64]

MEASUREMENT = Path(__file__).with_name("satin_purple.bsdf")
START_TIMEOUT_S = 60.0
STOP_TIMEOUT_S = 10.0
# The table of values shows these nodes of the MERL grid.
SHOWN_THETA_HALF_NODES = (10, 20, 60)
SHOWN_THETA_DIFF_NODES = (0, 60)


def main(folder: Path) -> None:
    """Print the responses of the service and save ``demo.png`` in a folder."""
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="dsbrdf-demo-") as scratch, running_service(Path(scratch)) as url:
        print(f"service on {url}, ready after {time.perf_counter() - begin:.1f} s")
        measurement = read_rgl(MEASUREMENT).measurement()
        with httpx.Client(base_url=url, timeout=60.0) as client:
            fit = _fit_twice(client)
            model, report = from_json(_get(client, fit, "export", format="json").text)
            _show_components(client, fit)
            _show_metrics(report, model.n_lobes)
            _show_values(client, fit, measurement)
    folder.mkdir(parents=True, exist_ok=True)
    figure = folder / "demo.png"
    spheres = compare_spheres(measurement, model, lighting="environment", size=256)
    figure.write_bytes(encode_figure(overview_figure(dsbrdf.profiles(measurement), model, spheres=spheres)))
    print(f"\n{figure}: profiles, fit and components; lit spheres of measurement, fit and components")
    print(f"done in {time.perf_counter() - begin:.1f} s; the service is stopped and its data is removed")


@contextmanager
def running_service(folder: Path) -> Iterator[str]:
    """Run the service on a free port while the block runs, its data and log in a folder; yield its URL."""
    log = folder / "service.log"
    command = [sys.executable, "-m", "dsbrdf_service", "--port", "0", "--data-dir", str(folder / "data")]
    with log.open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
    try:
        url = address_when_ready(process, log)
        if url is None:
            raise RuntimeError(f"the service did not start; its log:\n{log.read_text(errors='replace')[-2000:]}")
        yield url
    finally:
        stop(process)


def stop(process: subprocess.Popen[bytes]) -> None:
    """Ask a process to end, and kill it if it does not."""
    process.terminate()
    try:
        process.wait(STOP_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def address_when_ready(process: subprocess.Popen[bytes], log: Path) -> str | None:
    """Wait until the service is ready and return its URL, found in its log; None if it ends or takes too long."""
    deadline = time.monotonic() + START_TIMEOUT_S
    while process.poll() is None and time.monotonic() < deadline:
        found = re.search(r"http://[\d.]+:\d+", log.read_text(errors="replace"))
        with suppress(httpx.TransportError):  # the service does not listen yet, or is busy
            if found and httpx.get(f"{found[0]}/health/ready", timeout=5.0).is_success:
                return found[0]
        time.sleep(0.05)
    return None


def _fit_twice(client: httpx.Client) -> dict[str, Any]:
    """Submit the measurement twice; the second time the service finds the fit and computes nothing."""
    content = MEASUREMENT.read_bytes()
    print(f"POST /v1/fits with {len(content):,} bytes of {MEASUREMENT.name}, a measured paint, twice:")
    for _ in range(2):
        begin = time.perf_counter()
        response = client.post("/v1/fits", content=content, headers={"Content-Type": "application/octet-stream"})
        response.raise_for_status()
        fit: dict[str, Any] = response.json()
        seconds = time.perf_counter() - begin
        print(f"  {response.status_code} {response.reason_phrase}, fit {fit['id']} {fit['status']}, {seconds:.2f} s")
    if fit["status"] != "succeeded":
        raise RuntimeError(f"the fit has {fit['status']}: {fit['error']}")
    return fit


def _get(client: httpx.Client, fit: dict[str, Any], path: str, **query: Any) -> httpx.Response:
    return client.get(f"/v1/fits/{fit['id']}/{path}", params=query).raise_for_status()


def _values(client: httpx.Client, fit: dict[str, Any], path: str, theta_half: Array, theta_diff: Array) -> Array:
    """Return BRDF values (n, 3) [1/sr] over HTTP, for angles (n,) [degrees]."""
    query = {"theta_half_deg": theta_half.tolist(), "theta_diff_deg": theta_diff.tolist()}
    return np.array(_get(client, fit, path, **query).json()["values"])


def _show_components(client: httpx.Client, fit: dict[str, Any]) -> None:
    """Print the components, their own lobes, and whether their values add up to those of the fit."""
    components = _get(client, fit, "components").json()["items"]
    print(*components_table(components), "", *component_surfaces_table(components), sep="\n")
    point = np.array([2.0]), np.array([30.0])
    parts = [_values(client, fit, f"components/{component['label']}/brdf", *point)[0] for component in components]
    whole = _values(client, fit, "brdf", *point)[0]
    print(f"largest difference between their sum and the fit: {np.abs(np.sum(parts, axis=0) - whole).max():.1e} /sr")


def _show_metrics(report: dsbrdf.FitReport | None, n_lobes: int) -> None:
    """Print in words which numbers of lobes were tried, and the errors of the fit."""
    if report is None:
        raise RuntimeError("the service exported the fit without its report")
    worse = [str(step.n_lobes) for step in report.search if not step.kept]
    print(f"\nThe fit began with {report.search[0].n_lobes} lobes and kept {n_lobes}", end="")
    print(f"; with {' or '.join(worse)} lobes, it was worse on held-out rows." if worse else ".")
    print(*metrics_lines(report.metrics, 100), sep="\n")


def _show_values(client: httpx.Client, fit: dict[str, Any], measurement: dsbrdf.Measurement) -> None:
    """Print measured values beside those of the service."""
    nodes = np.array([(i, j) for j in SHOWN_THETA_DIFF_NODES for i in SHOWN_THETA_HALF_NODES])
    theta_half, theta_diff = np.degrees(THETA_HALF[nodes[:, 0]]), np.degrees(THETA_DIFF[nodes[:, 1]])
    measured = measurement.values[:, nodes[:, 0], nodes[:, 1], 90].T
    fitted = _values(client, fit, "brdf", theta_half, theta_diff)
    names = "".join(f"{channel + ' measured, fitted':>23}" for channel in CHANNELS)
    print(f"\n{'theta_half':>10}{'theta_diff':>12}{names}   [1/sr]")
    for angles, pairs in zip(zip(theta_half, theta_diff, strict=True), np.stack([measured, fitted], -1), strict=True):
        cells = "".join(f"{data:>12.4f} {value:>10.4f}" for data, value in pairs)
        print(f"{angles[0]:>9.1f}°{angles[1]:>11.0f}°{cells}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out"))
