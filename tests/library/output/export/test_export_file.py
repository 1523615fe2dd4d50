"""Files for other programs, read by these or by their syntax, and the surface of MaterialX, by its own shaders."""

import re
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType, SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest

import dsbrdf
from dsbrdf import FitReport, FitResult, InvalidArgumentError, decompose, parse_merl, render_sphere
from dsbrdf.arrays import Evaluate
from dsbrdf.components import DiffuseLayer, LayeredModel, SpecularLayer
from dsbrdf.data import half_difference
from dsbrdf.output import FORMATS, export_model
from dsbrdf.output.export import example, materialx
from dsbrdf.output.export.glsl import glsl_function
from dsbrdf.output.export.materialx import FoundSurface, fit_openpbr
from dsbrdf.output.export.openpbr import OpenPBR
from dsbrdf.rendering import LIGHTINGS, displayed, exposure, sphere_likeness, sphere_normals
from tests.support.models import mixture, pairs_of_directions, single_lobe
from tests.support.renderers import generated_function, materialx_document, mitsuba_variant, surface_of
from tests.support.reproduced import assert_reproduced
from tests.support.webgl import CHROMIUM, ShaderCall, evaluate_glsl

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("coarse_sampling")]

needs_materialx = pytest.mark.skipif(find_spec("MaterialX") is None, reason='"MaterialX" is not installed')
COATED = OpenPBR((0.6, 0.3, 0.1), 0.3, (0.9, 0.8, 0.5), specular_roughness=0.5, coat_weight=0.6, coat_roughness=0.25)
# About what a decomposition would say of it, not the surface itself.
COAT = SpecularLayer((0.03, 0.03, 0.03), 0.8, 0.08, 2.0, (0.0, 0.0), 0.0, 0.0)
BASE = SpecularLayer((0.15, 0.1, 0.05), 0.8, 0.3, 2.0, (0.0, 0.0), 0.0, 1.0)
LAYERS = LayeredModel((COAT, BASE, DiffuseLayer((0.3, 0.15, 0.05), (0.0,) * 6)))
MODEL = mixture(3, 0)


def document_of(found: FoundSurface) -> str:
    def known(evaluate: Evaluate, layers: LayeredModel) -> FoundSurface:
        assert (evaluate, layers) == (MODEL.evaluate, decompose(MODEL).layers)
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(materialx, "fit_openpbr", known)
        return export_model(MODEL, "materialx").decode()


@pytest.fixture(scope="module", autouse=True)
def small_spheres() -> Iterator[None]:
    """Let surfaces be fitted on smaller spheres, which takes half of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(materialx, "_FITTED_SPHERE_SIZES_PX", {"three_lights": 16, "environment": 8})
        yield


@pytest.fixture(scope="module")
def fitted(small_spheres: None) -> FoundSurface:
    return fit_openpbr(COATED.evaluate, LAYERS)


@needs_materialx
@pytest.mark.skipif(CHROMIUM is None, reason='"chromium" is not installed')
def test_values_are_those_of_the_shaders_of_materialx(tmp_path: Path) -> None:
    pairs = pairs_of_directions(512)  # 4 rows of pixels
    surfaces = COATED, replace(COATED, specular_ior=2.2, coat_weight=1.0)  # The base of the second one is the denser.
    documents = [materialx_document(document_of(FoundSurface(surface, {}, {}))) for surface in surfaces]
    first, second = (np.tile(side, (2, 1)) for side in pairs)
    call = ShaderCall(generated_function(*documents), "reflected(a, b, gl_FragCoord.y < 4.0 ? 0 : 1)", first, second)
    values = evaluate_glsl({"both": call}, tmp_path)["both"]
    for surface, found in zip(surfaces, np.split(values, 2), strict=True):
        expected = surface.evaluate(*half_difference(*pairs))
        error = np.abs(found - expected) / expected
        assert np.max(error) < 1e-3
        assert np.median(error) < 1e-5


def test_a_surface_is_found_again_and_the_error_is_that_of_the_spheres(fitted: FoundSurface) -> None:
    for lighting, stated in fitted.by_lighting.items():
        pair = [render_sphere(one, lighting=lighting) for one in (COATED, fitted.surface)]
        assert sphere_likeness(pair[0], pair[1])[0] == pytest.approx(stated)
        assert stated > 40.0


def test_a_dielectric_and_a_metal_are_found_without_a_mixture_of_both() -> None:
    plastic = OpenPBR((0.5, 0.2, 0.1), specular_roughness=0.3, specular_ior=1.5)
    surface = SpecularLayer((0.05, 0.05, 0.05), 0.8, 0.1, 2.0, (0.0, 0.0), 0.0, 0.0)
    layers = LayeredModel((surface, DiffuseLayer((0.4, 0.2, 0.1), (0.0,) * 6)))
    found = fit_openpbr(plastic.evaluate, layers).surface
    assert (found.base_metalness, found.specular_color, found.coat_weight) == (0.0, (1.0, 1.0, 1.0), 0.0)
    assert found.base_color == pytest.approx(plastic.base_color, abs=0.01)
    assert (found.specular_roughness, found.specular_ior) == pytest.approx((0.3, 1.5), abs=0.01)
    gold = OpenPBR((0.9, 0.6, 0.2), 1.0, (0.9, 0.9, 0.9), specular_roughness=0.4)
    layers = LayeredModel((SpecularLayer((0.8, 0.6, 0.3), 0.8, 0.2, 2.0, (0.0, 0.0), 0.0, 0.0),))
    found = fit_openpbr(gold.evaluate, layers).surface
    assert (found.base_metalness, found.coat_weight) == (1.0, 0.0)
    assert found.base_color == pytest.approx(gold.base_color, abs=0.01)
    assert found.specular_roughness == pytest.approx(0.4, abs=0.01)


def test_the_error_of_a_region_is_that_of_its_pixels(fitted: FoundSurface) -> None:
    squares = []
    for lighting in LIGHTINGS:
        wanted, seen = (render_sphere(one, lighting=lighting, size=128) for one in (COATED, fitted.surface))
        normals, mask = sphere_normals(128)
        factor = exposure(wanted, mask)
        beyond = np.degrees(np.arccos(normals[:, 2])) > 60.0
        squares.append((displayed(wanted, factor)[mask][beyond] - displayed(seen, factor)[mask][beyond]) ** 2)
    assert fitted.by_region["grazing"] == pytest.approx(-10.0 * np.log10(np.mean(squares)))
    assert min(fitted.by_region.values()) < min(fitted.by_lighting.values())
    assert max(fitted.by_region.values()) > max(fitted.by_lighting.values())


@needs_materialx
def test_the_document_is_valid_and_states_surface_and_error(fitted: FoundSurface) -> None:
    document = materialx_document(document_of(fitted))
    assert document.validate() == (True, "")
    for name, value in asdict(surface_of(document)).items():
        assert value == pytest.approx(getattr(fitted.surface, name), rel=1e-5)
    doc = document.getNode("dsbrdf_surface").getAttribute("doc")
    stated = fitted.by_lighting | fitted.by_region
    assert all(f"{value:.1f} dB ({name})" in doc for name, value in stated.items())
    assert [node.getCategory() for node in document.getMaterialNodes()] == ["surfacematerial"]


@needs_materialx
def test_two_documents_share_no_name_and_no_number_has_an_exponent(tmp_path: Path) -> None:
    faint = replace(COATED, base_color=(3.5e-12, 1.25e-5, 0.5))
    names = []
    for title in ("Satin purple (2)", "4e", "été"):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(materialx, "fit_openpbr", lambda *_: FoundSurface(faint, {}, {}))
            dsbrdf.export(MODEL, tmp_path / f"{title}.mtlx")
        text = (tmp_path / f"{title}.mtlx").read_text()
        assert 'value="0, 0.0000125, 0.5"' in text
        document = materialx_document(text)
        assert document.validate() == (True, "")
        names.append([node.getName() for node in document.getNodes()])
    assert names == [[f"{one}_surface", one] for one in ("Satin_purple_2", "material_4e", "t")]


@pytest.mark.parametrize("suffix", ["json", "binary", "glsl", "py", "brdf", "csv", "bsdf"])
def test_the_suffix_tells_the_format(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"paint.{suffix.upper()}"
    dsbrdf.export(MODEL, path)
    name = next(name for name, kind in FORMATS.items() if kind.suffix == suffix)
    assert path.read_bytes() == export_model(MODEL, name)


def test_a_result_is_exported_with_its_report_and_a_component_as_one(report: FitReport, tmp_path: Path) -> None:
    result = FitResult(MODEL, report)
    dsbrdf.export(result, tmp_path / "paint.json")
    assert dsbrdf.load(tmp_path / "paint.json") == result
    dsbrdf.export(result, tmp_path / "paint.txt", "glsl")
    assert "vec3 dsbrdf(" in (tmp_path / "paint.txt").read_text()
    dsbrdf.export(decompose(MODEL)["diffuse"], tmp_path / "lobe.glsl")
    assert "This is a component" in (tmp_path / "lobe.glsl").read_text()


def test_layers_are_values_in_the_formats_that_hold_values() -> None:
    table = parse_merl(export_model(LAYERS, "merl"))
    np.testing.assert_allclose(table.values[:, 10, 20, 30], LAYERS.evaluate(*np.radians([10 / 9, 20.0, 30.0])))


OF_LOBES = ("json", "csv", "materialx")
NO_NAMES = ("", "2nd", "gl_paint", "a__b", "paint_", "flat", "a-b", "é", "p" * 65)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: dsbrdf.export(MODEL, "paint.obj"), r"paint\.obj: the file must end in one of .*\.json, .*\.mtlx"),
        *((lambda name=name: export_model(decompose(MODEL)["diffuse"], name), f"{name} cannot") for name in OF_LOBES),
        *((lambda name=name: export_model(MODEL, "glsl", name=name), "must begin with a letter") for name in NO_NAMES),
        (lambda: glsl_function(single_lobe(1.0, 1.0, 1e39)), "too large for GLSL"),
        (lambda: export_model(single_lobe(1.0, 1.0, 1e200), "materialx"), "too large for a picture"),
        (lambda: export_model(MODEL, "csv", sampling=True), "sampling are options of the format glsl, not of csv"),
        (lambda: example(Path("a.csv"), "csv", b"", ""), "example for glsl, bsdf, bsdf-spectral or materialx, not"),
    ],
)
def test_what_cannot_be_exported_is_refused(call: Callable[[], object], said: str) -> None:
    with pytest.raises(InvalidArgumentError, match=said):
        call()


def test_every_name_begins_with_that_of_the_function() -> None:
    for source in (
        export_model(MODEL, "glsl", name="paint", sampling=True).decode(),
        glsl_function(decompose(MODEL)["diffuse"], "paint", sampling=True),
        glsl_function(decompose(MODEL).layers, "paint", sampling=True),
    ):
        declared = re.findall(r"^(?:const )?(?:void|int|float|vec[234]|struct|paint\w+) (\w+)", source, re.MULTILINE)
        assert len(declared) > 8
        assert all(re.match(r"paint(_|$)", name) for name in declared)
        assert "dsbrdf" not in source.partition("\n")[2]


MATERIALX = b"""<materialx><open_pbr_surface name="a_surface">
<input name="base_color" value="0.5, 0.25, 0.125"/><input name="base_metalness" value="0.75"/>
<input name="specular_color" value="1, 1, 1"/><input name="specular_roughness" value="0.2"/>
<input name="specular_ior" value="1.5"/><input name="coat_weight" value="0"/><input name="coat_roughness" value="0.1"/>
<input name="coat_ior" value="1.6"/></open_pbr_surface><surfacematerial name="a"/></materialx>"""


def written(folder: Path, file: str, file_format: str, content: bytes, name: str = "dsbrdf") -> Path:
    (folder / file).write_bytes(content)
    path, text = example(folder / file, file_format, content, name)
    path.write_bytes(text)
    return path


@pytest.mark.skipif(CHROMIUM is None, reason='"chromium" is not installed')
def test_the_page_shades_with_the_function(tmp_path: Path) -> None:
    """The shader of the page, with its inputs as variables and the normal along the z axis."""
    to_light, to_camera = pairs_of_directions(2000)
    calls = {}
    for name, source in (("coat", MODEL), ("layers", decompose(MODEL).layers)):
        content = export_model(source, "glsl", name=name)
        page = written(tmp_path, f"{name}.glsl", "glsl", content, name).read_text()
        shader = page.partition('<script id="fragment" type="x-shader">')[2].partition("</script>")[0]
        shader = re.sub(r"^(in|uniform|out) ", "", shader, flags=re.MULTILINE).replace("vec4 color", "vec4 shaded")
        shader = shader.replace("color = vec4(mix", "shaded = vec4(mix").replace("void main", "void shade")
        assign = "seenNormal = vec3(0.0, 0.0, 1.0); seenPlace = -b; light = a; shade(); return shaded.rgb;"
        shader += f"vec3 shown(vec3 a, vec3 b) {{ {assign} }}"
        calls[name] = ShaderCall(shader, "shown(a, b)", to_light, to_camera)
    found = evaluate_glsl(calls, tmp_path)
    values = MODEL.evaluate(*half_difference(to_light, to_camera))
    expected = displayed(3.0 * values * to_light[:, 2:], 1.0)
    assert np.abs(np.minimum(found["coat"], 1.0) - expected).max() < 1e-3
    assert np.abs(np.minimum(found["layers"], 1.0) - expected).mean() < 0.1


def test_mitsuba_draws_the_scene(tmp_path: Path) -> None:
    mitsuba: ModuleType = mitsuba_variant("scalar_rgb")
    scene = mitsuba.load_file(str(written(tmp_path, 'a "&" b.bsdf', "bsdf", export_model(MODEL, "bsdf"))))
    picture = np.array(mitsuba.render(scene, spp=1))[..., :3]
    assert picture.shape == (256, 256, 3)
    sphere = picture[64:192, 64:192]
    assert np.isfinite(sphere).all()
    assert sphere.std() > 0.01


def test_the_scene_of_pbrt_has_the_table_as_its_material(tmp_path: Path) -> None:
    scene = written(tmp_path, "FILE grün.bsdf", "bsdf-spectral", b"").read_text("utf-8")
    assert_reproduced("exports/scene of pbrt", scene.splitlines())


def test_the_script_for_blender_sets_the_inputs(tmp_path: Path) -> None:
    script = written(tmp_path, "a.mtlx", "materialx", MATERIALX)
    blender, inputs = MagicMock(), defaultdict[str, SimpleNamespace](SimpleNamespace)
    blender.data.materials.new.return_value.node_tree.nodes = {"Principled BSDF": SimpleNamespace(inputs=inputs)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(__import__("sys").modules, "bpy", blender)
        exec(compile(script.read_text(), str(script), "exec"), {"__file__": str(script)})
    blender.data.materials.new.assert_called_once_with("a")
    assert inputs["Base Color"].default_value == (0.5, 0.25, 0.125, 1.0)
    expected = {"Metallic": 0.75, "Coat Weight": 0.0, "Coat Roughness": 0.1, "Coat IOR": 1.6}
    assert {name: inputs[name].default_value for name in expected} == expected
