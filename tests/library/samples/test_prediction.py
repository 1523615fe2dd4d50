"""What is predicted between samples."""

import numpy as np
import pytest

from dsbrdf import ScatteredSamples
from dsbrdf.arrays import Array
from dsbrdf.components import SpecularLayer
from dsbrdf.components.structures import STRUCTURES
from dsbrdf.data import half_difference, spherical
from dsbrdf.data.geometry import directions
from dsbrdf.samples.prediction import SamplePrediction


def highlight(theta_half: Array, *_: Array) -> Array:
    """A highlight of half width 2.4 degrees with wide tails, which no layer has at all angles (n, 3)."""
    return np.asarray(0.05 + 20.0 / (1.0 + (np.degrees(theta_half) / 2.0) ** 2) ** 1.2)[:, None] * np.ones(3)


def test_a_highlight_that_no_sample_saw_is_no_needle() -> None:
    """Tails alone would also be those of a coat that is as sharp as any: 37 to 594 times as bright."""
    random = np.random.default_rng(1)
    angles = random.uniform((0.0, 0.0, 0.0, 0.0), (80.0, 360.0, 80.0, 360.0), (400, 4))
    near = random.normal(0.0, 12.0, (2, 200))
    angles[:200, 2], angles[:200, 3] = np.clip(angles[:200, 0] + near[0], 0.0, 80.0), angles[:200, 1] + 180.0 + near[1]
    theta_in, phi_in, theta_out, phi_out = np.radians(angles).T
    pairs = spherical(theta_in, phi_in), spherical(theta_out, phi_out)
    unseen = np.flatnonzero(half_difference(*pairs)[0] > np.radians(3.5))[:100]
    first, second = (side[unseen] for side in pairs)
    values = highlight(*half_difference(first, second)) * (1.0 + 0.02 * random.standard_normal((100, 1)))
    prediction = SamplePrediction.fit(ScatteredSamples.from_arrays(first, second, values))
    mirror = np.zeros(3), np.radians([20.0, 45.0, 65.0]), np.zeros(3)
    ratio = prediction.evaluate_unmasked(*mirror) / highlight(*mirror)
    assert np.all((ratio > 0.2) & (ratio < 5.0)), ratio


def stretched(theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
    """A highlight that is round in angles about the mirror direction (n, 3)."""
    along, across = theta_half * np.cos(phi_diff), theta_half * np.cos(theta_diff) * np.sin(phi_diff)
    return np.asarray(0.05 + 8.0 / (1.0 + np.degrees(np.hypot(along, across)) ** 2 / 25.0) ** 2)[:, None] * np.ones(3)


@pytest.mark.parametrize(("is_in_plane", "lowest", "highest"), [(False, 0.8, 1.25), (True, 0.25, 0.7)])
def test_samples_all_around_tell_an_elongated_highlight(is_in_plane: bool, lowest: float, highest: float) -> None:
    """In one plane they cannot: the prediction lies between that of microfacets, 0.13, and the truth."""
    random = np.random.default_rng(3)
    half, diff = random.uniform(0.0, np.radians((20.0, 65.0)), (150, 2)).T
    phi = np.zeros(150) if is_in_plane else random.uniform(0.0, np.pi, 150)
    values = stretched(half, diff, phi) * (1.0 + 0.02 * random.standard_normal((150, 1)))
    first, second = directions(half, diff, phi)
    above = np.minimum(first[:, 2], second[:, 2]) > 0.1
    prediction = SamplePrediction.fit(ScatteredSamples.from_arrays(first[above], second[above], values[above]))
    asked = np.radians([10.0]), np.radians([60.0]), np.radians([90.0])
    ratio = prediction.evaluate_unmasked(*asked) / stretched(*asked)
    assert np.all((ratio > lowest) & (ratio < highest)), ratio


@pytest.mark.parametrize("half_width", [1e-3, 0.02])
def test_highlights_of_a_structure_can_be_bounded(half_width: float) -> None:
    for structure in STRUCTURES:
        bounded = structure.of_samples(half_width)
        for layer in bounded.model(np.clip(bounded.mean - 9.0, *bounded.bounds)).layers:
            if isinstance(layer, SpecularLayer):
                ggx = SpecularLayer(layer.f0, layer.f90, layer.alpha, 2.0, layer.rise, layer.masking, layer.under_coat)
                assert ggx.half_width >= half_width * (1.0 - 1e-9)
        assert (bounded.name, bounded.price) == (structure.name, structure.price)
