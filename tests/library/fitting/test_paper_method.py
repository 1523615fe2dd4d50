"""The paper's fit: known lobes come back, options do what they say, and what goes wrong is said."""

import dataclasses
import json
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf.data.grid import THETA_DIFF, THETA_HALF
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import Profiles, profiles
from dsbrdf.data.synthetic import model_measurement
from dsbrdf.errors import ConvergenceWarning, FitError, InvalidArgumentError
from dsbrdf.fitting import em
from dsbrdf.fitting.metrics import Metrics
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.paper_method import PAPER_SLICES
from dsbrdf.fitting.pipeline import fit
from dsbrdf.fitting.report import FitResult
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.version import ALGORITHM_VERSION

Array = NDArray[np.float64]

UNCONVERGED = pytest.mark.filterwarnings("ignore::dsbrdf.errors.ConvergenceWarning")


def paper(**chosen: Any) -> FitOptions:
    """Options of the paper's method with 3 lobes unless another number is asked for."""
    settings: dict[str, Any] = {"method": "paper", "n_lobes": 3} | chosen
    return FitOptions(**settings)


def known_model(*lobes: tuple[float, float, float, float], delta: float = 0.0) -> DSBRDF:
    """Lobes (kappa, its growth, gamma, its growth) that change towards grazing and differ a little by channel."""
    share = PAPER_SLICES / (np.pi / 2)
    channel = np.arange(3.0)[:, None]
    kappa = np.stack([k * (1 + 0.05 * channel) * (1 + dk * share) for k, dk, _, _ in lobes], axis=-1)
    gamma = np.stack([g * (1 + 0.1 * channel) * (1 + dg * share) for _, _, g, dg in lobes], axis=-1)
    return DSBRDF(PAPER_SLICES, np.expm1(kappa), kappa, gamma, delta=np.full((3, 18), delta), interpolation="linear")


def worst_by_slice(found: DSBRDF, truth: DSBRDF) -> Array:
    """Largest relative error of any kappa and gamma of each slice, shape (18,)."""
    errors = np.maximum(np.abs(found.kappa / truth.kappa - 1.0), np.abs(found.gamma / truth.gamma - 1.0))
    return np.asarray(errors.max(axis=(0, 2)))


@pytest.fixture(scope="module")
def glossy(plastic: Measurement) -> Profiles:
    return profiles(plastic)


@pytest.fixture(scope="module")
def fitted(plastic: Measurement) -> FitResult:
    return fit(plastic, paper())


@pytest.fixture(scope="module")
def one_lobe(plastic: Measurement) -> FitResult:
    """A fit that takes a fraction of the time."""
    return fit(plastic, paper(n_lobes=1))


# Recovery of known lobes from noiseless data


def test_one_known_lobe_is_recovered_to_the_last_digits() -> None:
    truth = known_model((3.0, 0.3, 50.0, -0.3))
    result = fit(model_measurement(truth), paper(n_lobes=1, horizon_cutoff=None))
    assert worst_by_slice(result.model, truth).max() < 1e-10
    assert result.report.metrics.relative_rms == pytest.approx(0.0, abs=1e-12)


def test_two_known_lobes_are_recovered_to_one_per_cent() -> None:
    truth = known_model((4.0, -0.2, 1000.0, -0.3), (0.5, 0.2, 1.0, 0.2))
    data = profiles(model_measurement(truth), horizon_cutoff=None)
    result = fit(data, paper(n_lobes=2, horizon_cutoff=None, mask=0.0))
    assert worst_by_slice(result.model, truth).max() < 0.01
    assert all(np.ravel(result.report.knots.converged))


def test_three_known_lobes_are_recovered_to_one_per_cent(monkeypatch: pytest.MonkeyPatch) -> None:
    truth = known_model((4.0, 0.1, 5000.0, 0.2), (1.0, 0.1, 60.0, -0.1), (0.3, 0.1, 1.0, 0.2))
    data = profiles(model_measurement(truth), horizon_cutoff=None)
    # The usual stopping rule is reached before the lobes near grazing have come to rest.
    usual = fit(data, paper(horizon_cutoff=None, mask=0.0, em_iterations=150)).model
    assert worst_by_slice(usual, truth)[:10].max() < 0.01
    monkeypatch.setattr(em, "EM_TOLERANCE", 1e-6)
    patient = fit(data, paper(horizon_cutoff=None, mask=0.0, em_iterations=1000)).model
    assert worst_by_slice(patient, truth).max() < 0.01


def test_delta_term_is_what_the_lobes_leave_at_the_centre() -> None:
    truth = known_model((3.0, 0.0, 50.0, 0.0), delta=7.0)
    data = profiles(model_measurement(truth), horizon_cutoff=None)
    result = fit(data, paper(n_lobes=1, horizon_cutoff=None))
    np.testing.assert_allclose(result.model.delta, 7.0, rtol=1e-9)
    centre = THETA_HALF < np.radians(1.0)
    rows = np.round(np.degrees(PAPER_SLICES)).astype(int)
    noisy = data.mean.copy()
    noisy[:, :, centre] *= np.linspace(0.8, 1.6, centre.sum())
    model = fit(dataclasses.replace(data, mean=noisy), paper(n_lobes=1, horizon_cutoff=None)).model
    lobes = np.expm1(model.kappa * np.cos(THETA_HALF[centre]) ** model.gamma)
    # A node stands for the solid angle up to the middles between it and its neighbours, and to 1 degree.
    ends = [0.0, *(0.5 * (THETA_HALF[:9] + THETA_HALF[1:10]))[: centre.sum() - 1].tolist(), float(np.radians(1.0))]
    solid_angle = np.diff(-np.cos(ends))
    weights = data.weight[:, rows][..., centre] * solid_angle
    expected = np.average(noisy[:, rows][..., centre] - lobes, axis=-1, weights=weights)
    np.testing.assert_allclose(model.delta, np.maximum(expected, 0.0), rtol=1e-9)


def test_delta_term_is_never_negative(glossy: Profiles) -> None:
    mean = glossy.mean.copy()
    mean[:, :, THETA_HALF < np.radians(1.0)] = 0.0
    model = fit(dataclasses.replace(glossy, mean=mean), paper()).model
    assert np.all(model.delta == 0.0)
    assert model.evaluate(THETA_HALF, THETA_DIFF[:, None]).min() >= 0.0


def test_lobes_do_not_tower_over_the_data_where_they_are_not_fitted(glossy: Profiles) -> None:
    # The spike is over at 1 degree: its flank just outside is all that the lobes are fitted to.
    truth = known_model((30.0, 0.0, 2e4, 0.0), (0.2, 0.0, 1.0, 0.0))
    values = np.moveaxis(truth.evaluate(THETA_HALF, THETA_DIFF[:, None]), -1, 0)
    saturated = dataclasses.replace(glossy, mean=np.minimum(values, 20.0))
    result = fit(saturated, paper(n_lobes=2))
    assert result.model.evaluate(THETA_HALF, THETA_DIFF[:, None]).max() < 3.0 * 20.0
    assert np.any(result.report.knots.bounds_hit)


# Which samples are used


def test_cutoff_decides_which_slices_have_data(plastic: Measurement, fitted: FitResult) -> None:
    assert np.array(fitted.report.knots.fitted).tolist() == [[True] * 16 + [False] * 2] * 3  # 80 and 85 degrees
    nearest = fitted.model
    assert nearest.kappa[:, 16:].tolist() == np.repeat(nearest.kappa[:, 15:16], 2, axis=1).tolist()
    assert nearest.gamma[:, 16:].tolist() == np.repeat(nearest.gamma[:, 15:16], 2, axis=1).tolist()
    everything = fit(plastic, paper(n_lobes=1, horizon_cutoff=None))
    assert np.all(everything.report.knots.fitted)
    assert everything.report.options.horizon_cutoff is None


@UNCONVERGED
@pytest.mark.parametrize(("mask", "used"), [(None, 1.0), (2.5, 2.5)])
def test_mask_hides_what_lies_outside(glossy: Profiles, mask: float | None, used: float) -> None:
    outside = THETA_HALF > np.pi / 2 - used * THETA_DIFF[:, None] + 1e-6
    options = paper(n_lobes=2, mask=mask, em_iterations=3)
    expected = fit(glossy, options).model
    hidden = dataclasses.replace(glossy, mean=np.where(outside, 50.0, glossy.mean))
    found = fit(hidden, options).model
    assert found.kappa.tolist() == expected.kappa.tolist()
    assert found.gamma.tolist() == expected.gamma.tolist()
    # One row of samples further in, and the fit sees the difference.
    seen = np.where(np.roll(outside, -1, axis=1) & (THETA_DIFF[:, None] > 0.1), 50.0, glossy.mean)
    assert fit(dataclasses.replace(glossy, mean=seen), options).model.kappa.tolist() != expected.kappa.tolist()


def test_centre_is_not_used_for_the_lobes(glossy: Profiles, one_lobe: FitResult) -> None:
    mean = np.where(THETA_HALF < np.radians(1.0), 1e4, glossy.mean)
    found = fit(dataclasses.replace(glossy, mean=mean), paper(n_lobes=1)).model
    assert found.kappa.tolist() == one_lobe.model.kappa.tolist()
    assert found.delta.min() > 5e3  # also at 85 degrees, where there are no data within the cutoff


def test_profiles_give_the_same_model_as_the_measurement(glossy: Profiles, fitted: FitResult) -> None:
    result = fit(glossy, paper())
    for name in ("kappa", "gamma", "center", "delta"):
        assert getattr(result.model, name).tolist() == getattr(fitted.model, name).tolist()
    assert result.report.metrics == Metrics()  # they need the samples


def test_profiles_must_have_been_made_with_the_same_options(glossy: Profiles) -> None:
    with pytest.raises(InvalidArgumentError, match="made with weighting 'plain', the options ask for 'cosine'"):
        fit(glossy, paper(weighting="cosine"))
    with pytest.raises(InvalidArgumentError, match="horizon_cutoff"):
        fit(glossy, paper(horizon_cutoff=None))
    with pytest.raises(InvalidArgumentError, match="robust"):
        fit(glossy, paper(robust=True))


@pytest.mark.parametrize("changed", [{"weighting": "cosine"}, {"weighting": "log"}, {"robust": True}])
def test_weights_change_the_fit_but_not_the_metrics_it_is_judged_by(
    plastic: Measurement, one_lobe: FitResult, changed: dict[str, Any]
) -> None:
    result = fit(plastic, paper(n_lobes=1, **changed))
    assert result.model.kappa.tolist() != one_lobe.model.kappa.tolist()
    assert result.report.metrics.floor == one_lobe.report.metrics.floor
    weighted = profiles(plastic, **changed)
    again = fit(weighted, paper(n_lobes=1, **changed))
    assert again.model.kappa.tolist() == result.model.kappa.tolist()


# The run itself


def test_same_input_gives_the_same_bits(plastic: Measurement, one_lobe: FitResult) -> None:
    again = fit(plastic, paper(n_lobes=1))
    for name in ("theta_diff", "kappa", "gamma", "center", "delta"):
        assert getattr(again.model, name).tobytes() == getattr(one_lobe.model, name).tobytes()
    assert again.report.metrics == one_lobe.report.metrics


def test_progress_rises_from_0_to_1(glossy: Profiles) -> None:
    shares: list[float] = []
    fit(glossy, paper(), progress=shares.append)
    assert shares[0] == 0.0
    assert shares[-1] == 1.0
    assert len(shares) > 10
    assert np.all(np.diff(shares) >= 0.0)


class StopError(Exception):
    pass


@pytest.mark.parametrize("number", [1, 2, 6])
def test_what_progress_raises_ends_the_fit_and_reaches_the_caller(glossy: Profiles, number: int) -> None:
    calls: list[float] = []

    def stop(share: float) -> None:
        calls.append(share)
        if len(calls) == number:
            raise StopError

    with pytest.raises(StopError):
        fit(glossy, paper(), progress=stop)
    assert len(calls) == number


def test_slices_that_stop_at_the_bound_are_reported_and_warned_about(glossy: Profiles) -> None:
    with pytest.warns(ConvergenceWarning, match="slices stopped at the bound of 2 iterations"):
        report = fit(glossy, paper(em_iterations=2)).report
    converged, iterations = np.array(report.knots.converged), np.array(report.knots.iterations)
    assert not converged.all()
    assert np.all(iterations[~converged] == 2)


def test_report_is_plain_and_says_what_was_done(fitted: FitResult) -> None:
    report = fitted.report
    assert json.loads(json.dumps(report.to_dict())) == report.to_dict()
    assert report.options == paper()
    assert report.versions.algorithm == ALGORITHM_VERSION
    assert report.knots.theta_diff == tuple(PAPER_SLICES)
    slices = report.knots
    for table in (slices.fitted, slices.converged, slices.iterations, slices.bounds_hit):
        assert np.shape(table) == (3, 18)
    assert all(seconds >= 0.0 for seconds in report.timings.values())
    np.testing.assert_allclose(report.albedo.albedo, fitted.model.albedo(report.albedo.theta_out))
    assert report.n_numbers == fitted.model.n_numbers
    metrics = report.metrics
    assert metrics.relative_rms is not None
    assert metrics.floor is not None
    assert metrics.excess == pytest.approx(metrics.relative_rms / metrics.floor)


@UNCONVERGED
@pytest.mark.parametrize("n_lobes", [1, 2, 5, 8])
def test_any_number_of_lobes_sorted_by_kappa(glossy: Profiles, n_lobes: int) -> None:
    model = fit(glossy, paper(n_lobes=n_lobes, em_iterations=5)).model
    assert model.kappa.shape == (3, 18, n_lobes)
    assert np.all(np.diff(model.kappa, axis=2) <= 0.0)
    assert np.all(model.center == 0.0)


# Poor data


def test_material_that_reflects_red_only() -> None:
    truth = known_model((3.0, 0.0, 50.0, 0.0))
    values = model_measurement(truth).values
    values[1:] = np.where(values[1:] > 0, 0.0, values[1:])
    result = fit(Measurement.from_values(values), paper(horizon_cutoff=None))
    grid = result.model.evaluate(THETA_HALF, THETA_DIFF[:, None])
    assert np.abs(grid[..., 1:]).max() < 1e-8
    assert result.report.metrics.relative_rms == pytest.approx(0.0, abs=0.02)
    assert np.all(np.isfinite(result.model.kappa))


def test_few_rows_of_data_are_fitted_where_they_are(plastic: Measurement) -> None:
    valid = np.zeros(plastic.valid.shape, bool)
    valid[12:32, 30:36] = plastic.valid[12:32, 30:36]
    result = fit(Measurement.from_values(plastic.values, valid), paper(n_lobes=2))
    present = np.isin(np.round(np.degrees(PAPER_SLICES)), [30, 35])
    assert np.array(result.report.knots.fitted).tolist() == [present.tolist()] * 3
    assert np.all(result.model.kappa[:, :6] == result.model.kappa[:, 6:7])
    assert np.all(result.model.kappa[:, 8:] == result.model.kappa[:, 7:8])


def test_too_little_data_is_an_error_with_a_remedy(plastic: Measurement) -> None:
    valid = np.zeros(plastic.valid.shape, bool)
    valid[15:18] = plastic.valid[15:18]  # 3 angles cannot give the 6 parameters of 3 lobes
    few = Measurement.from_values(plastic.values, valid)
    with pytest.raises(FitError, match="raise the horizon cutoff or lower the mask or the number of lobes"):
        fit(few, paper())
    assert fit(few, paper(n_lobes=1)).model.n_lobes == 1
    with pytest.raises(FitError, match="leave no slice with enough valid samples"):
        fit(plastic, paper(horizon_cutoff=float(np.radians(1.0))))
