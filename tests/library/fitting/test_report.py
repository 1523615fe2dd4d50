"""The report as an object: equality, copies, plain content."""

import copy
import json
import pickle
from dataclasses import replace

import numpy as np
import pytest

from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import profiles
from dsbrdf.fitting.metrics import Metrics
from dsbrdf.fitting.pipeline import fit
from dsbrdf.fitting.report import FitResult, KnotReport
from dsbrdf.model.render import render_sphere

KNOTS = tuple(np.radians([0.0, 30.0, 60.0, 89.0]))


@pytest.fixture(scope="module")
def result(matte: Measurement) -> FitResult:
    return fit(profiles(matte), n_lobes=1, ring_lobes=0, knots=list(KNOTS))


def test_copies_are_equal_and_hash_alike(result: FitResult) -> None:
    for other in (pickle.loads(pickle.dumps(result)), copy.deepcopy(result), copy.copy(result)):
        assert other == result
        assert hash(other) == hash(result)
    assert replace(result.report, n_numbers=1) != result.report
    assert replace(result.report, metrics=Metrics(male=0.1)) != result.report


def test_result_is_evaluated_and_drawn_as_its_model(result: FitResult) -> None:
    angles = np.radians([0.0, 30.0, 80.0]), np.radians(20.0), np.radians([[0.0], [90.0]])
    np.testing.assert_array_equal(result.evaluate(*angles), result.model.evaluate(*angles))
    assert result.evaluate(0.1, 0.2)[0] == result.model.evaluate(0.1, 0.2, np.pi / 2)[0]
    np.testing.assert_array_equal(render_sphere(result, size=16), render_sphere(result.model, size=16))


def test_plain_content_has_lists_and_the_names_of_the_attributes(result: FitResult) -> None:
    content = result.report.to_dict()
    assert json.loads(json.dumps(content)) == content
    assert content["options"]["knots"] == list(KNOTS)
    assert content["knots"]["converged"] == [list(row) for row in result.report.knots.converged]
    assert content["growth"][0]["n_lobes"] == 1


def test_repr_is_one_short_line(result: FitResult) -> None:
    calm = replace(result.report, warnings=())
    assert repr(calm) == f"<FitReport: no metrics, {result.model.n_numbers} numbers, 0 warnings>"
    known = replace(result.report, metrics=Metrics(relative_rms=0.0123456))
    assert repr(known).startswith("<FitReport: relative_rms 0.01235, ")


def test_slices_broadcast_to_channels_and_knots() -> None:
    slices = KnotReport.from_arrays(
        np.array(KNOTS), [True, True, False, True], np.bool_(False), 7, [[True], [False], [True]]
    )
    assert slices.theta_diff == KNOTS
    assert slices.fitted == ((True, True, False, True),) * 3
    assert slices.converged == ((False,) * 4,) * 3
    assert slices.iterations == ((7,) * 4,) * 3
    assert slices.bounds_hit == ((True,) * 4, (False,) * 4, (True,) * 4)
