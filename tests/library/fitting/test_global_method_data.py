"""The default fit where data are missing, wrong or few."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dsbrdf.data.grid import THETA_DIFF, THETA_HALF
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import Profiles, profiles
from dsbrdf.errors import DSBRDFError, FitError, MeasurementFormatError
from dsbrdf.fitting.metrics import on_grid, relative_errors
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import fit
from dsbrdf.fitting.report import FitResult
from dsbrdf.model.dsbrdf import DSBRDF
from tests.support.algorithm_1 import Array
from tests.support.models import curve_error


def calm_ratio(model: DSBRDF, data: Profiles) -> float:
    """Largest value of the model anywhere by the largest one measured; the model must be finite and not negative."""
    theta_half = np.radians(np.concatenate([[0.0, 0.5], np.linspace(1.0, 90.0, 181)]))
    values = model.evaluate(theta_half, np.radians(np.linspace(0.0, 90.0, 361))[:, None])
    assert np.isfinite(values).all()
    assert values.min() >= -1e-9 * values.max()
    largest = np.where(data.weight > 0, data.mean, 0.0).max(axis=(1, 2))
    return float((values.max(axis=(0, 1)) / largest).max())


def edited(measurement: Measurement, change: Any) -> Measurement:
    """The measurement after ``change(values, valid)``, which works in place."""
    values, valid = measurement.values.copy(), measurement.valid.copy()
    change(values, valid)
    values[:, ~valid] = -1.0
    return Measurement.from_values(values, valid, "edited")


@pytest.fixture(scope="module")
def plastic_profiles(plastic: Measurement) -> Profiles:
    return profiles(plastic)


@pytest.fixture(scope="module")
def fitted(plastic: Measurement) -> FitResult:
    return fit(plastic)


# Beyond the data


def test_calm_beyond_the_cutoff(fitted: FitResult, plastic_profiles: Profiles) -> None:
    assert calm_ratio(fitted.model, plastic_profiles) < 1.5


@pytest.mark.parametrize("cutoff", [30.0, 60.0])
def test_calm_beyond_a_low_cutoff(plastic: Measurement, cutoff: float) -> None:
    data = profiles(plastic, horizon_cutoff=np.radians(cutoff))
    result = fit(data, FitOptions(horizon_cutoff=np.radians(cutoff)))
    assert calm_ratio(result.model, data) < 2.0
    assert result.report.metrics["excess"] < 1.2  # type: ignore[operator]


def test_calm_in_missing_regions(plastic: Measurement) -> None:
    def remove(_: Array, valid: Array) -> None:
        valid[:, 25:60] = 0  # a band of theta_diff
        valid[20:50, :20] = 0  # and of theta_half

    measurement = edited(plastic, remove)
    data = profiles(measurement)
    result = fit(data)
    assert calm_ratio(result.model, data) < 2.0
    assert result.report.metrics["excess"] < 1.1  # type: ignore[operator]
    # What was taken away is met nearly as well: knots on both sides hold the spline.
    whole = relative_errors(result.model, profiles(plastic))
    assert whole["excess"] < 1.1  # type: ignore[operator]


def test_everything_above_the_horizon(plastic: Measurement) -> None:
    data = profiles(plastic, horizon_cutoff=None)
    result = fit(data, FitOptions(horizon_cutoff=None))
    assert result.report.slices["theta_diff"][-1] > np.radians(85.0)
    assert result.report.metrics["excess"] < 1.3  # type: ignore[operator]
    assert calm_ratio(result.model, data) < 2.0


# Outliers and weights


def test_spikes_do_not_spoil_a_robust_fit(plastic: Measurement) -> None:
    def spoil(values: Array, valid: Array) -> None:
        hit = np.random.default_rng(5).uniform(size=values.shape) < 0.01
        values[hit & (np.asarray(valid) > 0)] *= 100.0

    spoiled, clean = edited(plastic, spoil), profiles(plastic)
    reference = relative_errors(fit(plastic).model, clean)["relative_rms"]
    robust = relative_errors(fit(spoiled, FitOptions(robust=True)).model, clean)["relative_rms"]
    assert reference is not None
    assert robust is not None
    assert robust < 1.05 * reference
    fragile = relative_errors(fit(spoiled, FitOptions(n_lobes=2, ring_lobes=0)).model, clean)["relative_rms"]
    assert fragile > 2.0 * reference  # type: ignore[operator]


def test_outliers_over_theta_half_are_weighted_down(plastic: Measurement) -> None:
    data = profiles(plastic, robust=True)
    hit = np.random.default_rng(2).uniform(size=data.mean.shape) < 0.01
    spoiled = replace(data, mean=np.where(hit & (data.weight > 0), 3.0 * data.mean + 1.0, data.mean))
    options = FitOptions(n_lobes=2, ring_lobes=0, robust=True)
    reference, robust = (fit(d, options).model for d in (data, spoiled))
    fragile = fit(replace(spoiled, robust=False), replace(options, robust=False)).model
    error = [curve_error(model, reference, profiles(plastic)) for model in (robust, fragile)]
    assert error[0] < 0.5 * error[1]


# Options


def test_mask_leaves_out_what_it_masks(plastic_profiles: Profiles) -> None:
    kept = THETA_HALF <= np.pi / 2 - 1.0 * THETA_DIFF[:, None] + 1e-9
    noise = np.random.default_rng(0).uniform(0.0, 50.0, plastic_profiles.mean.shape)
    spoiled = replace(plastic_profiles, mean=np.where(kept, plastic_profiles.mean, noise))
    options = FitOptions(n_lobes=2, ring_lobes=0, mask=1.0)
    clean, masked = (fit(data, options).model for data in (plastic_profiles, spoiled))
    np.testing.assert_array_equal(clean.kappa, masked.kappa)
    np.testing.assert_array_equal(clean.gamma, masked.gamma)


def test_nothing_left_is_said(plastic_profiles: Profiles) -> None:
    empty = replace(plastic_profiles, weight=np.zeros_like(plastic_profiles.weight))
    with pytest.raises(FitError, match=r"^the mask and the horizon cutoff leave no valid samples: raise the cutoff or"):
        fit(empty)


# Little or odd data


def test_every_eighth_theta_half(plastic: Measurement) -> None:
    def thin(_: Array, valid: Array) -> None:
        valid[np.arange(90) % 8 != 3] = 0

    result = fit(edited(plastic, thin))
    whole = relative_errors(result.model, profiles(plastic))
    assert whole["relative_rms"] < 0.04  # type: ignore[operator]
    assert calm_ratio(result.model, profiles(plastic)) < 4.0


def test_red_only_material(plastic: Measurement) -> None:
    def redden(values: Array, _: Array) -> None:
        values[1:] = 0.0

    result = fit(edited(plastic, redden))
    values = on_grid(result.model)
    assert values[1:].max() < 1e-6 * values[0].max()
    assert result.report.metrics["excess"] < 1.1  # type: ignore[operator]
    assert [row["channel"] for row in result.report.by_channel] == ["red"]


def test_black_material_is_an_error_that_says_so(plastic: Measurement, plastic_profiles: Profiles) -> None:
    with pytest.raises(MeasurementFormatError, match="zero in all channels; a measurement has positive values"):
        edited(plastic, lambda values, _: values.fill(0.0))
    black = replace(plastic_profiles, mean=np.zeros((3, 90, 90)), within=np.zeros((3, 90, 90)))
    with pytest.raises(DSBRDFError, match="zero"):
        fit(black)


def part_of(data: Profiles, rows: Any, columns: Any) -> Profiles:
    """Profiles with nothing but these rows of theta_diff and columns of theta_half."""
    kept = np.zeros((90, 90), bool)
    kept[np.ix_(list(rows), list(columns))] = True
    mean, weight, within = (np.where(kept, array, 0.0) for array in (data.mean, data.weight, data.within))
    return replace(data, mean=mean, weight=weight, within=within)


@pytest.mark.parametrize(
    ("rows", "columns"),
    [([40], range(90)), ([0, 79], range(90)), (range(90), [20]), ([10], [20, 40]), ([10], [20])],
    ids=["one row", "two rows", "one column", "two nodes", "one node"],
)
def test_tiny_data(plastic_profiles: Profiles, rows: Any, columns: Any) -> None:
    data = part_of(plastic_profiles, rows, columns)
    result = fit(data)
    assert calm_ratio(result.model, data) < 10.0
    assert result.report.metrics["relative_rms"] < 0.1  # type: ignore[operator]
    json.dumps(result.report.__dict__, allow_nan=False)


def test_nothing_but_the_normal_is_too_little(plastic_profiles: Profiles) -> None:
    with pytest.raises(FitError, match="leave no valid samples"):
        fit(part_of(plastic_profiles, range(90), [0, 5]))
