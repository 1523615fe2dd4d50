import re
from pathlib import Path

import numpy as np
import pytest

from dsbrdf.output.export import export_model
from tests.support.mixtures import mixture
from tests.support.webgl import CHROMIUM, ShaderCall, evaluate_glsl

MODEL = mixture(3, 0)
TEXT = export_model(MODEL, "brdf").decode()


def sections(text: str) -> dict[str, str]:
    """Sections by name, read as that program does: a line of the kind first, then blocks."""
    assert text.splitlines()[0] == "analytic"
    return dict(re.findall(r"^::begin (\w+)\n(.*?)^::end \1$", text, re.MULTILINE | re.DOTALL))


def test_sections_are_those_of_an_analytic_brdf() -> None:
    found = sections(TEXT)
    assert set(found) == {"parameters", "shader"}
    assert re.fullmatch(r"float scale [\d.]+ [\d.]+ 1\n", found["parameters"])
    assert "vec3 BRDF(vec3 L, vec3 V, vec3 N, vec3 X, vec3 Y)" in found["shader"]


@pytest.mark.skipif(CHROMIUM is None, reason='"chromium" is not installed')
def test_the_shader_gives_the_values_in_a_turned_frame(tmp_path: Path) -> None:
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    first, second = np.array([[0.6, 0.0, 0.8], [0.0, 0.28, 0.96]]), np.array([[-0.48, 0.36, 0.8], [0.0, 0.0, 1.0]])
    x, y, z = (f"vec3({', '.join(map(str, axis))})" for axis in turn.T.tolist())
    shader = "const float scale = 2.0;\n" + sections(TEXT)["shader"]
    call = ShaderCall(shader, f"BRDF(a, b, {z}, {x}, {y})", first @ turn.T, second @ turn.T)
    values = evaluate_glsl({"turned": call}, tmp_path)["turned"]
    np.testing.assert_allclose(values, 2.0 * MODEL.evaluate_directions(first, second), rtol=1e-3)
