import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dsbrdf.data.grid import THETA_DIFF, THETA_HALF
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import Profiles
from dsbrdf.errors import FitError, MeasurementFormatError
from dsbrdf.fitting.metrics import relative_errors, sample_errors
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import fit, profiles_for
from dsbrdf.fitting.report import FitResult
from dsbrdf.model.dsbrdf import DSBRDF
from tests.support.algorithm_1 import Array


def calm_ratio(model: DSBRDF, data: Profiles) -> float:
    """Largest value of the model up to 89 degrees by the largest one measured; it must be finite and not negative."""
    theta_half = np.radians(np.concatenate([[0.0, 0.5], np.linspace(1.0, 89.0, 181)]))
    values = model.evaluate(theta_half, np.radians(np.linspace(0.0, 89.0, 361))[:, None])
    assert np.isfinite(values).all()
    assert values.min() >= 0.0
    largest = np.where(data.folded.weight > 0, data.folded.mean, 0.0).max(axis=(1, 2, 3))
    return float((values.max(axis=(0, 1)) / largest).max())


def relative_rms(model: DSBRDF, measurement: Measurement) -> float:
    found = relative_errors(sample_errors(model, measurement, FitOptions().horizon_cutoff))
    assert found is not None
    return found.relative_rms


def edited(measurement: Measurement, change: Any) -> Measurement:
    """The measurement after ``change(values, valid)``, which works in place."""
    values, valid = measurement.values.copy(), measurement.valid.copy()
    change(values, valid)
    values[:, ~valid] = -1.0
    return Measurement.from_values(values, valid, "edited")


def only(data: Profiles, kept: Array) -> Profiles:
    """The profiles with the samples of the nodes (theta_diff, theta_half) where kept is 1."""
    return replace(data, folded=replace(data.folded, weight=data.folded.weight * kept[..., None]))


@pytest.mark.parametrize("cutoff", [30.0, None])
def test_calm_with_another_cutoff(plastic: Measurement, plastic_profiles: Profiles, cutoff: float | None) -> None:
    options = FitOptions(n_lobes=3, horizon_cutoff=None if cutoff is None else float(np.radians(cutoff)))
    model = fit(profiles_for(plastic, options), options).model
    assert calm_ratio(model, plastic_profiles) < 3.0
    found = relative_errors(sample_errors(model, plastic, options.horizon_cutoff))
    assert found is not None
    assert found.relative_rms < 1.2 * found.floor


def test_calm_in_missing_regions(plastic: Measurement, plastic_profiles: Profiles, plastic_fit: FitResult) -> None:
    """A band of theta_diff, one of theta_half, and seven of eight theta_half: what lacks is met nearly as well."""
    bands, sparse = np.ones((90, 90)), np.ones((90, 1)) * (np.arange(90) % 8 == 3)
    bands[25:60] = bands[:20, 20:50] = 0.0
    reference = relative_rms(plastic_fit.model, plastic)
    assert calm_ratio(plastic_fit.model, plastic_profiles) < 2.0
    for kept, calm, error in ((bands, 3.0, 1.3 * reference), (sparse, 4.0, 0.06)):
        model = fit(only(plastic_profiles, kept)).model
        assert calm_ratio(model, plastic_profiles) < calm
        assert relative_rms(model, plastic) < error


def test_spikes_do_not_spoil_a_robust_fit(plastic: Measurement, plastic_fit: FitResult) -> None:
    def spoil(values: Array, valid: Array) -> None:
        hit = np.random.default_rng(5).uniform(size=values.shape) < 0.01
        values[hit & (np.asarray(valid) > 0)] *= 100.0

    spoiled, reference = edited(plastic, spoil), relative_rms(plastic_fit.model, plastic)
    fragile = FitOptions(n_lobes=2, ring_lobes=0)
    robust = replace(fragile, robust=True)
    error = [relative_rms(fit(profiles_for(spoiled, o), o).model, plastic) for o in (robust, fragile)]
    assert error[0] < 1.5 * reference
    assert error[1] > 2.0 * reference


def test_mask_leaves_out_what_it_masks(plastic_profiles: Profiles) -> None:
    kept = THETA_HALF <= np.pi / 2 - 1.0 * THETA_DIFF[:, None] + 1e-9
    folded = plastic_profiles.folded
    noise = np.random.default_rng(0).uniform(0.0, 50.0, folded.mean.shape)
    spoiled = replace(plastic_profiles, folded=replace(folded, mean=np.where(kept[..., None], folded.mean, noise)))
    options = FitOptions(n_lobes=1, ring_lobes=0, mask=1.0, weighting="plain")
    clean, masked = (fit(data, options).model for data in (plastic_profiles, spoiled))
    assert clean == masked
    unmasked = fit(spoiled, replace(options, mask=0.0)).model
    assert unmasked != masked


def test_red_only_material(plastic: Measurement) -> None:
    def redden(values: Array, _: Array) -> None:
        values[1:] = 0.0

    result = fit(edited(plastic, redden), n_lobes=2, ring_lobes=0)
    values = np.moveaxis(result.model.evaluate(THETA_HALF, THETA_DIFF[:, None]), -1, 0)
    assert values[1:].max() < 1e-4 * values[0].max()
    assert result.report.metrics.excess < 1.1  # type: ignore[operator]
    assert [row.channel for row in result.report.by_channel] == ["red"]


def test_nothing_left_is_said(plastic: Measurement, plastic_profiles: Profiles) -> None:
    with pytest.raises(MeasurementFormatError, match="zero in all channels; a measurement has positive values"):
        edited(plastic, lambda values, _: values.fill(0.0))
    folded, nothing = plastic_profiles.folded, np.zeros_like(plastic_profiles.folded.mean)
    for empty in (replace(folded, mean=nothing), replace(folded, weight=nothing)):
        with pytest.raises(FitError, match="the mask and the horizon cutoff leave no valid samples: raise the cutoff"):
            fit(replace(plastic_profiles, folded=empty))


@pytest.mark.filterwarnings("ignore::dsbrdf.errors.ConvergenceWarning")
@pytest.mark.parametrize(
    ("rows", "columns"),
    [([40], range(90)), ([0, 79], range(90)), (range(90), [20]), ([10], [20, 40]), ([10], [20])],
    ids=["one row", "two rows", "one column", "two nodes", "one node"],
)
def test_tiny_data(plastic_profiles: Profiles, rows: Any, columns: Any) -> None:
    folded = plastic_profiles.folded
    kept = np.zeros((90, 90))
    kept[np.ix_(list(rows), list(columns))] = 1.0
    thin = only(plastic_profiles, kept)
    result = fit(thin)
    assert calm_ratio(result.model, plastic_profiles) < 100.0
    grid = np.stack(list(result.model.evaluate_grid(THETA_HALF, THETA_DIFF, np.arccos(np.sqrt(np.full(1, 0.5))))))
    values, weight = np.moveaxis(grid[..., 0], 0, -1), thin.folded.weight.sum(axis=3)
    mean = np.sum(thin.folded.weight * folded.mean, axis=3) / np.where(weight > 0, weight, 1.0)
    error = np.sqrt(np.sum(weight * (values - mean) ** 2) / np.sum(weight * mean**2))
    assert error < 0.3
    json.dumps(result.report.to_dict(), allow_nan=False)
