import re
import sys
from io import BytesIO
from pathlib import Path

import httpx
import numpy as np
import pytest
from matplotlib.image import imread

from dsbrdf.output.sphere_panels import compare_spheres
from examples import demo

_COMPONENT = re.compile(r"^(\w+) +\d+% +\d+%-\d+%(?: +([\d.]+)°)?" + r" +([\d.]+)" * 3 + "$", re.MULTILINE)


def test_demo_prints_all_results_and_stops_the_service(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(
        demo, "compare_spheres", lambda *shown, **options: compare_spheres(*shown, **options | {"size": 64})
    )
    demo.main(tmp_path / "out")
    out = capsys.readouterr().out
    words = ["201 Created", "200 OK", "90 % range", "width", "tail", "relative_rms", "excess", "male"]
    assert [word for word in words if word not in out] == []
    rows = re.findall(r"^ +[\d.]+° +\d+°((?: +[\d.]+){6})$", out, re.MULTILINE)
    assert len(rows) == len(demo.SHOWN_THETA_HALF_NODES) * len(demo.SHOWN_THETA_DIFF_NODES)
    peak = [float(word) for word in rows[0].split()]
    assert peak[1::2] == pytest.approx(peak[0::2], rel=0.1)  # fitted next to measured
    found = {row[0]: [float(word or "nan") for word in row[1:]] for row in _COMPONENT.findall(out)}
    assert list(found) == ["specular_lobe", "diffuse"]
    width, red, green, blue = found["specular_lobe"]
    assert width == pytest.approx(4.3, abs=1.0)
    assert green < red < blue  # The paint is grey with a purple highlight.
    assert found["diffuse"][1:] == pytest.approx([np.mean(found["diffuse"][1:])] * 3, rel=0.15)
    image = imread(BytesIO((tmp_path / "out/demo.png").read_bytes()), format="png")
    assert min(image.shape[:2]) > 800
    assert image[..., :3].std() > 0.05
    address = re.search(r"http://[\d.]+:\d+", out)
    assert address is not None
    with pytest.raises(httpx.TransportError):
        httpx.get(f"{address[0]}/health/live", timeout=5)


def test_demo_shows_the_log_of_a_service_that_fails_to_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "python"
    program.write_text("#!/bin/sh\necho it broke\nexit 3\n")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    with pytest.raises(RuntimeError, match=r"the service did not start.*\n.*it broke"), demo.running_service(tmp_path):
        pytest.fail("nothing is running")
