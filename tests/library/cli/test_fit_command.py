"""``dsbrdf fit``: options, what it prints and stores, fits on a server; and ``convert``, which may fit first."""

import errno
import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cyclopts import App

import dsbrdf
from dsbrdf import Finding, FitResult, TableOptions, decompose, load, read_merl
from dsbrdf.cli import fit_command
from dsbrdf.cli.parameters import DEFAULT, Flags
from dsbrdf.data import PHI_DIFF, THETA_DIFF, THETA_HALF, incident_cosines, read_rgl
from dsbrdf.data.rgl import encode_tensors, parse_tensors
from dsbrdf.engines import FileFit, batch, local
from dsbrdf.fitting.options import sentences_of
from dsbrdf.output.export.rgl import rgl_bsdf
from tests.support.command_line import QUICK, document, load_fit, printed, run, sentence
from tests.support.models import single_lobe
from tests.support.reproduced import assert_reproduced

pytestmark = pytest.mark.slow


def test_every_option_has_a_flag_with_help() -> None:
    text = " ".join(printed("fit", "--help").split())
    for name, told in sentences_of(dsbrdf.FitOptions).items():
        assert f" --{name.replace('_', '-')} " in text
        assert " ".join(told.split()[:4]) in text
        assert name in (dsbrdf.FitOptions.__doc__ or "") + (TableOptions.__doc__ or "")
    assert "[rad]" not in text
    assert "[default: 80]" in text


@pytest.mark.parametrize(
    ("words", "asked"),
    [
        ("--horizon-cutoff-deg=10 --knots-deg=10,20", {"horizon_cutoff_deg": 10, "knots_deg": (10, 20)}),
        ("--knots-deg auto --horizon-cutoff-deg none", {"horizon_cutoff_deg": None}),
        ("--n-lobes 2 --weighting log --robust", {"n_lobes": 2, "weighting": "log", "robust": True}),
        ("--lobe student --weighting auto --mask 0.5 --no-robust", {"lobe": "student", "mask": 0.5}),
    ],
)
def test_flags_reach_the_options(words: str, asked: dict[str, Any]) -> None:
    def options_of(*, flags: Flags = DEFAULT) -> dsbrdf.FitOptions:
        return flags.options()

    found = App(default_command=options_of, result_action="return_value")(words.split())
    assert found == dsbrdf.FitOptions(**asked)


@pytest.fixture
def two_files(plastic_file: Path, tmp_path: Path) -> list[str]:
    files = [tmp_path / "one.binary", tmp_path / "two.binary"]
    for file in files:
        shutil.copyfile(plastic_file, file)
    return [str(file) for file in files]


def test_every_warning_is_shown_once_and_json_is_a_stored_model(plastic_file: Path, tmp_path: Path) -> None:
    measured = tmp_path / "plastic.binary"
    measured.symlink_to(plastic_file)
    command = ["fit", str(measured), "--method", "paper", "--n-lobes", "1", "--em-iterations", "1"]
    captured = run(*command, "--json")
    answer = json.loads(captured.stdout)
    sentences = answer["warnings"]
    assert "stopped after 1 iterations" in sentences[0]
    assert (sentences, captured.stderr) == ([found["sentence"] for found in answer["findings"]], "")
    assert answer["findings"][0]["code"] == "not-converged"
    (tmp_path / "printed.json").write_text(captured.stdout)
    labels = decompose(load(tmp_path / "printed.json")).labels
    assert [part["label"] for part in answer["components"]] == [*labels]
    assert (answer["status"], answer["metrics"]) == ("succeeded", answer["report"]["metrics"])
    shown = [f"warning: {sentence}" for sentence in sentences]
    file = tmp_path / "plastic.json"
    for words, last in (
        ([*command, "--force"], f"saved: {file}\n"),
        (command, f"saved: {file} (kept)\n"),
        ([*command, "-o", str(tmp_path / "out")], f"saved: {tmp_path / 'out' / 'plastic.json'}\n"),
        (["show", str(file)], "\n"),
    ):
        captured = run(*words)
        assert captured.stderr == ""
        assert captured.stdout.endswith(last)
        assert captured.stdout.splitlines()[1 : len(shown) + 1] == shown
        assert captured.stdout.count("warning: ") == len(shown)


def test_lost_fit_process_exits_with_1(monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(files: list[Path], *_: Any, **__: Any) -> Iterator[batch.FileFit]:
        yield batch.FileFit(files[0], error="the process died", lost=True)
        yield batch.FileFit(files[1], error="no measurement")

    monkeypatch.setattr(fit_command, "fit_files", lost)
    captured = run("fit", "a.binary", "b.binary", code=1)
    assert captured.stderr == "dsbrdf: a.binary: the process died\ndsbrdf: b.binary: no measurement\n"


def test_folder_argument_means_its_binary_files(plastic_file: Path, tmp_path: Path) -> None:
    folder = tmp_path / "materials"
    folder.mkdir()
    assert "contains no .binary file" in sentence("fit", folder)
    (folder / "a.binary").symlink_to(plastic_file)
    (folder / "notes.txt").write_text("not a measurement")
    assert [item["file"] for item in document("fit", folder, "--json", *QUICK)["items"]] == [str(folder / "a.binary")]


def test_second_run_keeps_the_stored_fits_of_these_files_and_options(
    two_files: list[str], plastic_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run("fit", plastic_file, "-o", tmp_path, *QUICK)
    stored_fit = tmp_path / "plastic.json"
    monkeypatch.setattr(local.LocalEngine, "submit", lambda *_: 1 // 0)  # instead of a fit
    one, two = (tmp_path / "out" / name for name in ("one.json", "two.json"))
    command = ["fit", *two_files, "-o", str(one.parent), "--json", *QUICK]
    one.parent.mkdir()
    shutil.copyfile(stored_fit, two)
    damaged = stored_fit.read_bytes()[:-100]
    dsbrdf.save(load_fit(stored_fit).model, without_report := tmp_path / "plain.json")
    for stored in (damaged, without_report.read_bytes(), stored_fit.read_bytes()):
        with pytest.raises(ZeroDivisionError):
            run(*command)
        one.write_bytes(stored)
    for item in document(*command)["items"]:
        assert item["resumed"] is True
        assert item["model"] == json.loads(stored_fit.read_text())["model"]
    for words in (["--weighting", "cosine"], ["--force"]):
        with pytest.raises(ZeroDivisionError):
            run(*command, *words)
    before, after = (one.stat().st_mtime + shift for shift in (-10, 10))
    os.utime(two_files[0], (after, after))
    with pytest.raises(ZeroDivisionError):
        run(*command)
    os.utime(two_files[0], (before, before))
    monkeypatch.setattr(batch, "ALGORITHM_VERSION", "another")
    with pytest.raises(ZeroDivisionError):
        run(*command)


def test_full_disk_exits_with_1(plastic_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(batch, "write_atomically", full)
    assert "No space left on device" in sentence("fit", plastic_file, "-o", tmp_path, *QUICK, code=1)


def test_several_files_end_with_a_table_worst_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good = load_fit(Path(__file__).parents[2] / "project/stored/1.0/plastic.json")
    metrics = replace(good.report.metrics, relative_rms=0.9)
    worse = replace(good.report, metrics=metrics, findings_of_fit=(Finding("look", "Look at it."),))
    bad = FitResult(single_lobe(5.0, 20.0, center=0.2), worse)

    def known(files: list[Path], *_: Any, **__: Any) -> Iterator[FileFit]:
        yield FileFit(files[0], result=good)
        yield FileFit(files[1], error="no measurement")
        yield FileFit(files[2], result=bad)

    monkeypatch.setattr(fit_command, "fit_files", known)
    monkeypatch.setenv("COLUMNS", "100")
    command, table = ["fit", "good.binary", "none.binary", "bad.binary"], tmp_path / "fits.csv"
    captured = run(*command, "--csv", table, code=2)
    texts = (captured.stdout, captured.stderr, table.read_text())
    assert_reproduced("commands/fit good.binary none.binary bad.binary", [text.splitlines() for text in texts], 1e-3)
    items = document(*command, "--json", code=2)["items"]
    asked = [("good.binary", "succeeded"), ("none.binary", "failed"), ("bad.binary", "succeeded")]
    assert [(item["file"], item["status"]) for item in items] == asked
    assert items[1]["error"] == "no measurement"


def test_server_that_does_not_answer_is_named(plastic_file: Path) -> None:
    said = sentence("fit", plastic_file, "--url", "http://127.0.0.1:9", code=1)
    nobody = "dsbrdf: nothing answers at http://127.0.0.1:9: is a service running there? dsbrdf serve starts one"
    assert said.startswith(nobody)


def test_a_measurement_becomes_a_bsdf_file_and_one_of_its_own_kind_a_copy(plastic_file: Path, tmp_path: Path) -> None:
    output = tmp_path / "plastic.bsdf"
    run("convert", plastic_file, output)
    assert parse_tensors(output.read_bytes())["rgb"].shape[2] == 3
    for source in (plastic_file, output):
        run("convert", source, tmp_path / f"copy{source.suffix}")
        assert (tmp_path / f"copy{source.suffix}").read_bytes() == source.read_bytes()
    run("convert", output, tmp_path / "spectral.bsdf", "--spectral")
    assert "spectra" in parse_tensors((tmp_path / "spectral.bsdf").read_bytes())


def test_an_rgl_file_becomes_a_merl_file_and_what_that_cannot_hold_is_told(tmp_path: Path) -> None:
    source, output = tmp_path / "paint.bsdf", tmp_path / "paint.binary"
    # One order of the directions is brighter than the other, and none begins beyond 72 degrees.
    fields = dict(parse_tensors(rgl_bsdf(single_lobe(1.0, 1.0, 0.2))))
    fields["rgb"] = (fields["rgb"] * (1.0 + 1.5 * fields["theta_i"])[:, None, None, None]).astype(np.float32)
    fields["theta_i"] = fields["theta_i"][:29]
    fields |= {name: fields[name][:, :29] for name in ("vndf", "luminance", "rgb")}
    source.write_bytes(encode_tensors(fields))
    answer = run("convert", source, output, "--json")
    assert "warning: " in answer.stderr
    rgl = read_rgl(source)
    assert 0.1 < json.loads(answer.stdout)["non_reciprocity"] == rgl.non_reciprocity()
    written = read_merl(output)
    nodes = tuple(np.mgrid[1:80:9, 0:80:5, 0:180:20].reshape(3, -1))
    angles = [axis[index] for axis, index in zip((THETA_HALF, THETA_DIFF, PHI_DIFF), nodes, strict=True)]
    cosines = np.array(incident_cosines(*angles))
    begins = (cosines > np.cos(fields["theta_i"][-1])) & (cosines.min(axis=0) > 1e-9)
    np.testing.assert_array_equal(written.valid[nodes], begins.any(axis=0))
    orders = [rgl.evaluate(angles[0], angles[1], angles[2] + turn) for turn in (0.0, np.pi)]
    found = np.stack([channel[nodes] for channel in written.values], axis=-1)
    for which in ((True, True), (True, False), (False, True)):
        at = np.all(begins.T == which, axis=1)
        assert at.sum() > 50
        expected = np.average(orders, axis=0, weights=which)[at]
        assert np.median(np.abs(found[at] / expected - 1.0)) < 1e-3
