import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dsbrdf.data.merl import read_merl
from dsbrdf.fitting.report import FitResult
from dsbrdf.model.image_metrics import displayed, exposure
from dsbrdf.model.render import render_sphere, sphere_normals
from dsbrdf.output.serialize import save
from tests.support.command_line import document, printed, run


@pytest.fixture(scope="module")
def model_file(two_lobe_fit: FitResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("models") / "fitted.json"
    save(two_lobe_fit, path)
    return path


def test_plot_writes_a_figure(model_file: Path, tmp_path: Path) -> None:
    output = tmp_path / "figure.pdf"
    about = document("plot", model_file, "-o", output, "--json")
    content = output.read_bytes()
    assert content.startswith(b"%PDF")
    assert about == {"output": str(output), "format": "pdf", "bytes": len(content)}


def test_plot_with_the_measurement_draws_its_profiles(model_file: Path, plastic_file: Path, tmp_path: Path) -> None:
    """More than the parameters, and its lobes instead of its components if asked for."""
    pictures = []
    for arguments in ([], [str(plastic_file)], [str(plastic_file), "--lobes"]):
        output = tmp_path / "figure.png"
        run("plot", model_file, *arguments, "-o", output)
        pictures.append(output.read_bytes())
    sizes = [struct.unpack(">II", picture[16:24]) for picture in pictures]
    assert sizes[1] > sizes[0]
    assert sizes[2] == sizes[1]
    assert pictures[2] != pictures[1]


def test_compare_a_measurement_with_its_fit(
    model_file: Path, plastic_file: Path, two_lobe_fit: FitResult, tmp_path: Path
) -> None:
    picture = tmp_path / "both.png"
    lines = printed("compare", plastic_file, model_file, "-o", picture).splitlines()
    assert lines[0].split() == ["plastic", "fitted"]
    assert lines[1].split() == ["kind", "measurement", "2", "lobes"]
    (error,) = [line.split()[1:] for line in lines if line.startswith("relative_rms")]
    assert error == [f"{two_lobe_fit.report.metrics.relative_rms:.4g}"]
    with Image.open(picture) as image:
        pixels = np.asarray(image) / 255.0
    assert pixels.shape == (256, 3 * 256, 3)
    sphere = render_sphere(read_merl(plastic_file), size=256)
    expected = displayed(sphere, exposure(sphere, sphere_normals(256)[1]))
    assert np.abs(pixels[:, :256] - expected).max() < 0.003


def test_compare_as_json(model_file: Path, two_lobe_fit: FitResult) -> None:
    answer = document("compare", model_file, model_file, "--json")
    assert [item["relative_rms"] for item in answer["items"]] == [two_lobe_fit.report.metrics.relative_rms] * 2
    assert answer["likeness"] == {"psnr": None, "ssim": pytest.approx(1.0)}
    assert answer["output"] is None


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_knows_commands_options_and_files(shell: str, tmp_path: Path) -> None:
    text, script = printed("completion", shell), tmp_path / "completion.sh"
    assert all(word in text for word in ("compare", "serve", "n-lobes", "theta-half", "specular_spike"))
    if shell == "bash":
        script.write_text(text)
        ask = f"source '{script}'; COMP_WORDS=(dsbrdf comp); COMP_CWORD=1; _dsbrdf; echo ${{COMPREPLY[@]}}"
        answer = subprocess.run(["bash", "-c", ask], capture_output=True, text=True, check=True)
        assert answer.stdout.split() == ["completion", "compare"]
