"""The .bsdf file as Mitsuba itself evaluates and samples it."""

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf import Measurement
from dsbrdf.data import half_difference
from dsbrdf.data.rgl import parse_tensors
from dsbrdf.output.export.rgl import SPECTRA, WAVELENGTHS, rgl_bsdf
from tests.support.known_models import pairs_of_directions
from tests.support.mitsuba_variants import mitsuba_variant
from tests.support.mixtures import mixture

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]

MODEL = mixture(3, 0)


@pytest.fixture
def mitsuba() -> ModuleType:
    return mitsuba_variant("scalar_rgb")


@pytest.fixture(scope="module")
def content() -> bytes:
    return rgl_bsdf(MODEL)


@pytest.fixture(scope="module")
def spectral() -> bytes:
    return rgl_bsdf(MODEL, spectral=True)


def loaded(mitsuba: ModuleType, content: bytes, folder: Path) -> Any:
    path = folder / "material.bsdf"
    path.write_bytes(content)
    return mitsuba.load_dict({"type": "measured", "filename": str(path)})


def evaluated(mitsuba: ModuleType, bsdf: Any, omega_in: Array, omega_out: Array, **surface_is: Any) -> Array:
    """Values times the cosine of omega_out, shape (n, channels)."""
    surface, context = mitsuba.SurfaceInteraction3f(), mitsuba.BSDFContext()
    for name, value in surface_is.items():
        setattr(surface, name, value)
    values = []
    for first, second in zip(omega_in.tolist(), omega_out.tolist(), strict=True):
        surface.wi = first
        values.append(np.ravel(bsdf.eval(context, surface, second)))
    return np.array(values, dtype=float)


def test_mitsuba_gives_the_values_of_the_model(mitsuba: ModuleType, content: bytes, tmp_path: Path) -> None:
    first, second = pairs_of_directions(1000, spread=None)
    values = evaluated(mitsuba, loaded(mitsuba, content, tmp_path), first, second)
    expected = MODEL.evaluate_directions(first, second) * second[:, 2:]
    error = np.abs(values - expected) / expected
    assert np.median(error) < 0.01
    assert np.mean(np.abs(values - expected)) < 0.02 * np.mean(expected)


def test_mitsuba_gives_the_values_of_the_measurement(mitsuba: ModuleType, tmp_path: Path, metal: Measurement) -> None:
    first, second = pairs_of_directions(1000, spread=None)
    values = evaluated(mitsuba, loaded(mitsuba, rgl_bsdf(metal, metal.name), tmp_path), first, second)
    expected = metal.interpolated.evaluate(*half_difference(first, second)) * second[:, 2:]
    # A metal without a diffuse part is nearly black away from its highlight, where nodes are few.
    assert np.median(np.abs(values - expected) / np.maximum(expected, 1e-3)) < 0.02


def test_samples_of_mitsuba_return_the_albedo(mitsuba: ModuleType, content: bytes, tmp_path: Path) -> None:
    bsdf, random = loaded(mitsuba, content, tmp_path), np.random.default_rng(1)
    surface, context = mitsuba.SurfaceInteraction3f(), mitsuba.BSDFContext()
    for angle in np.radians([0.0, 45.0, 75.0]):
        surface.wi = [float(np.sin(angle)), 0.0, float(np.cos(angle))]
        drawn = [bsdf.sample(context, surface, 0.5, uniform)[1] for uniform in random.random((2000, 2)).tolist()]
        weight = np.array([np.array(one) for one in drawn], dtype=float)
        albedo = MODEL.albedo(angle)
        assert weight.mean(axis=0) == pytest.approx(albedo, rel=0.03)
        assert np.all(weight.std(axis=0) < 0.5 * albedo)


def test_spectral_variants_get_the_same_colours(spectral: bytes, tmp_path: Path) -> None:
    module, (first, second) = mitsuba_variant("scalar_spectral"), pairs_of_directions(100, spread=None)
    bsdf, wavelengths = loaded(module, spectral, tmp_path), [380.0, 470.0, 560.0, 720.0]
    values = evaluated(module, bsdf, first, second, wavelengths=wavelengths)
    rgb = MODEL.evaluate_directions(first, second) * second[:, 2:]
    expected = rgb @ np.stack([np.interp(wavelengths, WAVELENGTHS, row) for row in SPECTRA])
    assert np.median(np.abs(values - expected) / expected) < 0.01


def test_fields_are_those_that_pbrt_asks_for(spectral: bytes) -> None:
    fields = parse_tensors(spectral)
    n_theta, n_wavelengths = fields["theta_i"].size, fields["wavelengths"].size
    assert fields["phi_i"].size <= 2  # isotropic
    assert fields["spectra"].shape == (1, n_theta, n_wavelengths, *fields["luminance"].shape[2:])
    assert fields["luminance"].shape[:2] == fields["vndf"].shape[:2] == (1, n_theta)
    assert fields["ndf"].ndim == fields["sigma"].ndim == 2
    single = ("theta_i", "phi_i", "wavelengths", "ndf", "sigma", "vndf", "luminance", "spectra")
    assert {fields[name].dtype.str for name in single} == {"<f4"}
    assert fields["description"].dtype.str == fields["jacobian"].dtype.str == "|u1"


def test_spectra_lit_by_d65_have_the_colours_they_came_from(mitsuba: ModuleType) -> None:
    wavelengths = np.arange(360.0, 831.0)
    matching = np.array([mitsuba.cie1931_xyz(at) for at in wavelengths.tolist()])
    weight = matching * np.array([mitsuba.cie_d65(at) for at in wavelengths.tolist()])[:, None]
    spectra = np.stack([np.interp(wavelengths, WAVELENGTHS, row) for row in SPECTRA])
    xyz = spectra @ weight / weight[:, 1].sum()
    rgb = np.array([np.ravel(mitsuba.xyz_to_srgb(mitsuba.Color3f(row))) for row in xyz.tolist()])
    assert rgb == pytest.approx(np.eye(3), abs=2e-4)
    assert SPECTRA.min() >= 0.0
    assert SPECTRA.sum(axis=0) == pytest.approx(1.0)
