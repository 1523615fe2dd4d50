"""Commands of stored models: values, reports, components, exports, pictures."""

import json
import re
import shutil
import struct
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from dsbrdf import FitResult, decompose, read_merl, render_sphere
from dsbrdf.output.documents import component_document
from dsbrdf.output.export import part_of
from dsbrdf.rendering import displayed
from tests.support.command_line import FEW_LOBES, document, load_fit, printed, run

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("words", "degrees"),
    [
        ("--theta-half 0 10 --theta-diff 30 --theta-half 40", ([0.0, 10.0, 40.0], 30.0, 90.0)),
        ("--theta-half 30,45 50 --theta-diff 30", ([30.0, 45.0, 50.0], 30.0, 90.0)),
        ("--theta-half 30, 45, 50 --theta-diff 30", ([30.0, 45.0, 50.0], 30.0, 90.0)),
        # the first is 100 degrees from the normal
        ("--theta-half 40 --theta-diff 60 --phi-diff 0 70 -110", (40.0, 60.0, [0.0, 70.0, -110.0])),
        # on the side of the mirror direction, which is theta_half = 0 where both are 30; and back to the light
        ("--theta-in 30 --theta-out 30 60", ([0.0, 15.0], [30.0, 45.0], 0.0)),
        ("--theta-in 30 --theta-out 30 60 --phi-out 0", ([30.0, 45.0], [0.0, 15.0], 0.0)),
        ("--omega-in -0.6,0,0.8 0,0,1 --omega-out 0.6,-0,0.8", ([0.0, 18.43494882], [36.86989765, 18.43494882], 0.0)),
        ("--omega-in 0,0,-1 --omega-out 0,0,1", ([90.0], 90.0, 0.0)),
        ("--theta-half 0.5 12 --theta-diff 45 --component diffuse", ([0.5, 12.0], 45.0, 90.0)),
    ],
)
def test_eval_gives_the_values_of_the_library(words: str, degrees: Any, model_file: Path) -> None:
    answer = document("eval", model_file, *words.split(), "--json")
    part = part_of(load_fit(model_file).model, words.partition("--component ")[2] or None)
    expected = part.evaluate(*(np.radians(angle) for angle in degrees))
    np.testing.assert_allclose(answer["values"], expected, rtol=1e-6)
    if "--theta-half" in words:
        asked = np.broadcast_arrays(*degrees)
        names = ("theta_half_deg", "theta_diff_deg", "phi_diff_deg")
        assert [answer[name] for name in names] == [angles.tolist() for angles in asked]


@pytest.mark.parametrize("words", [["eval", "--theta-half", "0,10", "--theta-diff", "30"], ["show"], ["decompose"]])
def test_text_holds_at_60_columns(words: list[str], model_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    lines = printed(words[0], model_file, *words[1:]).splitlines()
    assert [line for line in lines if len(line) > 60 and not line.startswith("warning")] == []


def test_decompose_prints_the_components(model_file: Path) -> None:
    items, components = document("decompose", model_file, "--json")["items"], [*decompose(load_fit(model_file).model)]
    assert items == json.loads(json.dumps([component_document(component) for component in components]))
    for item, component in zip(items, components, strict=True):
        heights = component.layers.evaluate(0.0, np.radians(item["lobe"]["theta_diff_deg"]))
        np.testing.assert_allclose(item["lobe"]["height"], heights, rtol=1e-9)


def test_fit_saves_draws_and_prints_the_report_of_show(plastic_file: Path, model_file: Path, tmp_path: Path) -> None:
    (tmp_path / "plastic.json").write_text("{}")  # damaged, and replaced
    *before, saved, figure = printed("fit", plastic_file, "-o", tmp_path, "--plot", *FEW_LOBES).splitlines()
    assert (saved, figure) == (f"saved: {tmp_path / 'plastic.json'}", f"figure: {tmp_path / 'plastic.png'}")
    assert load_fit(tmp_path / "plastic.json").model == load_fit(model_file).model
    assert (tmp_path / "plastic.png").read_bytes().startswith(b"\x89PNG")
    assert re.match(r"plastic: (very )?close \(\d+\.\d dB\); 2 lobes; \d+\.\d\d s$", before[0])
    shown = printed("show", model_file).splitlines()
    assert shown[0].rpartition(";")[0] == before[0].rpartition(";")[0]  # the time is another
    assert shown[1:] == before[1:]


def test_show_prints_the_stored_fit_as_json(model_file: Path) -> None:
    answer, result = document("show", model_file, "--json"), load_fit(model_file)
    assert answer["metrics"] == asdict(result.report.metrics)
    assert answer["model"]["amplitude"] == result.model.amplitude.tolist()
    assert [component["label"] for component in answer["components"]] == list(decompose(result).labels)


def test_closed_output_pipe_is_no_error(model_file: Path) -> None:
    many = " ".join(str(angle / 40) for angle in range(3000))  # their lines are longer than what a pipe holds
    words = f"-m dsbrdf.cli.main eval '{model_file}' --theta-diff 0 --theta-half {many}"
    command = f"'{sys.executable}' {words} | head -n 1"
    answer = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=True)
    assert answer.stdout.split()[0] == "theta_half"
    assert answer.stderr == ""


def pixels_of(path: Path) -> NDArray[np.float64]:
    with Image.open(path) as image:
        return np.asarray(image) / 255.0


def drawn(folder: Path, *words: object) -> tuple[NDArray[np.float64], dict[str, Any]]:
    about = document("render", *words, "-o", folder / "sphere.png", "--size", "32", "--json")
    return pixels_of(folder / "sphere.png"), about


def test_pictures_are_the_librarys(
    model_file: Path, plastic_file: Path, two_lobe_fit: FitResult, tmp_path: Path
) -> None:
    found = decompose(two_lobe_fit)
    whole = drawn(tmp_path, model_file)[1]["exposure"]
    for source, words, factor in (
        (two_lobe_fit.model, [model_file], whole),
        (found["diffuse"], [model_file, "--component", "diffuse"], whole),
        (found.layers, [model_file, "--component", "layers"], whole),
        (read_merl(plastic_file), [plastic_file, "--exposure", "0.5"], 0.5),
    ):
        pixels, about = drawn(tmp_path, *words)
        assert about["exposure"] == factor
        assert np.abs(pixels - displayed(render_sphere(source, size=32), factor)).max() < 0.003
    pixels, about = drawn(tmp_path, model_file, "--lighting", "environment")
    expected = displayed(render_sphere(found.model, lighting="environment", size=32), about["exposure"])
    assert np.abs(pixels - expected).max() < 0.003


def test_compare_in_a_panorama(plastic_file: Path, model_file: Path, two_lobe_fit: FitResult, tmp_path: Path) -> None:
    openexr = pytest.importorskip("OpenEXR")
    panorama, output = tmp_path / "even.exr", tmp_path / "both.png"
    openexr.File({}, {"RGB": np.ones((4, 8, 3), np.float32)}).write(str(panorama))
    command = ["compare", str(plastic_file), str(model_file), "-o", str(output), "--lighting", str(panorama)]
    words = printed(*command, "--size", "24")
    labels = decompose(two_lobe_fit).labels
    assert f"measured, fit, difference x 4, {', '.join(labels).replace('_', ' ')}; radiance times" in words
    about = document(*command, "--size", "24", "--json")
    assert f"in a panorama: PSNR {about['likeness']['psnr']:.1f} dB" in words
    assert pixels_of(output).shape == (24, (3 + len(labels)) * 24, 3)


def test_plot_draws_profiles_and_lobes_on_request(model_file: Path, plastic_file: Path, tmp_path: Path) -> None:
    output, pictures = tmp_path / "figure.png", []
    for arguments in ([], [plastic_file, "--lobes"]):
        about = document("plot", model_file, *arguments, "-o", output, "--json")
        pictures.append(output.read_bytes())
        assert about == {"output": str(output), "format": "png", "bytes": len(pictures[-1])}
    assert struct.unpack(">II", pictures[0][16:24]) < struct.unpack(">II", pictures[1][16:24])
    other = Path(shutil.copy(model_file, tmp_path / r"$\bad$.json"))  # Matplotlib shall not read a name as a formula.
    assert "2 materials compared" in printed("plot", model_file, other, "-o", output)


def test_compare_draws_names_above_spheres(
    model_file: Path, plastic_file: Path, two_lobe_fit: FitResult, tmp_path: Path
) -> None:
    run("compare", plastic_file, model_file, "-o", tmp_path / "both.png")
    pixels = pixels_of(tmp_path / "both.png")
    names, spheres = pixels[:-256], pixels[-256:]
    count = 3 + len(decompose(two_lobe_fit).labels)
    assert spheres.shape == (256, count * 256, 3)
    assert all(part.max() > 0.5 for part in np.split(names, count, axis=1))


def test_ggx_and_a_function_in_a_file_are_compared_with_a_measurement(plastic_file: Path, tmp_path: Path) -> None:
    grey = tmp_path / "grey.py"
    grey.write_text("import numpy as np\ndef evaluate(i, o):\n    return np.full((len(i), 3), 0.1)\n")
    answer = document("compare", plastic_file, "--with", "ggx", "--with", grey, "--json")
    assert [item["kind"] for item in answer["items"]] == ["measurement", "2 GGX highlights", "a function"]
    assert answer["items"][1]["psnr"] > 25.0 > answer["items"][2]["psnr"]
