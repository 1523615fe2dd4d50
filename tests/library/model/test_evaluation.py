"""The values of many points against SciPy's spline and the definition of the lobes, one operation after the other."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.evaluation import Mixture, linear

Array = NDArray[np.float64]

MANY = 140_000  # more than one block
GRADED = np.radians([0.0, 12, 24, 36, 46, 54, 60, 64.5, 68.5, 71.5, 74, 76, 78, 80])


def model_of(knots: Array, rings: tuple[int, ...], interpolation: str, seed: int = 0, n_lobes: int = 4) -> DSBRDF:
    """Lobes that change wildly from knot to knot, so that a spline through them is cut off at places."""
    generator = np.random.default_rng(seed)
    shape = (3, knots.size, n_lobes)
    center = np.zeros(shape)
    center[:, :, list(rings)] = generator.uniform(0.0, np.pi / 2, (3, knots.size, len(rings)))
    return DSBRDF(
        knots,
        kappa=np.exp(generator.uniform(-9.0, 2.0, shape)),
        gamma=np.exp(generator.uniform(-2.0, 9.0, shape)),
        center=center,
        delta=generator.uniform(0.0, 2.0, shape[:2]),
        interpolation=interpolation,
    )


def expected_values(model: DSBRDF, theta_half: Array, theta_diff: Array) -> Array:
    """Values (n, 3), a lobe and a channel at a time."""
    knots = model.theta_diff
    at = np.clip(theta_diff, knots[0], knots[-1])

    def between(parameter: Array, slack: float) -> Array:
        if knots.size == 1:
            return np.full_like(at, parameter[0])
        if model.interpolation == "linear":
            return np.interp(at, knots, parameter)
        spline = CubicSpline(knots, parameter, bc_type="natural")(at)
        return np.clip(spline, parameter.min() - slack, parameter.max() + slack)

    values = np.zeros((theta_half.size, 3))
    for channel in range(3):
        for k in range(model.n_lobes):
            kappa, gamma, center = (p[channel, :, k] for p in (model.kappa, model.gamma, model.center))
            if model.interpolation == "linear":
                scale, shape = between(kappa, 0.0), between(gamma, 0.0)
            else:
                scale, shape = (np.exp(between(np.log(p), np.log(2.0))) for p in (kappa, gamma))
            cosine = np.maximum(np.cos(theta_half - between(center, np.radians(1.0))), 0.0)
            values[:, channel] += np.expm1(scale * cosine**shape)
        inside = theta_half < np.radians(1.0)
        values[inside, channel] += np.interp(theta_diff, knots, model.delta[channel])[inside]
    return values


def points(count: int, seed: int = 1) -> tuple[Array, Array]:
    """Angles all over the range, among them its ends, the knots, and more than enough near the normal."""
    generator = np.random.default_rng(seed)
    theta_half, theta_diff = generator.uniform(0.0, np.pi / 2, (2, count))
    theta_half[::7] *= 0.02
    theta_half[1:4] = 0.0, np.pi / 2, np.radians(1.0)
    theta_diff[2:5] = 0.0, np.pi / 2, np.pi / 2
    theta_diff[5 : 5 + GRADED.size] = GRADED
    return theta_half, theta_diff


@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
@pytest.mark.parametrize("rings", [(), (1,), (0, 2), (0, 1, 2, 3)])
@pytest.mark.parametrize("knots", [GRADED, np.radians([7.0, 70.0]), np.array([0.4])])
def test_many_points_have_the_values_of_the_definition(
    interpolation: str, rings: tuple[int, ...], knots: Array
) -> None:
    model = model_of(knots, rings, interpolation)
    theta_half, theta_diff = points(MANY)
    values = model.evaluate(theta_half, theta_diff)
    some = np.r_[:40, 40:MANY:11]
    expected = expected_values(model, theta_half[some], theta_diff[some])
    # A cosine close to 1 is rounded to 1e-16, which its power by gamma, 8000 or twice that, makes 2e-12.
    np.testing.assert_allclose(values[some], expected, rtol=1e-11, atol=1e-280)


@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
@pytest.mark.parametrize("rings", [(), (0, 2), (0, 1, 2, 3)])
def test_few_points_and_many_have_the_same_values(interpolation: str, rings: tuple[int, ...]) -> None:
    model = model_of(GRADED, rings, interpolation)
    theta_half, theta_diff = points(MANY)
    many = model.evaluate(theta_half, theta_diff)
    for start in (0, 1000, 131_000, MANY - 77):
        part = slice(start, start + 300)
        np.testing.assert_array_equal(many[part], model.evaluate(theta_half[part], theta_diff[part]))
    for i in range(25):
        np.testing.assert_array_equal(many[i], model.evaluate(theta_half[i], theta_diff[i]))


def test_many_points_at_one_angle() -> None:
    model = model_of(GRADED, (3,), "cubic")
    theta_half = np.linspace(0.0, np.pi / 2, 20_000)
    for theta_diff in (0.0, GRADED[4], 1.0, np.pi / 2):
        values = model.evaluate(theta_half, theta_diff)
        expected = expected_values(model, theta_half, np.full_like(theta_half, theta_diff))
        np.testing.assert_allclose(values, expected, rtol=1e-11, atol=1e-280)


def test_more_knots_than_a_byte_counts() -> None:
    knots = np.linspace(0.0, 1.5, 400)
    model = model_of(knots, (2,), "cubic", n_lobes=3)
    theta_half, theta_diff = points(5000)
    expected = expected_values(model, theta_half, theta_diff)
    np.testing.assert_allclose(model.evaluate(theta_half, theta_diff), expected, rtol=1e-11, atol=1e-280)


@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
@pytest.mark.parametrize("count", [3, 5000])
def test_what_is_too_faint_for_a_number_is_zero(interpolation: str, count: int) -> None:
    shape = (3, 2, 2)
    ends, zero = np.array([0.0, 1.0]), np.zeros((3, 2))
    model = DSBRDF(ends, np.full(shape, 2.0), np.full(shape, 1e5), np.zeros(shape), zero, interpolation)
    values = model.evaluate(np.linspace(0.2, np.pi / 2, count), 0.5)
    assert np.all(values == 0.0)
    assert not np.any(np.signbit(values))
    # In between, a value is exact as long as it is a normal number by far.
    theta_half = np.linspace(0.07, 0.13, count)
    expected = np.asarray(2 * np.expm1(2.0 * np.cos(theta_half) ** 1e5))
    seen = expected > 1e-270
    assert 0 < np.count_nonzero(seen) < count
    np.testing.assert_allclose(model.evaluate(theta_half, 0.5)[seen, 1], expected[seen], rtol=1e-11)


def test_parameters_keep_the_order_of_the_lobes() -> None:
    model = model_of(GRADED, (0, 2), "cubic")
    found = model.parameters_at(GRADED)
    for values, name in zip(found[:3], ("kappa", "gamma", "center"), strict=True):
        np.testing.assert_allclose(values, np.moveaxis(getattr(model, name), 1, 0), rtol=1e-12, atol=1e-15)
    assert np.all(found[2][:, :, [1, 3]] == 0.0)
    kappa, gamma, center, delta = model.parameters_at(np.full((2, 5), 0.3))
    assert kappa.shape == gamma.shape == center.shape == (2, 5, 3, 4)
    assert delta.shape == (2, 5, 3)


def test_linear_interpolation_is_held_at_both_ends() -> None:
    knots, values = np.array([0.2, 0.6]), np.array([[1.0, -2.0], [3.0, 2.0]])
    found = linear(knots, values, np.array([0.0, 0.2, 0.3, 0.6, 1.5]))
    expected = np.array([[1.0, -2.0], [1.0, -2.0], [1.5, -1.0], [3.0, 2.0], [3.0, 2.0]])
    np.testing.assert_allclose(found, expected, rtol=1e-15)
    assert linear(knots[:1], values[:1], np.array([0.0, 1.0])).tolist() == [[1.0, -2.0]] * 2


def test_threads_may_share_a_model() -> None:
    theta_half, theta_diff = points(20_000)
    expected = model_of(GRADED, (1,), "cubic").evaluate(theta_half, theta_diff)
    for _ in range(5):
        fresh = model_of(GRADED, (1,), "cubic")  # whose splines the threads find at the same time
        with ThreadPoolExecutor(8) as threads:
            every = list(threads.map(fresh.evaluate, [theta_half] * 8, [theta_diff] * 8))
        for values in every:
            np.testing.assert_array_equal(values, expected)


def test_no_lobes_give_zero() -> None:
    empty = np.zeros((3, GRADED.size, 0))
    for cubic in (False, True):
        assert np.all(Mixture(GRADED, empty, empty, empty, cubic=cubic).values(*points(2000)) == 0.0)
