import dataclasses
from typing import Any, Literal

import numpy as np
import pytest

import dsbrdf
from dsbrdf import DSBRDF, FitError, FitOptions, FitResult, Measurement, Profiles, fit, profiles
from dsbrdf.data import THETA_DIFF, THETA_HALF, model_measurement
from dsbrdf.paper import PAPER_SLICES

pytestmark = pytest.mark.slow


def paper(**chosen: Any) -> FitOptions:
    settings: dict[str, Any] = {"method": "paper", "n_lobes": 3} | chosen
    return FitOptions(**settings)


def known_model(*lobes: tuple[float, float, float, float], delta: float = 0.0) -> DSBRDF:
    """Lobes (kappa, its growth, gamma, its growth) that change towards grazing and differ a little by channel."""
    share = PAPER_SLICES / (np.pi / 2)
    channel = np.arange(3.0)[:, None]
    kappa = np.stack([k * (1 + 0.05 * channel) * (1 + dk * share) for k, dk, _, _ in lobes], axis=-1)
    gamma = np.stack([g * (1 + 0.1 * channel) * (1 + dg * share) for _, _, g, dg in lobes], axis=-1)
    return DSBRDF(PAPER_SLICES, np.expm1(kappa), kappa, gamma, delta=np.full((3, 18), delta), interpolation="linear")


@pytest.fixture(scope="module")
def one_lobe(plastic: Measurement) -> FitResult:
    return fit(plastic, paper(n_lobes=1))


def test_one_known_lobe_is_recovered_to_the_last_digits() -> None:
    truth = known_model((3.0, 0.3, 50.0, -0.3))
    found = fit(model_measurement(truth), paper(n_lobes=1, horizon_cutoff_deg=None)).model
    for name in ("kappa", "gamma"):
        np.testing.assert_allclose(getattr(found, name), getattr(truth, name), rtol=1e-10)


def test_delta_term_is_what_the_lobes_leave_at_the_centre() -> None:
    truth = known_model((3.0, 0.0, 50.0, 0.0), delta=7.0)
    data = profiles(model_measurement(truth), horizon_cutoff=None)
    result = fit(data, paper(n_lobes=1, horizon_cutoff_deg=None))
    np.testing.assert_allclose(result.model.delta, 7.0, rtol=1e-9)
    centre = THETA_HALF < np.radians(1.0)
    rows = np.round(np.degrees(PAPER_SLICES)).astype(int)
    noisy = data.mean.copy()
    noisy[:, :, centre] *= np.linspace(0.8, 1.6, centre.sum())
    model = fit(dataclasses.replace(data, mean=noisy), paper(n_lobes=1, horizon_cutoff_deg=None)).model
    lobes = np.expm1(model.kappa * np.cos(THETA_HALF[centre]) ** model.gamma)
    # A node stands for the solid angle up to the middles between it and its neighbours, and to 1 degree.
    ends = [0.0, *(0.5 * (THETA_HALF[:9] + THETA_HALF[1:10]))[: centre.sum() - 1].tolist(), float(np.radians(1.0))]
    solid_angle = np.diff(-np.cos(ends))
    weights = data.weight[:, rows][..., centre] * solid_angle
    expected = np.average(noisy[:, rows][..., centre] - lobes, axis=-1, weights=weights)
    np.testing.assert_allclose(model.delta, np.maximum(expected, 0.0), rtol=1e-9)


def test_lobes_do_not_tower_over_the_data_where_they_are_not_fitted(plastic_profiles: Profiles) -> None:
    # The spike is over at 1 degree: its flank just outside is all that the lobes are fitted to.
    truth = known_model((30.0, 0.0, 2e4, 0.0), (0.2, 0.0, 1.0, 0.0))
    values = np.moveaxis(truth.evaluate(THETA_HALF, THETA_DIFF[:, None]), -1, 0)
    saturated = dataclasses.replace(plastic_profiles, mean=np.minimum(values, 20.0))
    result = fit(saturated, paper(n_lobes=2))
    assert result.model.evaluate(THETA_HALF, THETA_DIFF[:, None]).max() < 3.0 * 20.0
    assert np.any(result.report.knots.bounds_hit)


def test_cutoff_decides_which_slices_have_data(plastic: Measurement, one_lobe: FitResult) -> None:
    assert np.array(one_lobe.report.knots.fitted).tolist() == [[True] * 16 + [False] * 2] * 3  # 80 and 85 degrees
    nearest = one_lobe.model
    for shape in (nearest.kappa, nearest.gamma):
        assert shape[:, 16:].tolist() == np.repeat(shape[:, 15:16], 2, axis=1).tolist()
    everything = fit(plastic, paper(n_lobes=1, horizon_cutoff_deg=None))
    assert np.all(everything.report.knots.fitted)
    assert everything.report.options.horizon_cutoff_deg is None


@pytest.mark.filterwarnings("ignore::dsbrdf.errors.ConvergenceWarning")
@pytest.mark.parametrize(("mask", "used"), [("auto", 1.0), (2.5, 2.5)])
def test_mask_hides_what_lies_outside(plastic_profiles: Profiles, mask: float | Literal["auto"], used: float) -> None:
    outside = THETA_HALF > np.pi / 2 - used * THETA_DIFF[:, None] + 1e-6
    options = paper(n_lobes=2, mask=mask, em_iterations=3)
    expected = fit(plastic_profiles, options).model
    hidden = dataclasses.replace(plastic_profiles, mean=np.where(outside, 50.0, plastic_profiles.mean))
    found = fit(hidden, options).model
    assert found.kappa.tolist() == expected.kappa.tolist()
    assert found.gamma.tolist() == expected.gamma.tolist()
    # One row of samples further in, and the fit sees the difference.
    seen = np.where(np.roll(outside, -1, axis=1) & (THETA_DIFF[:, None] > 0.1), 50.0, plastic_profiles.mean)
    other = fit(dataclasses.replace(plastic_profiles, mean=seen), options).model
    assert other.kappa.tolist() != expected.kappa.tolist()


def test_centre_is_not_used_for_lobes_and_no_delta_is_negative(plastic_profiles: Profiles, one_lobe: FitResult) -> None:
    for value in (1e4, 0.0):
        mean = np.where(THETA_HALF < np.radians(1.0), value, plastic_profiles.mean)
        found = fit(dataclasses.replace(plastic_profiles, mean=mean), paper(n_lobes=1)).model
        assert found.kappa.tolist() == one_lobe.model.kappa.tolist()
        # also at 85 degrees, where there are no data within the cutoff
        assert found.delta.min() > 5e3 if value else not found.delta.any()


@pytest.mark.parametrize(("name", "asked"), [("weighting", "cosine"), ("horizon_cutoff_deg", None), ("robust", True)])
def test_profiles_must_have_been_made_with_the_same_options(plastic_profiles: Profiles, name: str, asked: Any) -> None:
    said = f"made with {name.removesuffix('_deg')}=.*, but the options have {asked!r}"
    with pytest.raises(dsbrdf.InvalidArgumentError, match=said):
        fit(plastic_profiles, paper(**{name: asked}))


class StopError(Exception):
    pass


@pytest.mark.parametrize("method", ["paper", "global"])
@pytest.mark.parametrize("number", [1, 2, 6])
def test_what_progress_raises_ends_the_fit_and_is_raised(plastic_profiles: Profiles, number: int, method: str) -> None:
    calls: list[float] = []

    def stop(share: float) -> None:
        calls.append(share)
        if len(calls) == number:
            raise StopError

    with pytest.raises(StopError):
        fit(plastic_profiles, n_lobes=3, method=method, progress=stop)
    assert len(calls) == number


def test_slices_that_stop_at_the_bound_are_reported_and_warned_about(plastic_profiles: Profiles) -> None:
    with pytest.warns(dsbrdf.ConvergenceWarning) as said:
        report = fit(plastic_profiles, paper(em_iterations=2)).report
    assert str(said[0].message) == report.warnings[0]
    iterations = np.array(report.knots.iterations)[~np.array(report.knots.converged)]
    assert set(iterations.tolist()) == {2}
    assert report.warnings[0].startswith(f"{iterations.size} slices stopped after 2 iterations, before")


def test_few_data_are_fitted_where_they_are_and_too_few_are_an_error_with_a_remedy(plastic: Measurement) -> None:
    def within(rows: slice, columns: slice) -> Measurement:
        valid = np.zeros(plastic.valid.shape, bool)
        valid[rows, columns] = plastic.valid[rows, columns]
        return Measurement.from_values(plastic.values, valid)

    result = fit(within(slice(12, 32), slice(30, 36)), paper(n_lobes=2))
    present = np.isin(np.round(np.degrees(PAPER_SLICES)), [30, 35])
    assert np.array(result.report.knots.fitted).tolist() == [present.tolist()] * 3
    assert np.all(result.model.kappa[:, :6] == result.model.kappa[:, 6:7])
    assert np.all(result.model.kappa[:, 8:] == result.model.kappa[:, 7:8])
    few = within(slice(15, 18), slice(None))  # 3 angles cannot give the 6 parameters of 3 lobes
    with pytest.raises(FitError, match="raise the horizon cutoff or lower the mask or the number of lobes"):
        fit(few, paper())
    assert fit(few, paper(n_lobes=1)).model.n_lobes == 1
    with pytest.raises(FitError, match="leave no slice with enough valid samples"):
        fit(plastic, paper(horizon_cutoff_deg=1))
