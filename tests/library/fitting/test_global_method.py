"""The default fit: it recovers what it is given, beats the paper's, and keeps calm where there are no data."""

import itertools
import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf.data.grid import CHANNELS, THETA_HALF
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import Profiles, profiles
from dsbrdf.data.synthetic import model_measurement
from dsbrdf.errors import ConvergenceWarning
from dsbrdf.fitting import global_method as global_fit
from dsbrdf.fitting.em import GAMMA_BOUNDS, KAPPA_BOUNDS
from dsbrdf.fitting.metrics import mean_absolute_log_error, on_grid
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import fit
from dsbrdf.fitting.report import FitResult
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.serialize import from_json, to_json
from tests.support.mixtures import mixture
from tests.support.models import curve_error

Array = NDArray[np.float64]

CUTOFF = FitOptions().horizon_cutoff

PLAIN = FitOptions(n_lobes=2, ring_lobes=0)


def cubic(n_lobes: int = 2) -> DSBRDF:
    """Well separated lobes whose parameters run along splines, knots inside the usual cutoff."""
    knots = np.radians([0.0, 12.0, 24.0, 36.0, 46.0, 54.0, 60.0, 66.0, 71.0, 75.0, 79.0])
    rise = (1.0 - np.cos(knots))[:, None]
    channel = np.array([1.0, 0.8, 1.2])[:, None, None]
    kappa = np.array([4.0, 0.25, 1.2])[:n_lobes] * channel * (1.0 + 0.3 * rise)
    gamma = np.array([1500.0, 1.5, 60.0])[:n_lobes] * (1.0 - 0.2 * rise) * np.ones((3, 1, 1))
    return DSBRDF(knots, kappa, gamma, np.zeros_like(kappa), np.zeros((3, knots.size)), "cubic")


def assert_parameters_within(found: DSBRDF, truth: DSBRDF, share: float) -> None:
    """Kappa and gamma at the knots of the fit, lobes ordered by width on both sides.

    Above 70 degrees the cutoff leaves so little of theta_half that the shape of a wide lobe cannot be seen.
    """
    kappa, gamma, _, _ = (np.moveaxis(p, 1, 0) for p in truth.parameters_at(found.theta_diff))
    order = np.argsort(-gamma[0, 0])
    np.testing.assert_allclose(found.kappa, kappa[:, :, order], rtol=share)
    seen = found.theta_diff < np.radians(70.0)
    np.testing.assert_allclose(found.gamma[:, seen], gamma[:, seen][:, :, order], rtol=share)


@pytest.fixture(scope="module")
def plastic_profiles(plastic: Measurement) -> Profiles:
    return profiles(plastic)


@pytest.fixture(scope="module")
def fitted(plastic: Measurement) -> FitResult:
    return fit(plastic)


# Recovery


def test_cubic_model_is_recovered() -> None:
    truth = cubic()
    data = profiles(model_measurement(truth))
    model = fit(data, PLAIN).model
    assert curve_error(model, truth, data) < 1e-4
    assert_parameters_within(model, truth, 0.01)


def test_paper_like_model_is_recovered() -> None:
    truth = mixture(2, 0)  # linear between 18 knots
    data = profiles(model_measurement(truth))
    model = fit(data, PLAIN).model
    assert curve_error(model, truth, data) < 2e-3
    assert_parameters_within(model, truth, 0.01)


def test_same_knots_give_the_same_model() -> None:
    truth = cubic()
    data = profiles(model_measurement(truth))
    model = fit(data, replace(PLAIN, knots=tuple(truth.theta_diff.tolist()))).model
    np.testing.assert_allclose(model.theta_diff, truth.theta_diff)
    assert curve_error(model, truth, data) < 1e-5
    assert_parameters_within(model, truth, 0.01)


# Against the paper's method, and against the floor


def test_default_beats_the_paper_and_is_near_the_floor(measurements: tuple[Measurement, ...]) -> None:
    for measurement in measurements:
        data = profiles(measurement)
        ours = fit(data).report.metrics
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
            paper = fit(data, FitOptions(method="paper")).report.metrics
        assert ours["relative_rms"] < paper["relative_rms"], measurement.name  # type: ignore[operator]
        assert ours["excess"] is not None
        assert 1.0 <= ours["excess"] < 1.5, measurement.name


def test_weightings_do_what_they_are_for(plastic: Measurement) -> None:
    options = FitOptions(n_lobes=2, ring_lobes=0)
    plain = fit(plastic, options)
    cosine = fit(plastic, replace(options, weighting="cosine"))
    log = fit(plastic, replace(options, weighting="log"))
    male = [result.report.metrics["male"] for result in (plain, cosine, log)]
    assert male[2] < male[0]  # type: ignore[operator]
    weighted = profiles(plastic, weighting="cosine")
    lobes_only = np.where(THETA_HALF >= np.radians(1.0), weighted.weight, 0.0)
    error = [float(np.sum(lobes_only * (on_grid(r.model) - weighted.mean) ** 2)) for r in (plain, cosine)]
    assert error[1] < error[0]
    assert male[2] == pytest.approx(mean_absolute_log_error(log.model, plastic, CUTOFF), rel=1e-12)
    assert all(result.report.metrics["excess"] >= 1.0 for result in (plain, cosine, log))  # type: ignore[operator]


def test_knots_are_used(plastic_profiles: Profiles) -> None:
    knots = tuple(np.radians([0.0, 20.0, 40.0, 55.0, 65.0, 72.0, 76.0, 79.0]).tolist())
    result = fit(plastic_profiles, FitOptions(n_lobes=2, ring_lobes=0, knots=knots))
    np.testing.assert_allclose(result.model.theta_diff, knots)
    assert result.report.options["knots"] == list(knots)


def test_lobes_mean_the_same_in_every_channel() -> None:
    truth = cubic(3)
    swapped = DSBRDF(  # the channels list their lobes in different orders
        truth.theta_diff,
        np.stack([truth.kappa[0], truth.kappa[1][:, [2, 0, 1]], truth.kappa[2][:, ::-1]]),
        np.stack([truth.gamma[0], truth.gamma[1][:, [2, 0, 1]], truth.gamma[2][:, ::-1]]),
        truth.center,
        truth.delta,
        "cubic",
    )
    model = fit(profiles(model_measurement(swapped, noise=0.01)), FitOptions(n_lobes=3, ring_lobes=0)).model
    assert_parameters_within(model, truth, 0.1)
    assert np.all(np.diff(np.median(model.gamma, axis=1), axis=1) < 0.0)  # from narrow to wide


def test_channels_are_aligned() -> None:
    truth = cubic(3)
    center = np.zeros_like(truth.kappa)
    center[:, :, 1] = 0.4
    order = [[0, 1, 2], [1, 2, 0], [2, 0, 1]]
    kappa, gamma, turned = (np.stack([p[c][:, order[c]] for c in range(3)]) for p in (truth.kappa, truth.gamma, center))
    aligned = global_fit._align(DSBRDF(truth.theta_diff, kappa, gamma, turned, truth.delta, "cubic"))
    for name, expected in (("kappa", truth.kappa), ("gamma", truth.gamma), ("center", center)):
        np.testing.assert_array_equal(getattr(aligned, name), expected[:, :, [0, 2, 1]])  # narrow, wide, ring


def test_delta_never_makes_the_model_negative(plastic_profiles: Profiles) -> None:
    mean = np.where(THETA_HALF < np.radians(1.0), 0.0, plastic_profiles.mean)
    model = fit(replace(plastic_profiles, mean=mean), PLAIN).model
    assert model.delta.min() < 0.0
    rows = np.round(np.degrees(model.theta_diff)).astype(int)
    assert on_grid(model)[:, rows].min() >= -1e-12 * mean.max()


def test_delta_is_what_the_lobes_leave() -> None:
    truth = replace(cubic(), delta=np.full((3, 11), 40.0))
    model = fit(profiles(model_measurement(truth)), PLAIN).model
    inner, outer = THETA_HALF < np.radians(1.0), THETA_HALF >= np.radians(1.0)
    expected, found = on_grid(truth)[:, :75], on_grid(model)[:, :75]
    np.testing.assert_allclose(found[:, :, outer], expected[:, :, outer], rtol=0.1, atol=0.01)
    assert np.abs(found[:, :, inner] / expected[:, :, inner] - 1.0).max() < 0.2


# Progress, flags and the report


def test_progress_grows_from_0_to_1(plastic_profiles: Profiles) -> None:
    shares: list[float] = []
    fit(plastic_profiles, PLAIN, progress=shares.append)
    assert shares[0] == 0.0
    assert shares[-1] == 1.0
    assert shares == sorted(shares)
    assert len(shares) > 8


@pytest.mark.parametrize("at", [0.2, 0.6, 0.95])
def test_what_progress_raises_ends_the_fit(plastic_profiles: Profiles, at: float) -> None:
    def stop(share: float) -> None:
        if share >= at:
            raise InterruptedError(f"{share}")

    with pytest.raises(InterruptedError):
        fit(plastic_profiles, PLAIN, progress=stop)


def test_warning_only_where_the_bound_on_iterations_was_met(
    plastic_profiles: Profiles, monkeypatch: pytest.MonkeyPatch
) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = fit(plastic_profiles, PLAIN)
    assert np.all(result.report.slices["converged"])
    monkeypatch.setattr(global_fit, "MAX_ITERATIONS", 1)
    with pytest.warns(ConvergenceWarning, match="slices stopped at the bound of"):
        result = fit(plastic_profiles, PLAIN)
    assert not np.any(result.report.slices["converged"])
    assert np.all(np.array(result.report.slices["iterations"]) == 1)


def test_report_is_complete(fitted: FitResult) -> None:
    report, model = fitted.report, fitted.model
    shape = (3, model.theta_diff.size)
    np.testing.assert_allclose(report.slices["theta_diff"], model.theta_diff)
    for name in ("fitted", "converged", "iterations", "bounds_hit"):
        assert np.shape(report.slices[name]) == shape, name
    assert [row["n_lobes"] for row in report.selection] == [1, 2, 3, 4, 5]
    for row in report.selection:
        assert set(row) == {"n_lobes", "e_p", "squared_error", "bic", "t", "critical_value", "significant"}
    rings = int(np.any(model.center > 0, axis=(0, 1)).sum())
    assert sum(row["pays"] for row in report.rings) == rings
    assert model.n_lobes - rings == 1 + sum(row["significant"] for row in report.selection)
    assert [row["channel"] for row in report.by_channel] == list(CHANNELS)
    edges = [row["theta_diff"] for row in report.by_theta_diff]
    assert edges[0][0] == 0.0
    assert all(a[1] == b[0] for a, b in itertools.pairwise(edges))
    assert all(row["excess"] >= 1.0 for row in report.by_channel + report.by_theta_diff)
    assert set(report.timings) == {"profiles", "search", "refine", "metrics", "energy"}
    assert FitOptions(**report.options) == FitOptions()
    assert {"algorithm", "dsbrdf", "numpy", "scipy", "python"} <= set(report.versions)
    assert np.shape(report.energy["sum_inverse_c"]) == shape


def test_bounds_hit_is_said() -> None:
    flat = np.full((3, 2, 1), 1.0)
    model = DSBRDF(np.radians([0.0, 80.0]), flat, 5.0 * flat, 0.0 * flat, np.zeros((3, 2)))
    kappa, gamma = model.kappa.copy(), model.gamma.copy()
    kappa[0, 1], gamma[2, 0] = KAPPA_BOUNDS[1], GAMMA_BOUNDS[0]
    model = DSBRDF(model.theta_diff, kappa, gamma, model.center, model.delta)
    assert global_fit._bounds_hit(model).tolist() == [[False, True], [False, False], [True, False]]


def test_result_survives_json(fitted: FitResult) -> None:
    text = to_json(fitted.model, fitted.report)
    model, report = from_json(text)
    assert report == fitted.report
    for name in ("theta_diff", "kappa", "gamma", "center", "delta"):
        np.testing.assert_array_equal(getattr(model, name), getattr(fitted.model, name))
    assert model.interpolation == "cubic"
    json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))


def test_same_measurement_same_model(plastic_profiles: Profiles) -> None:
    first, second = (fit(plastic_profiles).model for _ in range(2))
    assert first.kappa.tobytes() == second.kappa.tobytes()
    assert first.delta.tobytes() == second.delta.tobytes()
