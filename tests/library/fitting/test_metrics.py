from dataclasses import asdict, replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf import DSBRDF, InvalidArgumentError, Measurement
from dsbrdf.arrays import Array
from dsbrdf.data import DEFAULT_HORIZON_CUTOFF, PHI_DIFF, THETA_DIFF, THETA_HALF, model_measurement
from dsbrdf.fitting import METRICS, relative_errors, sample_errors
from dsbrdf.fitting.metrics import ALBEDO_ANGLES, RelativeErrors, error_tables, sample_metrics
from dsbrdf.model import directional_albedo

HALF, DIFF, PHI = np.broadcast_arrays(*np.meshgrid(THETA_HALF, THETA_DIFF, PHI_DIFF, indexing="ij", sparse=True))
GREEN_IS_BLACK = np.array([1.0, 0.0, 1.0])[:, None, None]


def some_model() -> DSBRDF:
    amplitude = np.tile([[3.5, 0.2], [4.5, 0.2], [19.0, 0.5]], (3, 1, 1)) * np.array([1.0, 0.9, 0.8])[:, None, None]
    kappa = np.array([[1.5, 0.2], [1.7, 0.2], [3.0, 0.4]])[None]
    gamma = np.array([[150.0, 0.5], [120.0, 0.7], [60.0, 1.0]])[None]
    shape = kappa, gamma, np.zeros_like(kappa), np.array([[0.8, 0.3]])
    return DSBRDF(np.radians([0.0, 40.0, 80.0]), amplitude, *shape, delta=np.full((3, 3), 0.5), interpolation="linear")


@cache
def cosines() -> tuple[Array, Array]:
    level, swing = np.cos(HALF) * np.cos(DIFF), np.sin(HALF) * np.sin(DIFF) * np.cos(PHI)
    return level - swing, level + swing


def counted_nodes(measurement: Measurement, cutoff: float | None) -> NDArray[np.bool_]:
    """Nodes that the metrics count, shape (90, 90, 180), from the definition."""
    lowest = np.minimum(*cosines())
    counted = measurement.valid & (HALF >= np.radians(1.0)) & (lowest > 1e-12)
    counted[:, :, 1::2] = False
    if cutoff is not None:
        counted &= lowest >= np.cos(cutoff) - 1e-12
    return counted


@pytest.fixture(scope="module")
def speckled(plastic: Measurement) -> Measurement:
    """The noisy plastic with random holes, many because every valid sample takes its time."""
    holes = np.random.default_rng(8).uniform(size=plastic.valid.shape) < 0.8
    return Measurement.from_values(plastic.values, plastic.valid & ~holes)


def direct_errors(
    measurement: Measurement, model: DSBRDF, cutoff: float | None, channels: list[int], bands: slice = slice(None)
) -> RelativeErrors:
    """Errors of some channels and rows of theta_diff, from all samples and their definitions."""
    counted = counted_nodes(measurement, cutoff)
    rows = np.zeros(counted.shape, bool)
    rows[:, bands] = counted[:, bands]
    samples = np.where(counted, measurement.values, 0.0)
    fit = np.zeros_like(samples)
    fit[:, counted] = model.evaluate_unmasked(HALF[counted], DIFF[counted], PHI[counted]).T
    partner = [(180 - k) % 180 for k in range(180)]
    mean = samples.sum(axis=3, keepdims=True) / np.maximum(counted.sum(axis=2, keepdims=True), 1)
    folded = (samples + samples[..., partner]) / np.maximum(counted + counted[..., partner].astype(float), 1.0)
    power = np.sum(samples[channels][:, rows] ** 2)
    differences = [(samples - other)[channels][:, rows] for other in (fit, mean, folded)]
    rms, floor, symmetric = (float(np.sqrt(np.sum(difference**2) / power)) for difference in differences)
    logs = [np.log(1.0 + values[channels][:, rows] * cosines()[0][rows]) for values in (samples, fit)]
    return RelativeErrors(rms, floor, symmetric, rms / floor, float(np.mean(np.abs(logs[0] - logs[1]))))


def assert_errors(found: RelativeErrors | None, expected: RelativeErrors) -> None:
    assert found is not None
    for name, value in asdict(expected).items():
        assert getattr(found, name) == pytest.approx(value, rel=1e-5), name


@pytest.mark.parametrize("cutoff", [None, 0.7])
def test_errors_against_sums_over_the_samples(speckled: Measurement, cutoff: float | None) -> None:
    model = some_model()
    found = relative_errors(sample_errors(model, speckled, cutoff))
    assert_errors(found, direct_errors(speckled, model, cutoff, [0, 1, 2]))


def test_every_channel_and_band_against_sums_over_the_samples(speckled: Measurement) -> None:
    model = some_model()
    by_channel, by_theta_diff = error_tables(sample_errors(model, speckled, DEFAULT_HORIZON_CUTOFF))
    assert [row.channel for row in by_channel] == ["red", "green", "blue"]
    assert_errors(by_channel[1], direct_errors(speckled, model, DEFAULT_HORIZON_CUTOFF, [1]))
    # At theta_diff = 80 degrees the cutoff leaves the centre only.
    edges = [0.0, 15.0, 30.0, 45.0, 60.0, 70.0, 75.0, 80.0]
    np.testing.assert_allclose(np.degrees([row.theta_diff for row in by_theta_diff]), list(pairwise(edges)), atol=1e-9)
    for band, rows in ((by_theta_diff[1], slice(15, 30)), (by_theta_diff[-1], slice(75, 80))):
        assert_errors(band, direct_errors(speckled, model, DEFAULT_HORIZON_CUTOFF, [0, 1, 2], rows))


@pytest.fixture(scope="module")
def lobes() -> DSBRDF:
    return some_model().select((0, 1), with_delta=False)


def test_symmetric_floor_is_below_every_reciprocal_model_and_the_bivariate_floor_is_not() -> None:
    truth = some_model()
    found = relative_errors(sample_errors(truth, model_measurement(truth, noise=0.02), None))
    assert found is not None
    assert found.symmetric_floor <= found.relative_rms < found.floor


def test_perfect_model_has_no_error_and_without_a_floor_no_excess(lobes: DSBRDF) -> None:
    round_ones = replace(lobes, elongation=np.zeros_like(lobes.elongation))
    found = relative_errors(sample_errors(round_ones, model_measurement(round_ones), None))
    assert found is not None
    assert (found.relative_rms, found.floor, found.male) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    assert found.excess is None  # a ratio of rounding errors says nothing


def test_nothing_to_compare_with_is_said(plastic: Measurement) -> None:
    with pytest.raises(InvalidArgumentError, match=r"no data to compare with: from theta_half = .* every sample used"):
        sample_errors(some_model(), plastic, float(np.radians(0.9)))


def test_albedo_error_is_the_mean_relative_distance_and_metrics_are_found_by_name(matte: Measurement) -> None:
    data = directional_albedo(matte.interpolated.evaluate, ALBEDO_ANGLES)
    factor = np.array([1.1, 0.8, 1.0])
    model = some_model()
    metrics = sample_metrics(model, matte, sample_errors(model, matte, None), data * factor)
    assert metrics.albedo_error == pytest.approx(0.1, rel=1e-9)  # mean of 0.1, 0.2 and 0
    assert [metrics[name] for name in METRICS] == list(asdict(metrics).values())
    with pytest.raises(KeyError, match="__class__"):
        metrics["__class__"]
    np.testing.assert_allclose(np.degrees(ALBEDO_ANGLES), [0.0, 30.0, 60.0, 75.0])


def test_model_of_the_measurement_looks_like_it_and_black_channels_count_nothing(lobes: DSBRDF) -> None:
    values, albedo = model_measurement(lobes).values, lobes.albedo(ALBEDO_ANGLES)
    values[1] = np.where(values[1] > 0, 0.0, values[1])
    no_green, model = Measurement.from_values(values), replace(lobes, amplitude=lobes.amplitude * GREEN_IS_BLACK)
    sums = sample_errors(model, no_green, DEFAULT_HORIZON_CUTOFF)
    assert [row.channel for row in error_tables(sums)[0]] == ["red", "blue"]
    found = asdict(sample_metrics(model, no_green, sums, albedo * GREEN_IS_BLACK[:, 0, 0]))
    assert found["albedo_error"] < 0.01
    assert found["psnr"] > 40.0
    assert found["ssim"] > 0.99
    worse = asdict(sample_metrics(model.select((1,), with_delta=False), no_green, sums, albedo))
    assert worse["psnr"] < found["psnr"] - 10.0
