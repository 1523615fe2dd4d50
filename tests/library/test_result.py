import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf import Finding, FitResult, Measurement, decompose, fit, profiles, render_sphere
from dsbrdf.data import THETA_DIFF, THETA_HALF, nodes_above_horizon, synthetic_measurement
from dsbrdf.fitting import DirectionalAlbedo, KnotReport, Metrics
from dsbrdf.result import accuracy_findings, fit_findings, verdict
from tests.support.reproduced import assert_reproduced, of_fit

pytestmark = pytest.mark.slow

CONVERGED = KnotReport.from_arrays(np.zeros(1), True, True, 5, False)
MODERATE = DirectionalAlbedo((0.0, 1.0), ((0.3, 0.3, 0.3), (0.5, 1.0, 0.5)))


@pytest.mark.parametrize("name", ["rgl_satin_purple", "merl_red-plastic", "rgl_acrylic_felt_pink"])
def test_measured_materials_have_none(reference_files: dict[str, Path], name: str) -> None:
    if name not in reference_files:
        pytest.skip(f"{name} is not among the measured materials")
    assert fit(reference_files[name]).report.findings_of_fit == ()


@pytest.mark.parametrize(
    ("kept", "end"),
    [
        (THETA_DIFF[None] <= np.radians(60.1), "theta_diff = 60"),
        (THETA_HALF[:, None] <= np.radians(50.0), "theta_half = 50"),
    ],
)
def test_measurement_that_does_not_reach_the_rim(matte: Measurement, kept: NDArray[np.bool_], end: str) -> None:
    valid = nodes_above_horizon() & kept[..., None]
    ended = profiles(Measurement.from_values(matte.values, valid))
    (found,) = fit_findings(ended, CONVERGED, MODERATE)
    assert f"no valid samples beyond {end} degrees: the model is extrapolated there" in found.sentence


def test_model_that_reflects_more_than_it_receives(matte: Measurement) -> None:
    data = profiles(matte)
    bright = replace(MODERATE, rgb=((0.3, 0.3, 0.3), (0.5, 1.2, 0.5)))
    (found,) = fit_findings(data, CONVERGED, bright)
    assert "than it receives: its directional albedo is 1.200 at 57 degrees in the green channel" in found.sentence
    assert found.numbers["albedo"] == 1.2
    assert not [*fit_findings(data, CONVERGED, MODERATE)]
    (found,) = fit_findings(data, CONVERGED, replace(MODERATE, rgb=((2e-4,) * 3, (1e-4,) * 3)))
    assert (found.code, found.numbers) == ("albedo-near-0", {"albedo": 2e-4})


def test_noisy_measurement() -> None:
    result = fit(synthetic_measurement(roughness=0.3, noise=0.3), n_lobes=2, ring_lobes=0)
    assert_reproduced("fit/noisy", of_fit(result), 0.02)
    assert [found.code for found in result.report.findings_of_fit] == ["asymmetric"]


ACCURACIES = (
    (0.09, 0.0, 0.1, 45.0),
    (0.14, 0.1, 0.1, 38.0),
    (0.11, 0.0, 0.1, 32.0),
    (0.32, 0.2, 0.1, 26.0),
    (0.1, 0.1, 0.2, 25.9),
    (0.05, 0.01, 0.0, 41.0),
    (0.2, 0.01, 0.0, 41.0),
)
"""relative_rms, symmetric_floor, albedo_error and psnr of fits."""


def test_large_errors_are_told_and_the_verdict_knows_of_a_missed_highlight() -> None:
    said = {}
    for errors in ACCURACIES:
        metrics = Metrics(**dict(zip(("relative_rms", "symmetric_floor", "albedo_error", "psnr"), errors, strict=True)))
        said[str(errors)] = [verdict(metrics), *(found.sentence for found in accuracy_findings(metrics))]
    assert_reproduced("findings/accuracy", said)
    assert verdict(Metrics()) is None


@pytest.fixture(scope="module")
def result(matte: Measurement) -> FitResult:
    return fit(profiles(matte), n_lobes=1, ring_lobes=0, knots_deg=(0.0, 30.0, 60.0, 89.0))


def test_result_is_evaluated_and_drawn_as_its_model(result: FitResult) -> None:
    angles = np.radians([0.0, 30.0, 80.0]), np.radians(20.0), np.radians([[0.0], [90.0]])
    np.testing.assert_array_equal(result.evaluate(*angles), result.model.evaluate(*angles))
    assert result.evaluate(0.1, 0.2)[0] == result.model.evaluate(0.1, 0.2, np.pi / 2)[0]
    np.testing.assert_array_equal(render_sphere(result, size=16), render_sphere(result.model, size=16))


def test_findings_are_those_of_the_fit_and_of_the_components(result: FitResult) -> None:
    known = replace(result, report=replace(result.report, findings_of_fit=(Finding("grey", "Grey."),)))
    assert known.report.findings == (Finding("grey", "Grey."), *decompose(known).findings)
    assert known.report.warnings == ("Grey.", *decompose(known).remarks)
    assert result.report.findings == decompose(result).findings
    assert known.report.to_dict()["findings_of_fit"] == [{"code": "grey", "sentence": "Grey.", "numbers": {}}]


def test_the_page_on_faults_lists_every_code() -> None:
    root = Path(__file__).parents[2]
    sources = "".join(path.read_text() for path in sorted((root / "dsbrdf").rglob("*.py")))
    codes = {*re.findall(r'Finding\(\s*"([\w-]+)"', sources), "sheen", "retro-reflection"}
    assert {code for code in codes if f"`{code}`" not in (root / "docs/faults.md").read_text()} == set()
    assert len(codes) > 20
