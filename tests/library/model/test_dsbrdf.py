"""The model against explicit loops over its definition."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from dsbrdf.data.geometry import directions
from dsbrdf.data.grid import GRID_SHAPE, THETA_DIFF, THETA_HALF
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.dsbrdf import DSBRDF

Array = NDArray[np.float64]

KNOTS = np.radians([5.0, 20.0, 47.0, 80.0])
ONE_DEGREE = np.radians(1.0)


def random_model(n_lobes: int = 3, knots: ArrayLike = KNOTS, seed: int = 0) -> DSBRDF:
    generator = np.random.default_rng(seed)
    shape = (3, np.size(knots), n_lobes)
    return DSBRDF(
        np.asarray(knots, float),
        kappa=generator.uniform(0.1, 6.0, shape),
        gamma=np.exp(generator.uniform(-1.0, 9.0, shape)),
        center=generator.uniform(0.0, np.pi / 2, shape) * (generator.uniform(size=shape) < 0.3),
        delta=generator.uniform(0.0, 2.0, shape[:2]),
    )


def value_by_hand(model: DSBRDF, theta_half: float, theta_diff: float) -> list[float]:
    """One value: the bracketing knots by search, then a sum over the lobes."""
    knots = model.theta_diff.tolist()
    if theta_diff <= knots[0] or len(knots) == 1:
        below, above, share = 0, 0, 0.0
    elif theta_diff >= knots[-1]:
        below, above, share = len(knots) - 1, len(knots) - 1, 0.0
    else:
        above = next(i for i, knot in enumerate(knots) if knot > theta_diff)
        below = above - 1
        share = (theta_diff - knots[below]) / (knots[above] - knots[below])

    def between(parameter: Array, *index: int) -> float:
        low, high = parameter[index[0], below, *index[1:]], parameter[index[0], above, *index[1:]]
        return float(low + share * (high - low))

    values = []
    for channel in range(3):
        total = between(model.delta, channel) if theta_half < ONE_DEGREE else 0.0
        for k in range(model.n_lobes):
            kappa, gamma, center = (between(p, channel, k) for p in (model.kappa, model.gamma, model.center))
            total += np.exp(kappa * max(np.cos(theta_half - center), 0.0) ** gamma) - 1.0
        values.append(float(total))
    return values


@pytest.mark.parametrize("knots", [KNOTS, [0.4], np.radians([0.0, 90.0])])
def test_values_are_those_of_a_loop_over_the_definition(knots: ArrayLike) -> None:
    model = random_model(knots=knots)
    generator = np.random.default_rng(1)
    theta_half = np.concatenate([generator.uniform(0.0, np.pi / 2, 60), [0.0, 0.999 * ONE_DEGREE, ONE_DEGREE, 1.3]])
    theta_diff = np.concatenate([generator.uniform(0.0, np.pi / 2, 60), [0.0, 0.3, 0.3, np.pi / 2]])
    expected = [value_by_hand(model, *pair) for pair in zip(theta_half.tolist(), theta_diff.tolist(), strict=True)]
    np.testing.assert_allclose(model.evaluate(theta_half, theta_diff), expected, rtol=1e-11, atol=1e-14)


def test_parameters_are_linear_between_knots_and_held_beyond_them() -> None:
    model = random_model()
    names = ("kappa", "gamma", "center", "delta")
    middle = 0.5 * (KNOTS[1:] + KNOTS[:-1])
    for found, name in zip(model.parameters_at(middle), names, strict=True):
        parameter = np.moveaxis(getattr(model, name), 1, 0)
        np.testing.assert_allclose(found, 0.5 * (parameter[1:] + parameter[:-1]), rtol=1e-12)
    for found, name in zip(model.parameters_at(KNOTS), names, strict=True):
        np.testing.assert_allclose(found, np.moveaxis(getattr(model, name), 1, 0), rtol=1e-14)
    ends = [0.0, KNOTS[0] / 2, (KNOTS[-1] + np.pi / 2) / 2, np.pi / 2]
    for found, name in zip(model.parameters_at(ends), names, strict=True):
        parameter = np.moveaxis(getattr(model, name), 1, 0)
        np.testing.assert_array_equal(found, parameter[[0, 0, -1, -1]])


def test_delta_counts_below_one_degree_only() -> None:
    model = random_model()
    bare = model.select((0, 1, 2), with_delta=False)
    angles = np.radians([0.0, 0.5, 0.999, 1.0, 1.1, 45.0])
    difference = model.evaluate(angles, KNOTS[1]) - bare.evaluate(angles, KNOTS[1])
    np.testing.assert_allclose(difference[:3], np.tile(model.delta[:, 1], (3, 1)), rtol=1e-9)
    assert np.all(difference[3:] == 0.0)


def test_directions_give_the_values_of_their_angles() -> None:
    model = random_model()
    generator = np.random.default_rng(2)
    theta_half, theta_diff = generator.uniform(0.0, 0.7, (2, 50))
    phi_diff, phi_half = generator.uniform(0.0, 2 * np.pi, (2, 50))
    omega_in, omega_out = directions(theta_half, theta_diff, phi_diff, phi_half)
    values = model.evaluate_directions(omega_in, omega_out)
    np.testing.assert_allclose(values, model.evaluate(theta_half, theta_diff), rtol=1e-9)
    np.testing.assert_allclose(model.evaluate_directions(omega_out, omega_in), values, rtol=1e-9)  # reciprocal
    one_to_many = model.evaluate_directions([0.0, 0.0, 1.0], omega_out)
    assert one_to_many.shape == (50, 3)
    np.testing.assert_allclose(one_to_many[7], model.evaluate_directions([0.0, 0.0, 1.0], omega_out[7]), rtol=1e-14)


def test_broadcasting_equals_a_loop_also_across_chunks() -> None:
    model = random_model()
    theta_half, theta_diff = np.linspace(0.0, np.pi / 2, 211), np.linspace(0.0, np.pi / 2, 97)[:, None]
    values = model.evaluate(theta_half, theta_diff)
    assert values.shape == (97, 211, 3)
    assert values[0].size * 97 > 2 * 8192
    for i in (0, 13, 50, 96):
        for j in (0, 1, 100, 210):
            single = model.evaluate(float(theta_half[j]), float(theta_diff[i, 0]))
            assert single.shape == (3,)
            np.testing.assert_allclose(values[i, j], single, rtol=1e-13)
    assert model.evaluate(np.empty((0, 4)), 0.3).shape == (0, 4, 3)


def test_model_without_lobes_is_its_delta() -> None:
    model = random_model(n_lobes=0)
    assert model.n_lobes == 0
    assert np.all(model.evaluate([0.1, 1.0], 0.3) == 0.0)
    np.testing.assert_allclose(model.evaluate(0.0, KNOTS[2]), model.delta[:, 2])
    assert np.all(random_model().select((), with_delta=False).evaluate([0.0, 1.0], 0.3) == 0.0)


def test_selected_lobes_add_up() -> None:
    model = random_model()
    theta_half, theta_diff = np.linspace(0.0, 1.5, 30), np.linspace(0.0, 1.5, 30)[:, None]
    whole = model.evaluate(theta_half, theta_diff)
    parts = model.select((2, 0), with_delta=True).evaluate(theta_half, theta_diff)
    parts += model.select((1,), with_delta=False).evaluate(theta_half, theta_diff)
    np.testing.assert_allclose(parts, whole, rtol=1e-12)


def test_table_holds_the_values_at_the_nodes() -> None:
    model = random_model()
    table = model.tabulate()
    assert table.shape == (3, *GRID_SHAPE)
    for i, j, k in ((0, 0, 0), (9, 30, 17), (10, 89, 179), (89, 45, 90)):
        np.testing.assert_allclose(table[:, i, j, k], model.evaluate(THETA_HALF[i], THETA_DIFF[j]), rtol=1e-14)
    assert np.all(table == table[..., :1])


def test_extreme_lobes_are_finite() -> None:
    shape = (3, 1, 1)
    theta = np.radians([0.0, 1e-4, 45.0, 90.0])
    for kappa, gamma in ((700.0, 1e7), (1e-9, 0.0), (40.0, 0.0), (40.0, 1e-4)):
        model = DSBRDF([0.0], np.full(shape, kappa), np.full(shape, gamma), np.zeros(shape), np.zeros((3, 1)))  # type: ignore[arg-type]
        values = model.evaluate(theta, theta)
        assert np.all(np.isfinite(values))
        assert values[0, 0] == pytest.approx(np.expm1(kappa), rel=1e-12)
        if gamma == 0.0:
            assert np.all(values == values[0])  # Lambertian to the horizon


@pytest.mark.parametrize(
    ("interpolation", "kappa", "gamma", "delta", "name"),
    [("linear", 701.0, 1.0, 0.0, "kappa"), ("cubic", 351.0, 1.0, 0.0, "kappa"), ("linear", 1.0, 2e100, 0.0, "gamma"),
     ("cubic", 1.0, 1.0, -2e300, "delta")],
)  # fmt: skip
def test_parameters_whose_values_would_overflow_are_refused(
    interpolation: str, kappa: float, gamma: float, delta: float, name: str
) -> None:
    shape = (3, KNOTS.size, 1)
    with pytest.raises(InvalidArgumentError, match=f"no {name} may exceed"):
        DSBRDF(
            KNOTS,
            np.full(shape, kappa),
            np.full(shape, gamma),
            np.zeros(shape),
            np.full((3, KNOTS.size), delta),
            interpolation,
        )


def test_model_keeps_its_own_read_only_arrays() -> None:
    kappa = np.ones((3, 4, 2))
    model = DSBRDF(KNOTS, kappa, kappa, np.zeros_like(kappa), np.zeros((3, 4)))
    kappa[:] = 5.0
    assert np.all(model.kappa == 1.0)
    with pytest.raises(ValueError, match="read-only"):
        model.gamma[0] = 2.0


def parts(**changed: Any) -> dict[str, Any]:
    good = {
        "theta_diff": [0.0, 0.5],
        "kappa": np.ones((3, 2, 1)),
        "gamma": np.ones((3, 2, 1)),
        "center": np.zeros((3, 2, 1)),
        "delta": np.zeros((3, 2)),
    }
    return good | changed


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"theta_diff": []}, "theta_diff must be a sequence of at least one knot"),
        ({"theta_diff": 0.3}, "theta_diff must be a sequence of at least one knot"),
        ({"theta_diff": [0.5, 0.5]}, "knots theta_diff must increase from 0 or more to at most pi/2"),
        ({"theta_diff": [0.0, 1.6]}, "knots theta_diff must increase from 0 or more to at most pi/2"),
        ({"theta_diff": [-0.1, 0.5]}, "knots theta_diff must increase from 0 or more to at most pi/2"),
        ({"theta_diff": [0.0, np.nan]}, "knots theta_diff must increase from 0 or more to at most pi/2"),
        ({"kappa": np.ones((3, 3, 1))}, r"kappa must have shape \(3, 2, lobes\), not \(3, 3, 1\)"),
        ({"kappa": np.ones((3, 2))}, r"kappa must have shape \(3, 2, lobes\), not \(3, 2\)"),
        ({"gamma": np.ones((3, 2, 2))}, r"gamma must have the shape of kappa, \(3, 2, 1\)"),
        ({"center": np.ones((3, 2, 2))}, r"center must have the shape of kappa, \(3, 2, 1\)"),
        ({"delta": np.ones((3, 1))}, r"delta must have shape \(3, 2\), not \(3, 1\)"),
        ({"kappa": np.zeros((3, 2, 1))}, "every kappa must be positive"),
        ({"kappa": np.full((3, 2, 1), np.inf)}, "every kappa must be positive.* and both finite"),
        ({"gamma": np.full((3, 2, 1), -1.0)}, "every gamma zero or positive"),
        ({"gamma": np.full((3, 2, 1), np.nan)}, "every gamma zero or positive"),
        ({"center": np.full((3, 2, 1), 1.7)}, "every center must lie between 0 and pi/2"),
        ({"delta": np.full((3, 2), np.inf)}, "every delta must be finite"),
        ({"interpolation": "magic"}, "interpolation must be one of .*linear.*, not 'magic'"),
    ],
)
def test_impossible_models_are_refused(changed: dict[str, Any], sentence: str) -> None:
    DSBRDF(**parts())
    with pytest.raises(InvalidArgumentError, match=sentence):
        DSBRDF(**parts(**changed))


@pytest.mark.parametrize("angle", [-1e-6, np.pi / 2 + 1e-6, np.nan, np.inf])
def test_angles_out_of_range_are_refused_by_name(angle: float) -> None:
    model = random_model()
    for name, call in (
        ("theta_half", lambda: model.evaluate([0.1, angle], 0.1)),
        ("theta_diff", lambda: model.evaluate(0.1, [0.1, angle])),
        ("theta_diff", lambda: model.parameters_at(angle)),
        ("theta_out", lambda: model.directional_albedo(angle)),
    ):
        with pytest.raises(InvalidArgumentError, match=f"{name} must lie between 0 and 90 degrees"):
            call()


def test_ninety_degrees_are_in_range_however_they_were_rounded() -> None:
    model = random_model()
    limit = model.evaluate(np.pi / 2, np.pi / 2)
    np.testing.assert_array_equal(model.evaluate(np.nextafter(np.pi / 2, 2.0), np.radians(90.0)), limit)


def test_directions_below_the_horizon_or_not_of_unit_length_are_refused() -> None:
    model = random_model()
    with pytest.raises(InvalidArgumentError, match="omega_in must lie on or above the horizon"):
        model.evaluate_directions([0.0, 0.6, -0.8], [0.0, 0.0, 1.0])
    with pytest.raises(InvalidArgumentError, match="omega_out must be of unit length"):
        model.evaluate_directions([0.0, 0.0, 1.0], [0.0, 0.0, 1.1])


def test_shapes_that_do_not_broadcast_are_refused() -> None:
    with pytest.raises(InvalidArgumentError, match=r"must broadcast together, not have \(2,\) and \(3,\)"):
        random_model().evaluate([0.1, 0.2], [0.1, 0.2, 0.3])


# Cubic interpolation


def test_cubic_interpolation_is_the_natural_spline_of_the_logarithms() -> None:
    # Smooth parameters keep the spline within its knots' range, where nothing is cut off.
    knots = np.radians([0.0, 10.0, 25.0, 45.0, 60.0, 80.0])
    kappa = np.tile((1.0 + knots)[:, None], (3, 1, 1)) * [1.0]
    gamma = np.tile((50.0 * np.exp(-knots))[:, None], (3, 1, 1)) * [1.0]
    center = np.tile((0.2 + 0.3 * np.sin(knots))[:, None], (3, 1, 1)) * [1.0]
    delta = np.tile(knots, (3, 1))
    model = DSBRDF(knots, kappa, gamma, center, delta, "cubic")
    angles = np.radians([3.0, 17.0, 30.0, 52.0, 79.0, 80.0, 86.0])
    held = np.minimum(angles, knots[-1])
    found = model.parameters_at(angles)
    for part, values in zip(found[:3], (np.log(kappa), np.log(gamma), center), strict=True):
        spline = natural_spline(knots, values[0, :, 0], held)
        expected = spline if values is center else np.exp(spline)
        np.testing.assert_allclose(part, np.tile(expected[:, None, None], (1, 3, 1)), rtol=1e-10)
    np.testing.assert_allclose(found[3], np.tile(held[:, None], (1, 3)), rtol=1e-12)
    np.testing.assert_allclose(model.parameters_at(knots)[0][:, 0, 0], kappa[0, :, 0], rtol=1e-12)


def natural_spline(x: Array, y: Array, at: Array) -> Array:
    """Textbook natural cubic spline: second derivatives from the tridiagonal system, then the piecewise cubic."""
    h, n = np.diff(x), len(x)
    matrix, right = np.eye(n), np.zeros(n)
    for i in range(1, n - 1):
        matrix[i, i - 1 : i + 2] = h[i - 1], 2 * (h[i - 1] + h[i]), h[i]
        right[i] = 6 * ((y[i + 1] - y[i]) / h[i] - (y[i] - y[i - 1]) / h[i - 1])
    second = np.linalg.solve(matrix, right)
    low = np.clip(np.searchsorted(x, at, side="right") - 1, 0, n - 2)
    a, b = (x[low + 1] - at) / h[low], (at - x[low]) / h[low]
    bend = (a**3 - a) * second[low] + (b**3 - b) * second[low + 1]
    return a * y[low] + b * y[low + 1] + bend * h[low] ** 2 / 6


def test_cubic_interpolation_does_not_overshoot_far() -> None:
    knots = np.radians([0.0, 30.0, 32.0, 80.0])
    kappa = np.array([0.1, 0.1, 8.0, 8.0])[None, :, None] * np.ones((3, 1, 1))
    model = DSBRDF(knots, kappa, 10.0 * np.ones((3, 4, 1)), np.zeros((3, 4, 1)), np.zeros((3, 4)), "cubic")
    found = model.parameters_at(np.radians(np.linspace(0.0, 90.0, 200)))[0]
    assert found.max() <= 16.0 * (1 + 1e-12)
    assert found.min() >= 0.05 * (1 - 1e-12)


def test_cubic_interpolation_needs_positive_gamma() -> None:
    with pytest.raises(InvalidArgumentError, match="every gamma must be positive for cubic interpolation"):
        DSBRDF(**parts(gamma=np.zeros((3, 2, 1)), interpolation="cubic"))
