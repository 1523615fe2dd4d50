import csv
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

import dsbrdf
from dsbrdf.data.grid import CHANNELS
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.decomposition import decompose
from dsbrdf.fitting.report import FitReport, FitResult
from dsbrdf.output.export import FORMATS, export_model
from tests.support.mixtures import mixture
from tests.support.random_models import papers_model

pytestmark = pytest.mark.usefixtures("coarse_sampling")
MODEL = mixture(2, 0)


@pytest.mark.parametrize("suffix", ["json", "npz", "binary", "glsl", "brdf", "csv", "bsdf"])
def test_the_suffix_tells_the_format(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"paint.{suffix.upper()}"
    dsbrdf.export(MODEL, path)
    name = next(name for name, kind in FORMATS.items() if kind.suffix == suffix)
    assert path.read_bytes() == export_model(MODEL, name)


@pytest.mark.parametrize("model", [mixture(3, 0), papers_model()], ids=["mixture", "paper"])
def test_rows_of_the_table_are_the_parameters(model: dsbrdf.DSBRDF) -> None:
    rows = list(csv.DictReader(StringIO(export_model(model, "csv").decode())))
    assert len(rows) == model.n_lobes * 3 * 19
    for row in rows[::7]:
        lobe, channel = int(row["lobe"]), CHANNELS.index(row["channel"])
        found = model.parameters_at([np.radians(float(row["theta_diff_deg"]))])
        for name in ("amplitude", "kappa", "gamma"):
            of_channel = min(channel, found[name].shape[1] - 1)
            assert float(row[name]) == pytest.approx(found[name][0, of_channel, lobe], rel=1e-7)
        assert float(row["elongation"]) == pytest.approx(found["elongation"][0, lobe], abs=1e-7)


def test_a_result_is_exported_with_its_report_and_a_component_as_one(report: FitReport, tmp_path: Path) -> None:
    result = FitResult(MODEL, report)
    result.export(tmp_path / "paint.json")
    assert dsbrdf.load_result(tmp_path / "paint.json") == result
    result.export(tmp_path / "paint.txt", "glsl")
    assert "vec3 dsbrdf(" in (tmp_path / "paint.txt").read_text()
    dsbrdf.export(dsbrdf.decompose(MODEL)["diffuse"], tmp_path / "lobe.glsl")
    assert "This is a component" in (tmp_path / "lobe.glsl").read_text()


def test_an_unknown_suffix_is_one_sentence_that_lists_the_others(tmp_path: Path) -> None:
    with pytest.raises(InvalidArgumentError, match=r"paint\.obj: the file must end in one of \.json, \.npz, \.binary"):
        dsbrdf.export(MODEL, tmp_path / "paint.obj")
    assert list(tmp_path.iterdir()) == []


def test_a_format_of_lobes_refuses_a_component() -> None:
    part = decompose(MODEL)["diffuse"]
    for name in ("json", "npz", "csv", "materialx"):
        said = rf"^{name} cannot hold a component.* merl, glsl, brdf, bsdf or bsdf-spectral, or export the guide"
        with pytest.raises(InvalidArgumentError, match=said):
            export_model(part, name)
