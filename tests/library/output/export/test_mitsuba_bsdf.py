"""The BSDF for Mitsuba 3 against the model itself, in scalar and LLVM variants: values, samples and derivatives."""

import importlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import dsbrdf
from dsbrdf import InvalidArgumentError
from dsbrdf.data import half_difference
from dsbrdf.model.sampling import ANGLES
from dsbrdf.output.export import mitsuba_bsdf
from dsbrdf.output.export.mitsuba_bsdf import register
from dsbrdf.output.export.mitsuba_model import PARAMETERS
from dsbrdf.output.export.rgl import SPECTRA, WAVELENGTHS
from dsbrdf.output.serialize import read_model_file
from tests.support.known_models import MODELS, pairs_of_directions
from tests.support.mitsuba_variants import mitsuba_variant, surface_at

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]

UNIFORM = np.random.default_rng(0).random((3, 50_000)).astype(np.float32)
RELATIVE_DIFFERENCE_STEP = 1e-5
UP = [0.6, 0.0, 0.8]
DOWN = [0.6, 0.0, -0.8]


@pytest.fixture(scope="module", autouse=True)
def tables_for_sampling_are_made_once() -> Iterator[None]:
    """What is read from a file equals the model in it and is replaced by it: its tables take half a second."""
    known = {model: model for model in MODELS.values()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mitsuba_bsdf, "read_model_file", lambda path: (known[read_model_file(path)[0]], None))
        yield


@pytest.fixture(params=["scalar_rgb", "llvm_ad_rgb"])
def variant(request: pytest.FixtureRequest) -> ModuleType:
    return prepared(request.param)


@pytest.fixture
def llvm() -> ModuleType:
    return prepared("llvm_ad_rgb")


def prepared(name: str) -> ModuleType:
    module = mitsuba_variant(name)
    register()
    return module


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("models")
    paths = {name: folder / f"{name}.json" for name in MODELS}
    for name, path in paths.items():
        dsbrdf.save(MODELS[name], path)
    return paths


def loaded(module: ModuleType, path: Path) -> Any:
    return module.load_dict({"type": "dsbrdf", "filename": str(path)})


def evaluated(module: ModuleType, bsdf: Any, wi: Array, wo: Array) -> Iterator[tuple[Array, Array]]:
    """Yield values times cosine and densities, for each pair or for all at once."""
    if module.variant().startswith("scalar"):
        for first, second in zip(wi.tolist(), wo.tolist(), strict=True):
            arguments = module.BSDFContext(), surface_at(module, first), module.Vector3f(second)
            yield np.ravel(bsdf.eval(*arguments)), np.array([bsdf.pdf(*arguments)])
        return
    surface = surface_at(module, wi.T.astype(np.float32))
    arguments = module.BSDFContext(), surface, module.Vector3f(wo.T.astype(np.float32))
    yield np.array(bsdf.eval(*arguments)).T, np.array(bsdf.pdf(*arguments))


@pytest.mark.parametrize("name", MODELS)
def test_values_and_densities_are_those_of_the_model(name: str, variant: ModuleType, files: dict[str, Path]) -> None:
    model = MODELS[name]
    wi, wo = pairs_of_directions(8 if variant.variant().startswith("scalar") else 10_000)
    found = list(evaluated(variant, loaded(variant, files[name]), wi, wo))
    values, densities = (np.concatenate([np.atleast_2d(one[i].T).T for one in found]) for i in (0, 1))
    expected = model.evaluate(*half_difference(wo, wi)) * wo[:, 2:]
    error = np.abs(values.reshape(-1, 3) - expected) / np.maximum(expected, 1e-5 * wo[:, 2:])
    # The random gammas of the paper's model differ a thousandfold between slices: theta_diff itself is then too coarse.
    assert error.max() < (5e-3 if name == "paper" else 1e-4)
    unit = [one / np.linalg.norm(one, axis=1)[:, None] for one in (wo, wi)]
    density = model.pdf(*unit)
    assert np.abs(densities.ravel() - density).max() < 1e-3 * density.max()
    assert np.median(np.abs(densities.ravel() / density - 1.0)) < 1e-5


@pytest.mark.parametrize("name", ["elongated rings and cusps", "paper"])
def test_samples_are_those_of_the_model_and_their_weights_add_up(
    name: str, llvm: ModuleType, files: dict[str, Path]
) -> None:
    model, theta = MODELS[name], np.radians(50.0)
    towards = np.repeat([[np.sin(theta)], [0.0], [np.cos(theta)]], UNIFORM.shape[1], axis=1)
    surface = surface_at(llvm, towards.astype(np.float32))
    one, two = llvm.Float(UNIFORM[0]), llvm.Point2f(UNIFORM[1:])
    drawn, weight = loaded(llvm, files[name]).sample(llvm.BSDFContext(), surface, one, two)
    # The same uniform numbers; only cosine-distributed directions are made from them in another way.
    expected = model.sampler.sample(towards.T, np.random.default_rng(0))
    row = round(theta / float(ANGLES[1]))
    mirrored = model.sampler.cumulative[row, -2] > UNIFORM[0]
    distance = np.linalg.norm(np.array(drawn.wo).T - expected, axis=1)[mirrored]
    assert distance.size > 1000
    assert np.quantile(distance, 0.999) < 1e-4
    weights = np.array(weight).T.astype(float)
    error = 5.0 * weights.std(axis=0) / np.sqrt(len(weights))
    assert np.all(np.abs(weights.mean(axis=0) - model.albedo(theta)) < error)


def test_nothing_is_reflected_below_the_horizon(variant: ModuleType, files: dict[str, Path]) -> None:
    bsdf = loaded(variant, files["mixture"])
    for wi, wo in ((UP, DOWN), (DOWN, UP)):
        arguments = variant.BSDFContext(), surface_at(variant, wi), variant.Vector3f(wo)
        assert np.ravel(bsdf.eval(*arguments)).tolist() == [0.0, 0.0, 0.0]
        assert np.ravel(bsdf.pdf(*arguments)).tolist() == [0.0]


def test_spectral_variants_add_three_spectra(files: dict[str, Path]) -> None:
    module = prepared("scalar_spectral")
    wo = [0.0, 0.28, 0.96]
    surface = surface_at(module, UP)
    surface.wavelengths = [400.0, 510.0, 615.0, 800.0]
    value = np.ravel(loaded(module, files["mixture"]).eval(module.BSDFContext(), surface, module.Vector3f(wo)))
    rgb = MODELS["mixture"].evaluate_directions(UP, wo) * wo[2]
    spectrum = np.stack([np.interp(surface.wavelengths, WAVELENGTHS, row) for row in SPECTRA], axis=-1)
    assert value == pytest.approx(spectrum @ rgb, rel=1e-5)


def test_a_variant_with_polarisation_is_refused() -> None:
    mitsuba_variant("scalar_spectral_polarized")
    with pytest.raises(InvalidArgumentError, match="without polarisation"):
        register()


def test_missing_mitsuba_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dsbrdf.extras.find_spec", lambda _: None)
    with pytest.raises(ImportError, match=r"^mitsuba must be installed .* pip install 'dsbrdf\[mitsuba\]'$"):
        mitsuba_bsdf.register()


def unusual_pairs() -> tuple[Array, Array]:
    """Pairs in single precision: exact mirror pairs, equal directions, grazing ones, the normal, and any others."""
    random = np.random.default_rng(3)
    cosine = np.concatenate([random.uniform(0.05, 1.0, 30), [1.0, 0.02, 0.02, 0.9, 0.4]])
    turn = random.uniform(0.0, 6.28, cosine.size)
    sine = np.sqrt(1.0 - cosine**2)
    first = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=-1).astype(np.float32).astype(float)
    second = np.roll(first, 7, axis=0)
    second[:10] = first[:10] * [-1.0, -1.0, 1.0]
    second[10:15] = first[10:15]
    second[30:32] = first[30:32] * [-1.0, -1.0, 1.0]
    return first, second


def changed(model: dsbrdf.DSBRDF, name: str, place: tuple[int, ...], step: float) -> dsbrdf.DSBRDF:
    array = getattr(model, name).copy()
    array[place] += step
    return replace(model, **{name: array})


def places(model: dsbrdf.DSBRDF, name: str) -> list[tuple[int, ...]]:
    """A few elements of a parameter, of lobes that have it."""
    array = getattr(model, name)
    stored = np.flatnonzero(np.broadcast_to(lobes_with(model, name), array.shape))
    flat = np.random.default_rng(1).permutation(stored)[:4]
    return [tuple(int(i) for i in np.unravel_index(place, array.shape)) for place in flat.tolist()]


def lobes_with(model: dsbrdf.DSBRDF, name: str) -> NDArray[np.bool_]:
    """Lobes that have a parameter: a center or an elongation that is not 0."""
    some = {"center": model.center.any(axis=(0, 1)), "elongation": model.elongation.any(axis=0)}
    return np.asarray(some.get(name, np.ones(model.n_lobes, bool)))


@pytest.mark.parametrize("kind", MODELS)
def test_derivatives_are_those_of_finite_differences(kind: str, llvm: ModuleType, files: dict[str, Path]) -> None:
    dr, model = importlib.import_module("drjit"), MODELS[kind]
    wi, wo = unusual_pairs()
    angles = half_difference(wo, wi)
    bsdf = loaded(llvm, files[kind])
    parameters = llvm.traverse(bsdf)
    surface, towards = surface_at(llvm, wi.T.astype(np.float32)), llvm.Vector3f(wo.T.astype(np.float32))
    value = model.evaluate(*angles) * wo[:, 2:]
    for name in PARAMETERS:
        for place in places(model, name):
            size = RELATIVE_DIFFERENCE_STEP * max(1.0, abs(float(getattr(model, name)[place])))
            up, down = (changed(model, name, place, sign * size).evaluate(*angles) for sign in (1.0, -1.0))
            expected = (up - down) / (2.0 * size) * wo[:, 2:]
            tangent = np.zeros(getattr(model, name).shape, np.float32)
            tangent[place] = 1.0
            tangent = tangent[..., lobes_with(model, name)]
            dr.enable_grad(parameters[name])
            parameters.set_dirty(name)
            parameters.update()
            dr.set_grad(parameters[name], llvm.TensorXf(tangent))
            found = dr.forward_to(bsdf.eval(llvm.BSDFContext(), surface, towards))
            derivative = np.array(found, dtype=float).T
            dr.disable_grad(parameters[name])
            assert np.isfinite(derivative).all()
            scale = np.abs(expected) + 1e-2 * value / max(1.0, abs(float(getattr(model, name)[place])))
            error = np.abs(derivative - expected) / np.maximum(scale, 1e-9)
            assert error.max() < 1e-3, (name, place, np.argmax(error.max(axis=1)))


def test_derivatives_in_the_directions_are_finite(llvm: ModuleType, files: dict[str, Path]) -> None:
    dr = importlib.import_module("drjit")
    wi, wo = unusual_pairs()
    for kind in MODELS:
        bsdf = loaded(llvm, files[kind])
        towards = llvm.Vector3f(wo.T.astype(np.float32))
        surface = surface_at(llvm, wi.T.astype(np.float32))
        dr.enable_grad(towards, surface.wi)
        value = bsdf.eval(llvm.BSDFContext(), surface, towards)
        if kind == "mixture":  # the density is a table of the same kind for all, and takes half a second to make
            value += bsdf.pdf(llvm.BSDFContext(), surface, towards)
        dr.backward(dr.sum(value))
        for vector in (towards, surface.wi):
            assert np.isfinite(np.array(dr.grad(vector))).all(), kind


def test_changed_parameters_change_the_values(variant: ModuleType, files: dict[str, Path]) -> None:
    model, bsdf = MODELS["mixture"], loaded(variant, files["mixture"])
    parameters = variant.traverse(bsdf)
    parameters["amplitude"] = 2.0 * parameters["amplitude"]
    parameters["elongation"] = parameters["elongation"] + 0.5
    parameters.update()
    now = bsdf.model()
    np.testing.assert_allclose(now.amplitude, 2.0 * model.amplitude, rtol=1e-6)
    wo = [-0.48, 0.36, 0.8]
    value = np.ravel(bsdf.eval(variant.BSDFContext(), surface_at(variant, UP), variant.Vector3f(wo)))
    np.testing.assert_allclose(value, now.evaluate_directions(wo, UP) * wo[2], rtol=1e-4)


@pytest.mark.parametrize("kind", MODELS)
def test_parameters_are_those_that_change_the_values(kind: str, variant: ModuleType, files: dict[str, Path]) -> None:
    model, bsdf = MODELS[kind], loaded(variant, files[kind])
    parameters = variant.traverse(bsdf)
    expected = {name: getattr(model, name)[..., lobes_with(model, name)].shape for name in PARAMETERS}
    found = {name: tuple(parameters[name].shape) for name in PARAMETERS if name in parameters}
    assert found == {name: shape for name, shape in expected.items() if 0 not in shape}
    for name in PARAMETERS:
        np.testing.assert_allclose(getattr(bsdf.model(), name), getattr(model, name), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    ("properties", "words"),
    [
        ({}, 'the BSDF "dsbrdf" needs the property "filename"'),
        ({"filename": 3.0}, 'the BSDF "dsbrdf" needs the property "filename"'),
        ({"filename": "lost.json"}, "there is no file lost.json"),
        ({"filename": "a.json"}, "a.json: The data is not a stored model"),
    ],
)
def test_a_wrong_file_or_property_is_one_sentence(
    properties: dict[str, Any], words: str, llvm: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.json").write_text("{}")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RuntimeError) as caught:
        llvm.load_dict({"type": "dsbrdf", **properties})
    assert words in str(caught.value).strip().splitlines()[-1]
