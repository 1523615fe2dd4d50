from dataclasses import asdict, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf.data.grid import DEFAULT_HORIZON_CUTOFF, PHI_DIFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.interpolation import interpolate
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.synthetic import model_measurement
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.metrics import (
    ALBEDO_ANGLES,
    BANDS,
    METRICS,
    error_tables,
    relative_errors,
    sample_errors,
    sample_metrics,
    seen_errors,
)
from dsbrdf.model.albedo import directional_albedo
from dsbrdf.model.dsbrdf import DSBRDF

Array = NDArray[np.float64]

HALF, DIFF, PHI = np.meshgrid(THETA_HALF, THETA_DIFF, PHI_DIFF, indexing="ij")
COS_IN = np.cos(HALF) * np.cos(DIFF) - np.sin(HALF) * np.sin(DIFF) * np.cos(PHI)
COS_OUT = np.cos(HALF) * np.cos(DIFF) + np.sin(HALF) * np.sin(DIFF) * np.cos(PHI)


def some_model() -> DSBRDF:
    """Two coloured lobes, elongated, over three knots."""
    amplitude = np.tile([[3.5, 0.2], [4.5, 0.2], [19.0, 0.5]], (3, 1, 1)) * np.array([1.0, 0.9, 0.8])[:, None, None]
    kappa = np.array([[1.5, 0.2], [1.7, 0.2], [3.0, 0.4]])[None]
    gamma = np.array([[150.0, 0.5], [120.0, 0.7], [60.0, 1.0]])[None]
    knots, elongation = np.radians([0.0, 40.0, 80.0]), np.array([[0.8, 0.3]])
    return DSBRDF(
        knots, amplitude, kappa, gamma, elongation=elongation, delta=np.full((3, 3), 0.5), interpolation="linear"
    )


def values_of(model: DSBRDF, nodes: NDArray[np.bool_]) -> Array:
    """Values at the nodes chosen, zeros at the others, shape (3, 90, 90, 180)."""
    values = np.zeros((3, *nodes.shape))
    values[:, nodes] = model.evaluate_unmasked(HALF[nodes], DIFF[nodes], PHI[nodes]).T
    return values


def counted_nodes(measurement: Measurement, cutoff: float | None) -> NDArray[np.bool_]:
    """Nodes that the metrics count, shape (90, 90, 180), from the definition."""
    counted = measurement.valid & (HALF >= np.radians(1.0)) & (COS_IN > 1e-12) & (COS_OUT > 1e-12)
    if cutoff is not None:
        smallest = np.cos(cutoff) - 1e-12
        counted &= (smallest <= COS_IN) & (smallest <= COS_OUT)
    return counted


def direct_rms(measurement: Measurement, fit: Array, counted: NDArray[np.bool_]) -> float:
    """Relative RMS over all samples of values that broadcast to (3, 90, 90, 180)."""
    values = measurement.values
    fit = np.broadcast_to(fit, values.shape)
    return float(np.sqrt(np.sum((values - fit)[:, counted] ** 2) / np.sum(values[:, counted] ** 2)))


def phi_means(measurement: Measurement, counted: NDArray[np.bool_]) -> Array:
    """Mean of the counted samples over phi_diff, shape (3, 90, 90, 1)."""
    count = counted.sum(axis=-1, keepdims=True)
    return np.where(counted, measurement.values, 0.0).sum(axis=-1, keepdims=True) / np.maximum(count, 1)


@pytest.fixture(scope="module")
def speckled(plastic: Measurement) -> Measurement:
    """The noisy plastic with random holes, many because every valid sample takes its time."""
    holes = np.random.default_rng(8).uniform(size=plastic.valid.shape) < 0.8
    return Measurement.from_values(plastic.values, plastic.valid & ~holes)


def folded_means(measurement: Measurement, counted: NDArray[np.bool_]) -> Array:
    """Mean of the counted samples at phi_diff and 180 degrees - phi_diff, by looking at each pair."""
    partner = [(180 - k) % 180 for k in range(180)]
    values = np.where(counted, measurement.values, 0.0)
    both = counted.astype(float) + counted[..., partner]
    return np.asarray((values + values[..., partner]) / np.maximum(both, 1.0))


@pytest.mark.parametrize("cutoff", [DEFAULT_HORIZON_CUTOFF, None, 0.7])
def test_errors_against_sums_over_the_samples(speckled: Measurement, cutoff: float | None) -> None:
    model, counted = some_model(), counted_nodes(speckled, cutoff)
    fit = values_of(model, counted)
    found = relative_errors(sample_errors(model, speckled, cutoff))
    assert found is not None
    rms = direct_rms(speckled, fit, counted)
    floor = direct_rms(speckled, phi_means(speckled, counted), counted)
    symmetric = direct_rms(speckled, folded_means(speckled, counted), counted)
    assert found.relative_rms == pytest.approx(rms, rel=1e-10)
    assert found.floor == pytest.approx(floor, rel=1e-10)
    assert found.symmetric_floor == pytest.approx(symmetric, rel=1e-10)
    assert found.excess == pytest.approx(rms / floor, rel=1e-10)
    cosine = COS_IN[counted]
    logs = [np.log(1.0 + values[:, counted] * cosine) for values in (speckled.values, fit)]
    assert found.male == pytest.approx(float(np.mean(np.abs(logs[0] - logs[1]))), rel=1e-9)


def test_every_channel_and_band_against_sums_over_the_samples(speckled: Measurement) -> None:
    model, counted = some_model(), counted_nodes(speckled, DEFAULT_HORIZON_CUTOFF)
    fit, values = values_of(model, counted), speckled.values
    middle = np.broadcast_to(phi_means(speckled, counted), values.shape)
    by_channel, by_theta_diff = error_tables(sample_errors(model, speckled, DEFAULT_HORIZON_CUTOFF))

    def expected(channels: list[int], nodes: NDArray[np.bool_]) -> tuple[float, float]:
        power = np.sum(values[channels][:, nodes] ** 2)
        errors = [np.sum((values - other)[channels][:, nodes] ** 2) for other in (fit, middle)]
        return float(np.sqrt(errors[0] / power)), float(np.sqrt(errors[1] / power))

    assert [row.channel for row in by_channel] == ["red", "green", "blue"]
    for index, errors in enumerate(by_channel):
        assert (errors.relative_rms, errors.floor) == pytest.approx(expected([index], counted), rel=1e-9)
    assert by_theta_diff[0].theta_diff == pytest.approx((0.0, np.radians(15.0)))
    assert len(by_theta_diff) == 7  # at theta_diff = 80 degrees the cutoff leaves the centre only
    for band in by_theta_diff:
        first, last = np.degrees(band.theta_diff)
        inside = counted & (np.degrees(DIFF) >= first - 1e-6) & (np.degrees(DIFF) < last - 1e-6)
        assert (band.relative_rms, band.floor) == pytest.approx(expected([0, 1, 2], inside), rel=1e-9)
        assert band.excess == pytest.approx(band.relative_rms / band.floor)
    assert BANDS[0] == 0.0
    assert np.degrees(BANDS[-1]) == pytest.approx(90.0)


@pytest.fixture(scope="module")
def lobes() -> DSBRDF:
    """The model without its delta term."""
    return some_model().select((0, 1), with_delta=False)


@pytest.fixture(scope="module")
def of_lobes(lobes: DSBRDF) -> Measurement:
    return model_measurement(lobes)


@pytest.fixture(scope="module")
def no_green(of_lobes: Measurement) -> Measurement:
    values = of_lobes.values
    values[1] = np.where(values[1] > 0, 0.0, values[1])
    return Measurement.from_values(values)


def test_symmetric_floor_is_below_every_reciprocal_model_and_the_bivariate_floor_is_not() -> None:
    truth = some_model()
    found = relative_errors(sample_errors(truth, model_measurement(truth, noise=0.02), None))
    assert found is not None
    assert found.symmetric_floor <= found.relative_rms < found.floor


def test_perfect_model_has_no_error_and_without_a_floor_no_excess(lobes: DSBRDF) -> None:
    round_ones = replace(lobes, elongation=np.zeros_like(lobes.elongation))
    found = relative_errors(sample_errors(round_ones, model_measurement(round_ones), None))
    assert found is not None
    assert (found.relative_rms, found.floor, found.male) == pytest.approx((0.0, 0.0, 0.0), abs=1e-13)
    assert found.excess is None  # a ratio of rounding errors says nothing


def test_nothing_to_compare_with_is_said(plastic: Measurement) -> None:
    with pytest.raises(InvalidArgumentError, match="no data to compare with: every sample used is zero or left out"):
        sample_errors(some_model(), plastic, float(np.radians(0.9)))


def test_albedo_error_is_the_mean_relative_distance(matte: Measurement) -> None:
    data = directional_albedo(interpolate(matte).evaluate, ALBEDO_ANGLES)
    factor = np.array([1.1, 0.8, 1.0])
    albedo_error, _, _ = seen_errors(some_model(), matte, data * factor)
    assert albedo_error == pytest.approx(0.1, rel=1e-9)  # mean of 0.1, 0.2 and 0
    np.testing.assert_allclose(np.degrees(ALBEDO_ANGLES), [0.0, 30.0, 60.0, 75.0])


def test_model_of_the_measurement_looks_like_it(lobes: DSBRDF, of_lobes: Measurement) -> None:
    albedo = lobes.albedo(ALBEDO_ANGLES)
    albedo_error, psnr, ssim = seen_errors(lobes, of_lobes, albedo)
    assert albedo_error < 0.01
    assert psnr > 40.0
    assert ssim > 0.99
    _, worse, _ = seen_errors(lobes.select((1,), with_delta=False), of_lobes, albedo)
    assert worse < psnr - 10.0


def test_black_channels_have_no_row_and_no_albedo_error(lobes: DSBRDF, no_green: Measurement) -> None:
    by_channel, _ = error_tables(sample_errors(lobes, no_green, DEFAULT_HORIZON_CUTOFF))
    assert [row.channel for row in by_channel] == ["red", "blue"]
    albedo_error, _, _ = seen_errors(lobes, no_green, lobes.albedo(ALBEDO_ANGLES) * [1.0, 0.0, 1.0])
    assert albedo_error < 0.01


def test_metrics_are_found_by_name(matte: Measurement) -> None:
    truth = some_model()
    albedo = truth.albedo(ALBEDO_ANGLES)
    metrics = sample_metrics(truth, matte, sample_errors(truth, matte, None), albedo)
    assert [metrics[name] for name in METRICS] == list(asdict(metrics).values())
    assert (metrics.albedo_error, metrics.psnr, metrics.ssim) == seen_errors(truth, matte, albedo)
    with pytest.raises(KeyError, match="__class__"):
        metrics["__class__"]
