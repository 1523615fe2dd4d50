"""Few samples, samples in one plane, and values in another unit."""

import numpy as np
import pytest
from numpy.typing import NDArray

import dsbrdf
from dsbrdf.data.scattered_samples import ScatteredSamples
from dsbrdf.data.synthetic import synthetic_measurement
from dsbrdf.fitting.sample_warnings import coverage_warnings, unit_warnings
from dsbrdf.fitting.usual_materials import N_PAIRS, guides, usual_material, with_usual_values
from tests.support.mixtures import scattered_directions, scattered_samples

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def truth() -> dsbrdf.DSBRDF:
    """A rough plastic of GGX on a diffuse ground, as a model: none of the known materials."""
    plastic = synthetic_measurement(roughness=0.2, diffuse=(0.50, 0.40, 0.20))
    return dsbrdf.fit(dsbrdf.profiles(plastic), dsbrdf.FitOptions()).model


def in_plane(model: dsbrdf.DSBRDF) -> ScatteredSamples:
    """Five angles of incidence, 161 of reflection, 2 % noise."""
    theta_in, theta_out = np.meshgrid(np.radians([0, 15, 30, 45, 60]), np.radians(np.linspace(-80, 80, 161)))
    zero = np.zeros(theta_in.size)
    omega_in = np.stack([-np.sin(theta_in.ravel()), zero, np.cos(theta_in.ravel())], axis=-1)
    omega_out = np.stack([np.sin(theta_out.ravel()), zero, np.cos(theta_out.ravel())], axis=-1)
    noise = 1.0 + 0.02 * np.random.default_rng(1).standard_normal((zero.size, 3))
    return ScatteredSamples.from_arrays(omega_in, omega_out, model.evaluate_directions(omega_in, omega_out) * noise)


def median_error(model: dsbrdf.DSBRDF, truth: dsbrdf.DSBRDF) -> float:
    """Median relative error at pairs within 80 degrees of the normal that no fit has seen."""
    omega_in, omega_out = scattered_directions(truth, 4000, 77)
    within = np.minimum(omega_in[:, 2], omega_out[:, 2]) > np.cos(np.radians(80.0))
    found, expected = (one.evaluate_directions(omega_in[within], omega_out[within]) for one in (model, truth))
    return float(np.median(np.abs(found - expected) / expected))


def test_the_known_materials_are_71() -> None:
    assert guides().shape == (71, 70)
    assert np.isfinite(guides()).all()


def test_samples_in_one_plane_tell_the_rest_as_materials_are_like(truth: dsbrdf.DSBRDF) -> None:
    result = dsbrdf.fit(in_plane(truth))
    assert median_error(result.model, truth) < 0.15
    assert any("of the directions have no sample within 10 degrees" in text for text in result.report.warnings)


def test_two_hundred_samples_are_a_material(truth: dsbrdf.DSBRDF) -> None:
    samples = scattered_samples(truth, 200)
    result = dsbrdf.fit(samples)
    assert median_error(result.model, truth) < 0.1


def test_values_of_the_usual_material_hardly_count(truth: dsbrdf.DSBRDF) -> None:
    samples = scattered_samples(truth, 1000)
    completed, far = with_usual_values(samples, truth)
    assert completed.weight[:1000].sum() == 1000.0
    assert completed.weight[1000:].sum() == pytest.approx(0.02 * N_PAIRS)
    np.testing.assert_array_equal(completed.values[:1000], samples.values)
    _, plane = with_usual_values(in_plane(truth), truth)
    assert far < 0.1 < 0.4 < plane


@pytest.mark.parametrize("level", [1e-3, 1.0, 1e3])
def test_the_usual_material_follows_the_level_of_the_samples(level: float, truth: dsbrdf.DSBRDF) -> None:
    samples = scattered_samples(truth, 300)
    scaled = ScatteredSamples.from_arrays(samples.omega_in, samples.omega_out, samples.values * level)
    one, other = (usual_material(part).model.evaluate(0.1, 0.4) for part in (samples, scaled))
    np.testing.assert_allclose(other, one * level, rtol=0.02)


@pytest.mark.parametrize(
    ("factor", "side", "words"),
    [
        (1500.0, None, "multiply them by 1/1500"),
        (40.0, None, "multiply them by 1/100 (are they per cent?)"),
        (np.pi, None, "multiply them by 1/pi (are they radiance factors?)"),
        (1.0, "omega_in", 'if so, set cosine to "in"'),
        (1.0, "omega_out", 'if so, set cosine to "out"'),
    ],
)
def test_units_far_off_are_named(factor: float, side: str | None, words: str, truth: dsbrdf.DSBRDF) -> None:
    samples = scattered_samples(truth, 500)
    values = samples.values * factor * (1.0 if side is None else getattr(samples, side)[:, 2:])
    wrong = ScatteredSamples.from_arrays(samples.omega_in, samples.omega_out, values)
    usual = usual_material(wrong)
    albedo = usual.model.albedo(np.radians([0.0, 30.0, 60.0]))
    (sentence,) = unit_warnings(wrong, usual, albedo)
    assert sentence.count("\n") == 0
    assert words in sentence
    right = usual_material(samples)
    assert unit_warnings(samples, right, right.model.albedo(np.radians([0.0, 30.0, 60.0]))) == ()


def test_a_material_taken_instead_of_a_fit_is_told() -> None:
    (sentence,) = coverage_warnings(0.0, is_usual=True)
    assert "the model is that material" in sentence
    assert coverage_warnings(0.0, is_usual=False) == ()
