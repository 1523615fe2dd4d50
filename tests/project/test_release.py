"""What a release promises: its version is the same everywhere, and what an earlier one stored can be opened."""

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
import yaml

import dsbrdf
from tests.support.command_line import load_fit
from tests.support.server import Server
from tests.support.stored_fits import THETA_DIFF, THETA_HALF

ROOT = Path(__file__).parents[2]
STORED = sorted((Path(__file__).parent / "stored").iterdir())  # a folder for each release that stored something new
releases = pytest.mark.parametrize("folder", STORED, ids=lambda folder: folder.name)


def test_version_is_the_same_everywhere() -> None:
    version = dsbrdf.__version__
    assert re.fullmatch(r"\d+\.\d+\.\d+", version)
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == version
    changelog = (ROOT / "CHANGELOG.md").read_text()
    assert re.findall(r"^## \[(\d.*?)\] - \d{4}-\d\d-\d\d$", changelog, re.MULTILINE)[0] == version


def test_first_release_of_this_major_version_is_there() -> None:
    assert f"{dsbrdf.__version__.partition('.')[0]}.0" in [folder.name for folder in STORED]


@pytest.mark.soak
def test_source_distribution_makes_a_wheel_whose_service_works(tmp_path: Path) -> None:
    def build(target: str, folder: Path) -> Path:
        command = [sys.executable, "-m", "hatchling", "build", "--target", target, "--directory", str(tmp_path)]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
        (made,) = tmp_path.glob("*.whl" if target == "wheel" else "*.tar.gz")
        return made

    sources = build("sdist", ROOT)
    with tarfile.open(sources) as archive:
        archive.extractall(tmp_path, filter="data")
    with zipfile.ZipFile(build("wheel", tmp_path / sources.name.removesuffix(".tar.gz"))) as wheel:
        wheel.extractall(tmp_path / "installed")
    packages = {path.name for path in (tmp_path / "installed").iterdir() if path.suffix != ".dist-info"}
    assert packages == {"dsbrdf", "dsbrdf_service"}
    assert (tmp_path / "installed/dsbrdf/output/atlas/aurora_white.json").is_file()
    code = "from dsbrdf_service import app, settings; app.create_app(settings.Settings()).openapi();print(app.__file__)"
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "installed")}
    command = [sys.executable, "-P", "-c", code]
    answer = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == str(tmp_path / "installed/dsbrdf_service/app.py")


@releases
def test_model_stored_by_an_earlier_release_has_the_same_values(folder: Path) -> None:
    result = load_fit(folder / "plastic.json")
    expected = json.loads((folder / "values.json").read_text())
    np.testing.assert_allclose(result.model.evaluate(THETA_HALF, THETA_DIFF), expected, rtol=1e-12)
    assert result.report.options == dsbrdf.FitOptions(n_lobes=2)
    assert result.report.metrics.relative_rms is not None


@releases
def test_service_opens_the_database_of_an_earlier_release(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "data").mkdir(mode=0o700)
    shutil.copy(folder / "dsbrdf.sqlite", tmp_path / "data")
    expected = json.loads((folder / "values.json").read_text())[1][1]  # theta_half 5, theta_diff 30 degrees
    with Server.running(tmp_path / "data") as server:
        (fit,) = server.http.get("/v1/fits").raise_for_status().json()["items"]
        points = {"theta_half_deg": 5, "theta_diff_deg": 30}
        values = server.http.get(f"/v1/fits/{fit['id']}/brdf", params=points).raise_for_status().json()["values"]
    np.testing.assert_allclose(np.ravel(values), expected, rtol=1e-12)
