"""The metrics against their definitions, evaluated on the samples and not on profiles."""

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf.data.grid import DEFAULT_HORIZON_CUTOFF, PHI_DIFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import Profiles, profiles
from dsbrdf.data.synthetic import model_measurement
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.metrics import (
    BANDS,
    OUTSIDE_CENTER,
    error_tables,
    mean_absolute_log_error,
    on_grid,
    relative_errors,
)
from dsbrdf.model.dsbrdf import DSBRDF

Array = NDArray[np.float64]

HALF, DIFF, PHI = np.meshgrid(THETA_HALF, THETA_DIFF, PHI_DIFF, indexing="ij")
COS_IN = np.cos(HALF) * np.cos(DIFF) - np.sin(HALF) * np.sin(DIFF) * np.cos(PHI)
COS_OUT = np.cos(HALF) * np.cos(DIFF) + np.sin(HALF) * np.sin(DIFF) * np.cos(PHI)


def some_model() -> DSBRDF:
    knots = np.radians([0.0, 40.0, 80.0])
    kappa = np.tile([[1.5, 0.2], [1.7, 0.2], [3.0, 0.4]], (3, 1, 1)) * np.array([1.0, 0.9, 0.8])[:, None, None]
    gamma = np.tile([[150.0, 0.5], [120.0, 0.7], [60.0, 1.0]], (3, 1, 1))
    return DSBRDF(knots, kappa, gamma, np.zeros_like(kappa), np.full((3, 3), 0.5))


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
    """The noisy plastic with random holes."""
    holes = np.random.default_rng(8).uniform(size=plastic.valid.shape) < 0.2
    return Measurement.from_values(plastic.values, plastic.valid & ~holes)


@pytest.mark.parametrize("cutoff", [DEFAULT_HORIZON_CUTOFF, None, 0.7])
def test_relative_errors_against_sums_over_the_samples(speckled: Measurement, cutoff: float | None) -> None:
    model, counted = some_model(), counted_nodes(speckled, cutoff)
    fit = np.moveaxis(model.evaluate(THETA_HALF[:, None], THETA_DIFF), -1, 0)[..., None]
    found = relative_errors(model, profiles(speckled, horizon_cutoff=cutoff))
    rms = direct_rms(speckled, fit, counted)
    floor = direct_rms(speckled, phi_means(speckled, counted), counted)
    assert found["relative_rms"] == pytest.approx(rms, rel=1e-10)
    assert found["floor"] == pytest.approx(floor, rel=1e-10)
    assert found["excess"] == pytest.approx(rms / floor, rel=1e-10)
    assert set(found) == {"relative_rms", "floor", "excess"}


@pytest.mark.parametrize("cutoff", [DEFAULT_HORIZON_CUTOFF, None])
def test_male_against_a_mean_over_the_samples(speckled: Measurement, cutoff: float | None) -> None:
    model, counted = some_model(), counted_nodes(speckled, cutoff)
    fit = np.broadcast_to(
        np.moveaxis(model.evaluate(THETA_HALF[:, None], THETA_DIFF), -1, 0)[..., None], (3, 90, 90, 180)
    )
    cosine = COS_IN[counted]
    measured = np.log(1.0 + speckled.values[:, counted] * cosine)
    expected = float(np.mean(np.abs(measured - np.log(1.0 + fit[:, counted] * cosine))))
    assert mean_absolute_log_error(model, speckled, cutoff) == pytest.approx(expected, rel=1e-9)


def test_every_channel_and_band_against_sums_over_the_samples(speckled: Measurement) -> None:
    model, counted = some_model(), counted_nodes(speckled, DEFAULT_HORIZON_CUTOFF)
    fit = np.broadcast_to(
        np.moveaxis(model.evaluate(THETA_HALF[:, None], THETA_DIFF), -1, 0)[..., None], (3, 90, 90, 180)
    )
    values, middle = speckled.values, np.broadcast_to(phi_means(speckled, counted), (3, 90, 90, 180))
    by_channel, by_theta_diff = error_tables(model, profiles(speckled))

    def expected(channels: list[int], nodes: NDArray[np.bool_]) -> tuple[float, float]:
        power = np.sum(values[channels][:, nodes] ** 2)
        errors = [np.sum((values - other)[channels][:, nodes] ** 2) for other in (fit, middle)]
        return float(np.sqrt(errors[0] / power)), float(np.sqrt(errors[1] / power))

    assert [row["channel"] for row in by_channel] == ["red", "green", "blue"]
    for index, row in enumerate(by_channel):
        assert (row["relative_rms"], row["floor"]) == pytest.approx(expected([index], counted), rel=1e-9)
    assert by_theta_diff[0]["theta_diff"] == [0.0, pytest.approx(np.radians(15.0))]
    assert len(by_theta_diff) == 7  # at theta_diff = 80 degrees the cutoff leaves the centre only
    for row in by_theta_diff:
        first, last = np.degrees(row["theta_diff"])
        inside = counted & (np.degrees(DIFF) >= first - 1e-6) & (np.degrees(DIFF) < last - 1e-6)
        assert (row["relative_rms"], row["floor"]) == pytest.approx(expected([0, 1, 2], inside), rel=1e-9)
        assert row["excess"] == pytest.approx(row["relative_rms"] / row["floor"])
    assert BANDS[0] == 0.0
    assert np.degrees(BANDS[-1]) == pytest.approx(90.0)


def test_black_channels_have_no_row() -> None:
    model = some_model()
    values = model_measurement(model).values
    values[1] = np.where(values[1] > 0, 0.0, values[1])
    by_channel, _ = error_tables(model, profiles(Measurement.from_values(values)))
    assert [row["channel"] for row in by_channel] == ["red", "blue"]


def test_floor_is_below_every_bivariate_model(speckled: Measurement) -> None:
    data = profiles(speckled)
    generator = np.random.default_rng(4)
    for _ in range(5):
        shape = (3, 3, 2)
        kappa, gamma = generator.uniform(0.01, 2.0, shape), np.exp(generator.uniform(-1.0, 6.0, shape))
        model = DSBRDF(np.radians([0.0, 30.0, 80.0]), kappa, gamma, np.zeros(shape), np.zeros((3, 3)))
        found = relative_errors(model, data)
        assert found["relative_rms"] is not None
        assert found["floor"] is not None
        assert found["excess"] is not None
        assert found["relative_rms"] > found["floor"]
        assert found["excess"] > 1.0
    # Nor can moving the mean of a single cell in either direction get below it.
    counted = counted_nodes(speckled, DEFAULT_HORIZON_CUTOFF)
    best = phi_means(speckled, counted)
    floor = direct_rms(speckled, best, counted)
    for step in (-1e-3, 1e-3):
        moved = best.copy()
        moved[1, 30, 20] += step
        assert direct_rms(speckled, moved, counted) > floor


def test_perfect_model_has_no_error_and_no_excess() -> None:
    model = some_model()
    measurement = model_measurement(model)
    found = relative_errors(model, profiles(measurement))
    assert found["relative_rms"] == pytest.approx(0.0, abs=1e-14)
    assert found["floor"] == pytest.approx(0.0, abs=1e-14)
    assert found["excess"] is None  # a ratio of rounding errors says nothing
    assert mean_absolute_log_error(model, measurement, None) == pytest.approx(0.0, abs=1e-14)


def test_centre_does_not_count(plastic: Measurement) -> None:
    assert OUTSIDE_CENTER.tolist() == [bool(angle >= 1.0) for angle in np.degrees(THETA_HALF)]
    values = plastic.values
    values[:, ~OUTSIDE_CENTER] = np.where(values[:, ~OUTSIDE_CENTER] >= 0, 1e4, values[:, ~OUTSIDE_CENTER])
    other, model = Measurement.from_values(values), some_model()
    assert relative_errors(model, profiles(other)) == pytest.approx(relative_errors(model, profiles(plastic)))
    assert mean_absolute_log_error(model, other, None) == pytest.approx(
        mean_absolute_log_error(model, plastic, None), rel=1e-9
    )


def test_model_on_the_grid_is_in_the_order_of_the_profiles() -> None:
    model = some_model()
    grid = on_grid(model)
    assert grid.shape == (3, 90, 90)
    for i, j in ((0, 0), (12, 50), (70, 3)):
        np.testing.assert_allclose(grid[:, j, i], model.evaluate(THETA_HALF[i], THETA_DIFF[j]), rtol=1e-13)


@pytest.mark.parametrize("made", [{"weighting": "cosine"}, {"weighting": "log"}, {"robust": True}])
def test_weighted_profiles_are_refused(plastic: Measurement, made: dict[str, str]) -> None:
    weighted = profiles(plastic, **made)  # type: ignore[arg-type]
    with pytest.raises(InvalidArgumentError, match="defined on plain profiles without outlier weights"):
        relative_errors(some_model(), weighted)


def test_nothing_to_compare_with_is_said(plastic: Measurement) -> None:
    zeros = np.zeros((3, 90, 90))
    empty = Profiles(zeros, zeros, zeros, None, "plain", False, "empty", "")
    with pytest.raises(InvalidArgumentError, match="no data to compare with: every sample used is zero or left out"):
        relative_errors(some_model(), empty)
    with pytest.raises(InvalidArgumentError, match="the horizon cutoff leaves no valid sample"):
        mean_absolute_log_error(some_model(), plastic, float(np.radians(0.9)))
