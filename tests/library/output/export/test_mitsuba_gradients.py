"""Parameters of the BSDF for Mitsuba: `traverse`, derivatives against finite differences, a lobe optimised."""

import importlib
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import dsbrdf
from dsbrdf.data.geometry import half_difference
from dsbrdf.output.export.mitsuba_bsdf import register
from dsbrdf.output.export.mitsuba_model import PARAMETERS
from tests.support.known_models import MODELS
from tests.support.mitsuba_variants import mitsuba_variant, surface_at

Array = NDArray[np.float64]

STEP = 1e-5


@pytest.fixture
def llvm() -> ModuleType:
    module = mitsuba_variant("llvm_ad_rgb")
    register()
    return module


def pairs() -> tuple[Array, Array]:
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


def loaded(module: ModuleType, model: dsbrdf.DSBRDF, folder: Path) -> Any:
    path = folder / "model.json"
    dsbrdf.save(model, path)
    return module.load_dict({"type": "dsbrdf", "filename": str(path)})


def changed(model: dsbrdf.DSBRDF, name: str, place: tuple[int, ...], step: float) -> dsbrdf.DSBRDF:
    array = getattr(model, name).copy()
    array[place] += step
    return replace(model, **{name: array})


def places(model: dsbrdf.DSBRDF, name: str) -> list[tuple[int, ...]]:
    """A few elements of a parameter, among them the first and the last."""
    array = getattr(model, name)
    if (name == "center" and not model.is_ring.any()) or (name == "elongation" and not array.any()):
        return []
    flat = np.random.default_rng(1).permutation(array.size)[:4]
    found = [tuple(int(i) for i in np.unravel_index(place, array.shape)) for place in flat.tolist()]
    return [place for place in found if name != "center" or model.is_ring[place[-1]]]


@pytest.mark.parametrize("kind", MODELS)
def test_derivatives_are_those_of_finite_differences(kind: str, llvm: ModuleType, tmp_path: Path) -> None:
    dr, model = importlib.import_module("drjit"), MODELS[kind]
    wi, wo = pairs()
    angles = half_difference(wo, wi)
    bsdf = loaded(llvm, model, tmp_path)
    parameters = llvm.traverse(bsdf)
    surface, towards = surface_at(llvm, wi.T.astype(np.float32)), llvm.Vector3f(wo.T.astype(np.float32))
    value = model.evaluate(*angles) * wo[:, 2:]
    for name in PARAMETERS:
        for place in places(model, name):
            size = STEP * max(1.0, abs(float(getattr(model, name)[place])))
            up, down = (changed(model, name, place, sign * size).evaluate(*angles) for sign in (1.0, -1.0))
            expected = (up - down) / (2.0 * size) * wo[:, 2:]
            tangent = np.zeros(getattr(model, name).shape, np.float32)
            tangent[place] = 1.0
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


def test_derivatives_in_the_directions_are_finite(llvm: ModuleType, tmp_path: Path) -> None:
    dr = importlib.import_module("drjit")
    wi, wo = pairs()
    for kind, model in MODELS.items():
        bsdf = loaded(llvm, model, tmp_path)
        towards = llvm.Vector3f(wo.T.astype(np.float32))
        surface = surface_at(llvm, wi.T.astype(np.float32))
        dr.enable_grad(towards, surface.wi)
        value = bsdf.eval(llvm.BSDFContext(), surface, towards)
        if kind == "mixture":  # the density is a table of the same kind for all, and takes half a second to make
            value += bsdf.pdf(llvm.BSDFContext(), surface, towards)
        dr.backward(dr.sum(value))
        for vector in (towards, surface.wi):
            assert np.isfinite(np.array(dr.grad(vector))).all(), kind


@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
def test_changed_parameters_change_the_values(variant: str, tmp_path: Path) -> None:
    module, model = mitsuba_variant(variant), MODELS["mixture"]
    register()
    bsdf = loaded(module, model, tmp_path)
    parameters = module.traverse(bsdf)
    assert {name: tuple(parameters[name].shape) for name in PARAMETERS} == {
        name: getattr(model, name).shape for name in PARAMETERS
    }
    parameters["amplitude"] = 2.0 * parameters["amplitude"]
    parameters["elongation"] = parameters["elongation"] + 0.5
    parameters.update()
    now = bsdf.model()
    np.testing.assert_allclose(now.amplitude, 2.0 * model.amplitude, rtol=1e-6)
    wi, wo = [0.6, 0.0, 0.8], [-0.48, 0.36, 0.8]
    value = np.ravel(bsdf.eval(module.BSDFContext(), surface_at(module, wi), module.Vector3f(wo)))
    np.testing.assert_allclose(value, now.evaluate_directions(wo, wi) * wo[2], rtol=1e-4)


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
