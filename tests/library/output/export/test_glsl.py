"""The GLSL of models, layers and components, and BRDF Explorer's file: WebGL 2 against the library in doubles."""

import itertools
import re

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf import InvalidArgumentError, decompose
from dsbrdf.components import DiffuseLayer, LayeredModel, RetroLayer, SheenLayer, SpecularLayer
from dsbrdf.data import half_difference
from dsbrdf.output import export_model
from dsbrdf.output.export.glsl import glsl_function
from tests.support import known_models
from tests.support.mixtures import mixture
from tests.support.random_models import random_model
from tests.support.webgl import CHROMIUM, ShaderCall, evaluate_glsl

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]

GROUND = DiffuseLayer((0.4, 0.2, 0.05), (0.7, 0.1, -0.2, 0.3, 0.5, -0.6))
COAT = SpecularLayer((0.04, 0.041, 0.042), 0.9, 0.05, 2.0, (0.2, -0.3), 0.4, 0.0)
METAL = SpecularLayer((0.9, 0.6, 0.3), 1.1, 0.3, 5.0, (-0.1, 0.2), 0.8, 1.0)
LAYERED = {
    "dielectric over diffuse": LayeredModel((COAT, GROUND)),
    "coat over metal": LayeredModel((COAT, METAL)),
    "mirror with long tails": LayeredModel((SpecularLayer((0.5, 0.5, 0.5), 1.0, 0.004, 0.8, (0.0, 0.0), 0.0, 0.0),)),
    "cloth": LayeredModel((RetroLayer((0.1, 0.2, 0.3), 0.1), GROUND, SheenLayer((0.02, 0.03, 0.1), (2.0, 3.0)))),
    "nothing": LayeredModel(()),
}
MODELS = known_models.MODELS | {"one lobe": mixture(1, 4)}
ALL = MODELS | LAYERED
PAINTS = {"mixture": "satin_paint", "elongated rings and cusps": "Wax2", "cloth": "felt"}  # materials in one program
SAMPLED = ("mixture", "coat over metal")
DECOMPOSED = {
    "three components": mixture(3, 0),
    "two components": known_models.MODELS["elongated rings and cusps"],
    "highlight alone": known_models.single_lobe(2.0, 900.0, 0.5, family="student"),
    "paper": known_models.MODELS["paper"],
}
DIVIDED = "three components"
"""Of which each component has a program of its own."""
WEIGHTS = {"specular_spike": 3.0, "specular_lobe": 2.0, "diffuse": 0.5}
TOWARDS = np.array([0.5, 0.0, np.sqrt(0.75)])
FRAME = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
"""Axes x, y, z of a turned surface, in its columns."""
ROWS = 79  # rows of 128 pixels
PAIRS = known_models.pairs_of_directions(128 * ROWS, lowest=0.02, spread=0.03)


@pytest.fixture(scope="module")
def values(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Array]:
    """What the browser computes for each model, and for pairs with one direction below the horizon."""
    if CHROMIUM is None:
        pytest.skip('"chromium" is not installed')
    up, down = [0.6, 0.0, 0.8], [0.6, 0.0, -0.8]
    first, second = np.vstack([PAIRS[0], up, down]), np.vstack([PAIRS[1], down, up])
    calls = {name: ShaderCall(glsl_function(model), "dsbrdf(a, b)", first, second) for name, model in ALL.items()}
    both = "".join(glsl_function(ALL[name], paint) for name, paint in PAINTS.items())
    one, two, three = (f"{paint}(a, b)" for paint in PAINTS.values())
    which = f"gl_FragCoord.y < {ROWS}.0 ? {one} : gl_FragCoord.y < {2 * ROWS}.0 ? {two} : {three}"
    calls["paints"] = ShaderCall(both, which, np.tile(PAIRS[0], (3, 1)), np.tile(PAIRS[1], (3, 1)), precision="")
    for name in SAMPLED:
        source = glsl_function(ALL[name], sampling=True)
        towards, numbers = np.broadcast_to(TOWARDS, PAIRS[0].shape), np.random.default_rng(4).random(PAIRS[0].shape)
        which = f"gl_FragCoord.y < {ROWS}.0 ? vec3(dsbrdf_pdf(a, b)) : dsbrdf_sample(a, b)"
        first, second = np.vstack([PAIRS[0], towards]), np.vstack([PAIRS[1], numbers])
        calls[f"{name}, sampling"] = ShaderCall(source, which, first, second)
    x, y, z = (f"vec3({', '.join(map(str, axis))})" for axis in FRAME.T.tolist())
    shader = "const float scale = 2.0;\n" + brdf_sections()["shader"]
    calls["turned"] = ShaderCall(shader, f"BRDF(a, b, {z}, {x}, {y})", *(one @ FRAME.T for one in PAIRS))
    weights = ", ".join(map(str, WEIGHTS.values()))
    for name, model in DECOMPOSED.items():
        source = glsl_function(next(iter(decompose(model))))
        calls[f"{name}, weights"] = ShaderCall(source, f"dsbrdf_shown(a, b, vec3({weights}))", *PAIRS)
    for component in decompose(DECOMPOSED[DIVIDED]):
        calls[component.label] = ShaderCall(glsl_function(component), "dsbrdf(a, b)", *PAIRS)
    found = evaluate_glsl(calls, tmp_path_factory.mktemp("glsl"))
    found |= dict(zip(PAINTS.values(), np.split(found["paints"], 3), strict=True))
    for name in SAMPLED:
        found[f"{name}, pdf"], found[f"{name}, sample"] = np.split(found[f"{name}, sampling"], 2)
    return found


def brdf_sections() -> dict[str, str]:
    """Sections of a .brdf file, read as that program does: a line of the kind first, then blocks."""
    text = export_model(MODELS["mixture"], "brdf").decode()
    assert text.splitlines()[0] == "analytic"
    found = dict(re.findall(r"^::begin (\w+)\n(.*?)^::end \1$", text, re.MULTILINE | re.DOTALL))
    assert re.fullmatch(r"float scale [\d.]+ [\d.]+ 1\n", found["parameters"])
    assert "vec3 BRDF(vec3 L, vec3 V, vec3 N, vec3 X, vec3 Y)" in found["shader"]
    return found


@pytest.mark.parametrize("name", ALL)
def test_webgl_gives_the_values_of_models_and_layers(name: str, values: dict[str, Array]) -> None:
    # `evaluate_directions` scales directions to exact unit length first, which single precision cannot hold.
    expected = ALL[name].evaluate(*half_difference(*PAIRS))
    error = np.abs(values[name][:-2] - expected) / np.maximum(expected, 1e-5)  # less than 1e-5 /sr cannot be seen
    # The random gammas of the paper's model differ a thousandfold between slices: theta_diff itself is then too coarse.
    assert error.max() < (1e-3 if name == "paper" else 1e-4)
    assert values[name][-2:].tolist() == [[0.0] * 3] * 2


@pytest.mark.parametrize("name", PAINTS)
def test_materials_share_a_program_that_states_no_precision(name: str, values: dict[str, Array]) -> None:
    np.testing.assert_array_equal(values[PAINTS[name]], values[name][:-2])


@pytest.mark.parametrize("name", SAMPLED)
def test_webgl_gives_the_density_of_the_model(name: str, values: dict[str, Array]) -> None:
    expected = ALL[name].pdf(*PAIRS)
    # The tabulated mixture of a direction halfway between two angles is another after rounding.
    error = np.abs(values[f"{name}, pdf"][:, 0] - expected) / expected
    assert np.quantile(error, 0.999) < 1e-4


@pytest.mark.parametrize("name", SAMPLED)
def test_webgl_draws_directions_with_that_density(name: str, values: dict[str, Array]) -> None:
    """The mean of 1 / density over the samples in a ring about the mirror direction is the ring's solid angle."""
    drawn = values[f"{name}, sample"]
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1.0, atol=1e-5)
    height = drawn @ (TOWARDS * [-1.0, -1.0, 1.0])
    edges = np.cos(np.radians([60.0, 40.0, 20.0, 8.0, 3.0, 0.0]))
    inverse = 1.0 / np.maximum(ALL[name].pdf(drawn / np.linalg.norm(drawn, axis=1)[:, None], TOWARDS), 1e-9)
    for low, high in itertools.pairwise(edges):
        area = np.where((height > low) & (np.minimum(height, 1.0) <= high), inverse, 0.0)
        assert abs(area.mean() - 2.0 * np.pi * (high - low)) < 4.0 * area.std() / np.sqrt(area.size)


def test_brdf_explorer_gives_the_values_in_a_turned_frame(values: dict[str, Array]) -> None:
    expected = 2.0 * MODELS["mixture"].evaluate(*half_difference(*PAIRS))
    np.testing.assert_allclose(values["turned"], expected, rtol=1e-3)


@pytest.mark.parametrize("name", ["", "2nd", "gl_paint", "a__b", "paint_", "flat", "mix", "a-b", "é", "p" * 65])
def test_a_name_that_no_function_can_have_is_refused(name: str) -> None:
    with pytest.raises(InvalidArgumentError, match="must begin with a letter, have at most 64 letters and digits"):
        export_model(MODELS["one lobe"], "glsl", name=name)


def test_every_name_begins_with_that_of_the_function() -> None:
    for source in (
        export_model(MODELS["mixture"], "glsl", name="paint", sampling=True).decode(),
        glsl_function(decompose(MODELS["mixture"])["diffuse"], "paint", sampling=True),
        glsl_function(decompose(MODELS["mixture"]).layers, "paint", sampling=True),
    ):
        declared = re.findall(r"^(?:const )?(?:void|int|float|vec[234]|struct|paint\w+) (\w+)", source, re.MULTILINE)
        assert len(declared) > 8
        assert all(re.match(r"paint(_|$)", name) for name in declared)
        assert "dsbrdf" not in source.partition("\n")[2]


def test_a_parameter_too_large_for_single_precision_is_refused() -> None:
    with pytest.raises(InvalidArgumentError, match="too large for GLSL"):
        glsl_function(known_models.single_lobe(1.0, 1.0, 1e39))


def test_source_is_small() -> None:
    model = random_model(1, n_lobes=7)
    assert len(export_model(model, "glsl")) < 40_000
    assert len(glsl_function(decompose(model)["diffuse"])) < 60_000


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


@pytest.mark.parametrize("name", ["dielectric over diffuse", "coat over metal"])
def test_a_typical_layered_model_is_a_page_that_can_be_read(name: str) -> None:
    lines = glsl_function(LAYERED[name]).splitlines()
    assert len(lines) <= 60
    assert max(map(len, lines)) <= 120
