"""Synthetic materials, and faults of measurements: noticed, while good measurements are not blamed."""

from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest

import dsbrdf
from dsbrdf import InvalidArgumentError, Measurement, Profiles, profiles
from dsbrdf.arrays import Array
from dsbrdf.data import PHI_DIFF, THETA_DIFF, THETA_HALF, model_measurement, synthetic_measurement
from dsbrdf.data.faults import clip_levels, horizon_disagreement, profile_findings
from dsbrdf.data.geometry import incident_cosines, nodes_above_horizon
from dsbrdf.data.value_faults import value_findings
from dsbrdf.fitting import relative_errors, sample_errors
from dsbrdf.model import directional_albedo
from tests.support.models import random_model
from tests.support.reproduced import assert_reproduced

CUTOFF = float(np.radians(80.0))
HALF_OF_GREEN = np.array([False, True, False])[:, None, None, None] & (np.arange(180) < 90)


COSINES = np.stack(incident_cosines(THETA_HALF[:, None, None], THETA_DIFF[:, None], PHI_DIFF)).clip(0.0)
"""Of omega_in and omega_out."""


def changed(measurement: Measurement, change: Callable[[Array], Array]) -> Measurement:
    return Measurement.from_values(change(np.maximum(measurement.values, 0.0)), measurement.valid)


def clipped(values: Array) -> Array:
    """Clip at 30 % of the highlight at normal incidence."""
    return np.minimum(values, 0.3 * values[:, 0, :1].max())


def with_garbage(values: Array) -> Array:
    factors = np.exp(1.5 * np.random.default_rng(0).standard_normal(values.shape))
    return np.where(np.cos(CUTOFF) > COSINES.min(axis=0), values * factors, values)


FAULTS: dict[str, Callable[[Array], Array]] = {
    "clipped-highlight": clipped,
    "sudden-zeros coarse-values": lambda values: np.round(values / values.max() * 255.0) / 255.0 * values.max(),
    "constant-floor": lambda values: values + 0.05,
    "bad-horizon": with_garbage,
    "outside-gamut": lambda values: values - np.array([0.0, 0.0, 0.02])[:, None, None, None],
    "constant-channel": lambda values: np.concatenate([values[:2], np.full_like(values[2:], 0.02)]),
    "uneven-sweeps": lambda values: values * np.where(np.arange(90) < 30, 1.0, 1.1)[:, None],
    "repeated-samples": lambda values: np.repeat(values[:, ::2], 2, axis=1),
    "sudden-zeros": lambda values: np.where(THETA_DIFF[:, None] > np.radians(60.0), 0.0, values),
    "times-cosine": lambda values: values * COSINES[1],
    "hollow-highlight": lambda values: np.where(values > 2.0, values - 1.9, values),
    "noise after clipping": lambda values: (
        clipped(values) * (1.0 + 0.01 * np.random.default_rng(3).standard_normal(values.shape))
    ),
    "a number below 0": lambda values: np.where(HALF_OF_GREEN, -1.0, values),
    "a copied half": lambda values: np.concatenate([values[..., :90]] * 2, axis=-1),
    "a missing centre": lambda values: np.where(THETA_HALF[:, None, None] < np.radians(2.0), -1.0, values),
}
LAYOUTS: dict[str, Callable[[Array], Array]] = {
    "theta_half descends": lambda values: values[:, ::-1],
    "theta_half is evenly spaced": lambda values: values[:, np.sqrt(90.0 * np.arange(90)).round().astype(int)],
    "theta_diff descends": lambda values: values[:, :, ::-1],
    "theta_half and theta_diff are exchanged": lambda values: values.swapaxes(1, 2),
    "theta_half is off by 1 nodes": lambda values: np.roll(values, 1, axis=1),
    "theta_diff is off by -2 nodes": lambda values: np.roll(values, -2, axis=2),
    "phi_diff covers 360 degrees": lambda values: np.concatenate([values[..., ::2]] * 2, axis=-1),
    "phi_diff begins at 90 degrees": lambda values: np.roll(values, 90, axis=-1),
    "phi_diff begins at 179 degrees": lambda values: np.roll(values, 1, axis=-1),
}


@pytest.fixture(scope="module")
def paint() -> Measurement:
    return synthetic_measurement(roughness=0.12, diffuse=(0.004, 0.005, 0.006), noise=0.02)


def codes(measurement: Measurement) -> list[str]:
    return [one.code for one in (*profile_findings(profiles(measurement)), *value_findings(measurement))]


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_noticed(paint: Measurement, fault: str) -> None:
    spoiled = changed(paint, FAULTS[fault])
    found = [*profile_findings(profiles(spoiled)), *value_findings(spoiled)]
    assert found
    assert_reproduced(f"faults/{fault}", [asdict(one) for one in found])


@pytest.mark.parametrize("layout", LAYOUTS)
def test_another_order_of_angles_is_named(paint: Measurement, layout: str) -> None:
    found = {one.code: one.sentence for one in value_findings(Measurement.from_values(LAYOUTS[layout](paint.values)))}
    assert f"a file in which {layout}:" in found["misplaced-angles"]


def test_nothing_is_a_false_alarm(
    plastic: Measurement, matte: Measurement, metal: Measurement, paint: Measurement
) -> None:
    lambertian = changed(matte, lambda values: np.full_like(values, 0.1))
    sparse = Measurement.from_values(matte.values, matte.valid & (np.arange(180) % 45 == 0))
    for good in (plastic, matte, metal, paint, lambertian, sparse):
        assert codes(good) == []


def test_samples_of_a_clipped_highlight_count_as_lower_bounds(metal: Measurement) -> None:
    spoiled = changed(metal, clipped)
    assert np.isfinite(clip_levels(profiles(spoiled).folded)).all()
    assert np.isinf(clip_levels(profiles(metal).folded)).all()
    result = dsbrdf.fit(spoiled, n_lobes=3)
    peak, level = float(metal.values[0, 0, 0, 0]), float(spoiled.values[0, 0, 0, 0])
    assert float(result.model.evaluate(0.0, 0.0)[0]) > level + 0.2 * (peak - level)
    assert "clipped-highlight" in [found.code for found in result.report.findings]
    parts, known = dsbrdf.decompose(result), dsbrdf.decompose(result.model)
    assert any(part.half_width is not None for part in known)
    assert all(part.half_width is None for part in parts)
    assert {surface.alpha for part in parts for surface in part.surfaces} <= {None}


def test_garbage_beyond_a_cutoff_changes_nothing_inside(plastic: Measurement) -> None:
    black = changed(plastic, lambda values: np.where(np.cos(CUTOFF) > COSINES.min(axis=0), 0.0, values))
    spoiled = changed(plastic, with_garbage)
    models = (dsbrdf.fit(data, n_lobes=1, ring_lobes=0).model for data in (plastic, spoiled, black))
    good, *found = (relative_errors(sample_errors(model, plastic, CUTOFF)) for model in models)
    assert good is not None
    for errors in found:
        assert errors is not None
        assert errors.relative_rms < 1.1 * good.relative_rms + 0.005
    assert horizon_disagreement(profiles(plastic).folded, CUTOFF)[0] < 1.0
    assert horizon_disagreement(profiles(spoiled).folded, None)[0] == 0.0


@pytest.mark.parametrize(
    ("logs", "disagreement"),
    [
        (0.4 * (-1.0) ** np.arange(90), 0.8 / 0.3),  # Each row differs by 0.8 from the mean of its neighbours.
        (0.02 * np.arange(90.0), 0.04 / 0.8),  # Rows 2 degrees apart differ by 0.04.
    ],
)
def test_disagreement_beyond_the_cutoff_is_in_units_of_its_limits(
    logs: Array, disagreement: float, plastic_profiles: Profiles
) -> None:
    folded = plastic_profiles.folded
    mean = np.exp(logs)[:, None, None] * np.ones_like(folded.mean)
    found, trust = horizon_disagreement(replace(folded, mean=mean), CUTOFF)
    assert found == pytest.approx(disagreement, rel=0.01)
    assert trust[0, 89, 40, 0] == pytest.approx(max(found, 1.0) ** -12.0)
    assert trust[0, 20, 40, 0] == 1.0


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


BAD_SURFACES = ({"roughness": 0.0}, {"diffuse": (0.1, 0.2)}, {"specular": (0.1, 0.2, 1.1)})
OUT_OF_RANGE = (*BAD_SURFACES, {"noise": np.nan}, {"noise": -0.1})


@pytest.mark.parametrize("arguments", OUT_OF_RANGE, ids=repr)
def test_parameters_out_of_range_are_named(arguments: dict[str, Any]) -> None:
    with pytest.raises(InvalidArgumentError) as caught:
        synthetic_measurement(**arguments)
    assert_reproduced(f"options/synthetic {arguments}", str(caught.value))
