"""Files for other programs, and the surface of MaterialX: it is what the library's own shaders compute."""

import csv
import importlib.util
from dataclasses import asdict
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

import dsbrdf
from dsbrdf.arrays import Evaluate
from dsbrdf.data.geometry import half_difference
from dsbrdf.data.grid import CHANNELS
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.decomposition import decompose
from dsbrdf.fitting.report import FitReport, FitResult
from dsbrdf.model.render import render_sphere, sphere_likeness
from dsbrdf.output.export import FORMATS, export_model, materialx
from dsbrdf.output.export.materialx import fit_openpbr
from dsbrdf.output.export.openpbr import OpenPBR
from tests.support.known_models import pairs_of_directions, single_lobe
from tests.support.materialx_shader import generated_function, materialx_document, surface_of
from tests.support.mixtures import mixture
from tests.support.random_models import papers_model
from tests.support.webgl import CHROMIUM, ShaderCall, evaluate_glsl

pytestmark = pytest.mark.slow

FittedSurface = tuple[OpenPBR, dict[str, float]]

needs_materialx = pytest.mark.skipif(
    importlib.util.find_spec("MaterialX") is None, reason='"MaterialX" is not installed'
)
COATED = OpenPBR(
    (0.6, 0.3, 0.1), 0.3, 0.7, (0.9, 0.8, 0.5), specular_roughness=0.5, coat_weight=0.6, coat_roughness=0.25
)
MODEL = mixture(3, 0)


def document_of(found: FittedSurface) -> str:
    """The document of a model for which a surface has been found."""

    def known(evaluate: Evaluate) -> FittedSurface:
        assert evaluate == MODEL.evaluate
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(materialx, "fit_openpbr", known)
        return export_model(MODEL, "materialx").decode()


@pytest.fixture(scope="module")
def fitted() -> FittedSurface:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(materialx, "_POLISHED", 1)  # the best start alone, which takes half the time
        return fit_openpbr(COATED.evaluate)


@needs_materialx
@pytest.mark.skipif(CHROMIUM is None, reason='"chromium" is not installed')
def test_values_are_those_of_the_shaders_of_materialx(tmp_path: Path) -> None:
    pairs = pairs_of_directions(2000)
    shader = generated_function(materialx_document(document_of((COATED, {}))))
    (values,) = evaluate_glsl({"coated": ShaderCall(shader, "reflected(a, b)", *pairs)}, tmp_path).values()
    expected = COATED.evaluate(*half_difference(*pairs))
    error = np.abs(values - expected) / expected
    assert np.max(error) < 1e-3
    assert np.median(error) < 1e-5


def test_a_surface_is_found_again_and_the_error_is_that_of_the_spheres(fitted: FittedSurface) -> None:
    surface, psnr = fitted
    for lighting, stated in psnr.items():
        pair = [render_sphere(one, lighting=lighting) for one in (COATED, surface)]
        assert sphere_likeness(pair[0], pair[1])[0] == pytest.approx(stated)
        assert stated > 40.0


@needs_materialx
def test_the_document_is_valid_and_states_surface_and_error(fitted: FittedSurface) -> None:
    document, (surface, psnr) = materialx_document(document_of(fitted)), fitted
    assert document.validate() == (True, "")
    for name, value in asdict(surface_of(document)).items():
        assert value == pytest.approx(getattr(surface, name), rel=1e-5)
    doc = document.getNode("dsbrdf_surface").getAttribute("doc")
    assert all(f"{stated:.1f} dB ({lighting})" in doc for lighting, stated in psnr.items())
    assert [node.getCategory() for node in document.getMaterialNodes()] == ["surfacematerial"]


def test_a_model_too_bright_for_a_picture_is_refused_and_nothing_is_reflected_below_the_horizon() -> None:
    with pytest.raises(InvalidArgumentError, match="too large for a picture"):
        export_model(single_lobe(1.0, 1.0, 1e200), "materialx")
    assert np.all(COATED.evaluate(*np.radians([[60.0], [60.0], [0.0]])) == 0.0)


@pytest.mark.parametrize("suffix", ["json", "binary", "glsl", "brdf", "csv", "bsdf"])
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
    dsbrdf.export(decompose(MODEL)["diffuse"], tmp_path / "lobe.glsl")
    assert "This is a component" in (tmp_path / "lobe.glsl").read_text()


def test_an_unknown_suffix_is_one_sentence_that_lists_the_others(tmp_path: Path) -> None:
    with pytest.raises(InvalidArgumentError, match=r"paint\.obj: the file must end in one of \.json, \.binary"):
        dsbrdf.export(MODEL, tmp_path / "paint.obj")
    assert list(tmp_path.iterdir()) == []


def test_a_format_of_lobes_refuses_a_component() -> None:
    part = decompose(MODEL)["diffuse"]
    for name in ("json", "csv", "materialx"):
        said = rf"^{name} cannot hold a component.* merl, glsl, brdf, bsdf or bsdf-spectral, or export the layers"
        with pytest.raises(InvalidArgumentError, match=said):
            export_model(part, name)
