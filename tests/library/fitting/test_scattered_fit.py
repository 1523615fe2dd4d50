from typing import Any

import numpy as np
import pytest

import dsbrdf
from dsbrdf.data.geometry import directions, half_difference
from dsbrdf.data.grid import THETA_DIFF, THETA_HALF
from dsbrdf.data.reduction import Profiles
from dsbrdf.data.scattered_samples import ScatteredSamples
from dsbrdf.data.synthetic import synthetic_measurement
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.global_method import fit_global
from dsbrdf.fitting.metrics import Metrics
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.report_warnings import error_warnings, unit_warnings
from dsbrdf.fitting.sample_bins import sample_profiles, sample_rows, scattered_metrics
from dsbrdf.fitting.usual_materials import N_PAIRS, usual_material, with_usual_values
from tests.support.mixtures import deviations, mixture, scattered_directions, scattered_samples

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("coarse_sampling")]
TRUTH = mixture(2, 1)


def test_parameters_of_a_known_model_are_found() -> None:
    """Few of the samples are at grazing angles: with as many knots there as a table has, the fit runs away."""
    truth = mixture(3, 4)
    result = dsbrdf.fit(scattered_samples(truth), n_lobes=3, ring_lobes=0)
    found = deviations(result.model, truth)
    # kappa and gamma can make up for each other.
    assert max(found[name] for name in ("amplitude", "half width", "elongation")) < 0.03
    metrics = result.report.metrics
    assert metrics.relative_rms is not None
    assert metrics.relative_rms < 3e-3
    assert metrics.male is not None
    assert metrics.psnr is None
    assert not any("left out of a fit" in sentence for sentence in result.report.warnings)


def test_bins_of_moved_samples_are_the_means_of_the_model() -> None:
    samples, options = scattered_samples(TRUTH, 3000), FitOptions()
    moved = sample_profiles(samples, options, TRUTH)
    rough = sample_profiles(samples, options)
    used = moved.folded.weight[0] > 0.0
    assert moved.folded.weight[0].sum() == pytest.approx(3000)
    np.testing.assert_array_equal(moved.folded.weight, rough.folded.weight)
    j, i, b = np.nonzero(used)
    phi = np.arccos(np.sqrt(moved.folded.cos2_phi[used]))
    at_middle = TRUTH.evaluate_unmasked(THETA_HALF[i], THETA_DIFF[j], phi).T
    difference = [np.median(np.abs(data.folded.mean[:, used] / at_middle - 1.0)) for data in (moved, rough)]
    assert difference[0] < 0.005
    assert difference[1] > 5.0 * difference[0]
    assert set(b) == set(range(9))


def test_sample_counts_in_the_bin_of_the_nearest_node_of_phi_diff() -> None:
    """The bins are of 10 degrees; a node at 10 degrees is in the second one."""
    for degrees, expected in ((9.4, 0), (9.6, 1), (-9.6, 1), (170.6, 0), (89.8, 8), (100.0, 8)):
        pair = directions(*np.radians([20.0, 30.0, degrees]))
        omega_in, omega_out = (np.tile(omega, (200, 1)) for omega in pair)
        one = ScatteredSamples.from_arrays(omega_in, omega_out, np.ones((200, 3)))
        weight = sample_profiles(one, FitOptions()).folded.weight[0]
        assert np.flatnonzero(weight.sum(axis=(0, 1))).tolist() == [expected]


def test_samples_in_rows_stay_where_they_are_but_for_less_than_a_degree_of_theta_diff() -> None:
    samples, options = scattered_samples(TRUTH, 3000), FitOptions()
    data = sample_rows(samples, sample_profiles(samples, options, TRUTH), options, TRUTH)
    used = data.weight[0, ..., 0] > 0.0
    assert np.count_nonzero(used) == 3000
    row, _ = np.nonzero(used)
    theta_half, theta_diff, phi_diff = half_difference(samples.omega_in, samples.omega_out)
    np.testing.assert_allclose(np.sort(data.theta_half[used]), np.sort(theta_half))
    np.testing.assert_allclose(np.sort(data.cos2_phi[used][:, 0]), np.sort(np.cos(phi_diff) ** 2))
    assert np.abs(np.sort(data.theta_diff[row]) - np.sort(theta_diff)).max() < np.radians(1.0)
    phi = np.arccos(np.sqrt(data.cos2_phi[used][:, 0]))
    there = TRUTH.evaluate_unmasked(data.theta_half[used], data.theta_diff[row], phi)
    np.testing.assert_allclose(data.mean[:, used, 0].T, there, rtol=1e-9)


def scaled(samples: ScatteredSamples, factor: Any, notes: tuple[str, ...] = ()) -> ScatteredSamples:
    """The samples with their values times a factor."""
    return ScatteredSamples.from_arrays(samples.omega_in, samples.omega_out, samples.values * factor, notes=notes)


def test_held_out_samples_are_not_fitted_cosines_are_divided_out_and_notes_are_warnings() -> None:
    """Each sample is in one of two parts, and counts there what it counts in the whole."""
    samples, rounds = scattered_samples(TRUTH, 300), list[tuple[Profiles, Profiles, Profiles]]()

    def note(data: Profiles, *arguments: Any) -> Any:
        rounds.append((data, *arguments[-1]))
        return fit_global(data, *arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dsbrdf.fitting.pipeline.fit_global", note)
        expected = dsbrdf.fit(samples, n_lobes=1, ring_lobes=0)
    assert any(
        "worse than a material that is like others: the model is that" in said for said in expected.report.warnings
    )
    assert sum("The model reflects" in said for said in expected.report.warnings) == 1  # too much, once
    for profiles in rounds:
        whole, fitted, held_out = (part.folded.weight for part in profiles)
        assert held_out.sum() > 0.1 * whole.sum()
        np.testing.assert_allclose(fitted + held_out, whole, rtol=1e-9)
    shares: list[float] = []
    multiplied = scaled(samples, samples.omega_out[:, 2:], notes=("Grey.",))
    found = dsbrdf.fit(multiplied, n_lobes=1, ring_lobes=0, cosine="out", progress=shares.append)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert shares == sorted(shares)
    np.testing.assert_allclose(found.model.evaluate(0.2, 0.5), expected.model.evaluate(0.2, 0.5), rtol=1e-6)
    assert found.report.warnings == ("Grey.", *expected.report.warnings)


@pytest.mark.parametrize("bright", [0, 7], ids=["fitted", "held out"])
def test_one_bright_sample_among_black_ones_is_fitted(bright: int) -> None:
    samples = scattered_samples(TRUTH, 200)
    one = scaled(samples, np.arange(200)[:, None] == bright)
    assert np.isfinite(dsbrdf.fit(one, n_lobes=1, ring_lobes=0).model.amplitude).all()


def test_weights_are_those_of_repeated_samples() -> None:
    samples, count = scattered_samples(TRUTH, 400), np.arange(400) % 3 + 1
    parts = samples.omega_in, samples.omega_out, samples.values
    first, second, values = (np.repeat(part, count, axis=0) for part in parts)
    repeated = ScatteredSamples.from_arrays(first, second, values)
    weighted = ScatteredSamples.from_arrays(*parts, count.astype(float))
    by_number, by_weight = (sample_profiles(one, FitOptions()).folded for one in (repeated, weighted))
    np.testing.assert_allclose(by_number.mean, by_weight.mean)
    np.testing.assert_array_equal(by_number.weight, by_weight.weight)


@pytest.mark.parametrize("cutoff", [None, float(np.radians(60.0))])
def test_metrics_of_samples_are_those_of_a_loop(cutoff: float | None) -> None:
    samples, model = scattered_samples(TRUTH, 300), mixture(1, 0)
    error = signal = logs = 0.0
    for first, second, values in zip(samples.omega_in, samples.omega_out, samples.values, strict=True):
        fitted = model.evaluate_directions(first, second)
        logs += float(np.abs(np.log((1.0 + values * first[2]) / (1.0 + fitted * first[2]))).mean()) / 300
        if cutoff is None or min(first[2], second[2]) >= np.cos(cutoff):
            error, signal = error + np.sum((values - fitted) ** 2), signal + np.sum(values**2)
    found = scattered_metrics(model, samples, cutoff)
    assert (found.relative_rms, found.male) == pytest.approx((np.sqrt(error / signal), logs), rel=1e-9)


def test_what_is_for_one_kind_of_data_is_refused_for_the_other(matte: dsbrdf.Measurement) -> None:
    with pytest.raises(InvalidArgumentError, match="cannot be fitted with method 'paper'"):
        dsbrdf.fit(scattered_samples(TRUTH, 300), method="paper")
    with pytest.raises(InvalidArgumentError, match="cosine is for scattered samples"):
        dsbrdf.fit(matte, cosine="in")
    with pytest.raises(InvalidArgumentError, match="as FitOptions or by name, not both"):
        dsbrdf.fit(matte, FitOptions(), n_lobes=1)


@pytest.fixture(scope="module")
def truth() -> dsbrdf.DSBRDF:
    """A rough plastic of GGX on a diffuse ground, as a model: none of the known materials."""
    plastic = synthetic_measurement(roughness=0.2, diffuse=(0.50, 0.40, 0.20))
    return dsbrdf.fit(dsbrdf.profiles(plastic), dsbrdf.FitOptions()).model


def in_plane(model: dsbrdf.DSBRDF) -> ScatteredSamples:
    """Five angles of incidence, 81 of reflection, 2 % noise."""
    theta_in, theta_out = np.meshgrid(np.radians([0, 15, 30, 45, 60]), np.radians(np.linspace(-80, 80, 81)))
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


def test_two_hundred_samples_or_one_plane_are_a_material(truth: dsbrdf.DSBRDF) -> None:
    assert median_error(dsbrdf.fit(scattered_samples(truth, 200)).model, truth) < 0.1
    result = dsbrdf.fit(in_plane(truth), n_lobes=3, ring_lobes=0)
    assert median_error(result.model, truth) < 0.15
    assert any("of the directions have no sample within 10 degrees" in text for text in result.report.warnings)


def test_values_of_the_usual_material_hardly_count(truth: dsbrdf.DSBRDF) -> None:
    samples = scattered_samples(truth, 1000)
    completed, far = with_usual_values(samples, truth)
    assert completed.weight[:1000].sum() == 1000.0
    assert completed.weight[1000:].sum() == pytest.approx(0.02 * N_PAIRS)
    np.testing.assert_array_equal(completed.values[:1000], samples.values)
    _, plane = with_usual_values(in_plane(truth), truth)
    assert far < 0.1 < 0.4 < plane


@pytest.mark.parametrize("level", [1e-3, 1e3])
def test_the_usual_material_follows_the_level_of_the_samples(level: float, truth: dsbrdf.DSBRDF) -> None:
    samples = scattered_samples(truth, 300)
    one, other = (usual_material(part)[0].evaluate(0.1, 0.4) for part in (samples, scaled(samples, level)))
    np.testing.assert_allclose(other, one * level, rtol=2e-3)


@pytest.mark.parametrize(
    ("factor", "side", "words"),
    [
        (1.0, None, None),
        (1500.0, None, "multiply them by 1/1500"),
        (40.0, None, "multiply them by 1/100 (are they per cent?)"),
        (np.pi, None, "multiply them by 1/pi (are they radiance factors?)"),
        (1.0, "in", 'if so, set cosine to "in"'),
        (1.0, "out", 'if so, set cosine to "out"'),
    ],
)
def test_units_far_off_are_named(factor: float, side: str | None, words: str | None, truth: dsbrdf.DSBRDF) -> None:
    samples = scattered_samples(truth, 500)
    samples = scaled(samples, factor if side is None else getattr(samples, f"omega_{side}")[:, 2:])
    usual, cost = usual_material(samples)
    said = [*unit_warnings(samples, cost, usual.albedo(np.radians([0.0, 30.0, 60.0])))]
    assert len(said) == (words is not None)
    assert (words or "") in "".join(said)


def test_an_error_that_only_samples_left_out_tell_of_is_named() -> None:
    (sentence,) = error_warnings(Metrics(relative_rms=0.1), Metrics(relative_rms=0.6))
    assert "left out of a fit relative_rms is 0.6, at those of the fit 0.1" in sentence
    assert not [*error_warnings(Metrics(relative_rms=0.1), Metrics(relative_rms=0.15))]
    assert not [*error_warnings(Metrics(relative_rms=0.001), Metrics(relative_rms=0.01))]


@pytest.mark.parametrize("value", [1e8, 1e-8])
def test_samples_at_the_limits_are_completed(value: float, truth: dsbrdf.DSBRDF) -> None:
    omega_in, omega_out = scattered_directions(truth, 400, 0)
    samples = ScatteredSamples.from_arrays(omega_in, omega_out, np.full((400, 3), value))
    completed, _ = with_usual_values(samples, usual_material(samples)[0])
    assert len(completed.values) == 400 + N_PAIRS
