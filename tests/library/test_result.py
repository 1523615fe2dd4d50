import re
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from dsbrdf import Finding, FitResult, Measurement, decompose, fit, profiles, render_sphere
from dsbrdf.data import THETA_DIFF, THETA_HALF, synthetic_measurement
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


def test_ends_of_a_measurement_and_strange_albedos_are_told(matte: Measurement) -> None:
    up_to_60, up_to_50 = THETA_DIFF <= np.radians(60.1), THETA_HALF[:, None] <= np.radians(50.0)
    whole, *ended = (
        profiles(Measurement.from_values(matte.values, matte.valid & kept[..., None]))
        for kept in (np.ones((90, 90), bool), up_to_60, up_to_50)
    )
    bright = replace(MODERATE, rgb=((0.3, 0.3, 0.3), (0.5, 1.2, 0.5)))
    dark = replace(MODERATE, rgb=((2e-4,) * 3, (1e-4,) * 3))
    for name, data, albedo in (
        ("good", whole, MODERATE),
        ("up to theta_diff = 60", ended[0], MODERATE),
        ("up to theta_half = 50", ended[1], MODERATE),
        ("bright", whole, bright),
        ("dark", whole, dark),
    ):
        assert_reproduced(f"findings/{name}", [asdict(one) for one in fit_findings(data, CONVERGED, albedo)])


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
