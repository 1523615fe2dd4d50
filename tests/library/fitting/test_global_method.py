"""The global method: known lobes come back, options count, odd data stay calm, fits are as accurate as before."""

import json
import warnings
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest

import dsbrdf
from dsbrdf import DSBRDF, FitError, FitOptions, FitResult, Measurement, Profiles, fit, profiles
from dsbrdf.arrays import Array
from dsbrdf.data import CHANNELS, THETA_DIFF, THETA_HALF, model_measurement, nodes_above_horizon, synthetic_measurement
from dsbrdf.fitting import METRICS, Metrics, global_method, relative_errors, sample_errors
from dsbrdf.fitting.fit_data import FitData
from dsbrdf.fitting.mixture import KAPPA_BOUNDS, REACH_BOUNDS, Structure
from dsbrdf.fitting.mixture_problem import MixtureProblem
from dsbrdf.model import half_width
from dsbrdf.pipeline import profiles_for
from dsbrdf.version import versions
from tests.support.models import NOISE, deviations, found_by_fit, mixture, numbers_of_lobes, single_lobe
from tests.support.reproduced import assert_reproduced, digest

pytestmark = pytest.mark.slow

ONE = FitOptions(n_lobes=1, ring_lobes=0)
TWO = FitOptions(n_lobes=2, ring_lobes=0)


@pytest.mark.parametrize(("n_lobes", "seed"), [(1, 2), (3, 1), (2, 4)])
def test_number_and_parameters_of_known_mixtures_come_back(n_lobes: int, seed: int) -> None:
    model, truth = found_by_fit(n_lobes, seed), mixture(n_lobes, seed)
    assert numbers_of_lobes(model) == (n_lobes, 0)
    found = deviations(model, truth)
    assert max(found[name] for name in ("amplitude", "half width", "elongation")) < 0.02, found
    parameters = {name: digest(values) for name, values in model.parameters_at([0.1, 0.7, 1.3]).items()}
    assert_reproduced(f"fit/{n_lobes} lobes", parameters, 5e-3)


def test_what_bins_hide_of_elongated_lobes_is_what_their_means_differ_by() -> None:
    """Without noise, the mean of a bin is the model at its mean of cos(phi_diff)**2 plus what the bin hides."""
    folded = profiles(model_measurement(single_lobe(1.0, 40.0, 30.0, elongation=1.0))).folded
    rows, columns = np.array([0, 30, 60, 75]), np.arange(5, 60, 6)
    data = FitData.select(folded, folded.weight, rows, columns)
    knot = np.zeros(1)
    structure = Structure((False,), (knot,) * 3, "hemi_epd")
    lobe = np.array([[0.0, np.log(40.0)]])
    unknowns = structure.join(np.full((1, 3), np.log(30.0)), lobe, np.ones((1, 1)))
    problem = MixtureProblem(data, structure)
    hidden = global_method._lost_in_bins(problem, unknowns, range(data.mean.shape[-1]))
    seen = data.weight > 0
    assert np.max(np.abs(hidden[seen]) / data.mean[seen]) > 0.05
    np.testing.assert_allclose((problem.values(unknowns) + hidden)[seen], data.mean[seen], rtol=1e-6, atol=1e-12)


def test_student_lobes_come_back_too() -> None:
    one = np.ones((1, 1, 1))
    shape = np.concatenate([3.0 * one, 1.2 * one], axis=2), np.concatenate([2e3 * one, 1.0 * one], axis=2)
    height = np.array([[20.0, 0.3], [10.0, 0.2], [15.0, 0.1]])[:, None, :]
    truth = DSBRDF(np.zeros(1), height, *shape, elongation=np.full((1, 2), 0.7), lobe="student")
    data = profiles(model_measurement(truth, noise=NOISE))
    model = fit(data, FitOptions(n_lobes=2, ring_lobes=0, lobe="student")).model
    assert model.lobe == "student"
    found = model.parameters_at(np.radians([10.0, 40.0, 60.0]))
    np.testing.assert_allclose(found["amplitude"], np.tile(height[:, 0], (3, 1, 1)), rtol=0.02)


def test_parametric_variation_has_few_coefficients_a_lobe(plastic: Measurement, two_lobe_fit: FitResult) -> None:
    """Five a channel of the amplitude, and kappa, gamma and elongation once."""
    result = fit(plastic, replace(TWO, variation="parametric"))
    parametric, errors = result.model, [one.report.metrics.relative_rms or np.inf for one in (result, two_lobe_fit)]
    assert parametric.n_numbers == 2 * (3 * 5 + 3)
    np.testing.assert_allclose(parametric.theta_diff, np.radians([0.0, 70.0, 89.0]), atol=0.02)
    found = parametric.parameters_at(np.radians([0.0, 30.0, 60.0, 80.0]))
    for name in ("kappa", "gamma", "elongation"):
        np.testing.assert_allclose(found[name], np.broadcast_to(found[name][:1], found[name].shape), rtol=1e-12)
    assert errors[0] < 1.5 * errors[1]


def test_lobes_stand_from_narrow_to_wide_rings_last_and_shapes_are_shared(plastic_profiles: Profiles) -> None:
    model = fit(plastic_profiles, FitOptions(n_lobes=3, ring_lobes=1)).model
    assert model.is_ring.tolist() == [False, False, True]
    narrow, wide, _ = np.median(half_width(model.kappa, model.gamma, model.lobe)[0], axis=0)
    assert narrow < wide
    assert model.kappa.shape[0] == 1
    assert np.all(model.delta == 0.0)
    assert model.interpolation == "spline"


def test_knots_and_weighting_are_used(plastic_profiles: Profiles) -> None:
    knots = (0, 20, 40, 55, 65, 72, 79, 89)
    plain, log = (fit(plastic_profiles, replace(ONE, knots_deg=knots, weighting=name)) for name in ("plain", "log"))
    np.testing.assert_allclose(plain.model.theta_diff, np.radians(knots))
    assert plain.report.options.knots_deg == knots
    angles = np.radians([5.0, 60.0]), np.radians(30.0)  # one lobe is too few: something has to be given up
    bright, dark = np.transpose(plain.model.evaluate(*angles) / log.model.evaluate(*angles))[0]
    assert abs(bright - 1.0) + abs(dark - 1.0) > 0.05


def test_profiles_give_the_same_model_without_metrics(plastic_profiles: Profiles, two_lobe_fit: FitResult) -> None:
    shares: list[float] = []
    result = fit(plastic_profiles, TWO, progress=shares.append)
    assert result.model == two_lobe_fit.model
    assert (result.report.metrics, result.report.selection) == (Metrics(), ())
    assert result.report.search == two_lobe_fit.report.search
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert shares == sorted(shares)
    assert len(shares) > 8


def test_warning_only_where_iterations_ran_out(plastic_profiles: Profiles, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(global_method, "MAX_ITERATIONS", 500)
    monkeypatch.setattr(global_method, "_bounds_hit", lambda _: True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = fit(plastic_profiles, ONE)
    assert np.all(result.report.knots.converged)
    assert np.all(result.report.knots.bounds_hit)
    monkeypatch.setattr(global_method, "MAX_ITERATIONS", 1)
    with pytest.warns(dsbrdf.ConvergenceWarning, match="^The fit stopped after 1 iterations"):
        result = fit(plastic_profiles, ONE)
    assert not np.any(result.report.knots.converged)
    assert np.all(np.array(result.report.knots.iterations) == 1)


def test_report_is_complete_and_plain(plastic_fit: FitResult) -> None:
    report, model = plastic_fit.report, plastic_fit.model
    shape = (3, model.theta_diff.size)
    assert json.loads(json.dumps(report.to_dict(), allow_nan=False)) == report.to_dict()
    assert report.knots.theta_diff == tuple(model.theta_diff)
    assert all(np.shape(table) == shape for name, table in vars(report.knots).items() if name != "theta_diff")
    of_samples = {"relative_rms_left_out", "relative_rms_expected"}
    assert {name for name in METRICS if not isinstance(report.metrics[name], float)} == of_samples
    last = [step for step in report.search if step.kept][-1]
    assert (last.n_lobes, last.ring_lobes) == (model.n_lobes, model.is_ring.sum())
    assert [row.channel for row in report.by_channel] == list(CHANNELS)
    edges = [row.theta_diff for row in report.by_theta_diff]
    assert [first for first, _ in edges] == [0.0, *(last for _, last in edges[:-1])]
    reflected = report.directional_albedo
    np.testing.assert_allclose(reflected.rgb, model.albedo(reflected.theta_out))
    assert report.n_numbers == model.n_numbers
    assert {"profiles", "search", "refine", "metrics", "albedo"} <= set(report.timings)
    assert report.options == FitOptions()
    assert report.versions == versions()
    assert report.findings_of_fit == ()


def test_lobe_at_a_bound_is_said() -> None:
    for kappa, gamma, hit in ((1.0, 50.0, False), (KAPPA_BOUNDS[1], 50.0, True), (1.0, 0.5 / REACH_BOUNDS[0], True)):
        assert global_method._bounds_hit(single_lobe(kappa, gamma, 1.0)) is hit


def calm_ratio(model: DSBRDF, data: Profiles) -> float:
    """Largest value of the model up to 89 degrees by the largest one measured; it must be finite and not negative."""
    theta_half = np.radians(np.concatenate([[0.0, 0.5], np.linspace(1.0, 89.0, 181)]))
    values = model.evaluate(theta_half, np.radians(np.linspace(0.0, 89.0, 361))[:, None])
    assert np.isfinite(values).all()
    assert values.min() >= 0.0
    largest = np.where(data.folded.weight > 0, data.folded.mean, 0.0).max(axis=(1, 2, 3))
    return float((values.max(axis=(0, 1)) / largest).max())


def relative_rms(model: DSBRDF, measurement: Measurement) -> float:
    found = relative_errors(sample_errors(model, measurement, FitOptions().horizon_cutoff))
    assert found is not None
    return found.relative_rms


def edited(measurement: Measurement, change: Any) -> Measurement:
    values, valid = measurement.values.copy(), measurement.valid.copy()
    change(values, valid)
    values[:, ~valid] = -1.0
    return Measurement.from_values(values, valid, "edited")


def only(data: Profiles, kept: Array) -> Profiles:
    return replace(data, folded=replace(data.folded, weight=data.folded.weight * kept[..., None]))


@pytest.mark.parametrize("cutoff", [30.0, None])
def test_calm_with_another_cutoff(plastic: Measurement, plastic_profiles: Profiles, cutoff: float | None) -> None:
    options = FitOptions(n_lobes=3, horizon_cutoff_deg=cutoff)
    model = fit(profiles_for(plastic, options), options).model
    assert calm_ratio(model, plastic_profiles) < 3.0
    found = relative_errors(sample_errors(model, plastic, options.horizon_cutoff))
    assert found is not None
    assert found.relative_rms < 1.2 * found.floor


def test_calm_in_missing_regions(plastic: Measurement, plastic_profiles: Profiles, plastic_fit: FitResult) -> None:
    """A band of theta_diff, one of theta_half, and seven of eight theta_half: what lacks is met nearly as well."""
    bands, sparse = np.ones((90, 90)), np.ones((90, 1)) * (np.arange(90) % 8 == 3)
    bands[25:60] = bands[:20, 20:50] = 0.0
    reference = relative_rms(plastic_fit.model, plastic)
    assert calm_ratio(plastic_fit.model, plastic_profiles) < 2.0
    for kept, calm, error in ((bands, 3.0, 1.3 * reference), (sparse, 4.0, 0.06)):
        model = fit(only(plastic_profiles, kept)).model
        assert calm_ratio(model, plastic_profiles) < calm
        assert relative_rms(model, plastic) < error


def test_lobes_are_no_narrower_than_columns_with_enough_samples_allow(metal: Measurement) -> None:
    n_sparse = 25  # columns, with one sample each

    def thin_out(_: Array, valid: Array) -> None:
        few = np.zeros_like(valid[:n_sparse])
        few[:, 20, 0] = True
        valid[:n_sparse] *= few

    model = fit(edited(metal, thin_out), TWO).model
    assert half_width(model.kappa, model.gamma, model.lobe).min() > THETA_HALF[n_sparse - 1]


def test_spikes_do_not_spoil_a_robust_fit(plastic: Measurement, plastic_fit: FitResult) -> None:
    def spoil(values: Array, valid: Array) -> None:
        hit = np.random.default_rng(5).uniform(size=values.shape) < 0.01
        values[hit & (np.asarray(valid) > 0)] *= 100.0

    spoiled, reference = edited(plastic, spoil), relative_rms(plastic_fit.model, plastic)
    fragile = FitOptions(n_lobes=2, ring_lobes=0)
    robust = replace(fragile, robust=True)
    error = [relative_rms(fit(profiles_for(spoiled, o), o).model, plastic) for o in (robust, fragile)]
    assert error[0] < 1.5 * reference
    assert error[1] > 2.0 * reference


def test_mask_leaves_out_what_it_masks(plastic_profiles: Profiles) -> None:
    kept = THETA_HALF <= np.pi / 2 - 1.0 * THETA_DIFF[:, None] + 1e-9
    folded = plastic_profiles.folded
    noise = np.random.default_rng(0).uniform(0.0, 50.0, folded.mean.shape)
    spoiled = replace(plastic_profiles, folded=replace(folded, mean=np.where(kept[..., None], folded.mean, noise)))
    options = FitOptions(n_lobes=1, ring_lobes=0, mask=1.0, weighting="plain")
    clean, masked = (fit(data, options).model for data in (plastic_profiles, spoiled))
    assert clean == masked
    unmasked = fit(spoiled, replace(options, mask=0.0)).model
    assert unmasked != masked


def test_red_only_material(plastic: Measurement) -> None:
    def redden(values: Array, _: Array) -> None:
        values[1:] = 0.0

    result = fit(edited(plastic, redden), n_lobes=2, ring_lobes=0)
    values = np.moveaxis(result.model.evaluate(THETA_HALF, THETA_DIFF[:, None]), -1, 0)
    assert values[1:].max() < 1e-4 * values[0].max()
    assert result.report.metrics.excess < 1.1  # type: ignore[operator]
    assert [row.channel for row in result.report.by_channel] == ["red"]


def test_nothing_left_is_said(plastic: Measurement, plastic_profiles: Profiles) -> None:
    with pytest.raises(dsbrdf.MeasurementFormatError, match=r"a measurement needs at least 0\.1% of the nodes"):
        edited(plastic, lambda values, _: values.fill(0.0))
    folded, nothing = plastic_profiles.folded, np.zeros_like(plastic_profiles.folded.mean)
    for empty in (replace(folded, mean=nothing), replace(folded, weight=nothing)):
        with pytest.raises(FitError, match="the mask and the horizon cutoff leave no valid samples: raise the cutoff"):
            fit(replace(plastic_profiles, folded=empty))


@pytest.mark.filterwarnings("ignore::dsbrdf.errors.ConvergenceWarning")
@pytest.mark.parametrize(
    ("rows", "columns"),
    [([40], range(90)), ([0, 79], range(90)), (range(90), [20]), ([10], [20, 40]), ([10], [20])],
    ids=["one row", "two rows", "one column", "two nodes", "one node"],
)
def test_tiny_data(plastic_profiles: Profiles, rows: Any, columns: Any) -> None:
    folded = plastic_profiles.folded
    kept = np.zeros((90, 90))
    kept[np.ix_(list(rows), list(columns))] = 1.0
    thin = only(plastic_profiles, kept)
    result = fit(thin)
    assert calm_ratio(result.model, plastic_profiles) < 100.0
    grid = np.stack(list(result.model.evaluate_grid(THETA_HALF, THETA_DIFF, np.arccos(np.sqrt(np.full(1, 0.5))))))
    values, weight = grid[..., 0].swapaxes(0, 1), thin.folded.weight.sum(axis=3)
    mean = np.sum(thin.folded.weight * folded.mean, axis=3) / np.where(weight > 0, weight, 1.0)
    error = np.sqrt(np.sum(weight * (values - mean) ** 2) / np.sum(weight * mean**2))
    assert error < 0.3
    json.dumps(result.report.to_dict(), allow_nan=False)


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
