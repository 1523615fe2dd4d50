from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from dsbrdf.data.merl import read_merl
from dsbrdf.fitting.decomposition import decompose
from dsbrdf.model.image_metrics import displayed
from dsbrdf.model.render import render_sphere
from dsbrdf.output.serialize import save
from tests.support.command_line import document, printed
from tests.support.mixtures import mixture

MODEL = mixture(3, 0)


@pytest.fixture(scope="module")
def model_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("models") / "mixture.json"
    save(MODEL, path)
    return path


def drawn(*words: object, size: int = 32) -> tuple[NDArray[np.float64], dict[str, Any]]:
    """The pixels that the command writes, and what it prints of them."""
    with TemporaryDirectory() as folder:
        output = Path(folder) / "sphere.png"
        about = document("render", *words, "-o", output, "--size", size, "--json")
        with Image.open(output) as image:
            return np.asarray(image) / 255.0, about


@pytest.mark.parametrize("lighting", ["three_lights", "environment"])
def test_picture_is_that_of_the_library(model_file: Path, lighting: str) -> None:
    pixels, about = drawn(model_file, "--lighting", lighting, size=48)
    expected = displayed(render_sphere(MODEL, lighting=lighting, size=48), about["exposure"])
    assert np.abs(pixels - expected).max() < 0.003
    assert expected.max() > 0.999


def test_a_component_has_the_exposure_of_the_whole(model_file: Path) -> None:
    found, whole = decompose(MODEL), drawn(model_file)[1]["exposure"]
    for name, part in (("diffuse", found["diffuse"]), ("guide", found.guide)):
        pixels, about = drawn(model_file, "--component", name)
        assert about["exposure"] == whole
        assert np.abs(pixels - displayed(render_sphere(part, size=32), whole)).max() < 0.003


def test_a_measurement_is_drawn(plastic_file: Path) -> None:
    pixels, about = drawn(plastic_file, "--exposure", "0.5")
    assert about["exposure"] == 0.5
    assert np.abs(pixels - displayed(render_sphere(read_merl(plastic_file), size=32), 0.5)).max() < 0.003


def test_measurement_and_fit_are_compared_under_a_panorama(
    plastic_file: Path, model_file: Path, tmp_path: Path
) -> None:
    panorama, output = tmp_path / "even.hdr", tmp_path / "both.png"
    panorama.write_bytes(b"#?RADIANCE\n\n-Y 4 +X 8\n" + bytes([128, 128, 128, 129]) * 32)
    command = ["render", str(plastic_file), str(model_file), "-o", str(output), "--lighting", str(panorama)]
    words = printed(*command, "--size", "24")
    labels = decompose(MODEL).labels
    assert f"measured, fit, difference x 4, {', '.join(labels).replace('_', ' ')}\n" in words
    about = document(*command, "--size", "24", "--json")
    assert f"PSNR {about['psnr']:.1f} dB" in words
    with Image.open(output) as image:
        assert image.size == ((3 + len(labels)) * 24, 24)
