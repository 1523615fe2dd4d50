"""The MaterialX file: valid for the library, and the surface in it is what the library's own shaders compute."""

import importlib.util
from dataclasses import asdict

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf.arrays import Evaluate
from dsbrdf.data.geometry import half_difference
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.render import render_sphere, sphere_likeness
from dsbrdf.output.export import export_model, materialx
from dsbrdf.output.export.materialx import FittedSurface, fit_openpbr
from dsbrdf.output.export.openpbr import OpenPBR
from tests.support.known_models import pairs_of_directions, single_lobe
from tests.support.materialx_shader import generated_function, materialx_document, surface_of
from tests.support.mixtures import mixture
from tests.support.webgl import CHROMIUM, ShaderCall, evaluate_glsl

Array = NDArray[np.float64]

needs_materialx = pytest.mark.skipif(
    importlib.util.find_spec("MaterialX") is None, reason='"MaterialX" is not installed'
)
COATED = OpenPBR(
    (0.6, 0.3, 0.1), 0.3, 0.7, (0.9, 0.8, 0.5), specular_roughness=0.5, coat_weight=0.6, coat_roughness=0.25
)
SURFACES = {
    "coated mixture of both": COATED,
    "of less index than air": OpenPBR((0.4, 0.4, 0.4), specular_ior=0.8, specular_roughness=0.4),
}
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


@pytest.fixture(scope="module")
def values(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Array]:
    """What the shaders of MaterialX compute for each surface."""
    pairs = pairs_of_directions(2000)
    documents = {name: materialx_document(document_of(FittedSurface(one, {}))) for name, one in SURFACES.items()}
    calls = {
        name: ShaderCall(generated_function(document), "reflected(a, b)", *pairs)
        for name, document in documents.items()
    }
    return evaluate_glsl(calls, tmp_path_factory.mktemp("materialx"))


@needs_materialx
@pytest.mark.skipif(CHROMIUM is None, reason='"chromium" is not installed')
@pytest.mark.parametrize("name", SURFACES)
def test_values_are_those_of_the_shaders_of_materialx(name: str, values: dict[str, Array]) -> None:
    expected = SURFACES[name].evaluate(*half_difference(*pairs_of_directions(2000)))
    error = np.abs(values[name] - expected) / expected
    assert np.max(error) < 1e-3
    assert np.median(error) < 1e-5


def test_a_surface_is_found_again_and_the_error_is_that_of_the_spheres(fitted: FittedSurface) -> None:
    for lighting, stated in fitted.psnr.items():
        pair = [render_sphere(one, lighting=lighting) for one in (COATED, fitted.surface)]
        assert sphere_likeness(pair[0], pair[1])[0] == pytest.approx(stated)
        assert stated > 40.0


@needs_materialx
def test_the_document_is_valid_and_states_surface_and_error(fitted: FittedSurface) -> None:
    document = materialx_document(document_of(fitted))
    assert document.validate() == (True, "")
    for name, value in asdict(surface_of(document)).items():
        assert value == pytest.approx(getattr(fitted.surface, name), rel=1e-5)
    doc = document.getNode("dsbrdf_surface").getAttribute("doc")
    assert all(f"{psnr:.1f} dB ({lighting})" in doc for lighting, psnr in fitted.psnr.items())
    assert [node.getCategory() for node in document.getMaterialNodes()] == ["surfacematerial"]


def test_a_model_too_bright_for_a_picture_is_refused_and_nothing_is_reflected_below_the_horizon() -> None:
    with pytest.raises(InvalidArgumentError, match="too large for a picture"):
        export_model(single_lobe(1.0, 1.0, 1e200), "materialx")
    assert np.all(COATED.evaluate(*np.radians([[60.0], [60.0], [0.0]])) == 0.0)
