"""A model and a report to be written and read."""

import numpy as np
import pytest

from dsbrdf import DSBRDF
from dsbrdf.fitting.report import FitReport
from tests.support.models import make_model


@pytest.fixture
def model() -> DSBRDF:
    return make_model()


@pytest.fixture
def report() -> FitReport:
    numbers = np.random.default_rng(0).standard_normal((3, 4)).tolist()
    return FitReport(
        metrics={"relative_rms": 0.1 + 0.2, "floor": 1e-323, "excess": 1.7976931348623157e308, "male": None},
        by_channel=[{"channel": "red", "excess": 1.5}],
        by_theta_diff=[],
        slices={"theta_diff": numbers[0], "converged": [[True, False]], "iterations": [[3, 100]]},
        growth=[{"n_lobes": 1, "ring_lobes": 0, "error": 1e-5, "pays": True}],
        selection=[{"n_lobes": 1, "t": None, "significant": False}],
        albedo={"theta_out": [0.0], "albedo": numbers},
        n_numbers=378,
        timings={"em": 0.1},
        options={"n_lobes": 3, "method": "paper", "mask": None, "robust": False},
        versions={"dsbrdf": "0.1.0", "name": "Grün µ"},
    )
