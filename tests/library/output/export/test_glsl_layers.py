"""Layered models, and the components of models, as GLSL: run by WebGL 2, against the library in double precision."""

import numpy as np
import pytest

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import half_difference
from dsbrdf.fitting.decomposition import decompose
from dsbrdf.model.layers import DiffuseLayer, LayeredModel, RetroLayer, SheenLayer, SpecularLayer
from dsbrdf.output.export.glsl import glsl_function
from tests.support import known_models
from tests.support.mixtures import mixture
from tests.support.webgl import CHROMIUM, ShaderCall, evaluate_glsl

pytestmark = pytest.mark.slow

GROUND = DiffuseLayer((0.4, 0.2, 0.05), (0.7, 0.1, -0.2, 0.3, 0.5, -0.6))
COAT = SpecularLayer((0.04, 0.041, 0.042), 0.9, 0.05, 2.0, (0.2, -0.3), 0.4, 0.0)
METAL = SpecularLayer((0.9, 0.6, 0.3), 1.1, 0.3, 5.0, (-0.1, 0.2), 0.8, 1.0)
MODELS = {
    "dielectric over diffuse": LayeredModel((COAT, GROUND)),
    "coat over metal": LayeredModel((COAT, METAL)),
    "mirror with long tails": LayeredModel((SpecularLayer((0.5, 0.5, 0.5), 1.0, 0.004, 0.8, (0.0, 0.0), 0.0, 0.0),)),
    "cloth": LayeredModel((RetroLayer((0.1, 0.2, 0.3), 0.1), GROUND, SheenLayer((0.02, 0.03, 0.1), (2.0, 3.0)))),
    "nothing": LayeredModel(()),
}
TYPICAL = ("dielectric over diffuse", "coat over metal")
DECOMPOSED = {
    "three components": mixture(3, 0),
    "two components": known_models.MODELS["elongated rings and cusps"],
    "diffuse alone": known_models.single_lobe(1.5, 1.0, 0.5),
    "highlight alone": known_models.single_lobe(2.0, 900.0, 0.5, family="student"),
    "paper": known_models.MODELS["paper"],
}
DIVIDED = "three components"
"""Of which each component has a program of its own."""
WEIGHTS = {"specular_spike": 3.0, "specular_lobe": 2.0, "diffuse": 0.5}
PAIRS = known_models.pairs_of_directions(10_000, lowest=0.02, spread=0.03)


@pytest.fixture(scope="module")
def values(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Array]:
    """What the browser computes."""
    if CHROMIUM is None:
        pytest.skip('"chromium" is not installed')
    up, down = [0.6, 0.0, 0.8], [0.6, 0.0, -0.8]
    first, second = np.vstack([PAIRS[0], up, down]), np.vstack([PAIRS[1], down, up])
    calls = {name: ShaderCall(glsl_function(model), "dsbrdf(a, b)", first, second) for name, model in MODELS.items()}
    both = glsl_function(MODELS["cloth"], "felt") + glsl_function(MODELS["coat over metal"], "car", sampling=True)
    calls["felt"] = ShaderCall(both, "felt(a, b)", *PAIRS, precision="")
    calls["pdf"] = ShaderCall(both, "vec3(car_pdf(a, b))", *PAIRS, precision="")
    weights = ", ".join(map(str, WEIGHTS.values()))
    for name, model in DECOMPOSED.items():
        source = glsl_function(next(iter(decompose(model))))
        calls[f"{name}, weights"] = ShaderCall(source, f"dsbrdf_shown(a, b, vec3({weights}))", *PAIRS)
    for component in decompose(DECOMPOSED[DIVIDED]):
        calls[component.label] = ShaderCall(glsl_function(component), "dsbrdf(a, b)", *PAIRS)
    return evaluate_glsl(calls, tmp_path_factory.mktemp("glsl"))


@pytest.mark.parametrize("name", MODELS)
def test_webgl_gives_the_values_of_the_layers(name: str, values: dict[str, Array]) -> None:
    expected = MODELS[name].evaluate(*half_difference(*PAIRS))
    error = np.abs(values[name][:-2] - expected) / np.maximum(expected, 1e-5)
    assert error.max() < 1e-4
    assert values[name][-2:].tolist() == [[0.0] * 3] * 2


def test_two_materials_share_a_program_that_states_no_precision(values: dict[str, Array]) -> None:
    np.testing.assert_array_equal(values["felt"], values["cloth"][:-2])


def test_webgl_gives_the_density_of_the_layers(values: dict[str, Array]) -> None:
    expected = MODELS["coat over metal"].pdf(*PAIRS)
    error = np.abs(values["pdf"][:, 0] - expected) / expected
    assert np.quantile(error, 0.999) < 1e-4  # halfway between two tabulated angles rounding decides


@pytest.mark.parametrize("name", DECOMPOSED)
def test_webgl_divides_the_model_as_the_library_does(name: str, values: dict[str, Array]) -> None:
    model, angles = DECOMPOSED[name], half_difference(*PAIRS)
    whole = model.evaluate(*angles)
    weighted = np.zeros_like(whole)
    bound = 1e-3 if name == "paper" else 1e-4  # its gammas differ so much that theta_diff itself is too coarse
    for component in decompose(model):
        expected = component.evaluate(*angles)
        weighted += WEIGHTS[component.label] * expected
        if name == DIVIDED:
            # Where a component ends, the little that is left is a difference, and has the rounding of the model.
            level = np.maximum(expected, np.maximum(0.1 * whole, 1e-5))
            assert np.max(np.abs(values[component.label] - expected) / level) < bound
    error = np.abs(values[f"{name}, weights"] - weighted) / np.maximum(weighted, 1e-5)
    assert error.max() < bound


@pytest.mark.parametrize("name", TYPICAL)
def test_a_typical_model_is_a_page_that_can_be_read(name: str) -> None:
    lines = glsl_function(MODELS[name]).splitlines()
    assert len(lines) <= 60
    assert max(map(len, lines)) <= 120
