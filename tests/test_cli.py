"""The command ``dsbrdf``: what it prints, what it writes, and how it ends."""

import errno
import inspect
import json
import os
import shutil
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

import dsbrdf
from dsbrdf import extras
from dsbrdf.cli import fit_arguments as flags
from dsbrdf.cli import fit_command, model_commands
from dsbrdf.cli import main as cli
from dsbrdf.cli.arguments import Parser
from dsbrdf.data.measurement import Measurement
from dsbrdf.engines import batch, local, worker_process
from dsbrdf.model.decomposition import LABELS
from dsbrdf.output.serialize import from_json, from_npz, load

Capture = pytest.CaptureFixture[str]
QUICK = ("--method", "paper", "--n-lobes", "1", "--em-iterations", "40")


@pytest.fixture(scope="module")
def model_file(plastic_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fits")
    assert cli.main(["fit", str(plastic_file), "-o", str(folder)]) == 0
    return folder / "plastic.json"


@pytest.fixture
def damaged_file(plastic_file: Path, tmp_path: Path) -> Path:
    path = tmp_path / "cut.binary"
    with plastic_file.open("rb") as file:
        path.write_bytes(file.read(1000))
    return path


def document(capture: Capture) -> Any:
    out = capture.readouterr().out
    assert out.count("\n") == 1
    return json.loads(out)


def sentence(capture: Capture) -> str:
    """The one line on stderr of a command that printed nothing else."""
    captured = capture.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    return captured.err


# fit


@pytest.mark.filterwarnings("ignore::dsbrdf.ConvergenceWarning")
def test_fit_prints_metrics_and_lobes(plastic_file: Path, plastic: Measurement, capsys: Capture) -> None:
    assert cli.main(["fit", str(plastic_file), "--n-lobes", "2"]) == 0
    out = capsys.readouterr().out
    result = dsbrdf.fit(plastic, dsbrdf.FitOptions(n_lobes=2))
    assert f"relative_rms {result.report.metrics['relative_rms']:.4g}" in out
    for component in dsbrdf.decompose(result.model):
        (line,) = [line for line in out.splitlines() if line.startswith(component.label)]
        for value in component.albedo:
            assert f"{value:.4f}" in line
        if component.half_width is not None:
            assert f"{np.degrees(component.half_width):.2f}°" in line
    kappa, gamma, _, _ = result.model.parameters_at(np.radians(30.0))
    assert f"{kappa[0, 1]:.4g}" in out
    assert f"{gamma[0, 1]:.4g}" in out


def test_fit_tells_how_the_lobes_were_chosen_and_where_the_error_is(
    plastic: Measurement, capsys: Capture, plastic_file: Path
) -> None:
    assert cli.main(["fit", str(plastic_file)]) == 0
    out = capsys.readouterr().out
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", dsbrdf.ConvergenceWarning)
        result = dsbrdf.fit(plastic)
    rings = sum(row["pays"] for row in result.report.rings)
    expected = f"plastic: {result.model.n_lobes - rings} lobes" + (f" + {rings} ring lobe" if rings else "")
    assert out.startswith(expected)
    lines = out.splitlines()
    assert len(result.report.selection) > 1
    for row in result.report.selection:
        (line,) = [line for line in lines if line.startswith(f"{row['n_lobes']}  ")]
        for name, form in (("e_p", ".4f"), ("t", ".2f"), ("critical_value", ".3f")):
            assert row[name] is None or f" {row[name]:{form}} " in line
        assert line.endswith("too few") == row["significant"]
    for row in result.report.rings:
        assert f"{row['ring_lobes']} {'pays' if row['pays'] else 'does not pay'}" in out
    for band in result.report.by_theta_diff:
        low, high = np.degrees(band["theta_diff"])
        (line,) = [line for line in lines if line.startswith(f"theta_diff {low:.0f}° to {high:.0f}°")]
        assert line.split()[-3:] == [f"{band['relative_rms']:.4f}", f"{band['floor']:.4f}", f"{band['excess']:.3f}"]


def test_a_ring_lobe_is_shown_with_its_center(plastic_file: Path, capsys: Capture) -> None:
    assert cli.main(["fit", str(plastic_file), "--n-lobes", "1", "--ring-lobes", "1"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("plastic: 1 lobe + 1 ring lobe; ")
    (line,) = [line for line in out.splitlines() if line.split()[:1] == ["center"]]
    assert line.count("°") == 4


@pytest.mark.filterwarnings("ignore::dsbrdf.ConvergenceWarning")
def test_fit_writes_what_the_library_would_save(model_file: Path, plastic: Measurement) -> None:
    model, report = from_json(model_file.read_text())
    expected = dsbrdf.fit(plastic)
    np.testing.assert_array_equal(model.kappa, expected.model.kappa)
    np.testing.assert_array_equal(model.gamma, expected.model.gamma)
    assert report is not None
    assert report.metrics == expected.report.metrics
    assert report.options == expected.report.options


def test_fit_json_of_one_file_is_a_stored_model(plastic_file: Path, tmp_path: Path, capsys: Capture) -> None:
    assert cli.main(["fit", str(plastic_file), "--json", *QUICK]) == 0
    answer = document(capsys)
    stored = tmp_path / "stored.json"
    stored.write_text(json.dumps(answer))
    assert load(stored).n_lobes == 1
    assert answer["status"] == "succeeded"
    assert answer["metrics"] == answer["report"]["metrics"]
    assert answer["lobes"]["kappa"] == answer["model"]["kappa"]
    assert answer["lobes"]["theta_diff_deg"][:3] == [0.0, 5.0, 10.0]
    assert [component["label"] for component in answer["components"]] == list(LABELS)


def test_one_bad_file_does_not_stop_the_others(
    plastic_file: Path, damaged_file: Path, tmp_path: Path, capsys: Capture
) -> None:
    files = [str(damaged_file), str(tmp_path / "none.binary"), str(plastic_file)]
    assert cli.main(["fit", *files, "-o", str(tmp_path / "out"), *QUICK]) == 2
    captured = capsys.readouterr()
    first, second = captured.err.splitlines()
    with pytest.raises(dsbrdf.MeasurementFormatError) as refusal:
        dsbrdf.read_merl(damaged_file)
    assert first == f"dsbrdf: {damaged_file}: {refusal.value}"
    assert second == f"dsbrdf: {tmp_path / 'none.binary'}: No such file or directory"
    assert captured.out.startswith("plastic: 1 lobe")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["plastic.json"]


def test_a_fit_that_was_lost_is_not_the_users_fault(monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    def lost(files: list[Path], *_: Any, **__: Any) -> Iterator[batch.FileFit]:
        yield batch.FileFit(files[0], error="the process died", lost=True)
        yield batch.FileFit(files[1], error="no measurement")

    monkeypatch.setattr(fit_command, "fit_files", lost)
    assert cli.main(["fit", "a.binary", "b.binary"]) == 1
    assert capsys.readouterr().err == "dsbrdf: a.binary: the process died\ndsbrdf: b.binary: no measurement\n"


def test_fit_json_of_several_files_tells_of_each(plastic_file: Path, damaged_file: Path, capsys: Capture) -> None:
    assert cli.main(["fit", str(damaged_file), str(plastic_file), "--json", *QUICK]) == 2
    bad, good = document(capsys)["items"]
    assert (bad["file"], bad["status"]) == (str(damaged_file), "failed")
    assert "1000" in bad["error"]
    assert (good["file"], good["status"], good["error"]) == (str(plastic_file), "succeeded", None)


def test_a_folder_stands_for_its_files(plastic_file: Path, tmp_path: Path, capsys: Capture) -> None:
    folder = tmp_path / "materials"
    folder.mkdir()
    assert cli.main(["fit", str(folder)]) == 2
    assert "contains no .binary file" in sentence(capsys)
    (folder / "a.binary").symlink_to(plastic_file)
    (folder / "notes.txt").write_text("not a measurement")
    assert cli.main(["fit", str(folder), "--json", *QUICK]) == 0
    assert [item["file"] for item in document(capsys)["items"]] == [str(folder / "a.binary")]


def test_slices_that_did_not_converge_are_told_but_no_error(plastic_file: Path, capsys: Capture) -> None:
    assert cli.main(["fit", str(plastic_file), "--method", "paper", "--em-iterations", "1"]) == 0
    captured = capsys.readouterr()
    assert "stopped at the bound of 1 iterations" in captured.err
    assert captured.err.startswith(f"dsbrdf: {plastic_file}: ")
    assert captured.err.count("\n") == 1


# resuming


@pytest.fixture
def two_files(plastic_file: Path, tmp_path: Path) -> list[str]:
    files = [tmp_path / "one.binary", tmp_path / "two.binary"]
    for file in files:
        shutil.copyfile(plastic_file, file)
    return [str(file) for file in files]


@pytest.fixture
def no_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make every attempt to start a worker process fail."""

    def refuse(*_: Any) -> NoReturn:
        pytest.fail("a worker process was started")

    monkeypatch.setattr(worker_process, "start_fork_server", refuse)
    monkeypatch.setattr(worker_process.WorkerProcess, "__init__", refuse)


@pytest.mark.usefixtures("no_processes")
def test_one_file_is_fitted_in_this_process(
    plastic_file: Path, tmp_path: Path, capsys: Capture, terminal: Callable[[], None]
) -> None:
    terminal()
    assert cli.main(["fit", str(plastic_file), "-o", str(tmp_path), *QUICK]) == 0
    captured = capsys.readouterr()
    assert captured.out.startswith("plastic: 1 lobe")
    assert "1/1 files" in captured.err
    assert load(tmp_path / "plastic.json").n_lobes == 1


@pytest.mark.usefixtures("no_processes")
def test_one_bad_file_gets_one_sentence(damaged_file: Path, capsys: Capture) -> None:
    assert cli.main(["fit", str(damaged_file)]) == 2
    assert sentence(capsys).startswith(f"dsbrdf: {damaged_file}: The data has only 1000 bytes")


def test_a_second_run_keeps_what_is_there(
    two_files: list[str], tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = ["fit", *two_files, "-o", str(tmp_path / "out"), "--json", *QUICK]
    assert cli.main(command) == 0
    first = document(capsys)["items"]
    monkeypatch.setattr(local.LocalEngine, "start", None)  # nothing is to be computed
    assert cli.main(command) == 0
    second = document(capsys)["items"]
    assert [item.pop("resumed") for item in first] == [False, False]
    assert [item.pop("resumed") for item in second] == [True, True]
    for item in (*first, *second):
        item.pop("warnings")
    assert first == second


@pytest.mark.parametrize("reason", ["options", "force", "measurement", "damaged", "algorithm", "no report"])
def test_a_fit_that_is_not_the_one_asked_for_is_made_again(
    two_files: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture, reason: str
) -> None:
    output = tmp_path / "out" / "one.json"
    command = ["fit", two_files[0], "-o", str(output.parent), "--json", *QUICK]
    assert cli.main(command) == 0
    capsys.readouterr()
    if reason == "options":
        command += ["--weighting", "cosine"]
    elif reason == "force":
        command += ["--force"]
    elif reason == "measurement":
        after = output.stat().st_mtime + 10
        os.utime(two_files[0], (after, after))
    elif reason == "damaged":
        output.write_bytes(output.read_bytes()[:-100])
    elif reason == "algorithm":
        monkeypatch.setattr(batch, "ALGORITHM_VERSION", "another")
    else:
        dsbrdf.save(load(output), output)
    assert cli.main(command) == 0
    assert document(capsys)["resumed"] is False
    assert from_json(output.read_text())[1] is not None


def test_two_files_of_one_name_are_refused(two_files: list[str], tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "other").mkdir()
    shutil.copyfile(two_files[0], tmp_path / "other/one.binary")
    assert cli.main(["fit", two_files[0], str(tmp_path / "other/one.binary"), "-o", str(tmp_path / "out")]) == 2
    assert "would both be written to" in sentence(capsys)


def test_a_full_disk_is_not_the_users_fault(
    plastic_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(batch, "save", full)
    assert cli.main(["fit", str(plastic_file), "-o", str(tmp_path), *QUICK]) == 1
    assert "No space left on device" in sentence(capsys)


# options of the fit


def options_of(*words: str) -> dsbrdf.FitOptions:
    parser = Parser()
    flags.add_fit_options(parser)
    return flags.fit_options(parser.parse_args(words))


def test_without_flags_the_options_are_the_defaults() -> None:
    assert options_of() == dsbrdf.FitOptions()


def test_every_option_has_a_flag_with_help(capsys: Capture) -> None:
    with pytest.raises(SystemExit):
        cli.main(["fit", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    for field in fields(dsbrdf.FitOptions):
        flag = f"--{field.name.replace('_', '-')}"
        assert f" {flag}" in text
    assert "[rad]" not in text
    assert "(default: 80)" in text


def test_every_angle_among_the_options_is_known_as_one() -> None:
    names = {field.name for field in fields(dsbrdf.FitOptions)}
    angles = {name for name, text in flags._field_descriptions().items() if "[rad]" in text}
    assert angles == flags.ANGLE_FIELDS & names


def test_the_help_does_not_depend_on_how_this_python_keeps_docstrings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python 3.13 takes the indentation off."""
    texts = flags._field_descriptions()
    assert set(texts) == {field.name for field in fields(dsbrdf.FitOptions)}
    monkeypatch.setattr(dsbrdf.FitOptions, "__doc__", inspect.cleandoc(dsbrdf.FitOptions.__doc__ or ""))
    assert flags._field_descriptions() == texts


def test_flags_reach_the_options() -> None:
    words = ["--n-lobes", "2", "--weighting", "log", "--robust", "--mask", "0.5", "--horizon-cutoff", "75"]
    asked = dsbrdf.FitOptions(n_lobes=2, weighting="log", robust=True, mask=0.5, horizon_cutoff=float(np.radians(75)))
    assert options_of(*words) == asked
    assert options_of("--horizon-cutoff", "none").horizon_cutoff is None
    assert options_of("--no-robust").robust is False


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--n-lobes", "9"], "n_lobes must be"),
        (["--n-lobes", "two"], "--n-lobes: must be "),
        (["--n-lobes", "2.5"], "--n-lobes: must be "),
        (["--weighting", "heavy"], "--weighting: must be plain or cosine or log, not 'heavy'"),
        (["--horizon-cutoff", "100"], "cutoff must lie above 0 and at most at 90 degrees, not at 100"),
        (["--horizon-cutoff", "nan"], "cutoff must lie above 0"),
        (["--mask", "1,2"], "--mask: must be none or a number, not '1,2'"),
        (["--jobs", "0"], "the number of fits that run at once, must be at least 1, not 0"),
        (["--jobs", "many"], "--jobs: must be a whole number, not 'many'"),
        (["--scheduler", "host"], "--scheduler: must be an address such as tcp://host:8786, not 'host'"),
        (["--scheduler", "tcp://host"], "--scheduler: must be an address such as"),
        (["--no-such-flag"], "unrecognized arguments: --no-such-flag"),
    ],
)
def test_bad_options_get_one_sentence(words: list[str], said: str, plastic_file: Path, capsys: Capture) -> None:
    assert exit_code(["fit", str(plastic_file), *words]) == 2
    assert said in sentence(capsys)


def exit_code(argv: list[str]) -> int:
    """What the process would end with, whether argparse ended it or the command returned."""
    try:
        return cli.main(argv)
    except SystemExit as end:
        return int(end.code or 0)


# models


def test_eval_by_angles(model_file: Path, capsys: Capture) -> None:
    command = ["eval", str(model_file), "--theta-half", "0", "10", "--theta-diff", "30"]
    assert cli.main([*command, "--theta-half", "40", "--json"]) == 0
    answer = document(capsys)
    expected = load(model_file).evaluate(np.radians([0.0, 10.0, 40.0]), np.radians(30.0))
    np.testing.assert_array_equal(answer["values"], expected)
    assert answer["theta_half_deg"] == [0.0, 10.0, 40.0]
    assert answer["theta_diff_deg"] == [30.0] * 3
    assert cli.main(command) == 0
    rows = capsys.readouterr().out.splitlines()
    assert rows[0].split() == ["theta_half_deg", "theta_diff_deg", "red", "green", "blue"]
    np.testing.assert_allclose([float(word) for word in rows[2].split()], [10, 30, *expected[1]], rtol=1e-5)


def test_eval_by_directions(model_file: Path, capsys: Capture) -> None:
    words = ["--omega-in", "-0.6,0,0.8", "--omega-in", "0,0,1", "--omega-out", "0.6,-0,0.8", "--json"]
    assert cli.main(["eval", str(model_file), *words]) == 0
    expected = load(model_file).evaluate_directions(np.array([[-0.6, 0, 0.8], [0, 0, 1]]), np.array([0.6, 0, 0.8]))
    np.testing.assert_array_equal(document(capsys)["values"], expected)


def test_components_sum_to_the_model(model_file: Path, capsys: Capture) -> None:
    command = ["eval", str(model_file), "--theta-half", "0.5", "12", "60", "--theta-diff", "0", "45", "20", "--json"]
    assert cli.main(command) == 0
    whole = np.array(document(capsys)["values"])
    total = np.zeros_like(whole)
    for label in LABELS:
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
        (["--theta-half", "x", "--theta-diff", "0"], "--theta-half: invalid float value: 'x'"),
        (["--theta-half", "1", "--omega-in", "0,0,1"], "either --theta-half and --theta-diff or --omega-in"),
        (["--omega-in", "0,0,2", "--omega-out", "0,0,1"], "omega_in must be of unit length"),
        (["--omega-in", "0,0,-1", "--omega-out", "0,0,1"], "omega_in"),
        (["--omega-in", "0,1", "--omega-out", "0,0,1"], "--omega-in: must be three numbers x,y,z, not '0,1'"),
        (["--theta-half", "1", "--theta-diff", "1", "--component", "shiny"], "invalid choice: 'shiny'"),
    ],
)
def test_bad_points_get_one_sentence(words: list[str], said: str, model_file: Path, capsys: Capture) -> None:
    assert exit_code(["eval", str(model_file), *words]) == 2
    assert said in sentence(capsys)


def test_decompose(model_file: Path, capsys: Capture) -> None:
    assert cli.main(["decompose", str(model_file), "--json"]) == 0
    items = document(capsys)["items"]
    for item, component in zip(items, dsbrdf.decompose(load(model_file)), strict=True):
        assert item["label"] == component.label
        assert item["lobes"] == list(component.lobes)
        assert item["albedo"] == component.albedo.tolist()
        assert item["parameters"]["kappa"] == component.kappa.tolist()
        assert item["parameters"]["delta"] == component.delta.tolist()
        if component.half_width is not None:
            assert item["half_width_deg"] == pytest.approx(np.degrees(component.half_width))
    assert cli.main(["decompose", str(model_file), "--channel", "blue"]) == 0
    out = capsys.readouterr().out
    assert "blue channel" in out
    assert all(label in out for label in LABELS)


def test_export_without_loss(model_file: Path, tmp_path: Path, capsys: Capture) -> None:
    model, report = from_json(model_file.read_text())
    assert cli.main(["export", str(model_file), "--format", "npz", "-o", str(tmp_path / "model.npz")]) == 0
    assert capsys.readouterr().out == ""
    again = from_npz((tmp_path / "model.npz").read_bytes())
    np.testing.assert_array_equal(again[0].kappa, model.kappa)
    assert again[1] == report
    assert cli.main(["export", str(tmp_path / "model.npz"), "--format", "json", "-o", str(tmp_path / "back.json")]) == 0
    assert (tmp_path / "back.json").read_text() == model_file.read_text()


def test_export_as_a_table(model_file: Path, tmp_path: Path, capsys: Capture) -> None:
    table = tmp_path / "table.binary"
    command = ["export", str(model_file), "--format", "merl", "-o", str(table), "--component", "diffuse", "--json"]
    assert cli.main(command) == 0
    assert document(capsys) == {"output": str(table), "format": "merl", "bytes": 34_992_012}
    measurement = dsbrdf.read_merl(table)
    part = dsbrdf.decompose(load(model_file)).diffuse
    # node (30, 20, 90): theta_half = (30 / 90)**2 * 90 = 10 degrees, theta_diff = 20 degrees
    expected = part.evaluate(np.radians(10.0), np.radians(20.0))
    np.testing.assert_allclose(measurement.values[:, 30, 20, 90], expected, rtol=1e-12)


@pytest.mark.parametrize("content", [b"", b"{}", b"\xff\xfe", b'{"format": "other"}', b"[" * 5000])
@pytest.mark.parametrize("suffix", [".json", ".npz", ".txt"])
def test_what_is_no_model_gets_one_sentence(content: bytes, suffix: str, tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / f"model{suffix}"
    path.write_bytes(content)
    assert cli.main(["decompose", str(path)]) == 2
    assert sentence(capsys).startswith(f"dsbrdf: {path}: ")


def test_a_missing_model_gets_one_sentence(tmp_path: Path, capsys: Capture) -> None:
    assert cli.main(["decompose", str(tmp_path / "none.json")]) == 2
    assert sentence(capsys) == f"dsbrdf: {tmp_path / 'none.json'}: No such file or directory\n"


def test_a_folder_that_is_not_there_is_told_by_the_name_that_was_given(
    model_file: Path, tmp_path: Path, capsys: Capture
) -> None:
    output = tmp_path / "nowhere" / "model.npz"
    assert cli.main(["export", str(model_file), "--format", "npz", "-o", str(output)]) == 2
    assert sentence(capsys) == f"dsbrdf: {output}: No such file or directory\n"


# serve, demo, and the command itself


def test_serve_becomes_the_service(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[list[str]] = []

    def execv(_: str, command: list[str]) -> NoReturn:
        calls.append(command)
        raise SystemExit

    monkeypatch.setattr(os, "execv", execv)
    exit_code(["serve"])
    exit_code(["serve", "--host", "::1", "--port", "81", "--data-dir", "d", "--workers", "3", "--insecure"])
    start = [sys.executable, "-m", "service"]
    every = ["--host", "::1", "--port", "81", "--data-dir", "d", "--workers", "3", "--insecure"]
    assert calls == [start, start + every]


def test_the_service_knows_the_flags_of_serve() -> None:
    answer = subprocess.run([sys.executable, "-m", "service", "--help"], capture_output=True, text=True, check=True)
    for flag in ("--host", "--port", "--data-dir", "--workers", "--insecure"):
        assert flag in answer.stdout


@pytest.mark.parametrize(("command", "extra"), [("serve", "service"), ("demo", "dev")])
def test_a_missing_extra_is_named(command: str, extra: str, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    assert cli.main([command]) == 1
    assert f"pip install 'dsbrdf[{extra}]'" in sentence(capsys)


def test_version(capsys: Capture) -> None:
    assert exit_code(["--version"]) == 0
    assert capsys.readouterr().out == f"dsbrdf {dsbrdf.__version__}\n"


@pytest.mark.parametrize("words", [["--version"], ["--help"], ["keys", "--help"], ["purge", "--help"]])
def test_command_that_computes_nothing_imports_no_numpy(words: list[str]) -> None:
    """NumPy and SciPy would take most of the time of such a command."""
    program = "import atexit, sys\nfrom dsbrdf.cli.main import main\n"
    program += "atexit.register(lambda: print(sorted({'numpy', 'scipy'} & {*sys.modules})))\nsys.exit(main())"
    answer = subprocess.run([sys.executable, "-c", program, *words], capture_output=True, text=True, check=True)
    assert answer.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize("words", [[], ["unknown"], ["fit"], ["eval"], ["export", "m.json"]])
def test_bad_usage_gets_one_sentence(words: list[str], capsys: Capture) -> None:
    assert exit_code(words) == 2
    assert sentence(capsys).startswith("dsbrdf")


def test_a_fault_of_our_own_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch, model_file: Path) -> None:
    def broken(*_: Any, **__: Any) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(model_commands, "component_documents", broken)
    with pytest.raises(ZeroDivisionError):
        cli.main(["decompose", str(model_file)])


def test_a_reader_that_leaves_early_is_no_error(model_file: Path) -> None:
    many = " ".join(str(angle / 200) for angle in range(15_000))
    command = (
        f"'{sys.executable}' -m dsbrdf.cli.main eval '{model_file}' --theta-diff 0 --theta-half {many} | head -n 1"
    )
    answer = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=True)
    assert answer.stdout.split()[0] == "theta_half_deg"
    assert answer.stderr == ""


def test_progress_goes_to_a_terminal_only(
    plastic_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture, terminal: Callable[[], None]
) -> None:
    assert cli.main(["fit", str(plastic_file), "--json", *QUICK]) == 0
    assert capsys.readouterr().err == ""
    terminal()
    assert cli.main(["fit", str(plastic_file), "--json", *QUICK]) == 0
    captured = capsys.readouterr()
    assert "1/1 files" in captured.err
    assert json.loads(captured.out)["status"] == "succeeded"
    assert cli.main(["fit", str(plastic_file), *QUICK]) == 0
    assert capsys.readouterr().out.startswith("plastic: 1 lobe")


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Call it to make stderr look like a terminal."""

    def pretend() -> None:
        monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)

    return pretend
