import dataclasses
import hashlib
from typing import Any

import numpy as np
import pytest

from dsbrdf.data.geometry import directions
from dsbrdf.data.grid import CHANNELS, GRID_SHAPE, PHI_DIFF, THETA_DIFF, THETA_HALF, nodes_above_horizon
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.merl import encode_merl
from dsbrdf.errors import MeasurementFormatError


def test_grid_stands_at_the_left_edges() -> None:
    assert CHANNELS == ("red", "green", "blue")
    assert GRID_SHAPE == (len(THETA_HALF), len(THETA_DIFF), len(PHI_DIFF))
    np.testing.assert_allclose(np.degrees(THETA_HALF[[0, 1, 30, 89]]), [0.0, 1 / 90, 10.0, 89**2 / 90])
    np.testing.assert_allclose(np.degrees(THETA_DIFF[[0, 1, 89]]), [0.0, 1.0, 89.0])
    np.testing.assert_allclose(np.degrees(PHI_DIFF[[0, 1, 179]]), [0.0, 1.0, 179.0])
    for axis in (THETA_HALF, THETA_DIFF, PHI_DIFF):
        with pytest.raises(ValueError, match="read-only"):
            axis[0] = 1.0


def test_nodes_above_horizon_agree_with_the_directions() -> None:
    above = nodes_above_horizon()
    assert above.shape == GRID_SHAPE
    omega_in, omega_out = directions(THETA_HALF[::7, None, None], THETA_DIFF[::3, None], PHI_DIFF[::5])
    expected = (omega_in[..., 2] > 1e-13) & (omega_out[..., 2] > 1e-13)
    np.testing.assert_array_equal(above[::7, ::3, ::5], expected)
    assert not above[30, 80, 0]  # 10 + 80 degrees: on the horizon
    with pytest.raises(ValueError, match="read-only"):
        above[0, 0, 0] = False


def test_values_are_stored_times_scale(plastic: Measurement) -> None:
    values = plastic.values
    assert values.shape == (3, *GRID_SHAPE)
    for channel, factor in enumerate((1.0, 1.15, 1.66)):
        np.testing.assert_allclose(values[channel], plastic.stored[channel] * factor / 1500.0, rtol=4e-16)


def test_a_measurement_cannot_be_changed(plastic: Measurement) -> None:
    for array in (plastic.stored, plastic.valid, plastic.scale):
        with pytest.raises(ValueError, match="read-only"):
            array.flat[0] = 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        plastic.name = "other"  # type: ignore[misc]


def test_from_values_equals_reading_the_encoded_bytes() -> None:
    values = np.random.default_rng(3).uniform(0.1, 5.0, (3, *GRID_SHAPE))
    values[:, 4, 5, 6] = -2.0
    valid = np.ones(GRID_SHAPE, dtype=bool)
    valid[7, 8, 9] = False
    values[:, 7, 8, 9] = np.nan  # what an invalid node holds does not matter
    measurement = Measurement.from_values(values, valid, name="random")
    expected = nodes_above_horizon().copy()
    expected[4, 5, 6] = expected[7, 8, 9] = False
    np.testing.assert_array_equal(measurement.valid, expected)
    np.testing.assert_allclose(measurement.values[:, valid], values[:, valid], rtol=5e-16)
    np.testing.assert_array_equal(measurement.stored[:, 7, 8, 9], -1.0)
    assert measurement.name == "random"
    assert measurement.sha256 == hashlib.sha256(encode_merl(measurement)).hexdigest()


@pytest.mark.parametrize(
    ("values", "valid", "words"),
    [
        (np.zeros((90, 90, 180)), None, r"have the shape \(90, 90, 180\); a measurement has \(3, 90, 90, 180\)"),
        (np.zeros((90, 90, 180, 3)), None, r"have the shape \(.*; a measurement has \(3, 90, 90, 180\)"),
        (np.zeros(()), None, r"have the shape \(.*; a measurement has \(3, 90, 90, 180\)"),
        (np.ones((3, *GRID_SHAPE)), np.ones((90, 180, 90), bool), r"valid nodes have the shape \(90, 180, 90\)"),
        (np.zeros((3, *GRID_SHAPE)), None, "Every valid node is zero"),
        (np.array([["a"]]), None, "must be real numbers"),
        (np.where(np.arange(180) == 7, np.inf, np.ones((3, *GRID_SHAPE))), None, "^24300 of the values are NaN"),
    ],
    ids=["no channels", "channels last", "a number", "nodes", "zeros", "text", "infinite"],
)
def test_from_values_names_the_fault(values: Any, valid: Any, words: str) -> None:
    with pytest.raises(MeasurementFormatError, match=words):
        Measurement.from_values(values, valid)
