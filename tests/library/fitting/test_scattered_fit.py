"""A fit of scattered samples finds the model that they were drawn from."""

from typing import Any

import numpy as np
import pytest

import dsbrdf
from dsbrdf.data.geometry import directions, half_difference
from dsbrdf.data.grid import THETA_DIFF, THETA_HALF
from dsbrdf.data.reduction import Profiles
from dsbrdf.data.scattered_samples import ScatteredSamples
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.global_method import fit_global
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.sample_bins import sample_profiles, sample_rows
from tests.support.mixtures import deviations, mixture, scattered_samples

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


def test_held_out_samples_are_not_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each sample is in one of the two parts, and counts there what it counts in the whole."""
    parts: list[tuple[Profiles, Profiles, Profiles]] = []

    def note(data: Profiles, *arguments: Any) -> Any:
        parts.append((data, *arguments[-1]))
        return fit_global(data, *arguments)

    monkeypatch.setattr("dsbrdf.fitting.pipeline.fit_global", note)
    dsbrdf.fit(scattered_samples(TRUTH, 400), n_lobes=1, ring_lobes=0)
    for part in parts:
        whole, fitted, held_out = (profiles.folded.weight for profiles in part)
        assert held_out.sum() > 0.1 * whole.sum()
        np.testing.assert_allclose(fitted + held_out, whole, rtol=1e-9)


def test_one_bright_sample_among_black_ones_is_fitted() -> None:
    """It is among those that lobes are fitted to or among those held out, never in both."""
    samples = scattered_samples(TRUTH, 300)
    for bright in (0, 7):
        values = np.zeros((300, 3))
        values[bright] = 1.0
        one = ScatteredSamples.from_arrays(samples.omega_in, samples.omega_out, values)
        assert np.isfinite(dsbrdf.fit(one, n_lobes=1, ring_lobes=0).model.amplitude).all()


def test_weights_are_those_of_repeated_samples() -> None:
    samples = scattered_samples(TRUTH, 400)
    first, second, values = samples.omega_in, samples.omega_out, samples.values
    twice = [np.concatenate([part, part]) for part in (first, second, values)]
    doubled = ScatteredSamples.from_arrays(twice[0], twice[1], twice[2])
    weighted = ScatteredSamples.from_arrays(first, second, values, np.full(400, 2.0))
    by_number, by_weight = (sample_profiles(one, FitOptions()).folded for one in (doubled, weighted))
    np.testing.assert_allclose(by_number.mean, by_weight.mean)
    np.testing.assert_array_equal(by_number.weight, by_weight.weight)


def test_the_papers_method_needs_slices() -> None:
    with pytest.raises(InvalidArgumentError, match="cannot be fitted with method 'paper'"):
        dsbrdf.fit(scattered_samples(TRUTH, 300), method="paper")


def test_values_times_a_cosine_are_divided_by_it_and_notes_are_warnings() -> None:
    samples = scattered_samples(TRUTH, 300)
    multiplied = ScatteredSamples.from_arrays(
        samples.omega_in, samples.omega_out, samples.values * samples.omega_out[:, 2:], notes=("Grey.",)
    )
    found = dsbrdf.fit(multiplied, n_lobes=1, ring_lobes=0, cosine="out")
    expected = dsbrdf.fit(samples, n_lobes=1, ring_lobes=0)
    np.testing.assert_allclose(found.model.evaluate(0.2, 0.5), expected.model.evaluate(0.2, 0.5), rtol=1e-6)
    assert found.report.warnings == ("Grey.", *expected.report.warnings)


def test_a_measurement_on_the_grid_has_no_values_times_a_cosine(matte: dsbrdf.Measurement) -> None:
    with pytest.raises(InvalidArgumentError, match="cosine is for scattered samples"):
        dsbrdf.fit(matte, cosine="in")
