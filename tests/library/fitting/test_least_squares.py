"""The least-squares core: derivatives against finite differences, the optimum against SciPy, honest flags."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from dsbrdf.data.grid import THETA_DIFF, THETA_HALF
from dsbrdf.fitting.em import GAMMA_BOUNDS, KAPPA_BOUNDS
from dsbrdf.fitting.least_squares import CENTER_BOUNDS, FitData, Lobes, ProfileProblem, Refined, minimize
from dsbrdf.model.splines import roughness

Array = NDArray[np.float64]

KNOTS = np.array([0, 20, 50])
ROWS = np.arange(0, 60, 6)
COLUMNS = np.arange(2, 90, 4)
SMOOTHING, COUPLING = 1e-4, 1e-3  # far above the usual, so that they count in the tests
EVERY = np.arange(3)


def unknowns_of(kappa: list[float], gamma: list[float], center: list[float]) -> Array:
    """The same lobes at every knot and in every channel."""
    return np.tile(np.concatenate([np.log(kappa), np.log(gamma), center]), (3, KNOTS.size, 1))


def data_of(mean: Array, *, seed: int = 0) -> FitData:
    """Profiles with uneven weights, some of them zero."""
    random = np.random.default_rng(seed)
    weight = random.uniform(20.0, 180.0, mean.shape) * (random.uniform(size=mean.shape) > 0.1)
    within = weight * (0.02 * mean) ** 2
    return FitData(mean, weight, within, mean.max(axis=2))


def problem_of(data: FitData) -> ProfileProblem:
    return ProfileProblem(data, KNOTS, ROWS, COLUMNS, SMOOTHING, COUPLING)


def two_lobes_and_a_ring(seed: int = 0) -> FitData:
    """A material made of them, with parameters that change along theta_diff and 5 % noise."""
    random = np.random.default_rng(seed)
    share = THETA_DIFF[None, :, None] / 2
    channel = np.array([1.0, 0.8, 1.3])[:, None, None]
    mean = np.expm1((3.0 + share) * channel * np.cos(THETA_HALF) ** (150.0 - 50.0 * share))
    mean += np.expm1(0.5 * channel * np.cos(THETA_HALF) ** (1.5 + share))
    mean += np.expm1(0.7 * channel * np.cos(THETA_HALF - 0.5) ** (60.0 * (1.0 + share)))
    return data_of(mean * (1.0 + 0.05 * random.standard_normal(mean.shape)))


LOBES = Lobes(2, 1)
START = unknowns_of([2.0, 0.3, 0.4], [80.0, 3.0, 40.0], [0.42])


def somewhere(seed: int = 3) -> Array:
    """Unknowns near the start, another at each knot and channel."""
    return START + 0.2 * np.random.default_rng(seed).standard_normal(START.shape)


def numeric_jacobian(problem: ProfileProblem, lobes: Lobes, unknowns: Array) -> Array:
    """Central differences of the residuals of each channel, (3, residuals, D P)."""
    flat, step = unknowns.reshape(3, -1), 1e-5
    columns = []
    for i in range(flat.shape[1]):
        shift = np.zeros_like(flat)
        shift[:, i] = step
        ahead, behind = (problem.residuals(lobes, (flat + s * shift).reshape(unknowns.shape)) for s in (1, -1))
        columns.append((ahead - behind).reshape(3, -1) / (2 * step))
    return np.stack(columns, axis=-1)


def penalty_rows(problem: ProfileProblem, lobes: Lobes) -> tuple[Array, Array]:
    """Matrices whose squared products with unknowns and their distance from the anchor give the pulls."""
    values, vectors = np.linalg.eigh(SMOOTHING * roughness(np.degrees(THETA_DIFF[KNOTS])))
    p = lobes.n_parameters
    smooth = np.kron((np.sqrt(np.maximum(values, 0.0)) * vectors).T, np.eye(p))
    shape_only = np.diag((np.arange(p) >= lobes.count).astype(float))
    return smooth, np.sqrt(COUPLING) * np.kron(np.eye(KNOTS.size), shape_only)


def penalised(problem: ProfileProblem, lobes: Lobes, channel: int, flat: Array, anchor: Array) -> Array:
    """Residuals of one channel and those of the pulls, for SciPy."""
    smooth, apart = penalty_rows(problem, lobes)
    unknowns = flat.reshape(1, KNOTS.size, -1)
    fit = problem.residuals(lobes, unknowns, np.array([channel])).ravel()
    root = np.sqrt(problem.signal[channel])
    return np.concatenate([fit, root * (smooth @ flat), root * (apart @ (flat - anchor.ravel()))])


def test_residuals_are_those_of_the_formula() -> None:
    data = two_lobes_and_a_ring()
    problem, unknowns = problem_of(data), somewhere()
    residual = problem.residuals(LOBES, unknowns)
    for row in (0, 20 // 6, 9):
        at_knot = np.flatnonzero(KNOTS == ROWS[row])
        if at_knot.size:
            log_kappa, log_gamma, center = np.split(unknowns[1, at_knot[0]], [3, 6])
            offset = THETA_HALF[COLUMNS, None] - np.concatenate([[0.0, 0.0], center])
            model = np.expm1(np.exp(log_kappa) * np.cos(offset) ** np.exp(log_gamma)).sum(axis=1)
            root = np.sqrt(data.weight[1, ROWS[row], COLUMNS])
            np.testing.assert_allclose(residual[1, row], root * (model - data.mean[1, ROWS[row], COLUMNS]), atol=1e-9)
    np.testing.assert_allclose(problem.squared_error(LOBES, unknowns), (residual**2).sum(axis=(1, 2)))
    np.testing.assert_array_equal(problem.residuals(LOBES, unknowns[2:], np.array([2])), residual[2:])


@pytest.mark.parametrize("lobes", [Lobes(1), Lobes(3), Lobes(2, 1), Lobes(1, 2), Lobes(0, 1)], ids=str)
def test_gradient_and_normal_matrix_agree_with_finite_differences(lobes: Lobes) -> None:
    random = np.random.default_rng(4)
    shape = (3, KNOTS.size, lobes.count)
    # A flatter ring's derivative is singular 90 degrees from its center, and a spline that leaves its range is cut off.
    center = random.uniform(0.2, 0.6, (3, 1, lobes.rings)) * (1.0 + THETA_DIFF[KNOTS, None])
    unknowns = np.concatenate([random.uniform(-1.0, 0.7, shape), random.uniform(2.0, 4.0, shape), center], axis=2)
    problem, anchor = problem_of(two_lobes_and_a_ring()), unknowns.mean(axis=0)
    cost, normal, gradient = problem.linearize(lobes, unknowns, anchor, EVERY)
    smooth, apart = penalty_rows(problem, lobes)
    jacobian = numeric_jacobian(problem, lobes, unknowns)
    residual = problem.residuals(lobes, unknowns).reshape(3, -1)
    for c in range(3):
        pull, distance = smooth @ unknowns[c].ravel(), apart @ (unknowns[c] - anchor).ravel()
        expected_cost = residual[c] @ residual[c] + problem.signal[c] * (pull @ pull + distance @ distance)
        expected_gradient = jacobian[c].T @ residual[c] + problem.signal[c] * (smooth.T @ pull + apart.T @ distance)
        expected_normal = jacobian[c].T @ jacobian[c] + problem.signal[c] * (smooth.T @ smooth + apart.T @ apart)
        assert cost[c] == pytest.approx(expected_cost, rel=1e-12)
        np.testing.assert_allclose(gradient[c], expected_gradient, rtol=1e-6, atol=1e-7 * np.abs(gradient[c]).max())
        np.testing.assert_allclose(normal[c], expected_normal, rtol=1e-6, atol=1e-8 * np.abs(normal[c]).max())


def test_one_channel_alone_has_the_same_equations() -> None:
    problem, unknowns = problem_of(two_lobes_and_a_ring()), somewhere()
    anchor = unknowns.mean(axis=0)
    together = problem.linearize(LOBES, unknowns, anchor, EVERY)
    alone = problem.linearize(LOBES, unknowns[1:2], anchor, np.array([1]))
    for whole, part in zip(together, alone, strict=True):
        np.testing.assert_allclose(whole[1:2], part, rtol=1e-12)


def assert_as_good_as_scipy(
    problem: ProfileProblem, lobes: Lobes, start: Array, refined: Refined, scipy_start: Array
) -> None:
    low, high = lobes.bounds(problem.largest_kappa)
    start = np.clip(start, low, high)
    anchor = start.mean(axis=0)
    cost, _, _ = problem.linearize(lobes, refined.unknowns, anchor, EVERY)
    for c in range(3):
        best = least_squares(
            lambda x, c=c: penalised(problem, lobes, c, x, anchor),  # type: ignore[misc]
            np.clip(scipy_start[c], low[c] + 1e-9, high[c] - 1e-9).ravel(),
            bounds=(low[c].ravel(), high[c].ravel()),
            method="trf",
            x_scale="jac",
            xtol=1e-14,
            ftol=1e-14,
            gtol=1e-14,
            max_nfev=400,
        )
        assert cost[c] == pytest.approx(2.0 * best.cost, rel=1e-6)


def test_optimum_is_that_of_scipy() -> None:
    problem = problem_of(two_lobes_and_a_ring())
    refined = minimize(problem, LOBES, START, tolerance=1e-12, iterations=500)
    assert refined.converged.all()
    assert_as_good_as_scipy(problem, LOBES, START, refined, START)


def test_optimum_at_the_bounds_is_that_of_scipy() -> None:
    data = two_lobes_and_a_ring()
    data = replace(data, peak=0.15 * data.peak)  # no lobe may get as high as the data
    problem = problem_of(data)
    refined = minimize(problem, LOBES, START, tolerance=1e-12, iterations=500)
    low, high = LOBES.bounds(problem.largest_kappa)
    assert np.all((low <= refined.unknowns) & (refined.unknowns <= high))
    assert np.any(refined.unknowns == high)
    assert_as_good_as_scipy(problem, LOBES, START, refined, refined.unknowns)


def test_no_lobe_peaks_higher_than_four_times_the_data_around_its_knot() -> None:
    data = two_lobes_and_a_ring()
    problem = problem_of(data)
    ranges = [slice(0, 21), slice(0, 51), slice(20, 90)]
    expected = np.stack([np.log1p(4.0 * data.peak[:, rows].max(axis=1)) for rows in ranges], axis=1)
    np.testing.assert_allclose(problem.largest_kappa, expected)
    low, high = LOBES.bounds(problem.largest_kappa)
    np.testing.assert_allclose(np.exp(high[:, :, :3]), np.repeat(expected[:, :, None], 3, axis=2))
    np.testing.assert_allclose(np.exp(low[:, :, :3]), KAPPA_BOUNDS[0])
    np.testing.assert_allclose(np.exp(low[:, :, 3:6]), GAMMA_BOUNDS[0])
    np.testing.assert_allclose(np.exp(high[:, :, 3:6]), GAMMA_BOUNDS[1])
    assert np.unique(low[:, :, 6]).tolist() == [CENTER_BOUNDS[0]]
    assert np.unique(high[:, :, 6]).tolist() == [CENTER_BOUNDS[1]]


def test_start_outside_of_the_bounds_is_brought_inside() -> None:
    problem = problem_of(two_lobes_and_a_ring())
    wild = START.copy()
    wild[:, :, 0], wild[:, :, 3], wild[:, :, 6] = 10.0, 30.0, 4.0
    refined = minimize(problem, LOBES, wild, tolerance=1e-6, iterations=3)
    low, high = LOBES.bounds(problem.largest_kappa)
    assert np.all((low <= refined.unknowns) & (refined.unknowns <= high))


def test_flags_are_honest() -> None:
    problem = ProfileProblem(two_lobes_and_a_ring(), KNOTS, ROWS, COLUMNS, SMOOTHING, coupling=0.0)
    numbers: list[int] = []
    one = minimize(problem, LOBES, START, tolerance=1e-9, iterations=1, on_iteration=numbers.append)
    assert not one.converged.any()
    assert one.iterations.tolist() == [1, 1, 1]
    assert numbers == [1]
    done = minimize(problem, LOBES, START, tolerance=1e-9, iterations=300)
    assert done.converged.all()
    assert done.iterations.max() < 300
    again = minimize(problem, LOBES, done.unknowns, tolerance=1e-6, iterations=300)
    assert again.iterations.max() <= 5


def test_more_iterations_never_raise_the_cost() -> None:
    problem, anchor = problem_of(two_lobes_and_a_ring()), START.mean(axis=0)
    costs = []
    for iterations in (1, 2, 4, 8, 16, 32):
        refined = minimize(problem, LOBES, START, tolerance=1e-12, iterations=iterations)
        costs.append(problem.linearize(LOBES, refined.unknowns, anchor, EVERY)[0])
    assert np.all(np.diff(costs, axis=0) <= 0.0)


def test_same_problem_same_bits() -> None:
    first, second = (
        minimize(problem_of(two_lobes_and_a_ring()), LOBES, START, tolerance=1e-6, iterations=50) for _ in range(2)
    )
    assert first.unknowns.tobytes() == second.unknowns.tobytes()
    assert first.iterations.tolist() == second.iterations.tolist()


def test_channels_do_not_depend_on_each_other() -> None:
    data = two_lobes_and_a_ring()
    order = np.array([2, 0, 1])
    turned = FitData(data.mean[order], data.weight[order], data.within[order], data.peak[order])
    first, second = (
        minimize(problem_of(d), LOBES, START, tolerance=1e-9, iterations=200).unknowns for d in (data, turned)
    )
    np.testing.assert_allclose(first[order], second, rtol=1e-7, atol=1e-9)


def test_black_channel_is_fitted_by_nothing() -> None:
    data = two_lobes_and_a_ring()
    for array in (data.mean, data.within, data.peak):
        array[1] = 0.0
    problem = problem_of(data)
    refined = minimize(problem, LOBES, START, tolerance=1e-5, iterations=150)
    assert np.isfinite(refined.unknowns).all()
    assert refined.converged.all()
    error = problem.squared_error(LOBES, refined.unknowns)
    assert error[1] < 1e-9 * problem.signal[0]


def test_channel_without_weight_keeps_its_start() -> None:
    data = two_lobes_and_a_ring()
    data.weight[2] = 0.0
    refined = minimize(problem_of(data), LOBES, START, tolerance=1e-5, iterations=150)
    assert refined.converged.all()
    np.testing.assert_allclose(refined.unknowns[2, :, 3:], START[2, :, 3:], atol=0.5)
