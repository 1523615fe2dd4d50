"""The command ``dsbrdf paper``."""

from pathlib import Path

import pytest

from dsbrdf.cli.main import main
from dsbrdf.data.merl import read_merl
from dsbrdf.fitting.options import FitOptions
from dsbrdf.paper import materials
from dsbrdf.paper.materials import fit_quietly


def test_unknown_figure_is_bad_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["paper", "figure7", "--data", str(tmp_path), "-o", str(tmp_path)]) == 2
    assert "figure7" in capsys.readouterr().err


def test_folder_without_measurements_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["paper", "figure1", "--data", str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err == (f"dsbrdf: {tmp_path} contains no .binary file; name a folder of measurements\n")


def test_unreadable_measurement_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.binary").touch()
    assert main(["paper", "report", "--data", str(tmp_path), "-o", str(tmp_path / "out"), "--jobs", "1"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("dsbrdf: figure4 needs at least 1 material, not 0; ")
    assert "bad.binary" in error


def test_figure_is_made_and_its_numbers_are_told(
    plastic_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = fit_quietly(read_merl(plastic_file), FitOptions(method="paper", n_lobes=3, em_iterations=1))
    monkeypatch.setattr(materials, "fit_quietly", lambda *_: quick)
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "plastic.binary").symlink_to(plastic_file)
    out = tmp_path / "out"
    assert main(["paper", "figure1", "--data", str(tmp_path / "data"), "-o", str(out), "--materials", "plastic"]) == 0
    told = capsys.readouterr().out
    assert all(claim in told for claim in ("agrees", "Each lobe clearly captures"))
    assert sorted(path.name for path in out.iterdir()) == ["figure1.csv", "figure1.png", "figure1.svg", "kept"]
    assert str(out / "figure1") in told
