"""What `dsbrdf export --example` writes, read by its program or, where that is not here, by its syntax."""

import re
import shlex
from collections import defaultdict
from pathlib import Path
from types import ModuleType, SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest

from dsbrdf import InvalidArgumentError, decompose
from dsbrdf.data import half_difference
from dsbrdf.output import export_model
from dsbrdf.output.export import example
from dsbrdf.rendering import displayed
from tests.support.known_models import MODELS, pairs_of_directions
from tests.support.mitsuba_variants import mitsuba_variant
from tests.support.webgl import CHROMIUM, ShaderCall, evaluate_glsl

MODEL = MODELS["mixture"]
MATERIALX = b"""<materialx><open_pbr_surface name="a_surface">
<input name="base_color" value="0.5, 0.25, 0.125"/><input name="base_metalness" value="0.75"/>
<input name="specular_color" value="1, 1, 1"/><input name="specular_roughness" value="0.2"/>
<input name="specular_ior" value="1.5"/><input name="coat_weight" value="0"/><input name="coat_roughness" value="0.1"/>
<input name="coat_ior" value="1.6"/></open_pbr_surface><surfacematerial name="a"/></materialx>"""


def written(folder: Path, file: str, file_format: str, content: bytes, name: str = "dsbrdf") -> Path:
    """Write a file and its example, and return the example."""
    (folder / file).write_bytes(content)
    path, text = example(folder / file, file_format, content, name)
    path.write_bytes(text)
    return path


@pytest.mark.slow
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
        calls[name] = ShaderCall(
            shader + f"vec3 shown(vec3 a, vec3 b) {{ {assign} }}", "shown(a, b)", to_light, to_camera
        )
    found = evaluate_glsl(calls, tmp_path)
    values = MODEL.evaluate(*half_difference(to_light, to_camera))
    expected = displayed(3.0 * values * to_light[:, 2:], 1.0)
    assert np.abs(np.minimum(found["coat"], 1.0) - expected).max() < 1e-3
    assert np.abs(np.minimum(found["layers"], 1.0) - expected).mean() < 0.1


@pytest.mark.slow
def test_mitsuba_draws_the_scene(tmp_path: Path) -> None:
    mitsuba: ModuleType = mitsuba_variant("scalar_rgb")
    scene = mitsuba.load_file(str(written(tmp_path, 'a "&" b.bsdf', "bsdf", export_model(MODEL, "bsdf"))))
    picture = np.array(mitsuba.render(scene, spp=1))[..., :3]
    assert picture.shape == (256, 256, 3)
    sphere = picture[64:192, 64:192]
    assert np.isfinite(sphere).all()
    assert sphere.std() > 0.01


ARGUMENTS = {"Scale": 3, "LookAt": 9, "Translate": 3}
PARAMETER = re.compile(r"(?:(float|integer) (\w+)|rgb L|string filename)")


def test_the_scene_of_pbrt_is_directives_with_their_arguments(tmp_path: Path) -> None:
    """By the grammar of pbrt-v4: numbers after a transformation, else a type and pairs of parameter and values."""
    text = written(tmp_path, "a.bsdf", "bsdf-spectral", b"").read_text()
    words = shlex.split(re.sub(r"[\[\]]", " ", text), comments=True)
    starts = [i for i, word in enumerate(words) if re.fullmatch(r"[A-Z][A-Za-z]+", word)]
    directives = [words[i:j] for i, j in zip(starts, [*starts[1:], None], strict=True)]
    names = [directive[0] for directive in directives]
    assert names.index("Camera") < names.index("WorldBegin") < names.index("LightSource") < names.index("Material")
    assert names.count("AttributeBegin") == names.count("AttributeEnd") == 1
    for name, *rest in directives:
        if name in ARGUMENTS:
            assert len([float(number) for number in rest]) == ARGUMENTS[name]
        elif rest:
            counts = [
                3 if parameter.startswith("rgb") else 1 for parameter in rest[1:] if PARAMETER.fullmatch(parameter)
            ]
            assert len(rest) == 1 + sum(counts) + len(counts)
    assert ["Material", "measured", "string filename", "a.bsdf"] in directives


def test_the_script_for_blender_sets_the_inputs(tmp_path: Path) -> None:
    script = written(tmp_path, "a.mtlx", "materialx", MATERIALX)
    blender, inputs = MagicMock(), defaultdict[str, SimpleNamespace](SimpleNamespace)
    blender.data.materials.new.return_value.node_tree.nodes = {"Principled BSDF": SimpleNamespace(inputs=inputs)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(__import__("sys").modules, "bpy", blender)
        exec(compile(script.read_text(), str(script), "exec"), {"__file__": str(script)})
    blender.data.materials.new.assert_called_once_with("a")
    assert inputs["Base Color"].default_value == (0.5, 0.25, 0.125, 1.0)
    assert {name: one.default_value for name, one in inputs.items() if "Coat" in name or name == "Metallic"} == {
        "Metallic": 0.75,
        "Coat Weight": 0.0,
        "Coat Roughness": 0.1,
        "Coat IOR": 1.6,
    }


def test_a_format_without_an_example_says_which_have_one(tmp_path: Path) -> None:
    with pytest.raises(
        InvalidArgumentError, match=r"an example for glsl, bsdf, bsdf-spectral or materialx, not for csv"
    ):
        example(tmp_path / "a.csv", "csv", b"", "dsbrdf")
