"""What a bin of samples counts: against the formulas, and that nothing counts where nothing was measured."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from dsbrdf import Profiles
from dsbrdf.data import THETA_DIFF, THETA_HALF
from dsbrdf.data.reduction import FoldedProfiles, bin_weights, seen_weight

CUTOFF = float(np.radians(80.0))
WEIGHTINGS = ("balanced", "plain", "cosine", "log")
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


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_what_was_not_measured_counts_nothing_the_center_little_and_the_rest_something(
    folded: FoldedProfiles, weighting: str
) -> None:
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


@pytest.mark.parametrize("weighting", ["plain", "cosine", "log"])
def test_trust_falls_beyond_the_cutoff_down_to_nothing_at_the_horizon(folded: FoldedProfiles, weighting: str) -> None:
    trusted, all_of_it = (bin_weights(folded, weighting, cutoff) for cutoff in (CUTOFF, None))
    seen = all_of_it > 0.0
    ratio = np.where(seen, trusted / np.where(seen, all_of_it, 1.0), 1.0)
    assert np.all(ratio <= 1.0 + 1e-12)
    for j, i in ((70, 40), (40, 60)):
        lowest = np.array([min(cosines(folded, j, i, fold)) for fold in range(10)])
        np.testing.assert_allclose(ratio[1, j, i][lowest > np.cos(CUTOFF) + 1e-9], 1.0, rtol=1e-9)
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


def test_material_without_phi_diff_has_finite_weights(folded: FoldedProfiles) -> None:
    flat = replace(folded, mean=np.broadcast_to(folded.mean[..., :1], folded.mean.shape))
    black = replace(folded, mean=np.zeros_like(folded.mean))
    for data, weighting in itertools.product((flat, black), WEIGHTINGS):
        assert np.isfinite(bin_weights(data, weighting, CUTOFF)).all()
