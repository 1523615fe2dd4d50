"""Thinned tables and their interpolation against np.interp, line by line."""

import numpy as np
import pytest

from benchmarks.paper.table_interpolation import (
    guided_table_error,
    interpolated_rows,
    means_over_phi,
    table_error,
    thinned,
)
from dsbrdf import Measurement, profiles
from dsbrdf.data import DEFAULT_HORIZON_CUTOFF, PHI_DIFF, THETA_DIFF, THETA_HALF, above_horizon


def test_every_nth_row_is_kept(plastic: Measurement) -> None:
    rows = np.flatnonzero(thinned(plastic, 7).valid.any(axis=(1, 2)))
    np.testing.assert_array_equal(rows, np.arange(0, 90, 7))


@pytest.mark.parametrize("coordinate", [THETA_HALF, np.arange(90.0)], ids=["angle", "index"])
def test_rows_are_interpolated_linearly(plastic: Measurement, coordinate: np.ndarray) -> None:
    predict, kept = interpolated_rows(thinned(plastic, 8), coordinate), np.arange(90) % 8 == 0
    values = plastic.values
    for row in (3, 17, 60, 89):
        predicted = predict(row)
        for diff, phi in ((0, 0), (30, 45), (60, 90), (80, 170)):
            known = kept & plastic.valid[:, diff, phi]
            for channel in range(3):
                line = values[channel, known, diff, phi]
                expected = np.interp(coordinate[row], coordinate[known], line)
                assert predicted[channel, diff, phi] == pytest.approx(expected, rel=1e-12)


def test_means_are_those_of_the_profiles(plastic: Measurement) -> None:
    summary, means = profiles(plastic), means_over_phi(plastic).values
    used = summary.weight > 0
    np.testing.assert_allclose(means[..., 0].swapaxes(1, 2)[used], summary.mean[used], rtol=1e-12)


def test_error_of_the_table_of_means_is_the_floor(plastic: Measurement, quick_floor: float) -> None:
    assert table_error(plastic, plastic) == 0.0
    assert table_error(plastic, means_over_phi(plastic)) == pytest.approx(quick_floor, rel=1e-9)


def test_a_table_guided_by_the_data_is_exact_and_by_nothing_the_table_itself(plastic: Measurement) -> None:
    few, fewer = thinned(plastic, 15), thinned(plastic, 30)
    assert guided_table_error(few, fewer, plastic.values) == pytest.approx(0.0, abs=1e-12)
    error = table_error(few, fewer)
    assert error > 0.01
    assert guided_table_error(few, fewer, np.zeros_like(plastic.stored)) == pytest.approx(error, rel=1e-12)


@pytest.fixture
def quick_floor(plastic: Measurement) -> float:
    """The floor from the samples themselves."""
    used = above_horizon(THETA_HALF[:, None, None], THETA_DIFF[:, None], PHI_DIFF, DEFAULT_HORIZON_CUTOFF)
    used = used & plastic.valid & (THETA_HALF >= np.radians(1.0))[:, None, None]
    values = np.where(used, plastic.values, np.nan)[:, used.any(axis=2)]
    deviation = values - np.nanmean(values, axis=-1, keepdims=True)
    return float(np.sqrt(np.nansum(deviation**2) / np.nansum(values**2)))
