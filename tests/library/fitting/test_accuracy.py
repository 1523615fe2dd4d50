"""How accurate the default fit is on known materials: a search that finds something worse is noticed."""

from dataclasses import asdict

import pytest

from dsbrdf import Measurement, fit
from dsbrdf.data import nodes_above_horizon, synthetic_measurement

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def coated_paint() -> Measurement:
    """A narrow highlight, a wide one of another colour, and a ground."""
    coat = synthetic_measurement(roughness=0.04, diffuse=(0.02, 0.05, 0.2), specular=(0.04, 0.04, 0.04))
    flakes = synthetic_measurement(roughness=0.3, diffuse=(0.0, 0.0, 0.0), specular=(0.25, 0.2, 0.1))
    return Measurement.from_values(coat.values + flakes.values, nodes_above_horizon(), "coated paint")


@pytest.mark.filterwarnings("ignore::dsbrdf.errors.ConvergenceWarning")
@pytest.mark.parametrize(
    ("name", "excess", "albedo_error", "psnr"),
    [("metal", 0.118, 0.0015, 59.1), ("matte", 0.188, 0.0025, 39.3), ("coated_paint", 0.255, 0.0027, 47.7)],
)
def test_the_default_fit_is_as_accurate_as_it_was_has_no_warnings_and_beats_the_paper(
    name: str, excess: float, albedo_error: float, psnr: float, request: pytest.FixtureRequest
) -> None:
    measurement = request.getfixturevalue(name)
    result = fit(measurement)
    assert result.report.findings_of_fit == ()
    ours, papers = (asdict(one.report.metrics) for one in (result, fit(measurement, method="paper", n_lobes=2)))
    assert ours["excess"] < excess
    assert ours["albedo_error"] < albedo_error
    assert ours["psnr"] > psnr
    assert ours["psnr"] > papers["psnr"]
    for metric in ("relative_rms", "male", "albedo_error"):
        assert ours[metric] < papers[metric], metric
