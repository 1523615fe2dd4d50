"""``dsbrdf render``."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dsbrdf.cli.main import main
from dsbrdf.data.merl import read_merl
from dsbrdf.fitting.decomposition import decompose
from dsbrdf.model.image_metrics import displayed
from dsbrdf.model.render import render_sphere
from dsbrdf.output.serialize import save
from tests.support.mixtures import mixture

MODEL = mixture(3, 0)


@pytest.fixture(scope="module")
def model_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("models") / "mixture.json"
    save(MODEL, path)
    return path


@pytest.mark.parametrize("lighting", ["three_lights", "environment"])
def test_picture_is_that_of_the_library(
    model_file: Path, tmp_path: Path, lighting: str, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "sphere.png"
    options = ["--lighting", lighting, "--size", "48", "--json"]
    assert main(["render", str(model_file), "-o", str(output), *options]) == 0
    factor = json.loads(capsys.readouterr().out)["exposure"]
    expected = displayed(render_sphere(MODEL, lighting=lighting, size=48), factor)
    with Image.open(output) as image:
        assert np.abs(np.asarray(image) / 255.0 - expected).max() < 0.003
    assert expected.max() > 0.999


def test_a_component_has_the_exposure_of_the_whole(
    model_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found, output = decompose(MODEL), tmp_path / "a.png"
    factors = []
    for options, part in (([], MODEL), (["diffuse"], found["diffuse"]), (["guide"], found.guide)):
        component = ["--component", *options] if options else []
        assert main(["render", str(model_file), "-o", str(output), "--size", "32", "--json", *component]) == 0
        factors.append(json.loads(capsys.readouterr().out)["exposure"])
        with Image.open(output) as image:
            expected = displayed(render_sphere(part, size=32), factors[0])
            assert np.abs(np.asarray(image) / 255.0 - expected).max() < 0.003
    assert factors[0] == factors[1] == factors[2]


def test_a_measurement_is_drawn(plastic_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "plastic.png"
    assert main(["render", str(plastic_file), "-o", str(output), "--size", "32", "--exposure", "0.5"]) == 0
    assert "radiance times 0.5" in capsys.readouterr().out
    expected = displayed(render_sphere(read_merl(plastic_file), size=32), 0.5)
    with Image.open(output) as image:
        assert np.abs(np.asarray(image) / 255.0 - expected).max() < 0.003


def test_measurement_and_fit_are_compared_under_a_panorama(
    plastic_file: Path, model_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    panorama, output = tmp_path / "even.hdr", tmp_path / "both.png"
    panorama.write_bytes(b"#?RADIANCE\n\n-Y 4 +X 8\n" + bytes([128, 128, 128, 129]) * 32)
    command = ["render", str(plastic_file), str(model_file), "-o", str(output), "--lighting", str(panorama)]
    assert main([*command, "--size", "24"]) == 0
    words = capsys.readouterr().out
    labels = decompose(MODEL).labels
    assert f"measured, fit, difference x 4, {', '.join(labels).replace('_', ' ')}\n" in words
    assert main([*command, "--size", "24", "--json"]) == 0
    about = json.loads(capsys.readouterr().out)
    assert f"PSNR {about['psnr']:.1f} dB" in words
    with Image.open(output) as image:
        assert image.size == ((3 + len(labels)) * 24, 24)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["same"], "the second source must be a model"),
        (["model", "--component", "diffuse"], "leave --component out"),
        (["model", "model"], "one or two sources can be drawn, not 3"),
        (["--lighting", "no.hdr"], "no.hdr: No such file"),
        (["--lighting", "bad.exr"], "bad.exr: The file is neither a Radiance nor an OpenEXR picture"),
    ],
)
def test_bad_sources_and_lightings_are_one_sentence(
    plastic_file: Path,
    model_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    more: list[str],
    words: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bad.exr").write_text("nothing")
    files = {"same": str(plastic_file), "model": str(model_file)}
    assert main(["render", str(plastic_file), *(files.get(word, word) for word in more), "-o", "a.png"]) == 2
    message = capsys.readouterr().err
    assert words in message
    assert message.count("\n") == 1
    assert not Path("a.png").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["-o", "a.jpg"], "must end in .png"),
        (["-o", "a.png", "--size", "4"], "size must be a whole number from 8 to 1024"),
        (["-o", "a.png", "--exposure", "0"], "exposure must be a positive number"),
        (["-o", "a.png", "--component", "diffuse"], "a measurement has no components"),
    ],
)
def test_bad_input_is_one_sentence(
    plastic_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], words: str
) -> None:
    options[1] = str(tmp_path / options[1])
    assert main(["render", str(plastic_file), *options]) == 2
    message = capsys.readouterr().err
    assert words in message
    assert message.count("\n") == 1
    assert not any(tmp_path.iterdir())


def test_an_absent_component_is_named_with_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model, output = tmp_path / "matte.json", tmp_path / "a.png"
    save(MODEL.select((2,), with_delta=False), model)
    assert main(["render", str(model), "-o", str(output), "--component", "specular_spike"]) == 2
    message = capsys.readouterr().err
    assert message.startswith(f"dsbrdf: {model}: this model has no component specular_spike: it has ")
    assert not output.exists()


@pytest.mark.parametrize("option", [["--lighting", "moon"], ["--component", "shine"], ["--size", "big"]])
def test_unknown_choice_is_refused(model_file: Path, tmp_path: Path, option: list[str]) -> None:
    assert main(["render", str(model_file), "-o", str(tmp_path / "a.png"), *option]) == 2
