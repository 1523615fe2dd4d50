"""Derivatives of exported Python files in JAX and PyTorch, and of the BSDF in Mitsuba, against finite differences."""

import importlib
import importlib.util
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import dsbrdf
from dsbrdf import DSBRDF, InvalidArgumentError
from dsbrdf.arrays import Array
from dsbrdf.components import LayeredModel
from dsbrdf.data import half_difference
from dsbrdf.output import export_model
from dsbrdf.output.export.mitsuba import PARAMETERS, register
from tests.support import array_libraries
from tests.support.array_libraries import loaded
from tests.support.models import LAYERS, MODELS, pairs_of_directions
from tests.support.renderers import mitsuba_variant, surface_at

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("coarse_sampling")]

LIBRARIES = [name for name in ("jax", "torch") if importlib.util.find_spec(name) is not None]
TWO_KNOT_MODEL = DSBRDF(  # JAX compiles every knot
    np.radians([0.0, 80.0]),
    amplitude=np.random.default_rng(0).uniform(0.1, 3.0, (3, 4, 3)),
    kappa=np.array([[[0.5, 1.0, 2.0]] * 4]),
    gamma=np.array([[[300.0, 40.0, 2.0]] * 4]),
    center=np.array([[[0.0, 0.2, -0.1]] * 4]),
    elongation=np.array([[0.5, -0.3, 0.2]]),
)
PAIRS = pairs_of_directions(2000, lowest=float(np.cos(np.radians(80.0))), spread=0.03)
"""Pairs in single precision; not quite of length 1, they are no nodes of anything."""


@pytest.mark.parametrize("library", LIBRARIES)
def test_values_and_derivatives_in_other_libraries(library: str, tmp_path: Path) -> None:
    sources: dict[str, DSBRDF | LayeredModel] = {"model": TWO_KNOT_MODEL}
    if library != "jax":  # It compiles for a second what is written as the model is.
        sources["layers"] = LayeredModel(LAYERS.layers[1:])
    for name, source in sources.items():
        (tmp_path / f"{name}.py").write_bytes(export_model(source, "python"))
    modules = {name: loaded(tmp_path / f"{name}.py") for name in sources}
    random, first, second = np.random.default_rng(0), *(one[:200] for one in PAIRS)
    # Where a derivative might fail: the mirror direction, light from the viewer and from the normal, the horizon.
    first[:5] = np.array([[0.6, 0.0, 0.8], [0.6, 0.0, 0.8], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.6, 0.0, -0.8]])
    second[:4] = np.array([[-0.6, 0.0, 0.8], [0.6, 0.0, 0.8], [0.0, 0.0, 1.0], [-0.6, 0.0, 0.8]])
    weight = random.uniform(0.5, 1.0, (*first.shape[:1], 3))
    np.savez(tmp_path / "pairs.npz", omega_in=first, omega_out=second, weight=weight)
    subprocess.run([sys.executable, "-W", "error", array_libraries.__file__, library, tmp_path], check=True)

    for name, module in modules.items():
        with np.load(tmp_path / f"{name}.npz") as stored:
            found = dict(stored)
        np.testing.assert_allclose(found.pop("values"), module.evaluate(first, second), rtol=1e-12)
        assert all(np.isfinite(slope).all() for slope in found.values())
        regular, arrays = slice(5, None), {k: np.asarray(v) for k, v in module.PARAMETERS.items()}
        for changed in (*arrays, "omega_in", "omega_out"):
            of = {"omega_in": first, "omega_out": second}.get(changed, arrays.get(changed))
            assert of is not None
            step = 1e-6 * random.normal(size=of.shape) * (np.abs(of) + 1e-3)
            if changed.startswith("omega"):
                step[:5] = 0.0
            values = []
            for sign in (1.0, -1.0):
                now = arrays | {"omega_in": first, "omega_out": second} | {changed: of + sign * step}
                values.append(module.evaluate(now.pop("omega_in"), now.pop("omega_out"), now))
            steps = (weight * (values[0] - values[1]) / 2.0)[regular if changed.startswith("omega") else slice(None)]
            assert np.sum(found[f"by {changed}"] * step) == pytest.approx(steps.sum(), rel=1e-5, abs=1e-12), changed


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


def lobes_with(model: dsbrdf.DSBRDF, name: str) -> NDArray[np.bool_]:
    """Lobes that have a parameter: a center or an elongation that is not 0."""
    some = {"center": model.center.any(axis=(0, 1)), "elongation": model.elongation.any(axis=0)}
    return np.asarray(some.get(name, np.ones(model.n_lobes, bool)))


def prepared(name: str) -> ModuleType:
    module = mitsuba_variant(name)
    register()
    return module


def bsdf_of(module: ModuleType, model: DSBRDF, folder: Path) -> Any:
    dsbrdf.save(model, folder / "model.json")
    return module.load_dict({"type": "dsbrdf", "filename": str(folder / "model.json")})


@pytest.mark.parametrize("kind", MODELS)
def test_derivatives_in_mitsuba(kind: str, tmp_path: Path) -> None:
    """Along a random change of each parameter; those in the directions are finite."""
    module, dr, model = prepared("llvm_ad_rgb"), importlib.import_module("drjit"), MODELS[kind]
    wi, wo = unusual_pairs()
    angles, bsdf = half_difference(wo, wi), bsdf_of(module, model, tmp_path)
    parameters, context = module.traverse(bsdf), module.BSDFContext()
    surface, towards = surface_at(module, wi.T.astype(np.float32)), module.Vector3f(wo.T.astype(np.float32))
    value, random = model.evaluate(*angles) * wo[:, 2:], np.random.default_rng(1)
    for name in PARAMETERS:
        array, stored = getattr(model, name), lobes_with(model, name)
        if not stored.any():
            assert name not in parameters
            continue
        change = random.uniform(0.5, 1.0, array.shape) * np.where(stored, np.maximum(np.abs(array), 0.1), 0.0)
        up, down = (replace(model, **{name: array + sign * 1e-6 * change}).evaluate(*angles) for sign in (1, -1))
        expected = (up - down) / 2e-6 * wo[:, 2:]
        dr.enable_grad(parameters[name])
        parameters.set_dirty(name)
        parameters.update()
        dr.set_grad(parameters[name], module.TensorXf(change[..., stored].astype(np.float32)))
        derivative = np.array(dr.forward_to(bsdf.eval(context, surface, towards)), dtype=float).T
        dr.disable_grad(parameters[name])
        assert np.max(np.abs(derivative - expected) / np.maximum(np.abs(expected) + 0.1 * value, 1e-9)) < 1e-3, name
    dr.enable_grad(towards, surface.wi)
    dr.backward(dr.sum(bsdf.eval(context, surface, towards) + bsdf.pdf(context, surface, towards)))
    assert all(np.isfinite(np.array(dr.grad(vector))).all() for vector in (towards, surface.wi))


@pytest.mark.parametrize(("kind", "name"), [("elongated rings and cusps", "llvm_ad_rgb"), ("paper", "scalar_rgb")])
def test_changed_parameters_of_the_bsdf_change_the_values(kind: str, name: str, tmp_path: Path) -> None:
    variant, model, wi, wo = prepared(name), MODELS[kind], [0.6, 0.0, 0.8], [-0.48, 0.36, 0.8]
    bsdf = bsdf_of(variant, model, tmp_path)
    parameters = variant.traverse(bsdf)
    for parameter in PARAMETERS:
        np.testing.assert_allclose(getattr(bsdf.model(), parameter), getattr(model, parameter), rtol=1e-6, atol=1e-9)
        wanted = getattr(model, parameter)[..., lobes_with(model, parameter)]
        assert wanted.size == 0 or tuple(parameters[parameter].shape) == wanted.shape
    parameters["amplitude"] = 2.0 * parameters["amplitude"]
    parameters["gamma"] = 1.1 * parameters["gamma"]
    parameters.update()
    now = bsdf.model()
    np.testing.assert_allclose(now.amplitude, 2.0 * model.amplitude, rtol=1e-6)
    value = np.ravel(bsdf.eval(variant.BSDFContext(), surface_at(variant, wi), variant.Vector3f(wo)))
    np.testing.assert_allclose(value, now.evaluate_directions(wo, wi) * wo[2], rtol=1e-4)


def test_a_variant_with_polarisation_is_refused() -> None:
    mitsuba_variant("scalar_spectral_polarized")
    with pytest.raises(InvalidArgumentError, match="without polarisation"):
        register()


def test_a_wrong_file_or_property_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    llvm = prepared("llvm_ad_rgb")
    (tmp_path / "a.json").write_text("{}")
    monkeypatch.chdir(tmp_path)
    for properties, words in (
        ({"filename": 3.0}, 'the BSDF "dsbrdf" needs the property "filename"'),
        ({"filename": "lost.json"}, "there is no file lost.json"),
        ({"filename": "a.json"}, "a.json: The data is not a stored model"),
    ):
        with pytest.raises(RuntimeError) as caught:
            llvm.load_dict({"type": "dsbrdf", **properties})
        assert words in str(caught.value).strip().splitlines()[-1]
