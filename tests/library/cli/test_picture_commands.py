import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from dsbrdf.data.merl import read_merl
from dsbrdf.fitting.decomposition import decompose
from dsbrdf.fitting.report import FitResult
from dsbrdf.model.image_metrics import displayed, exposure
from dsbrdf.model.render import render_sphere, sphere_normals
from tests.support.command_line import document, printed, run


def pixels_of(path: Path) -> NDArray[np.float64]:
    with Image.open(path) as image:
        return np.asarray(image) / 255.0


def drawn(folder: Path, *words: object, size: int = 32) -> tuple[NDArray[np.float64], dict[str, Any]]:
    """The pixels that ``dsbrdf render`` writes, and what it prints of them."""
    about = document("render", *words, "-o", folder / "sphere.png", "--size", size, "--json")
    return pixels_of(folder / "sphere.png"), about


@pytest.mark.parametrize("lighting", ["three_lights", "environment"])
def test_picture_is_that_of_the_library(
    model_file: Path, two_lobe_fit: FitResult, lighting: str, tmp_path: Path
) -> None:
    pixels, about = drawn(tmp_path, model_file, "--lighting", lighting, size=48)
    expected = displayed(render_sphere(two_lobe_fit.model, lighting=lighting, size=48), about["exposure"])
    assert np.abs(pixels - expected).max() < 0.003
    assert expected.max() > 0.999


def test_a_component_has_the_exposure_of_the_whole(model_file: Path, two_lobe_fit: FitResult, tmp_path: Path) -> None:
    found, whole = decompose(two_lobe_fit.model), drawn(tmp_path, model_file)[1]["exposure"]
    for name, part in (("diffuse", found["diffuse"]), ("guide", found.guide)):
        pixels, about = drawn(tmp_path, model_file, "--component", name)
        assert about["exposure"] == whole
        assert np.abs(pixels - displayed(render_sphere(part, size=32), whole)).max() < 0.003


def test_a_measurement_is_drawn(plastic_file: Path, tmp_path: Path) -> None:
    pixels, about = drawn(tmp_path, plastic_file, "--exposure", "0.5")
    assert about["exposure"] == 0.5
    assert np.abs(pixels - displayed(render_sphere(read_merl(plastic_file), size=32), 0.5)).max() < 0.003


def test_measurement_and_fit_are_compared_under_a_panorama(
    plastic_file: Path, model_file: Path, two_lobe_fit: FitResult, tmp_path: Path
) -> None:
    panorama, output = tmp_path / "even.hdr", tmp_path / "both.png"
    panorama.write_bytes(b"#?RADIANCE\n\n-Y 4 +X 8\n" + bytes([128, 128, 128, 129]) * 32)
    command = ["render", str(plastic_file), str(model_file), "-o", str(output), "--lighting", str(panorama)]
    words = printed(*command, "--size", "24")
    labels = decompose(two_lobe_fit.model).labels
    assert f"measured, fit, difference x 4, {', '.join(labels).replace('_', ' ')}\n" in words
    about = document(*command, "--size", "24", "--json")
    assert f"PSNR {about['psnr']:.1f} dB" in words
    assert pixels_of(output).shape == (24, (3 + len(labels)) * 24, 3)


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
    assert lines[0].split() == ["plastic", "plastic"]
    assert lines[1].split() == ["kind", "measurement", "2", "lobes"]
    (error,) = [line.split()[1:] for line in lines if line.startswith("relative_rms")]
    assert error == [f"{two_lobe_fit.report.metrics.relative_rms:.4g}"]
    pixels = pixels_of(picture)
    assert pixels.shape == (256, 3 * 256, 3)
    sphere = render_sphere(read_merl(plastic_file), size=256)
    expected = displayed(sphere, exposure(sphere, sphere_normals(256)[1]))
    assert np.abs(pixels[:, :256] - expected).max() < 0.003


def test_compare_as_json(model_file: Path, two_lobe_fit: FitResult) -> None:
    answer = document("compare", model_file, model_file, "--json")
    assert [item["relative_rms"] for item in answer["items"]] == [two_lobe_fit.report.metrics.relative_rms] * 2
    assert answer["likeness"] == {"psnr": None, "ssim": pytest.approx(1.0)}
    assert answer["output"] is None
