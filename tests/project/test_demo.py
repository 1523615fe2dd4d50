"""The demo, as ``make demo`` runs it: with the real service in its own process."""

import re
import sys
from io import BytesIO
from pathlib import Path

import httpx
import numpy as np
import pytest
from matplotlib.image import imread

from examples import demo

_COMPONENT = re.compile(r"^(\w+) +([\d.]+)°" + r" +([\d.]+)" * 5 + "$", re.MULTILINE)


def test_demo_prints_all_results_and_stops_the_service(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    demo.main(tmp_path / "out")
    out = capsys.readouterr().out
    assert "201 Created" in out
    assert "200 OK" in out
    for word in ("half width", "clarity", "tail", "elongation", "relative_rms", "excess", "male"):
        assert word in out
    lines = out.splitlines()
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 100 + len(str(tmp_path))
    rows = re.findall(r"^ +[\d.]+° +\d+°((?: +[\d.]+){6})$", out, re.MULTILINE)
    assert len(rows) == len(demo.SHOWN_NODES) * len(demo.SHOWN_ROWS)
    peak = [float(word) for word in rows[0].split()]
    assert peak[1::2] == pytest.approx(peak[0::2], rel=0.1)  # fitted next to measured
    difference = re.search(r"largest difference between their sum and the fit: (\S+)", out)
    assert difference is not None
    assert float(difference[1]) < 1e-12
    found = {row[0]: [float(word) for word in row[1:]] for row in _COMPONENT.findall(out)}
    assert list(found) == ["specular_spike", "diffuse"]
    width, _, _, *albedo = found["specular_spike"]
    assert width == pytest.approx(np.degrees(np.arctan(0.06 * np.sqrt(np.sqrt(2.0) - 1.0))), rel=0.1)
    assert albedo == pytest.approx([np.mean(albedo)] * 3, rel=0.03)  # a clear coat: its highlight is neutral
    paint = np.array([0.42, 0.08, 0.05])
    color = np.array(found["diffuse"][3:]) / max(found["diffuse"][3:])
    assert color == pytest.approx(paint / paint.max(), abs=0.03)
    image = imread(BytesIO((tmp_path / "out/demo.png").read_bytes()), format="png")
    assert min(image.shape[:2]) > 800
    assert image[..., :3].std() > 0.05
    address = re.search(r"http://[\d.]+:\d+", out)
    assert address is not None
    with pytest.raises(httpx.TransportError):
        httpx.get(f"{address[0]}/health/live", timeout=5)


_READY = """#!{python}
from http.server import BaseHTTPRequestHandler, HTTPServer
class Handler(BaseHTTPRequestHandler):
    def do_GET(self):
        self.send_response(200 if self.path == "/health/ready" else 404)
        self.end_headers()
server = HTTPServer(("127.0.0.1", 0), Handler)
print(f"http://127.0.0.1:{{server.server_port}}", flush=True)
server.serve_forever()
"""


def replace_service(folder: Path, monkeypatch: pytest.MonkeyPatch, program: str) -> None:
    """Let a program run where the demo starts the service."""
    path = folder / "python"
    path.write_text(program)
    path.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(path))


def test_demo_service_stops_after_an_exception(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replace_service(tmp_path, monkeypatch, _READY.format(python=sys.executable))
    with pytest.raises(httpx.HTTPStatusError), demo.running_service(tmp_path) as url:
        httpx.get(f"{url}/no/such/page", timeout=5).raise_for_status()
    with pytest.raises(httpx.TransportError):
        httpx.get(f"{url}/health/live", timeout=5)


def test_demo_shows_the_log_of_a_service_that_fails_to_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replace_service(tmp_path, monkeypatch, "#!/bin/sh\necho it broke\nexit 3\n")
    with pytest.raises(RuntimeError, match=r"the service did not start.*\n.*it broke"), demo.running_service(tmp_path):
        pytest.fail("nothing is running")
