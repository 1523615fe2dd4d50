"""A model and a report to be written and read."""

import numpy as np
import pytest

from dsbrdf import DSBRDF, Finding, FitOptions, FitReport
from dsbrdf.fitting import DirectionalAlbedo, KnotReport, Metrics, SelectionStep
from dsbrdf.fitting.lobe_search import SearchStep
from dsbrdf.fitting.metrics import BandErrors, ChannelErrors
from dsbrdf.version import Versions
from tests.support.models import make_model


@pytest.fixture
def model() -> DSBRDF:
    return make_model()


@pytest.fixture
def report() -> FitReport:
    numbers = np.random.default_rng(0).standard_normal((3, 4)).tolist()
    return FitReport(
        findings_of_fit=(
            Finding("incomplete", "The model is extrapolated.", {"angle": 1e-3}),
            Finding("grün", "Grün µ"),
        ),
        metrics=Metrics(relative_rms=0.1 + 0.2, floor=1e-323, excess=1.7976931348623157e308),
        by_channel=(ChannelErrors(0.5, 0.25, 0.1, 2.0, 1e-3, "red"),),
        by_theta_diff=(BandErrors(0.0, 0.0, 0.0, None, 0.0, (0.0, 0.1)),),
        knots=KnotReport.from_arrays(numbers[0], True, [False, True, True, False], [[3], [100], [7]], False),
        search=(SearchStep(n_lobes=1, ring_lobes=0, error=1e-5, kept=True),),
        selection=(SelectionStep(1, -0.3, 1.5, None, None, None, False),),
        directional_albedo=DirectionalAlbedo((0.0, 0.5, 1.0), tuple(map(tuple, numbers))),
        n_numbers=378,
        timings={"em": 0.1},
        options=FitOptions(n_lobes=3, method="paper", robust=True),
        versions=Versions(algorithm="2", dsbrdf="0.1.0", numpy="Grün µ", scipy="1.17", python="3.13.0"),
    )
