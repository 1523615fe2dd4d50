"""Every target that computes values, over one list of materials: Python, GLSL, Mitsuba and tables for Mitsuba."""

import copy
import itertools
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import dsbrdf
from dsbrdf import DSBRDF, Measurement, decompose
from dsbrdf.arrays import Array
from dsbrdf.components import LayeredModel, SpecularLayer
from dsbrdf.components.component import Component
from dsbrdf.data import half_difference
from dsbrdf.data.rgl import parse_tensors
from dsbrdf.output import export_model
from dsbrdf.output.export.mitsuba import register
from dsbrdf.output.export.rgl import SPECTRA, WAVELENGTHS, rgl_bsdf
from tests.support import models
from tests.support.array_libraries import loaded
from tests.support.models import COAT, GROUND, METAL, RETRO, SHEEN, papers_model, random_model
from tests.support.renderers import mitsuba_variant, surface_at
from tests.support.webgl import CHROMIUM, ShaderCall, evaluate_glsl

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("coarse_sampling")]

Source = DSBRDF | LayeredModel | Component

# Copies, whose tables of densities are theirs alone.
MODELS: dict[str, DSBRDF] = {
    **{name: copy.copy(model) for name, model in models.MODELS.items()},
    "one knot": models.single_lobe(2.0, 900.0, 0.5, family="student"),
    "long stretch": models.single_lobe(1.5, 40.0, 0.5, center=0.2, elongation=6.0),
    "no lobes": random_model(0, n_lobes=0),
}
LAYERED = {
    "dielectric over diffuse": LayeredModel((COAT, GROUND)),
    "coat over metal": LayeredModel((COAT, METAL)),
    "mirror with long tails": LayeredModel((SpecularLayer((0.5, 0.5, 0.5), 1.0, 0.004, 0.8, (0.0, 0.0), 0.0, 0.0),)),
    "cloth": LayeredModel((RETRO, GROUND, SHEEN)),
    "no layers": LayeredModel(()),
}
COMPONENTS: dict[str, tuple[DSBRDF, int]] = {
    "part of mixture": (MODELS["mixture"], 1),
    "part of rings": (random_model(1, 2), 0),
    "only part": (MODELS["one knot"], 0),
    "part of paper": (papers_model(1), 0),
}
NAMES = (*MODELS, *LAYERED, *COMPONENTS)
WEIGHTED = ("part of mixture", "only part")
SAMPLED = ("mixture",)
PAIRS = models.pairs_of_directions(128 * 16, lowest=0.05, spread=0.03)
"""Pairs in single precision, in 16 rows of 128 pixels; the directions are not quite of length 1."""
BELOW = np.array([[0.0, 0.0, 1.0], [0.8, 0.0, -0.6]])  # Their half vector is above the horizon.
TOWARDS = np.array([0.5, 0.0, np.sqrt(0.75)])
WEIGHTS = {"specular_spike": 3.0, "specular_lobe": 2.0, "diffuse": 0.5}
FRAME = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
"""Axes x, y, z of a turned surface, in its columns."""
MAX_PYTHON_LINES = 150


@cache
def source_of(name: str) -> Source:
    if name in COMPONENTS:
        model, number = COMPONENTS[name]
        return list(decompose(model))[number]
    return (MODELS | LAYERED)[name]


@dataclass(frozen=True, eq=False)
class Expected:
    """The library's values at pairs, and what an error is compared with."""

    values: Array
    level: Array


def expected(source: Source, first: Array, second: Array, *, dark: float = 1e-5) -> Expected:
    """Values below `dark` cannot be seen; a component is a difference, and has the rounding of its model."""
    theta_half, theta_diff, phi_diff = half_difference(first, second)  # `evaluate_directions` makes them unit vectors.
    values = source.evaluate(theta_half, theta_diff, phi_diff)
    model = source.whole.model if isinstance(source, Component) else source
    level = np.maximum(np.maximum(values, 0.1 * model.evaluate(theta_half, theta_diff, phi_diff)), dark)
    if isinstance(model, DSBRDF) and model.interpolation == "linear":
        # The paper's model jumps between slices, so that the rounding of theta_diff alone changes values.
        level += 1e4 * np.abs(source.evaluate(theta_half, theta_diff + 4.8e-7, phi_diff) - values)
    return Expected(values, level)


def largest_error(values: Array, wanted: Expected) -> float:
    return float(np.max(np.abs(values - wanted.values) / wanted.level))


@pytest.mark.parametrize("name", NAMES)
def test_python(name: str, tmp_path: Path) -> None:
    content = export_model(source_of(name), "python")
    assert len(content.decode().splitlines()) <= MAX_PYTHON_LINES
    path = tmp_path / "material.py"
    path.write_bytes(content)
    evaluate = loaded(path).evaluate
    unit = [one / np.linalg.norm(one, axis=1)[:, None] for one in PAIRS]
    source, steep = source_of(name), np.minimum(unit[0][:, 2], unit[1][:, 2]) > np.cos(np.radians(80.0))
    wanted = source.evaluate(*half_difference(*unit))
    whole = source.whole.model.evaluate(*half_difference(*unit)) if isinstance(source, Component) else wanted
    assert np.all((np.abs(evaluate(*unit) - wanted) <= 1e-12 * np.maximum(whole, 1e-12))[steep])
    values = evaluate(*(one.astype(np.float32) for one in PAIRS))
    assert values.dtype == np.float32
    assert largest_error(values, expected(source, *PAIRS, dark=1e-3)) < 1e-4
    assert not evaluate(*BELOW).any()
    assert evaluate([0, 0, 1], [0, 0, 1]).shape in ((3,), (1,))
    np.testing.assert_allclose(evaluate(unit[0][:4, None], unit[1][None, :5])[2, 2], evaluate(unit[0][2], unit[1][2]))


def test_python_needs_nothing_of_this_library(tmp_path: Path) -> None:
    path = tmp_path / "diffuse.py"
    path.write_bytes(export_model(decompose(MODELS["mixture"])["diffuse"], "python"))
    code = f"import sys; sys.modules['dsbrdf'] = None; exec(open({str(path)!r}).read()); evaluate([0,0,1], [0,0,1])"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path)


@pytest.fixture(scope="module")
def glsl(tmp_path_factory: pytest.TempPathFactory, coarse_sampling: None) -> dict[str, Array]:
    """What one browser computes for each material, with two pairs that have a direction below the horizon."""
    if CHROMIUM is None:
        pytest.skip('"chromium" is not installed')
    first, second = np.vstack([PAIRS[0], BELOW]), np.vstack([PAIRS[1], BELOW[::-1]])
    written = {name: export_model(source_of(name), "glsl").decode() for name in NAMES}
    calls = {name: ShaderCall(source, "dsbrdf(a, b)", first, second) for name, source in written.items()}
    weights = f"vec3({', '.join(map(str, WEIGHTS.values()))})"
    for name in WEIGHTED:
        calls[f"{name}, weighted"] = ShaderCall(written[name], f"dsbrdf_shown(a, b, {weights})", *PAIRS)
    two = "".join(export_model(source_of(name), "glsl", name=name).decode() for name in ("mixture", "cloth"))
    calls["two"] = ShaderCall(two, "gl_FragCoord.x < 64.0 ? mixture(a, b) : cloth(a, b)", *PAIRS, precision="")
    for name in SAMPLED:
        source = export_model(source_of(name), "glsl", sampling=True).decode()
        numbers, towards = np.random.default_rng(4).random(PAIRS[0].shape), np.broadcast_to(TOWARDS, PAIRS[0].shape)
        calls[f"{name}, pdf"] = ShaderCall(source, "vec3(dsbrdf_pdf(a, b))", *PAIRS)
        calls[f"{name}, sample"] = ShaderCall(source, "dsbrdf_sample(a, b)", towards, numbers)
    x, y, z = (f"vec3({', '.join(map(str, axis))})" for axis in FRAME.T.tolist())
    shader = "const float scale = 2.0;\n" + brdf_sections()["shader"]
    calls["turned"] = ShaderCall(shader, f"BRDF(a, b, {z}, {x}, {y})", *(one @ FRAME.T for one in PAIRS))
    return evaluate_glsl(calls, tmp_path_factory.mktemp("glsl"))


def brdf_sections() -> dict[str, str]:
    """Sections of a .brdf file, read as that program does: a line of the kind first, then blocks."""
    text = export_model(MODELS["mixture"], "brdf").decode()
    assert text.splitlines()[0] == "analytic"
    found = dict(re.findall(r"^::begin (\w+)\n(.*?)^::end \1$", text, re.MULTILINE | re.DOTALL))
    assert re.fullmatch(r"float scale [\d.]+ [\d.]+ 1\n", found["parameters"])
    return found


@pytest.mark.parametrize("name", NAMES)
def test_glsl(name: str, glsl: dict[str, Array]) -> None:
    assert largest_error(glsl[name][:-2], expected(source_of(name), *PAIRS)) < 1e-4
    assert not glsl[name][-2:].any()


@pytest.mark.parametrize("name", WEIGHTED)
def test_glsl_of_a_component_has_the_others_too(name: str, glsl: dict[str, Array]) -> None:
    angles = half_difference(*PAIRS)
    whole = source_of(name).whole  # type: ignore[union-attr]
    weighted = np.sum([WEIGHTS[part.label] * part.evaluate(*angles) for part in whole], axis=0)
    level = expected(source_of(name), *PAIRS).level + weighted
    assert largest_error(glsl[f"{name}, weighted"], Expected(weighted, level)) < 1e-4


def test_glsl_of_two_materials_in_a_program_without_precision_and_of_brdf_explorer(glsl: dict[str, Array]) -> None:
    for name, half in (("mixture", np.s_[:64]), ("cloth", np.s_[64:])):
        alone, together = (glsl[key][: len(PAIRS[0])].reshape(-1, 128, 3)[:, half] for key in (name, "two"))
        np.testing.assert_array_equal(together, alone)
    np.testing.assert_allclose(glsl["turned"], 2.0 * expected(MODELS["mixture"], *PAIRS).values, rtol=1e-3)


@pytest.mark.parametrize("name", SAMPLED)
def test_glsl_samples(name: str, glsl: dict[str, Array]) -> None:
    """The mean of 1 / density over the samples in a ring about the mirror direction is the ring's solid angle."""
    source = source_of(name)
    assert not isinstance(source, Component)
    # The tabulated mixture of a direction halfway between two angles is another after rounding.
    density = source.pdf(*PAIRS)
    assert np.quantile(np.abs(glsl[f"{name}, pdf"][:, 0] - density) / density, 0.999) < 1e-4
    drawn = glsl[f"{name}, sample"]
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1.0, atol=1e-5)
    height = drawn @ (TOWARDS * [-1.0, -1.0, 1.0])
    inverse = 1.0 / np.maximum(source.pdf(drawn / np.linalg.norm(drawn, axis=1)[:, None], TOWARDS), 1e-9)
    for low, high in itertools.pairwise(np.cos(np.radians([60.0, 40.0, 20.0, 8.0, 3.0, 0.0]))):
        area = np.where((height > low) & (np.minimum(height, 1.0) <= high), inverse, 0.0)
        assert abs(area.mean() - 2.0 * np.pi * (high - low)) < 4.0 * area.std() / np.sqrt(area.size)


def mitsuba_with_models(variant: str, folder: Path) -> tuple[ModuleType, dict[str, dict[str, str]]]:
    module = mitsuba_variant(variant)
    register()
    for name in MODELS:
        dsbrdf.save(MODELS[name], folder / f"{name}.json")
    return module, {name: {"type": "dsbrdf", "filename": str(folder / f"{name}.json")} for name in MODELS}


def eval_and_pdf(module: ModuleType, bsdf: Any, wi: Array, wo: Array, **surface_is: Any) -> tuple[Array, Array]:
    """Return values times cosine (n, channels) and densities (n,), for all pairs at once where the variant can."""
    context = module.BSDFContext()
    if module.variant().startswith("scalar"):
        found: list[tuple[Array, float]] = []
        for first, second in zip(wi.tolist(), wo.tolist(), strict=True):
            surface = surface_at(module, first)
            for name, value in surface_is.items():
                setattr(surface, name, value)
            arguments = context, surface, module.Vector3f(second)
            found.append((np.ravel(bsdf.eval(*arguments)), bsdf.pdf(*arguments)))
        return np.array([one[0] for one in found], dtype=float), np.array([one[1] for one in found])
    arguments = context, surface_at(module, wi.T.astype(np.float32)), module.Vector3f(wo.T.astype(np.float32))
    return np.array(bsdf.eval(*arguments)).T, np.array(bsdf.pdf(*arguments))


@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
def test_mitsuba(variant: str, tmp_path: Path) -> None:
    module, described = mitsuba_with_models(variant, tmp_path)
    scalar = variant.startswith("scalar")
    wo, wi = (one[: 8 if scalar else None] for one in PAIRS)
    for name in ("elongated rings and cusps", "paper") if scalar else MODELS:
        model = MODELS[name]
        values, densities = eval_and_pdf(module, module.load_dict(described[name]), wi, wo)
        assert largest_error(values / wo[:, 2:], expected(model, wo, wi)) < 1e-4, name
        density = model.pdf(wo, wi)
        assert np.abs(densities - density).max() < 1e-3 * density.max()
        assert np.median(np.abs(densities / density - 1.0)) < 1e-5
    values, densities = eval_and_pdf(module, module.load_dict(described["mixture"]), BELOW, BELOW[::-1])
    assert not values.any()
    assert not densities.any()


def test_mitsuba_draws_a_row_of_tiles_in_a_furnace_as_bright_as_their_albedo(tmp_path: Path) -> None:
    module, described = mitsuba_with_models("llvm_ad_rgb", tmp_path)
    names = [name for name in MODELS if name != "no lobes"]
    theta, transform = np.radians(50.0), module.ScalarTransform4f
    origin = [0.0, 9.0 * np.sin(theta), 9.0 * np.cos(theta)]
    scene = {
        "type": "scene",
        "integrator": {"type": "direct"},
        "light": {"type": "constant", "radiance": 1.0},
        "camera": {
            "type": "orthographic",
            "to_world": transform().look_at(origin, [0, 0, 0], [0, 1, 0]) @ transform().scale(len(names)),
            "film": {"type": "hdrfilm", "width": 8 * len(names), "height": 8, "rfilter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": 256},
        },
    }
    for index, name in enumerate(names):
        place = transform().translate([len(names) - 1.0 - 2.0 * index, 0, 0]) @ transform().scale([1, 4, 1])
        scene[f"tile {index}"] = {"type": "rectangle", "to_world": place, "bsdf": described[name]}
    picture = np.array(module.render(module.load_dict(scene), seed=1))[..., :3]
    for name, tile in zip(names, np.split(picture[:, ::-1], len(names), axis=1), strict=True):
        albedo = np.asarray(MODELS[name].albedo(theta))
        np.testing.assert_allclose(tile.mean(axis=(0, 1)), albedo, rtol=0.03, err_msg=name)


@pytest.fixture(scope="module")
def table() -> bytes:
    return rgl_bsdf(MODELS["mixture"])


def measured(module: ModuleType, content: bytes, folder: Path) -> Any:
    (folder / "material.bsdf").write_bytes(content)
    return module.load_dict({"type": "measured", "filename": str(folder / "material.bsdf")})


@pytest.mark.parametrize("kind", ["model", "measurement"])
def test_a_table_for_mitsuba(kind: str, table: bytes, tmp_path: Path, metal: Measurement) -> None:
    wi, wo = models.pairs_of_directions(1000, spread=None)
    module, model = mitsuba_variant("llvm_ad_rgb"), MODELS["mixture"]
    evaluate: Callable[..., Array] = model.evaluate if kind == "model" else metal.interpolated.evaluate
    content = table if kind == "model" else rgl_bsdf(metal, metal.name)
    values = eval_and_pdf(module, measured(module, content, tmp_path), wi, wo)[0]
    wanted = evaluate(*half_difference(wi, wo)) * wo[:, 2:]
    # A metal without a diffuse part is nearly black away from its highlight, where nodes are few.
    assert np.median(np.abs(values - wanted) / np.maximum(wanted, 1e-3)) < 0.02
    if kind == "model":
        assert np.mean(np.abs(values - wanted)) < 0.02 * np.mean(wanted)


def test_samples_of_a_table_return_the_albedo(table: bytes, tmp_path: Path) -> None:
    module, count = mitsuba_variant("llvm_ad_rgb"), 20_000
    bsdf, uniform = measured(module, table, tmp_path), np.random.default_rng(1).random((2, count)).astype(np.float32)
    for angle in np.radians([0.0, 45.0, 75.0]):
        towards = np.repeat([[np.sin(angle)], [0.0], [np.cos(angle)]], count, axis=1)
        surface = surface_at(module, towards.astype(np.float32))
        weight = np.array(bsdf.sample(module.BSDFContext(), surface, module.Float(0.5), module.Point2f(uniform))[1]).T
        albedo = MODELS["mixture"].albedo(angle)
        assert weight.mean(axis=0) == pytest.approx(albedo, rel=0.02)
        assert np.all(weight.std(axis=0) < 0.5 * albedo)


def test_spectral_variants_add_three_spectra(tmp_path: Path) -> None:
    module, described = mitsuba_with_models("scalar_spectral", tmp_path)
    spectral = rgl_bsdf(MODELS["mixture"], spectral=True)
    wi, wo = models.pairs_of_directions(100, spread=None)
    at = [400.0, 470.0, 615.0, 720.0]
    spectra = np.stack([np.interp(at, WAVELENGTHS, row) for row in SPECTRA])
    wanted = expected(MODELS["mixture"], wo, wi).values * wo[:, 2:] @ spectra
    exact = eval_and_pdf(module, module.load_dict(described["mixture"]), wi, wo, wavelengths=at)[0]
    np.testing.assert_allclose(exact, wanted, rtol=1e-5)
    interpolated = eval_and_pdf(module, measured(module, spectral, tmp_path), wi, wo, wavelengths=at)[0]
    assert np.median(np.abs(interpolated - wanted) / wanted) < 0.01
    fields = parse_tensors(spectral)  # pbrt-v4 asks for these.
    assert fields["spectra"].shape == (1, fields["theta_i"].size, WAVELENGTHS.size, *fields["luminance"].shape[2:])
    single = ("theta_i", "phi_i", "wavelengths", "ndf", "sigma", "vndf", "luminance", "spectra")
    assert {fields[name].dtype.str for name in single} == {"<f4"}


def test_spectra_lit_by_d65_have_the_colours_they_came_from() -> None:
    module, wavelengths = mitsuba_variant("scalar_rgb"), np.arange(360.0, 831.0)
    matching = np.array([module.cie1931_xyz(at) for at in wavelengths.tolist()])
    weight = matching * np.array([module.cie_d65(at) for at in wavelengths.tolist()])[:, None]
    spectra = np.stack([np.interp(wavelengths, WAVELENGTHS, row) for row in SPECTRA])
    xyz = spectra @ weight / weight[:, 1].sum()
    rgb = np.array([np.ravel(module.xyz_to_srgb(module.Color3f(row))) for row in xyz.tolist()])
    assert rgb == pytest.approx(np.eye(3), abs=2e-4)
    assert SPECTRA.min() >= 0.0
    assert SPECTRA.sum(axis=0) == pytest.approx(1.0)
