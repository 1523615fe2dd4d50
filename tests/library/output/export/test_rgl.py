"""The .bsdf file as Mitsuba itself evaluates and samples it."""

import importlib
import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf.data.geometry import half_difference
from dsbrdf.data.interpolation import interpolate
from dsbrdf.data.measurement import Measurement
from dsbrdf.output.export.rgl import rgl_bsdf
from tests.support.mixtures import mixture

Array = NDArray[np.float64]

pytestmark = pytest.mark.skipif(importlib.util.find_spec("mitsuba") is None, reason='"mitsuba" is not installed')
MODEL = mixture(3, 0)


@pytest.fixture(scope="module")
def mitsuba() -> ModuleType:
    module = importlib.import_module("mitsuba")
    module.set_variant("scalar_rgb")
    return module


def loaded(mitsuba: ModuleType, content: bytes, folder: Path) -> Any:
    path = folder / "material.bsdf"
    path.write_bytes(content)
    return mitsuba.load_dict({"type": "measured", "filename": str(path)})


def evaluated(mitsuba: ModuleType, bsdf: Any, omega_in: Array, omega_out: Array) -> Array:
    """Values times the cosine of omega_out, shape (n, 3)."""
    surface, context = mitsuba.SurfaceInteraction3f(), mitsuba.BSDFContext()
    values = []
    for first, second in zip(omega_in.tolist(), omega_out.tolist(), strict=True):
        surface.wi = first
        values.append(np.array(bsdf.eval(context, surface, second)))
    return np.array(values, dtype=float)


def pairs_of_directions(number: int) -> tuple[Array, Array]:
    random = np.random.default_rng(0)
    cosine, turn = random.uniform(0.1, 1.0, (2, number)), random.uniform(0.0, 2.0 * np.pi, (2, number))
    sine = np.sqrt(1.0 - cosine**2)
    first, second = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=-1)
    return first, second


def test_mitsuba_gives_the_values_of_the_model(mitsuba: ModuleType, tmp_path: Path) -> None:
    first, second = pairs_of_directions(1000)
    values = evaluated(mitsuba, loaded(mitsuba, rgl_bsdf(MODEL), tmp_path), first, second)
    expected = MODEL.evaluate_directions(first, second) * second[:, 2:]
    error = np.abs(values - expected) / expected
    assert np.median(error) < 0.01
    assert np.mean(np.abs(values - expected)) < 0.02 * np.mean(expected)


def test_mitsuba_gives_the_values_of_the_measurement(mitsuba: ModuleType, tmp_path: Path, metal: Measurement) -> None:
    first, second = pairs_of_directions(1000)
    values = evaluated(mitsuba, loaded(mitsuba, rgl_bsdf(metal, metal.name), tmp_path), first, second)
    expected = interpolate(metal).evaluate(*half_difference(first, second)) * second[:, 2:]
    # A metal without a diffuse part is nearly black away from its highlight, where nodes are few.
    assert np.median(np.abs(values - expected) / np.maximum(expected, 1e-3)) < 0.02


def test_samples_of_mitsuba_return_the_albedo(mitsuba: ModuleType, tmp_path: Path) -> None:
    bsdf, random = loaded(mitsuba, rgl_bsdf(MODEL), tmp_path), np.random.default_rng(1)
    surface, context = mitsuba.SurfaceInteraction3f(), mitsuba.BSDFContext()
    for angle in np.radians([0.0, 45.0, 75.0]):
        surface.wi = [float(np.sin(angle)), 0.0, float(np.cos(angle))]
        drawn = [bsdf.sample(context, surface, 0.5, uniform)[1] for uniform in random.random((2000, 2)).tolist()]
        weight = np.array([np.array(one) for one in drawn], dtype=float)
        albedo = MODEL.albedo(angle)
        assert weight.mean(axis=0) == pytest.approx(albedo, rel=0.03)
        assert np.all(weight.std(axis=0) < 0.5 * albedo)
