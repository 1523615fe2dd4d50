import errno
import json
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import dsbrdf
from dsbrdf.cli import fit_command
from dsbrdf.engines import batch, local
from dsbrdf.output.serialize import load
from tests.support.command_line import QUICK, document, run, sentence


@pytest.fixture
def two_files(plastic_file: Path, tmp_path: Path) -> list[str]:
    files = [tmp_path / "one.binary", tmp_path / "two.binary"]
    for file in files:
        shutil.copyfile(plastic_file, file)
    return [str(file) for file in files]


@pytest.fixture(scope="module")
def stored_fit(plastic_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the command stores for the plastic; tests must not change it."""
    folder = tmp_path_factory.mktemp("stored")
    run("fit", plastic_file, "-o", folder, *QUICK)
    return folder / "plastic.json"


def test_every_warning_is_shown_once(plastic_file: Path, tmp_path: Path) -> None:
    command = ["fit", str(plastic_file), "--method", "paper", "--n-lobes", "1", "--em-iterations", "1"]
    captured = run(*command, "--json")
    answer = json.loads(captured.stdout)
    sentences = answer["warnings"]
    assert "stopped at the bound of 1 iterations" in sentences[0]
    assert (sentences, captured.stderr) == (answer["report"]["warnings"], "")
    shown = [f"warning: {sentence}" for sentence in sentences]
    file = tmp_path / "plastic.json"
    fit = [*command, "-o", str(tmp_path)]
    for words, last in ((fit, f"saved: {file}\n"), (fit, "plastic.json (kept)\n"), (["show", str(file)], "\n")):
        captured = run(*words)
        assert captured.stderr == ""
        assert captured.stdout.endswith(last)
        assert captured.stdout.splitlines()[1 : len(shown) + 1] == shown
        assert captured.stdout.count("warning: ") == len(shown)


def test_fit_json_is_a_stored_model(plastic_file: Path, tmp_path: Path) -> None:
    answer = document("fit", plastic_file, "--json", *QUICK)
    stored = tmp_path / "stored.json"
    stored.write_text(json.dumps(answer))
    assert load(stored).n_lobes == 1
    assert answer["status"] == "succeeded"
    assert answer["metrics"] == answer["report"]["metrics"]
    assert [part["label"] for part in answer["components"]] == list(dsbrdf.decompose(load(stored)).labels)


def test_one_bad_file_does_not_stop_the_others(plastic_file: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.binary"
    cut.write_bytes(plastic_file.read_bytes()[:1000])
    captured = run("fit", cut, tmp_path / "none.binary", plastic_file, "-o", tmp_path / "out", *QUICK, code=2)
    first, second, *warnings = captured.stderr.splitlines()
    with pytest.raises(dsbrdf.MeasurementFormatError) as refusal:
        dsbrdf.read_merl(cut)
    assert first == f"dsbrdf: {cut}: {refusal.value}"
    assert second == f"dsbrdf: {tmp_path / 'none.binary'}: No such file or directory"
    assert all(line.startswith(f"dsbrdf: {plastic_file}: ") for line in warnings)
    assert re.match(r"plastic: strongly different \(.*\); 1 lobe; ", captured.stdout)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["plastic.json"]


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


def test_second_run_keeps_existing_results(
    two_files: list[str], stored_fit: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(local.LocalEngine, "start", None)  # nothing is to be computed
    (tmp_path / "out").mkdir()
    for name in ("one.json", "two.json"):
        shutil.copyfile(stored_fit, tmp_path / "out" / name)
    for item in document("fit", *two_files, "-o", tmp_path / "out", "--json", *QUICK)["items"]:
        assert item["resumed"] is True
        assert item["model"] == json.loads(stored_fit.read_text())["model"]


@pytest.mark.parametrize("reason", ["options", "force", "measurement", "damaged", "algorithm", "no report"])
def test_stored_fit_with_other_options_is_replaced(
    two_files: list[str],
    stored_fit: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    reason: str,
) -> None:
    output = tmp_path / "out" / "one.json"
    output.parent.mkdir()
    shutil.copyfile(stored_fit, output)
    command = ["fit", two_files[0], "-o", str(output.parent), "--json", *QUICK]
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
    assert document(*command)["resumed"] is False
    assert dsbrdf.load_result(output).report.versions.algorithm == dsbrdf.ALGORITHM_VERSION


def test_files_of_the_same_name_are_refused(two_files: list[str], tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    shutil.copyfile(two_files[0], tmp_path / "other/one.binary")
    assert "would both be written to" in sentence(
        "fit", two_files[0], tmp_path / "other/one.binary", "-o", tmp_path / "out"
    )


def test_full_disk_exits_with_1(plastic_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(batch, "save", full)
    assert "No space left on device" in sentence("fit", plastic_file, "-o", tmp_path, *QUICK, code=1)
