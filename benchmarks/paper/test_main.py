"""The command: a figure is made, and what is wrong with the input is told."""

from pathlib import Path

import pytest

from benchmarks.paper import __main__ as command
from benchmarks.paper import materials
from benchmarks.paper.materials import Material
from dsbrdf import FitResult


def test_unreadable_measurement_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.binary").touch()
    assert command.main(["report", "--data", str(tmp_path), "-o", str(tmp_path / "out"), "--jobs", "1"]) == 2
    error = capsys.readouterr().err
    assert "figure4 needs at least 1 material, not 0; " in error
    assert "bad.binary" in error


def test_figure_is_made_and_its_numbers_are_told(
    material: Material,
    quick_fits: dict[str, FitResult],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(materials, "fit_quietly", lambda *_: quick_fits["paper-3"])
    data, out = str(material.file.parent), tmp_path / "out"
    assert command.main(["figure1", "--data", data, "-o", str(out), "--materials", "plastic", "--jobs", "1"]) == 0
    told = capsys.readouterr().out
    assert all(claim in told for claim in ("agrees", "Each lobe clearly captures"))
    assert sorted(path.name for path in out.iterdir()) == ["figure1.csv", "figure1.png", "figure1.svg", "kept"]
    assert str(out / "figure1") in told
