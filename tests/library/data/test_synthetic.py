from typing import Any

import numpy as np
import pytest

from dsbrdf import InvalidArgumentError, Measurement
from dsbrdf.data import THETA_DIFF, THETA_HALF, model_measurement, nodes_above_horizon, synthetic_measurement
from dsbrdf.model import directional_albedo
from tests.support.random_models import random_model


def test_albedo_is_that_of_the_material(matte: Measurement, metal: Measurement) -> None:
    albedo = directional_albedo(metal.interpolated.evaluate, np.array(0.3))
    np.testing.assert_allclose(albedo, [0.95, 0.64, 0.54], rtol=0.04)
    # Ashikhmin and Shirley: the diffuse albedo at normal incidence is close to diffuse (1 - F0).
    albedo = directional_albedo(matte.interpolated.evaluate, np.array(0.05))
    assert albedo == pytest.approx(np.array([0.6, 0.5, 0.4]) * 0.98, rel=0.1)


def test_values_are_reciprocal(matte: Measurement) -> None:
    values, valid = matte.values[..., 1:], matte.valid[..., 1:]
    np.testing.assert_array_equal(valid, valid[..., ::-1])
    np.testing.assert_allclose(values[:, valid], values[..., ::-1][:, valid], rtol=1e-10)


def test_microfacet_lobe_against_the_separate_terms() -> None:
    """D, G and F of Walter et al. (2007) and Heitz (2014) written out at one node."""
    alpha, i, j, k = 0.3, 35, 40, 25
    measurement = synthetic_measurement(roughness=alpha, diffuse=(0, 0, 0), specular=(0.04, 0.04, 0.04))
    half, diff, turn = THETA_HALF[i], THETA_DIFF[j], np.deg2rad(k)
    level, swing = np.cos(half) * np.cos(diff), np.sin(half) * np.sin(diff) * np.cos(turn)
    angle_in, angle_out = np.arccos(level - swing), np.arccos(level + swing)
    tangent = np.tan(half)
    d = 1 / (np.pi * alpha**2 * np.cos(half) ** 4 * (1 + (tangent / alpha) ** 2) ** 2)
    shadow = [(np.sqrt(1 + (alpha * np.tan(angle)) ** 2) - 1) / 2 for angle in (angle_in, angle_out)]
    g = 1 / (1 + shadow[0] + shadow[1])
    f = 0.04 + 0.96 * (1 - np.cos(diff)) ** 5
    expected = d * g * f / (4 * np.cos(angle_in) * np.cos(angle_out))
    np.testing.assert_allclose(measurement.values[:, i, j, k], expected, rtol=1e-11)


def test_noise_is_seeded_relative_and_unbiased(metal: Measurement) -> None:
    metallic: dict[str, Any] = {"roughness": 0.05, "diffuse": (0.0, 0.0, 0.0), "specular": (0.95, 0.64, 0.54)}
    first, again, other = (synthetic_measurement(**metallic, noise=0.05, seed=seed) for seed in (4, 4, 5))
    assert first.sha256 == again.sha256 != other.sha256
    ratio = first.values[:, metal.valid] / metal.values[:, metal.valid]
    assert ratio.mean() == pytest.approx(1.0, abs=2e-4)
    assert ratio.std() == pytest.approx(0.05, rel=5e-3)
    assert (ratio > 0).all()
    assert abs(np.corrcoef(ratio[0], ratio[1]).ravel()[1]) < 5e-3


def test_model_measurement_holds_the_model() -> None:
    model, above = random_model(), nodes_above_horizon()
    measurement = model_measurement(model, name="wild")
    np.testing.assert_array_equal(measurement.valid, above)
    np.testing.assert_allclose(measurement.values[:, above], model.tabulate()[:, above], rtol=1e-11)
    assert (measurement.stored[:, ~above] == -1.0).all()
    assert measurement.name == "wild"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"roughness": 0.0}, r"roughness must be in \[0\.005, 1\], not 0"),
        ({"roughness": np.nan}, r"roughness must be"),
        ({"diffuse": (0.1, 0.2)}, r"diffuse must be three numbers \(RGB\) in \[0, 1\], not \(0\.1, 0\.2\)"),
        ({"specular": (0.1, 0.2, 1.1)}, r"specular must be three numbers"),
        ({"specular": (0.1, 0.2, np.nan)}, r"specular must be three numbers"),
        ({"noise": np.nan}, r"noise must be in"),
        ({"noise": -0.1}, r"noise must be in \[0, 1\], not -0\.1"),
        ({"noise": 2.0}, r"noise must be in"),
    ],
)
def test_parameters_out_of_range_are_named(arguments: dict[str, float], message: str) -> None:
    with pytest.raises(InvalidArgumentError, match=message):
        synthetic_measurement(**arguments)  # type: ignore[arg-type]
