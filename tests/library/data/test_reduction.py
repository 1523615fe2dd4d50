"""The reduction against loops over the samples, and what a bin counts against the formulas."""

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dsbrdf import InvalidArgumentError, Measurement, Profiles, profiles
from dsbrdf.arrays import Array
from dsbrdf.data import DEFAULT_HORIZON_CUTOFF, PHI_DIFF, THETA_DIFF, THETA_HALF, directions
from dsbrdf.data.reduction import N_BINS, FoldedProfiles, bin_weights, seen_weight
from tests.support.reproduced import assert_reproduced

CELLS = [(0, 0), (0, 30), (30, 0), (40, 33), (55, 60), (10, 85), (60, 75), (89, 10), (35, 80)]
"""Indices (theta_half, theta_diff) at which loops are run: the normal, the horizon, grazing and in between."""


@pytest.fixture(scope="module")
def speckled(plastic: Measurement) -> Measurement:
    holes = np.random.default_rng(5).uniform(size=plastic.valid.shape) < 0.3
    return Measurement.from_values(plastic.values, plastic.valid & ~holes)


def samples_of(measurement: Measurement, channel: int, i: int, j: int, cutoff: float | None) -> tuple[Array, Array]:
    """Values, and cosines of omega_in, of the samples that count at a cell."""
    heights = np.array(directions(THETA_HALF[i], THETA_DIFF[j], PHI_DIFF))[..., 2]
    lowest = np.arccos(np.clip(heights.min(axis=0), -1.0, 1.0))
    used = measurement.valid[i, j] & (lowest <= (np.pi if cutoff is None else cutoff) + 1e-9)
    return (measurement.stored[channel, i, j] * measurement.scale[channel])[used], heights[0, used]


@pytest.mark.parametrize("cutoff", [DEFAULT_HORIZON_CUTOFF, None, 0.6])
@pytest.mark.parametrize("weighting", ["plain", "cosine", "log"])
def test_cells_are_those_of_a_loop_over_samples(speckled: Measurement, cutoff: float | None, weighting: str) -> None:
    found = profiles(speckled, horizon_cutoff=cutoff, weighting=weighting)
    filled = 0
    for (i, j), channel in itertools.product(CELLS, (0, 2)):
        values, cosines = samples_of(speckled, channel, i, j, cutoff)
        typical = float(values.mean()) if values.size else 0.0
        # 1, the squared cosine, or the square of the derivative of log(1 + f cos) at the typical f.
        formulas = {"plain": cosines**0, "cosine": cosines**2, "log": (cosines / (1.0 + typical * cosines)) ** 2}
        weights = formulas[weighting]
        mean = np.average(values, weights=weights) if values.size else 0.0
        cell = channel, j, i
        assert found.weight[cell] == pytest.approx(weights.sum(), rel=1e-12)
        assert found.mean[cell] == pytest.approx(mean, rel=1e-12)
        assert found.within[cell] == pytest.approx(np.sum(weights * (values - mean) ** 2), rel=1e-9, abs=1e-15)
        filled += bool(values.size)
    assert filled >= 6


def test_the_cutoff_itself_counts_and_the_next_degree_does_not(plastic: Measurement) -> None:
    # At theta_half = 0 both directions are at theta_diff, at theta_diff = 0 both are at theta_half.
    usual = profiles(plastic).weight
    assert usual[0, :, 0].tolist() == [180.0] * 81 + [0.0] * 9
    assert usual[0, 0].tolist() == [180.0 if angle <= 80.0 + 1e-9 else 0.0 for angle in np.degrees(THETA_HALF)]


def test_what_is_stored_at_invalid_nodes_does_not_matter(plastic: Measurement) -> None:
    robust_log = profiles(plastic, horizon_cutoff=None, weighting="log", robust=True)
    stored = plastic.stored.copy()
    stored[:, ~plastic.valid] = 1e6
    other = Measurement(stored, plastic.scale, plastic.valid, "other", "")
    assert (robust_log.horizon_cutoff, robust_log.weighting, robust_log.robust) == (None, "log", True)
    assert (robust_log.name, robust_log.sha256) == (plastic.name, plastic.sha256)
    for expected in (profiles(plastic), robust_log):
        cutoff, weighting, robust = expected.horizon_cutoff, expected.weighting, expected.robust
        found = profiles(other, horizon_cutoff=cutoff, weighting=weighting, robust=robust)
        for name in ("mean", "weight", "within"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_without_any_spread_nothing_is_an_outlier(matte: Measurement) -> None:
    clean = profiles(matte)
    exact = clean.within == 0.0
    np.testing.assert_allclose(profiles(matte, robust=True).weight[exact], clean.weight[exact], rtol=1e-6)


def expected_robust_weights(values: Array) -> Array:
    """1 up to 6 standard deviations from the median, these from the third quartile; 0 from 12 on."""
    distances = np.abs(values - np.median(values))
    scale = max(np.sort(distances)[3 * (len(values) - 1) // 4] / 1.1503, 0.01 * float(np.median(values)))
    return np.interp(distances / scale, [6.0, 12.0], [1.0, 0.0])


def folded_samples(measurement: Measurement, channel: int, i: int, j: int, fold: int) -> tuple[Array, Array]:
    """Values and cos(phi_diff)**2 of the valid samples in a bin of the folded phi_diff, by looking at each."""
    (members,) = np.nonzero(measurement.valid[i, j])
    members = np.array([k for k in members if min(k, 180 - k) // 10 == fold], dtype=int)
    return (measurement.stored[channel, i, j] * measurement.scale[channel])[members], np.cos(PHI_DIFF[members]) ** 2


def test_folded_bins_are_those_of_a_loop_over_the_samples_up_to_the_horizon(speckled: Measurement) -> None:
    folded, seen = profiles(speckled, horizon_cutoff=float(np.radians(30.0))).folded, 0
    assert folded.mean.shape == folded.weight.shape == (3, 90, 90, N_BINS)
    assert folded.cos2_phi.shape == (90, 90, N_BINS)
    for (i, j), fold, channel in itertools.product(CELLS, range(N_BINS), (0, 2)):
        values, squares = folded_samples(speckled, channel, i, j, fold)
        cell = channel, j, i, fold
        assert folded.weight[cell] == len(values)
        assert folded.mean[cell] == pytest.approx(sum(values) / max(len(values), 1), rel=1e-12)
        assert folded.cos2_phi[j, i, fold] == pytest.approx(sum(squares) / max(len(squares), 1), abs=1e-12)
        seen += bool(values.size)
    assert seen > 60


def test_robust_weights_fall_with_the_distance_from_the_median_of_a_cell_or_a_bin(plastic: Measurement) -> None:
    """Bins of fewer than 5 samples are judged together with the bins beside them."""
    # Samples are too large, some by a little and some by orders of magnitude.
    tails = np.abs(np.random.default_rng(7).standard_t(1.5, plastic.stored.shape))
    heavy_tailed = Measurement.from_values(plastic.values * (1.0 + 0.05 * tails), plastic.valid)
    found, n_graded, n_few = profiles(heavy_tailed, robust=True), 0, 0
    for i, j in CELLS:
        bins = [folded_samples(heavy_tailed, 1, i, j, fold)[0] for fold in range(-1, N_BINS + 1)]
        groups: list[tuple[Any, tuple[int, ...], Array, Array]] = [
            (found.folded, (1, j, i, fold), bins[fold + 1], np.concatenate([bins[fold], bins[fold + 2]]))
            for fold in range(N_BINS)
        ]
        whole = samples_of(heavy_tailed, 1, i, j, DEFAULT_HORIZON_CUTOFF)[0]
        for data, cell, values, beside in (*groups, (found, (1, j, i), whole, whole[:0])):
            if values.size:
                is_few = values.size < 5
                judged = np.concatenate([values, beside]) if is_few else values
                weights = expected_robust_weights(judged)[: values.size]
                assert data.weight[cell] == pytest.approx(float(weights.sum()), rel=1e-9)
                if weights.any():
                    assert data.mean[cell] == pytest.approx(float(np.average(values, weights=weights)), rel=1e-9)
                n_graded += bool(np.any((weights > 0.1) & (weights < 0.9)))
                n_few += is_few
    assert n_graded > 20
    assert n_few > 5


OUT_OF_RANGE = [*({"horizon_cutoff": angle} for angle in (0.0, -0.1, 1.6, np.nan, np.inf)), {"weighting": "square"}]


@pytest.mark.parametrize("options", OUT_OF_RANGE, ids=repr)
def test_options_out_of_range_are_refused(plastic: Measurement, options: dict[str, Any]) -> None:
    with pytest.raises(InvalidArgumentError) as caught:
        profiles(plastic, **options)
    assert_reproduced(f"options/profiles {options}", str(caught.value))


CUTOFF = float(np.radians(80.0))
BINS: list[tuple[int, int, int]] = [(0, 40, 3), (30, 20, 0), (60, 30, 8), (70, 25, 4), (75, 12, 2)]
"""Indices (theta_diff, theta_half, bin) for formulas written out: within the cutoff, theta_half >= 1 degree."""


@pytest.fixture
def folded(plastic_profiles: Profiles) -> FoldedProfiles:
    return plastic_profiles.folded


def cosines(folded: FoldedProfiles, j: int, i: int, fold: int) -> tuple[float, float]:
    """Cosines of both directions to the normal at the mean cos(phi_diff)**2 of the bin."""
    level = np.cos(THETA_DIFF[j]) * np.cos(THETA_HALF[i])
    swing = np.sin(THETA_DIFF[j]) * np.sin(THETA_HALF[i]) * np.sqrt(folded.cos2_phi[j, i, fold])
    return float(level - swing), float(level + swing)


def test_plain_cosine_and_log_are_the_formulas_within_the_cutoff(folded: FoldedProfiles) -> None:
    plain, cosine, log = (bin_weights(folded, name, CUTOFF) for name in ("plain", "cosine", "log"))
    for j, i, fold in BINS:
        cell, both = (slice(None), j, i, fold), cosines(folded, j, i, fold)
        assert min(both) > np.cos(CUTOFF)
        np.testing.assert_allclose(plain[cell], folded.weight[cell], rtol=1e-12)
        np.testing.assert_allclose(cosine[cell], folded.weight[cell] * np.prod(both), rtol=1e-9)
        mean = np.average(folded.mean[:, j, i], weights=folded.weight[:, j, i], axis=-1)
        np.testing.assert_allclose(log[cell], folded.weight[cell] * np.prod(both) / (1.0 + mean) ** 2, rtol=1e-9)


@pytest.mark.parametrize("weighting", ["balanced", "plain", "cosine", "log"])
def test_what_was_not_measured_counts_nothing_and_the_center_little(folded: FoldedProfiles, weighting: str) -> None:
    holes = np.random.default_rng(1).uniform(size=folded.weight.shape) < 0.3
    speckled = replace(folded, weight=np.where(holes, 0.0, folded.weight))
    weight = bin_weights(speckled, weighting, CUTOFF)
    assert np.isfinite(weight).all()
    assert weight.min() >= 0.0
    assert np.all(weight[speckled.weight == 0.0] == 0.0)
    for cell in BINS:
        np.testing.assert_array_equal(weight[:, *cell] > 0.0, speckled.weight[:, *cell] > 0.0)
    total = bin_weights(folded, weighting, CUTOFF).sum(axis=(0, 3))
    for j in (0, 30, 60):
        assert 0.0 < total[j, 0] < total[j, 5] < total[j, 9]


def test_weights_are_finite_if_a_mirror_reflects_all_light_in_the_center(folded: FoldedProfiles) -> None:
    needle = np.where(THETA_HALF[:, None] < np.radians(0.2), folded.mean, 1e-30)
    weight = bin_weights(replace(folded, mean=needle), "balanced", CUTOFF)
    assert np.all(np.isfinite(weight.astype(np.float32)))
    assert np.any(weight[:, :, 0] > 0.0)


@pytest.mark.parametrize("weighting", ["plain", "cosine", "log"])
def test_trust_falls_beyond_the_cutoff_down_to_nothing_at_the_horizon(folded: FoldedProfiles, weighting: str) -> None:
    trusted, all_of_it = (bin_weights(folded, weighting, cutoff) for cutoff in (CUTOFF, None))
    seen = all_of_it > 0.0
    ratio = np.where(seen, trusted / np.where(seen, all_of_it, 1.0), 1.0)
    assert np.all(ratio <= 1.0 + 1e-12)
    for j, i in ((70, 40), (40, 60)):
        lowest = np.array([min(cosines(folded, j, i, fold)) for fold in range(10)])
        expected = np.clip(lowest / np.cos(CUTOFF), 0.0, 1.0) ** 8
        np.testing.assert_allclose(ratio[1, j, i], np.where(seen[1, j, i], expected, 1.0), rtol=1e-9)
    # At theta_half = 0 both directions are at theta_diff.
    np.testing.assert_allclose(ratio[0, 80:, 0, 0], (np.cos(THETA_DIFF[80:]) / np.cos(CUTOFF)) ** 8, rtol=1e-9)
    np.testing.assert_array_equal(bin_weights(folded, weighting, np.pi / 2), all_of_it)


def test_balanced_lets_dark_nodes_count_more_than_plain_does_whatever_the_unit(folded: FoldedProfiles) -> None:
    plain, balanced = (bin_weights(folded, name, CUTOFF) for name in ("plain", "balanced"))
    loud = bin_weights(replace(folded, mean=1e3 * folded.mean), "balanced", CUTOFF)
    np.testing.assert_allclose(loud * 1e6, balanced, rtol=1e-6)
    bright, dark = (0, 0, 9, 4), (0, 0, 60, 4)  # red, at normal incidence: in the highlight, and beside it
    assert folded.mean[bright] > 4.0 * folded.mean[dark]
    assert balanced[dark] / balanced[bright] > 2.0 * plain[dark] / plain[bright]


def test_balanced_counts_errors_of_dark_values_alike_below_a_fiftieth_of_what_a_lit_material_shows() -> None:
    lit, typical = np.ones(3), 0.5
    mean = np.array([0.0, 0.01, 1.0])  # none, a fiftieth of the typical value, and far above it
    black, at_a_fiftieth, bright = seen_weight(lit, mean, typical)
    assert black / at_a_fiftieth == pytest.approx(2.0**1.2, rel=1e-6)
    assert bright == pytest.approx(1.01**-1.2, rel=1e-6)
