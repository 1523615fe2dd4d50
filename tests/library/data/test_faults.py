"""Faults of measurements are noticed, good measurements are not blamed, and what is good still counts."""

from collections.abc import Callable

import numpy as np
import pytest

import dsbrdf
from dsbrdf import Measurement, profiles
from dsbrdf.arrays import Array
from dsbrdf.data import PHI_DIFF, THETA_DIFF, THETA_HALF, incident_cosines, synthetic_measurement
from dsbrdf.data.faults import clip_levels, horizon_disagreement, profile_findings, value_findings
from dsbrdf.fitting import relative_errors, sample_errors

CUTOFF = float(np.radians(80.0))
LOWEST = np.minimum(*incident_cosines(THETA_HALF[:, None, None], THETA_DIFF[:, None], PHI_DIFF))
BEYOND = np.cos(CUTOFF) > LOWEST


def changed(measurement: Measurement, change: Callable[[Array], Array]) -> Measurement:
    return Measurement.from_values(change(np.maximum(measurement.values, 0.0)), measurement.valid)


def clipped(values: Array) -> Array:
    """Clip at 30 % of the highlight at normal incidence."""
    return np.minimum(values, 0.3 * values[:, 0, :1].max())


def in_8_bits(values: Array) -> Array:
    step = values.max() / 255.0
    return np.round(values / step) * step


def with_garbage(values: Array) -> Array:
    factors = np.exp(1.5 * np.random.default_rng(0).standard_normal(values.shape))
    return np.where(BEYOND, values * factors, values)


def outside_gamut(values: Array) -> Array:
    return values - np.array([0.0, 0.0, 0.02])[:, None, None, None]


FAULTS = {
    "clipped-highlight": clipped,
    "coarse-values": in_8_bits,
    "constant-floor": lambda values: values + 0.05,
    "bad-horizon": with_garbage,
    "outside-gamut": outside_gamut,
    "uneven-sweeps": lambda values: values * np.where(np.arange(90) < 30, 1.0, 1.2)[:, None],
    "repeated-samples": lambda values: np.repeat(values[:, ::2], 2, axis=1),
}


@pytest.fixture(scope="module")
def paint() -> Measurement:
    return synthetic_measurement(roughness=0.12, diffuse=(0.004, 0.005, 0.006), noise=0.02)


def codes(measurement: Measurement) -> list[str]:
    found = [*profile_findings(profiles(measurement)), *value_findings(measurement)]
    return [one.code for one in found]


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_noticed(paint: Measurement, fault: str) -> None:
    assert codes(changed(paint, FAULTS[fault])) == [fault]


def test_a_missing_centre_is_noticed(paint: Measurement) -> None:
    found = Measurement.from_values(paint.values, paint.valid & (THETA_HALF >= np.radians(2.0))[:, None, None])
    (one,) = profile_findings(profiles(found))
    assert "no valid samples with theta_half below 2.2 degrees: the height of a highlight" in one.sentence
    assert one.numbers == {"theta_half_deg": pytest.approx(14**2 / 90)}


def test_there_are_no_false_alarms(
    plastic: Measurement, matte: Measurement, metal: Measurement, paint: Measurement
) -> None:
    lambertian = changed(matte, lambda values: np.full_like(values, 0.1))
    for good in (plastic, matte, metal, paint, lambertian):
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
    spoiled = [changed(plastic, fault) for fault in (with_garbage, lambda values: np.where(BEYOND, 0.0, values))]
    models = (dsbrdf.fit(data, n_lobes=1, ring_lobes=0).model for data in (plastic, *spoiled))
    good, *found = (relative_errors(sample_errors(model, plastic, CUTOFF)) for model in models)
    assert good is not None
    for errors in found:
        assert errors is not None
        assert errors.relative_rms < 1.1 * good.relative_rms + 0.005
    assert horizon_disagreement(profiles(plastic).folded, CUTOFF)[0] < 1.0
    assert horizon_disagreement(profiles(spoiled[0]).folded, None)[0] == 0.0
