"""Exports by the suffix of a file's name."""

from pathlib import Path

import pytest

import dsbrdf
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.report import FitResult
from dsbrdf.output.export import FORMATS, export_model
from tests.support.mixtures import mixture, scattered_samples

MODEL = mixture(1, 0)
SUFFIXES = {"json", "npz", "binary", "glsl", "brdf", "csv", "bsdf"}


@pytest.mark.parametrize("suffix", sorted(SUFFIXES))
def test_the_suffix_tells_the_format(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"paint.{suffix.upper()}"
    dsbrdf.export(MODEL, path)
    name = next(name for name, kind in FORMATS.items() if kind.suffix == suffix)
    assert path.read_bytes() == export_model(MODEL, name)


def test_a_result_is_exported_with_its_report(tmp_path: Path) -> None:
    result = dsbrdf.fit(scattered_samples(MODEL, 300), n_lobes=1, ring_lobes=0)
    result.export(tmp_path / "paint.json")
    assert dsbrdf.load_result(tmp_path / "paint.json").report.metrics == result.report.metrics
    assert isinstance(result, FitResult)
    result.export(tmp_path / "paint.txt", "glsl")
    assert "vec3 dsbrdf(" in (tmp_path / "paint.txt").read_text()


def test_a_component_is_exported(tmp_path: Path) -> None:
    dsbrdf.export(next(iter(dsbrdf.decompose(MODEL))), tmp_path / "lobe.glsl")
    assert "This is a component" in (tmp_path / "lobe.glsl").read_text()


def test_an_unknown_suffix_is_one_sentence_that_lists_the_others(tmp_path: Path) -> None:
    with pytest.raises(InvalidArgumentError, match=r"paint\.obj: the file must end in one of \.json, \.npz, \.binary"):
        dsbrdf.export(MODEL, tmp_path / "paint.obj")
    with pytest.raises(InvalidArgumentError, match=r"unlike 'paint\.glsl'; dsbrdf\.export writes other kinds"):
        dsbrdf.save(MODEL, tmp_path / "paint.glsl")
    assert list(tmp_path.iterdir()) == []
