"""``dsbrdf eval``, ``show``, ``decompose`` and ``export``."""

import subprocess
import sys
from contextlib import redirect_stdout
from dataclasses import asdict, replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dsbrdf
from dsbrdf.cli import main as cli
from dsbrdf.cli import model_commands
from dsbrdf.fitting.decomposition import LABELS
from dsbrdf.fitting.report import FitResult
from dsbrdf.output.serialize import from_json, from_npz, load
from tests.support.command_line import FEW_LOBES, Capture, document, exit_code, sentence


@pytest.fixture(scope="module")
def printed_and_stored(plastic_file: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[list[str], Path]:
    """The lines that a fit printed, and the file that it wrote."""
    folder, out = tmp_path_factory.mktemp("fits"), StringIO()
    with redirect_stdout(out):
        assert cli.main(["fit", str(plastic_file), "-o", str(folder), *FEW_LOBES]) == 0
    return out.getvalue().splitlines(), folder / "plastic.json"


@pytest.fixture(scope="module")
def model_file(printed_and_stored: tuple[list[str], Path]) -> Path:
    return printed_and_stored[1]


def test_fit_writes_what_the_library_would_save(model_file: Path, two_lobe_fit: FitResult) -> None:
    stored = dsbrdf.load_result(model_file)
    assert stored.model == two_lobe_fit.model
    assert replace(stored.report, timings={}) == replace(two_lobe_fit.report, timings={})


# models


def test_eval_by_angles(model_file: Path, capsys: Capture) -> None:
    command = ["eval", str(model_file), "--theta-half", "0", "10", "--theta-diff", "30"]
    assert cli.main([*command, "--theta-half", "40", "--json"]) == 0
    answer = document(capsys)
    expected = load(model_file).evaluate(np.radians([0.0, 10.0, 40.0]), np.radians(30.0))
    np.testing.assert_array_equal(answer["values"], expected)
    assert answer["theta_half_deg"] == [0.0, 10.0, 40.0]
    assert answer["theta_diff_deg"] == [30.0] * 3
    assert answer["phi_diff_deg"] == [90.0] * 3
    assert cli.main(command) == 0
    rows = capsys.readouterr().out.splitlines()
    assert rows[0].split() == ["theta_half", "theta_diff", "phi_diff", "red", "green", "blue"]
    np.testing.assert_allclose([float(word) for word in rows[2].split()], [10, 30, 90, *expected[1]], rtol=1e-5)


@pytest.mark.parametrize("words", [["30,45", "50"], ["30", "45", "50"], ["30,", "45,", "50"], ["30, 45", "50"]])
def test_lists_take_commas_and_blanks(words: list[str], model_file: Path, capsys: Capture) -> None:
    expected = [30.0, 45.0, 50.0]
    assert cli.main(["eval", str(model_file), "--theta-half", *words, "--theta-diff", "30", "--json"]) == 0
    assert document(capsys)["theta_half_deg"] == expected


def test_eval_by_angles_of_the_directions(model_file: Path, capsys: Capture) -> None:
    command = ["eval", str(model_file), "--theta-in", "30", "--theta-out", "30", "60", "--json"]
    model = load(model_file)
    assert cli.main(command) == 0  # on the side of the mirror direction, which is theta_half = 0 where both are 30
    in_plane = document(capsys)["values"]
    np.testing.assert_allclose(in_plane, model.evaluate(np.radians([0.0, 15.0]), np.radians([30.0, 45.0]), 0.0))
    assert cli.main([*command, "--phi-out", "0"]) == 0  # back to the light, which is theta_diff = 0 where both are 30
    back = document(capsys)["values"]
    np.testing.assert_allclose(back, model.evaluate(np.radians([30.0, 45.0]), np.radians([0.0, 15.0]), 0.0))


@pytest.mark.parametrize("words", [["eval", "--theta-half", "0,10", "--theta-diff", "30"], ["show"], ["decompose"]])
def test_text_holds_at_60_columns(
    words: list[str], model_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    assert cli.main([words[0], str(model_file), *words[1:]]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if len(line) > 60 and not line.startswith("warning")] == []


def test_eval_with_phi_diff(model_file: Path, capsys: Capture) -> None:
    point = ["--theta-half", "40", "--theta-diff", "60"]
    assert cli.main(["eval", str(model_file), *point, "--phi-diff", "0", "70", "-110", "--json"]) == 0
    answer = document(capsys)
    assert answer["phi_diff_deg"] == [0.0, 70.0, -110.0]
    phi_diff = np.radians([0.0, 70.0, -110.0])
    expected = load(model_file).evaluate(np.radians(40.0), np.radians(60.0), phi_diff)
    np.testing.assert_array_equal(answer["values"], expected)
    assert answer["values"][0] == [0.0] * 3  # 100 degrees from the normal
    assert min(answer["values"][1]) > 0.0
    np.testing.assert_allclose(answer["values"][1], answer["values"][2], rtol=1e-12)


def test_direction_below_the_horizon_gives_0(model_file: Path, capsys: Capture) -> None:
    words = ["--omega-in", "0,0,-1", "--omega-in", "0,0,1", "--omega-out", "0,0,1", "--json"]
    assert cli.main(["eval", str(model_file), *words]) == 0
    below, above = document(capsys)["values"]
    assert below == [0.0] * 3
    assert min(above) > 0.0


def test_eval_by_directions(model_file: Path, capsys: Capture) -> None:
    words = ["--omega-in", "-0.6,0,0.8", "--omega-in", "0,0,1", "--omega-out", "0.6,-0,0.8", "--json"]
    assert cli.main(["eval", str(model_file), *words]) == 0
    expected = load(model_file).evaluate_directions(np.array([[-0.6, 0, 0.8], [0, 0, 1]]), np.array([0.6, 0, 0.8]))
    np.testing.assert_array_equal(document(capsys)["values"], expected)
    exchanged = ["--omega-in", "0.6,0,0.8", "--omega-out", "-0.6,0,0.8", "--json"]
    assert cli.main(["eval", str(model_file), *exchanged]) == 0
    np.testing.assert_allclose(document(capsys)["values"], expected[:1], rtol=1e-12)


def test_components_sum_to_the_model(model_file: Path, capsys: Capture) -> None:
    command = ["eval", str(model_file), "--theta-half", "0.5", "12", "60", "--theta-diff", "0", "45", "20", "--json"]
    assert cli.main(command) == 0
    whole = np.array(document(capsys)["values"])
    total = np.zeros_like(whole)
    labels = dsbrdf.decompose(load(model_file)).labels
    assert len(labels) == 2
    for label in labels:
        assert cli.main([*command, "--component", label]) == 0
        total += document(capsys)["values"]
    np.testing.assert_allclose(total, whole, rtol=1e-12)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "--theta-half is missing"),
        (["--theta-half", "1"], "--theta-diff is missing"),
        (["--omega-in", "0,0,1"], "--omega-out is missing"),
        (["--theta-half", "1", "2", "--theta-diff", "1", "2", "3"], "cannot be combined"),
        (["--theta-half", "91", "--theta-diff", "0"], "theta_half must lie between 0 and 90 degrees"),
        (["--theta-half", "-1", "--theta-diff", "0"], "theta_half must lie between 0 and 90 degrees"),
        (["--theta-half", "x", "--theta-diff", "0"], "--theta-half: must be a number, not 'x'"),
        (["--theta-half", "1", "--omega-in", "0,0,1"], "either --theta-half and --theta-diff, --theta-in and"),
        (["--omega-in", "0,0,2", "--omega-out", "0,0,1"], "omega_in must be of unit length"),
        (["--phi-diff", "1"], "--theta-half is missing"),
        (["--phi-diff", "1", "--omega-in", "0,0,1", "--omega-out", "0,0,1"], "either --theta-half and --theta-diff, "),
        (["--theta-half", "1", "--theta-diff", "1", "--phi-diff", "nan"], "phi_diff must be finite"),
        (["--theta-half", "1", "--theta-diff", "1", "2", "--phi-diff", "1", "2", "3"], "cannot be combined"),
        (["--omega-in", "0,1", "--omega-out", "0,0,1"], "a direction must be three numbers x,y,z, not '0,1'"),
        (
            ["--theta-half", "1", "--theta-diff", "1", "--component", "shiny"],
            "--component: must be specular_spike or specular_lobe or diffuse or guide",
        ),
    ],
)
def test_invalid_points_are_refused_in_one_sentence(
    words: list[str], said: str, model_file: Path, capsys: Capture
) -> None:
    assert exit_code(["eval", str(model_file), *words]) == 2
    assert said in sentence(capsys)


def test_decompose_prints_the_components(model_file: Path, capsys: Capture) -> None:
    assert cli.main(["decompose", str(model_file), "--json"]) == 0
    items = document(capsys)["items"]
    assert cli.main(["decompose", str(model_file)]) == 0
    lines = capsys.readouterr().out.splitlines()
    for item, component in zip(items, dsbrdf.decompose(load(model_file)), strict=True):
        assert (item["label"], item["clarity"]) == (component.label, component.clarity)
        assert item["albedo"] == component.albedo.tolist()
        assert item["color"] == pytest.approx(component.albedo / component.albedo.max())
        lobe = item["lobe"]
        angles = np.radians(lobe["theta_diff_deg"])
        np.testing.assert_allclose(lobe["height"], component.lobe.evaluate(0.0, angles), rtol=1e-9)
        half = component.lobe.evaluate(np.radians(lobe["half_width_deg"][0]), 0.0)
        np.testing.assert_allclose(half, np.array(lobe["height"][0]) / 2.0, rtol=1e-9)
        assert item["half_width_deg"] == pytest.approx(np.degrees(component.half_width))
        own = next(number for number, line in enumerate(lines) if line == component.label)
        shown = [lobe["height"][lobe["theta_diff_deg"].index(angle)] for angle in (0, 30, 60, 80)]
        printed = [[float(word) for word in line.split()[-4:]] for line in lines[own + 1 : own + 4]]
        np.testing.assert_allclose(printed, np.transpose(shown), rtol=1e-3)


def test_decompose_saves_the_guide(model_file: Path, tmp_path: Path, capsys: Capture) -> None:
    saved, exported = tmp_path / "guide.json", tmp_path / "guide.npz"
    assert cli.main(["decompose", str(model_file), "-o", str(saved)]) == 0
    assert cli.main(["export", str(model_file), "--component", "guide", "-o", str(exported)]) == 0
    guide = load(saved)
    assert guide == load(exported) == dsbrdf.decompose(load(model_file)).guide
    np.testing.assert_allclose(guide.evaluate(0.2, 0.5), load(model_file).evaluate(0.2, 0.5), rtol=0.2)
    capsys.readouterr()
    assert cli.main(["decompose", str(model_file), "-o", str(tmp_path / "guide.txt")]) == 2
    assert "must end in .json or .npz" in sentence(capsys)


@pytest.mark.parametrize("command", [["eval", "--theta-half", "0", "--theta-diff", "0"], ["export", "-o", "a.binary"]])
def test_an_absent_component_is_named_with_the_file(
    command: list[str], model_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    there = dsbrdf.decompose(load(model_file)).labels
    (absent,) = set(LABELS) - set(there)
    assert cli.main([*command, str(model_file), "--component", absent]) == 2
    assert (
        sentence(capsys)
        == f"dsbrdf: {model_file}: this model has no component {absent}: it has {' and '.join(there)}\n"
    )
    assert not any(tmp_path.iterdir())


def test_a_component_in_a_format_of_lobes_is_refused(model_file: Path, tmp_path: Path, capsys: Capture) -> None:
    output = tmp_path / "diffuse.json"
    assert cli.main(["export", str(model_file), "--component", "diffuse", "-o", str(output)]) == 2
    assert sentence(capsys).startswith("dsbrdf: json cannot hold a component")
    assert not output.exists()


def test_a_model_without_light_has_no_components(model_file: Path, tmp_path: Path, capsys: Capture) -> None:
    black = tmp_path / "black.json"
    dsbrdf.save(load(model_file).select((), with_delta=False), black)
    assert cli.main(["decompose", str(black)]) == 0
    assert capsys.readouterr().out.strip() == "The model has no light, and so no components."


def test_show_prints_the_lobes_of_the_model_on_request(model_file: Path, capsys: Capture) -> None:
    assert cli.main(["show", str(model_file)]) == 0
    assert "kappa" not in capsys.readouterr().out
    assert cli.main(["show", str(model_file), "--lobes", "--channel", "blue"]) == 0
    lines = capsys.readouterr().out.splitlines()
    start = next(number for number, line in enumerate(lines) if ", blue channel" in line)
    height, width, kappa = (
        [float(word.strip("°")) for word in line.split()[-4:]] for line in lines[start + 3 : start + 6]
    )
    angles = np.radians([0.0, 30.0, 60.0, 80.0])
    first = load(model_file).select((0,), with_delta=False)
    np.testing.assert_allclose(height, first.evaluate(0.0, angles)[:, 2], rtol=1e-3)
    half = first.evaluate(np.radians(width[0]), 0.0)[2]
    assert half == pytest.approx(height[0] / 2.0, rel=1e-2)
    np.testing.assert_allclose(kappa, first.parameters_at(angles)["kappa"][:, 0, 0], rtol=1e-3)


def test_show_prints_the_report_of_the_fit(
    printed_and_stored: tuple[list[str], Path], tmp_path: Path, capsys: Capture
) -> None:
    (*printed, last), model_file = printed_and_stored
    assert last == f"saved: {model_file}"
    assert cli.main(["show", str(model_file)]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert shown[0].rpartition(";")[0] == printed[0].rpartition(";")[0]  # the time is another
    assert shown[1:] == printed[1:]
    assert cli.main(["show", str(model_file), "--json"]) == 0
    answer = document(capsys)
    result = dsbrdf.load_result(model_file)
    assert answer["metrics"] == asdict(result.report.metrics)
    assert answer["model"]["amplitude"] == result.model.amplitude.tolist()
    assert [component["label"] for component in answer["components"]] == list(dsbrdf.decompose(result).labels)
    dsbrdf.save(result.model, tmp_path / "plain.npz")
    assert cli.main(["show", str(tmp_path / "plain.npz")]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert shown[0] == "plain: 2 lobes"
    assert set(shown[2:]) <= set(printed)


def test_export_without_loss(model_file: Path, tmp_path: Path, capsys: Capture) -> None:
    model, report = from_json(model_file.read_text())
    assert cli.main(["export", str(model_file), "--format", "npz", "-o", str(tmp_path / "model.npz")]) == 0
    assert capsys.readouterr().out.startswith(f"{tmp_path / 'model.npz'}: the model and its report for NumPy (")
    again = from_npz((tmp_path / "model.npz").read_bytes())
    np.testing.assert_array_equal(again[0].kappa, model.kappa)
    assert again[1] == report
    assert cli.main(["export", str(tmp_path / "model.npz"), "-o", str(tmp_path / "back.json")]) == 0
    assert (tmp_path / "back.json").read_text() == model_file.read_text()


def test_export_as_a_table(model_file: Path, tmp_path: Path, capsys: Capture) -> None:
    table = tmp_path / "table.binary"
    command = ["export", str(model_file), "--format", "merl", "-o", str(table), "--component", "diffuse", "--json"]
    assert cli.main(command) == 0
    assert document(capsys) == {"output": str(table), "format": "merl", "bytes": 34_992_012}
    measurement = dsbrdf.read_merl(table)
    part = dsbrdf.decompose(load(model_file))["diffuse"]
    # node (30, 20, 90): theta_half = (30 / 90)**2 * 90 = 10 degrees, theta_diff = 20 degrees
    expected = part.evaluate(np.radians(10.0), np.radians(20.0))
    np.testing.assert_allclose(measurement.values[:, 30, 20, 90], expected, rtol=1e-12)


@pytest.mark.parametrize("content", [b"", b"{}", b"\xff\xfe", b'{"format": "other"}', b"[" * 5000])
@pytest.mark.parametrize("suffix", [".json", ".npz", ".txt"])
def test_file_that_is_no_model_is_refused_in_one_sentence(
    content: bytes, suffix: str, tmp_path: Path, capsys: Capture
) -> None:
    path = tmp_path / f"model{suffix}"
    path.write_bytes(content)
    assert cli.main(["decompose", str(path)]) == 2
    assert sentence(capsys).startswith(f"dsbrdf: {path}: ")


def test_missing_model_is_reported_in_one_sentence(tmp_path: Path, capsys: Capture) -> None:
    assert cli.main(["decompose", str(tmp_path / "none.json")]) == 2
    assert sentence(capsys) == f"dsbrdf: {tmp_path / 'none.json'}: No such file or directory\n"


def test_missing_output_folder_is_reported_by_its_given_name(model_file: Path, tmp_path: Path, capsys: Capture) -> None:
    output = tmp_path / "nowhere" / "model.npz"
    assert cli.main(["export", str(model_file), "--format", "npz", "-o", str(output)]) == 2
    assert sentence(capsys) == f"dsbrdf: {output}: No such file or directory\n"


def test_internal_error_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch, model_file: Path) -> None:
    def broken(*_: Any, **__: Any) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(model_commands, "model_text", broken)
    with pytest.raises(ZeroDivisionError):
        cli.main(["decompose", str(model_file)])


def test_closed_output_pipe_is_no_error(model_file: Path) -> None:
    many = " ".join(str(angle / 40) for angle in range(3000))  # their lines are longer than what a pipe holds
    command = (
        f"'{sys.executable}' -m dsbrdf.cli.main eval '{model_file}' --theta-diff 0 --theta-half {many} | head -n 1"
    )
    answer = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=True)
    assert answer.stdout.split()[0] == "theta_half"
    assert answer.stderr == ""
