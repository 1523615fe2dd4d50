import csv
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

import dsbrdf
from dsbrdf.data.grid import CHANNELS
from dsbrdf.data.merl import parse_merl
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.decomposition import LABELS, decompose
from dsbrdf.output.export import FORMATS, GUIDE, PARTS, export_model, part_of
from dsbrdf.output.serialize import from_json
from tests.support.mixtures import mixture, scattered_samples
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


def test_a_result_is_exported_with_its_report_and_a_component_as_one(tmp_path: Path) -> None:
    result = dsbrdf.fit(scattered_samples(MODEL, 300), n_lobes=1, ring_lobes=0)
    result.export(tmp_path / "paint.json")
    assert dsbrdf.load_result(tmp_path / "paint.json").report.metrics == result.report.metrics
    result.export(tmp_path / "paint.txt", "glsl")
    assert "vec3 dsbrdf(" in (tmp_path / "paint.txt").read_text()
    dsbrdf.export(next(iter(dsbrdf.decompose(MODEL))), tmp_path / "lobe.glsl")
    assert "This is a component" in (tmp_path / "lobe.glsl").read_text()


def test_an_unknown_suffix_is_one_sentence_that_lists_the_others(tmp_path: Path) -> None:
    with pytest.raises(InvalidArgumentError, match=r"paint\.obj: the file must end in one of \.json, \.npz, \.binary"):
        dsbrdf.export(MODEL, tmp_path / "paint.obj")
    with pytest.raises(InvalidArgumentError, match=r"unlike 'paint\.glsl'; dsbrdf\.export writes other kinds"):
        dsbrdf.save(MODEL, tmp_path / "paint.glsl")
    assert list(tmp_path.iterdir()) == []


QUICK = ("json", "npz", "glsl", "brdf", "csv")


def test_tables_of_components_add_up_to_that_of_the_model() -> None:
    tables = [parse_merl(export_model(part, "merl")).values for part in (MODEL, *decompose(MODEL))]
    whole, *parts = (np.nan_to_num(table) for table in tables)
    assert len(parts) == 2
    assert all(part.max() > 0.01 for part in parts)
    np.testing.assert_allclose(sum(parts), whole, rtol=1e-9)


@pytest.mark.parametrize("file_format", ["json", "npz", "csv", "materialx"])
def test_a_format_of_lobes_refuses_a_component(file_format: str) -> None:
    said = rf"^{file_format} cannot hold a component.* merl, glsl, brdf, bsdf or bsdf-spectral, or export the guide"
    with pytest.raises(InvalidArgumentError, match=said):
        export_model(decompose(MODEL)["diffuse"], file_format)


def test_the_guide_is_stored_as_a_model() -> None:
    guide, report = from_json(export_model(part_of(MODEL, GUIDE), "json").decode())
    assert report is None
    assert guide == decompose(MODEL).guide
    at = np.radians([0.0, 5.0, 40.0]), np.radians([0.0, 30.0, 30.0])
    np.testing.assert_allclose(guide.evaluate(*at), sum(part.lobe.evaluate(*at) for part in decompose(MODEL)))


@pytest.mark.parametrize("file_format", QUICK)
def test_a_format_takes_the_guide(file_format: str) -> None:
    assert export_model(part_of(MODEL, GUIDE), file_format) != export_model(MODEL, file_format)


def test_parts_are_those_of_the_decomposition() -> None:
    assert PARTS == (*LABELS, "guide")
    assert part_of(MODEL, None) is MODEL
    assert part_of(MODEL, "diffuse") is decompose(MODEL).diffuse
    (absent,) = set(LABELS) - set(decompose(MODEL).labels)
    with pytest.raises(InvalidArgumentError, match=f"this model has no component {absent}: it has"):
        part_of(MODEL, absent)
