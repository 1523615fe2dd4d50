"""The least-squares core: derivatives against finite differences, the optimum against SciPy, honest flags."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares, lsq_linear

from dsbrdf.arrays import Array
from dsbrdf.data import THETA_DIFF, THETA_HALF
from dsbrdf.fitting.fit_data import FitData
from dsbrdf.fitting.least_squares import Solution, minimize
from dsbrdf.fitting.mixture import ELONGATION_BOUNDS, REACH_BOUNDS, Mixture, Structure, mixture_model
from dsbrdf.fitting.mixture_problem import MixtureProblem
from dsbrdf.model import FAMILIES, half_width

ROWS = np.arange(0, 80, 9)
COLUMNS = np.array([0, 6, 14, 22, 30, 45, 60, 75])
KNOTS = np.radians([0.0, 40.0, 68.0])  # rows go beyond
SMOOTHING = (1e-4, 3e-4, 2e-4)  # far above the usual, so that it counts in the tests
PRIOR = (2e-4, 1e-4)  # costs of squared log kappa and of squared elongations


def structure_of(rings: tuple[bool, ...], family: str = "hemi_epd") -> Structure:
    return Structure(rings, (KNOTS, KNOTS[[0, 2]], KNOTS[:1]), family)


def truth_of(structure: Structure, seed: int = 0) -> Array:
    """Unknowns of lobes of different widths that change with theta_diff and the channel."""
    random, k = np.random.default_rng(seed), structure.n_lobes
    unknowns = 0.2 * random.standard_normal(structure.n_unknowns)
    amplitude, shape, elongation = structure.split(unknowns)
    amplitude.reshape(-1, 3, k)[...] += np.linspace(1.5, -1.0, k)
    shape[:, k : 2 * k] += np.linspace(-5.5, -1.5, k)
    shape[:, 2 * k :] += 0.5
    elongation += 0.5
    return unknowns


def problem_of(structure: Structure) -> MixtureProblem:
    """Bins with 5 % noise and uneven weights, some of them zero."""
    cos2_phi = np.tile(np.cos(np.radians(np.arange(5.0, 90.0, 10.0))) ** 2, (ROWS.size, COLUMNS.size, 1))
    blank = np.zeros((3, *cos2_phi.shape))
    points = FitData(blank, blank, cos2_phi, THETA_DIFF[ROWS], THETA_HALF[COLUMNS])
    exact = MixtureProblem(points, structure).values(truth_of(structure))
    random = np.random.default_rng(0)
    weight = random.uniform(2.0, 20.0, exact.shape) * (random.uniform(size=exact.shape) > 0.1)
    noisy = exact * (1.0 + 0.05 * random.standard_normal(exact.shape))
    return MixtureProblem(replace(points, mean=noisy, weight=weight), structure, SMOOTHING, PRIOR)


def residuals(problem: MixtureProblem, unknowns: Array, prior: tuple[float, float] = PRIOR) -> Array:
    """Residuals whose squares add up to the cost: weighted ones, and those of the pull towards the prior."""
    parts = problem.structure.split(unknowns)
    smooth = [np.sqrt(share) * np.diff(part, 2, axis=0).ravel() for part, share in zip(parts, SMOOTHING, strict=True)]
    pulled = parts[1][:, : problem.structure.n_lobes], parts[2]
    usual = [np.sqrt(share) * part.ravel() for share, part in zip(prior, pulled, strict=True)]
    pull = np.concatenate(smooth + usual)
    fit = np.sqrt(problem.data.weight) * (problem.values(unknowns) - problem.data.mean)
    return np.concatenate([fit.ravel(), np.sqrt(problem.data.signal) * pull])


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize(
    ("rings", "log_reach_of_cusp"),
    [
        *((rings, None) for rings in ((False,), (False,) * 3, (False, True), (False, False, True, True))),
        *(((False, True), reach) for reach in (-4.0, -1.0)),
    ],
)
def test_cost_gradient_and_matrix_agree_with_finite_differences(
    rings: tuple[bool, ...], log_reach_of_cusp: float | None, family: str
) -> None:
    problem = problem_of(structure_of(rings, family))
    unknowns = truth_of(problem.structure)
    unknowns += 0.1 * np.random.default_rng(9).standard_normal(unknowns.size)
    if log_reach_of_cusp is not None:
        shape = problem.structure.split(unknowns)[1]
        shape[:, 3] += log_reach_of_cusp - shape[:, 3].mean()
        shape[:, 4] -= 0.6
    at = problem.evaluate(unknowns)
    matrix, gradient = problem.linearize(at)
    residual, steps = residuals(problem, unknowns), 1e-6 * np.eye(unknowns.size)
    columns = [residuals(problem, unknowns + step) - residuals(problem, unknowns - step) for step in steps]
    slopes = np.stack(columns, axis=1) / 2e-6
    assert at.cost == pytest.approx(residual @ residual, rel=1e-12)
    for found, expected in ((gradient, slopes.T @ residual), (np.tril(matrix), np.tril(slopes.T @ slopes))):
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("family", FAMILIES)
def test_single_precision_is_nearly_the_same(family: str) -> None:
    """Also at theta_half = 0 and for a lobe so narrow that it underflows."""
    double = problem_of(structure_of((False, False, True, True), family))
    unknowns = truth_of(double.structure)
    double.structure.split(unknowns)[1][:, 4] = np.log(1e-5)
    single = MixtureProblem(double.data.single(), double.structure, SMOOTHING, PRIOR)
    assert single.values(unknowns).dtype == single.evaluate(unknowns).parts[0][1].dtype == np.float32
    near = double.evaluate(unknowns + 0.1), single.evaluate(unknowns + 0.1)
    assert near[1].cost == pytest.approx(near[0].cost, rel=1e-4)
    for factor in (1e-20, 1e20):  # The unit is wrong by this factor.
        wrong_unit = replace(double.data, mean=double.data.mean * factor, weight=double.data.weight / factor**2)
        assert wrong_unit.single() is wrong_unit
    for found, expected in zip(single.linearize(near[1]), double.linearize(near[0]), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("family", FAMILIES)
def test_values_are_those_of_the_model(family: str) -> None:
    problem = problem_of(structure_of((False, False, True), family))
    unknowns = truth_of(problem.structure)
    model = mixture_model(Mixture(problem.structure, unknowns))
    found = problem.values(unknowns)
    for row, column, fold in ((0, 1, 0), (4, 3, 5), (8, 7, 8)):
        angles = THETA_HALF[COLUMNS[column]], THETA_DIFF[ROWS[row]]
        phi = np.arccos(np.sqrt(problem.data.cos2_phi[row, column, fold]))
        expected = model.evaluate_unmasked(*(np.array([angle]) for angle in (*angles, phi)))[0]
        np.testing.assert_allclose(found[:, row, column, fold], expected, rtol=1e-10)


def test_optimum_at_bounds_is_that_of_scipy() -> None:
    """Data narrower than any lobe may be, and more elongated: shapes end at their bounds, the rest goes on."""
    structure = structure_of((False, False))
    problem = problem_of(structure)
    truth = truth_of(structure)
    _, shape, elongation = structure.split(truth)
    shape[:, 2], elongation[:, 1] = np.log(0.05 * REACH_BOUNDS[0]), 1.5 * ELONGATION_BOUNDS[1]
    data = replace(problem.data, mean=problem.values(truth))
    problem = MixtureProblem(data, structure, SMOOTHING)  # A prior would pull unknowns away from their bounds.
    solution = minimize(problem, truth_of(structure, seed=5), tolerance=1e-12, iterations=800)
    low, high = structure.bounds
    assert solution.converged
    assert np.all((low <= solution.unknowns) & (solution.unknowns <= high))
    assert np.any(solution.unknowns == low)
    assert np.any(solution.unknowns == high)
    inside = np.clip(solution.unknowns, low + 1e-9, high - 1e-9)
    usual: dict[str, Any] = {"x_scale": "jac", "xtol": 1e-13, "ftol": 1e-13, "gtol": 1e-13, "max_nfev": 200}
    best = least_squares(partial(residuals, problem, prior=(0.0, 0.0)), inside, bounds=(low, high), **usual)
    assert solution.cost == pytest.approx(2.0 * best.cost, rel=1e-5)
    # At the optimum every unknown is at rest or pushed against its bound.
    matrix, gradient = problem.linearize(problem.evaluate(solution.unknowns))
    free = (solution.unknowns > low) & (solution.unknowns < high)
    assert np.abs(gradient[free] / np.sqrt(np.diag(matrix)[free] * solution.cost)).max() < 1e-4
    assert np.all(gradient[solution.unknowns == high] <= 0.0)


class Quadratic:
    """The square of a linear function of unknowns that are at most 0.1 away from 0."""

    precision = np.dtype(float)

    def __init__(self, seed: int) -> None:
        self.matrix, self.goal = np.split(np.random.default_rng(seed).standard_normal((9, 9)), [8], axis=1)

    def limit(self, unknowns: Array) -> Array:
        return np.clip(unknowns, -0.1, 0.1)

    def evaluate(self, unknowns: Array) -> SimpleNamespace:
        return SimpleNamespace(unknowns=unknowns, cost=float(np.sum((self.matrix @ unknowns - self.goal[:, 0]) ** 2)))

    def linearize(self, at: SimpleNamespace) -> tuple[Array, Array]:
        return self.matrix.T @ self.matrix, self.matrix.T @ (self.matrix @ at.unknowns - self.goal[:, 0])


@pytest.mark.parametrize("seed", [0, 1])
def test_few_steps_reach_the_least_squares_within_bounds(seed: int) -> None:
    problem: Any = Quadratic(seed)
    best = lsq_linear(problem.matrix, problem.goal[:, 0], (-0.1, 0.1))
    found = minimize(problem, np.zeros(8), iterations=4)
    assert found.cost == pytest.approx(2.0 * best.cost, rel=1e-4)


def test_flags_are_honest_and_the_cost_never_rises() -> None:
    problem = problem_of(structure_of((False, False, False)))
    start = truth_of(problem.structure, seed=7)
    calls: list[int] = []
    short = minimize(problem, start, tolerance=1e-12, iterations=2, on_iteration=calls.append)
    assert isinstance(short, Solution)
    assert (short.converged, short.iterations, calls) == (False, 2, [1, 2])
    costs = [minimize(problem, start, tolerance=0.0, iterations=n).cost for n in range(30)]
    assert costs[0] <= problem.evaluate(start).cost
    assert np.all(np.diff(costs) <= 0.0)
    # It ends after two steps in a row that lower the cost by less than the tolerance, of itself a thousandth.
    every = np.unique(costs)[::-1]
    usual = minimize(problem, start, iterations=500)
    for tolerance, found in ((0.02, minimize(problem, start, tolerance=0.02, iterations=500)), (1e-3, usual)):
        small = every[1:] > (1.0 - tolerance) * every[:-1]
        last = int(np.argmax(small[1:] & small[:-1])) + 2
        assert found.cost == every[last]


def test_a_step_that_raises_the_cost_by_little_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = problem_of(structure_of((False, False)))
    start = truth_of(problem.structure, seed=7)
    evaluate, cost = problem.evaluate, problem.evaluate(start).cost
    monkeypatch.setattr(
        MixtureProblem,
        "evaluate",
        lambda _, unknowns: replace(evaluate(unknowns), cost=cost * (1.0 + 1e-9 * np.any(unknowns != start))),
    )
    solution = minimize(problem, start, iterations=40)
    np.testing.assert_array_equal(solution.unknowns, start)
    assert solution.cost == cost


def test_fixed_unknowns_keep_their_values_and_a_start_out_of_bounds_is_brought_inside() -> None:
    problem = problem_of(structure_of((False, True)))
    start, kappa = truth_of(problem.structure, seed=3), problem.structure.is_kappa()
    assert kappa.sum() == 2 * problem.bases[1].shape[1]
    solution = minimize(problem, start, tolerance=1e-6, iterations=10, fixed=kappa)
    np.testing.assert_array_equal(solution.unknowns[kappa], start[kappa])
    assert np.all(solution.unknowns[~kappa] != start[~kappa])
    low, high = problem.structure.bounds
    inside = minimize(problem, start + 50.0, tolerance=1e-6, iterations=3).unknowns
    assert np.all((low <= inside) & (inside <= high))


def test_a_cusp_is_no_steeper_than_its_lobe_and_no_lobe_narrower_than_the_data_can_tell() -> None:
    spacing = 4.0
    structure = replace(structure_of((False, True)), theta_half=np.radians(np.arange(0.0, 90.0, spacing)))
    unknowns = truth_of(structure)
    shape = structure.split(unknowns)[1]
    shape[:, 2] = np.log(REACH_BOUNDS[0])
    shape[:, 4] = -3.0
    limited = structure.limit(unknowns)
    lobes = structure.lobe_shapes(limited)
    width = half_width(np.exp(lobes[:, :2]), np.exp(lobes[:, 2:4]), "hemi_epd")
    np.testing.assert_allclose(width[:, 0], np.radians(spacing))
    np.testing.assert_allclose(lobes[:, 4], -0.918 * np.minimum(width[:, 1], 0.25), rtol=1e-3)
    np.testing.assert_array_equal(structure.split(limited)[1][:, [0, 1, 3]], shape[:, [0, 1, 3]])
    np.testing.assert_array_equal(structure.limit(limited), limited)
    uneven = np.concatenate([np.arange(0.0, 30.0, 2.0), np.arange(30.0, 60.0, 6.0), np.arange(60.0, 90.0, 3.0)])
    crowded = replace(structure, theta_half=np.radians(uneven))
    shape[:, 3], shape[:, 4] = np.log(REACH_BOUNDS[0]), np.radians(45.0)
    lobes = crowded.lobe_shapes(crowded.limit(unknowns))
    width = half_width(np.exp(lobes[:, :2]), np.exp(lobes[:, 2:4]), "hemi_epd")
    np.testing.assert_allclose(width, np.broadcast_to(np.radians([2.0, 6.0]), width.shape))


@pytest.mark.parametrize("family", FAMILIES)
def test_unknowns_are_joined_as_they_were_split(family: str) -> None:
    structure = structure_of((False, True, True), family)
    unknowns = truth_of(structure)
    structure.split(unknowns)[1][:, -1] -= 0.6
    amplitude, _, elongation = structure.split(unknowns)
    joined = structure.join(amplitude, structure.lobe_shapes(unknowns), elongation)
    np.testing.assert_allclose(joined, unknowns, rtol=1e-12)
