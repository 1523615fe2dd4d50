"""Scattered samples given as arrays."""

import numpy as np
import pytest

from dsbrdf.data.scattered_samples import ScatteredSamples
from dsbrdf.errors import MeasurementFormatError


def test_weights_are_positive_and_as_many_as_samples() -> None:
    up = np.tile([0.0, 0.0, 1.0], (300, 1))
    with pytest.raises(MeasurementFormatError, match="weight is not positive; leave out"):
        ScatteredSamples.from_arrays(up, up, up, np.zeros(300))
    with pytest.raises(MeasurementFormatError, match=r"weight must have the shape \(300,\), not \(3,\)"):
        ScatteredSamples.from_arrays(up, up, up, np.ones(3))
    with pytest.raises(MeasurementFormatError, match="omega_in must be real numbers"):
        ScatteredSamples.from_arrays([["a"]], up, up)


def test_directions_are_made_unit_vectors() -> None:
    nearly = np.tile([0.6004, 0.0, 0.8], (300, 1))
    samples = ScatteredSamples.from_arrays(nearly, nearly, np.ones((300, 3)))
    np.testing.assert_allclose(np.linalg.norm(samples.omega_in, axis=1), 1.0, rtol=1e-15)
    with pytest.raises(MeasurementFormatError, match=r"In 300 of 300 samples.* omega_in is not of unit length"):
        ScatteredSamples.from_arrays(1.01 * nearly, nearly, np.ones((300, 3)))


def test_values_are_divided_by_the_cosine_that_they_contain() -> None:
    first, second = np.tile([0.6, 0.0, 0.8], (300, 1)), np.tile([0.0, 0.8, 0.6], (300, 1))
    samples = ScatteredSamples.from_arrays(first, second, np.full((300, 3), 0.24))
    np.testing.assert_allclose(samples.divided_by_cosine("in").values, 0.3, rtol=1e-14)
    np.testing.assert_allclose(samples.divided_by_cosine("out").values, 0.4, rtol=1e-14)
