"""The model as a user meets it: values, symmetry, what it refuses, and that it behaves as a value itself."""

import copy
import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray

from dsbrdf.data.geometry import directions, half_difference, incident_cosines
from dsbrdf.data.grid import GRID_SHAPE, PHI_DIFF, THETA_DIFF, THETA_HALF
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.lobes import FAMILIES

Array = NDArray[np.float64]

KNOTS = np.radians([0.0, 30.0, 60.0, 80.0])
SLICES = np.radians([5.0, 20.0, 47.0, 80.0])


def random_model(seed: int = 0, n_lobes: int = 4, family: str = "hemi_epd") -> DSBRDF:
    """Lobes such as fits find: a spike, wide ones, a ring and a cusp, elongated, changing from knot to knot."""
    random = np.random.default_rng([seed, n_lobes])
    shape, center = (1, 6, n_lobes), np.zeros((1, 6, n_lobes))
    wide = np.geomspace(3e3, 1.0, n_lobes) if n_lobes else np.zeros(0)
    center[..., 1:2] = random.uniform(-0.05, 0.4, (1, 6, 1))[..., : max(n_lobes - 1, 0)]
    return DSBRDF(
        KNOTS,
        amplitude=np.exp(random.uniform(-3.0, 4.0, (3, 6, n_lobes))),
        kappa=np.exp(random.uniform(-2.0, 1.5, shape)),
        gamma=wide * np.exp(random.uniform(-0.5, 0.5, shape)),
        center=center,
        elongation=random.uniform(-0.5, 1.2, (5, n_lobes)),
        elongation_theta_diff=np.radians([0.0, 50.0, 85.0]),
        lobe=family,
    )


def papers_model(n_lobes: int = 3, knots: ArrayLike = SLICES, seed: int = 0) -> DSBRDF:
    """The paper's lobes exp(kappa cos**gamma) - 1, a shape for each channel, and its delta term."""
    random = np.random.default_rng(seed)
    shape = (3, np.size(knots), n_lobes)
    kappa = random.uniform(0.1, 6.0, shape)
    return DSBRDF(
        np.asarray(knots, float),
        amplitude=np.expm1(kappa),
        kappa=kappa,
        gamma=np.exp(random.uniform(-1.0, 9.0, shape)),
        delta=random.uniform(0.0, 2.0, shape[:2]),
        interpolation="linear",
    )


def paper_by_hand(model: DSBRDF, theta_half: float, theta_diff: float) -> list[float]:
    """One value of the paper's model: the bracketing slices by search, then a sum over the lobes."""
    slices = model.theta_diff.tolist()
    above = next((i for i, angle in enumerate(slices) if angle > theta_diff), len(slices) - 1)
    below = max(above - 1, 0)
    if theta_diff >= slices[-1]:
        below = above
    share = 0.0 if above == below else max(theta_diff - slices[below], 0.0) / (slices[above] - slices[below])

    def between(parameter: Array, channel: int, *lobe: int) -> float:
        low, high = parameter[channel, below, *lobe], parameter[channel, above, *lobe]
        return float(low + share * (high - low))

    values = []
    for channel in range(3):
        total = between(model.delta, channel) if theta_half < np.radians(1.0) else 0.0
        for k in range(model.n_lobes):
            kappa, gamma = between(model.kappa, channel, k), between(model.gamma, channel, k)
            total += np.exp(kappa * np.cos(theta_half) ** gamma) - 1.0
        values.append(float(total))
    return values


# The paper's model


@pytest.mark.parametrize("slices", [SLICES, [0.4], np.radians([0.0, 90.0])])
def test_papers_model_has_the_values_of_the_paper_at_and_between_the_slices(slices: ArrayLike) -> None:
    model = papers_model(knots=slices)
    random = np.random.default_rng(1)
    theta_half = np.concatenate([random.uniform(0.0, 1.5, 60), np.radians([0.0, 0.999, 1.0, 74.0])])
    theta_diff = np.concatenate([random.uniform(0.0, np.pi / 2, 56), SLICES, [0.0, 0.3, 0.3, np.pi / 2]])
    expected = [paper_by_hand(model, *pair) for pair in zip(theta_half.tolist(), theta_diff.tolist(), strict=True)]
    found = model.evaluate_unmasked(theta_half, theta_diff, random.uniform(0.0, 7.0, 64))
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-14)


def test_delta_counts_below_one_degree_only_and_is_linear_between_the_slices() -> None:
    model = papers_model()
    bare = model.select((0, 1, 2), with_delta=False)
    angles, middle = np.radians([0.0, 0.5, 0.999, 1.0, 1.1, 45.0]), 0.5 * (SLICES[1] + SLICES[2])
    difference = model.evaluate(angles, middle) - bare.evaluate(angles, middle)
    expected = 0.5 * (model.delta[:, 1] + model.delta[:, 2])
    np.testing.assert_allclose(difference[:3], np.tile(expected, (3, 1)), rtol=1e-9)
    assert np.all(difference[3:] == 0.0)


# Guarantees for every pair of directions


def unit(z: Array, azimuth: Array) -> Array:
    radius = np.sqrt(np.maximum(1.0 - z * z, 0.0))
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=-1)


def pairs(count: int, seed: int = 0) -> tuple[Array, Array]:
    """Random directions, such within 3 degrees of the mirror direction, and such near the rim, (3 count, 3) each."""
    random = np.random.default_rng(seed)
    turn = random.uniform(0.0, 2 * np.pi, (2, 3 * count))
    z = random.uniform(0.0, 1.0, (2, 3 * count))
    z[:, 2 * count :] *= 0.05
    first, second = unit(z[0], turn[0]), unit(z[1], turn[1])
    near = slice(count, 2 * count)
    mirror = first[near] * np.array([-1.0, -1.0, 1.0])
    tilted = mirror + np.radians(3.0) * random.uniform(-1.0, 1.0, mirror.shape) * 0.57
    tilted[:, 2] = np.abs(tilted[:, 2])
    second[near] = tilted / np.linalg.norm(tilted, axis=1, keepdims=True)
    return first, second


@pytest.mark.parametrize("family", FAMILIES)
def test_every_value_is_finite_and_not_negative_and_reciprocal(family: str) -> None:
    omega_in, omega_out = pairs(20_000)
    for seed in range(3):
        model = random_model(seed, family=family)
        values = model.evaluate_directions(omega_in, omega_out)
        assert np.isfinite(values).all()
        assert values.min() > 0.0
        swapped = model.evaluate_directions(omega_out, omega_in)
        np.testing.assert_allclose(values, swapped, rtol=1e-12)
        parts = [model.select((k,), with_delta=False).evaluate_directions(omega_in, omega_out) for k in range(4)]
        assert min(part.min() for part in parts) >= 0.0
        np.testing.assert_allclose(np.sum(parts, axis=0), values, rtol=1e-12)


angle = st.floats(0.0, np.pi / 2)


@given(angle, angle, st.floats(-10.0, 10.0), st.integers(0, 20), st.sampled_from(FAMILIES))
def test_any_angles_give_a_finite_value_with_the_symmetry_of_phi_diff(
    theta_half: float, theta_diff: float, phi_diff: float, seed: int, family: str
) -> None:
    model = random_model(seed, family=family)
    value = model.evaluate(theta_half, theta_diff, phi_diff)
    assert np.isfinite(value).all()
    assert np.all(value >= 0.0)
    cosine = np.minimum(*incident_cosines(theta_half, theta_diff, phi_diff))
    if cosine > 1e-9:
        assert np.all(value > 0.0)
        for same in (-phi_diff, np.pi - phi_diff, phi_diff + np.pi):
            np.testing.assert_allclose(model.evaluate(theta_half, theta_diff, same), value, rtol=1e-11)
    elif cosine < -1e-9:
        assert np.all(value == 0.0)


@pytest.mark.parametrize("family", FAMILIES)
def test_steps_of_a_thousandth_of_a_degree_change_the_value_by_less_than_one_per_cent(family: str) -> None:
    """Of its local scale, the largest value within a fifth of a degree, up to the last row of the grid."""
    step, reach = np.radians(1e-3), np.radians(np.linspace(-0.2, 0.2, 11))
    angles = list(half_difference(*pairs(4000, seed=1)))
    angles[0] = np.clip(angles[0], step, np.pi / 2 - step)
    angles[1] = np.clip(angles[1], step, np.radians(89.0))
    for seed in range(4):
        model = random_model(seed, family=family)
        value = model.evaluate_unmasked(*angles)
        around = [np.clip(angles[0] + shift, 0.0, np.pi / 2) for shift in reach.tolist()]
        scale = np.max([model.evaluate_unmasked(half, angles[1], angles[2]) for half in around], axis=0)
        for axis in range(3):
            moved = [angle + step * (n == axis) for n, angle in enumerate(angles)]
            change = np.abs(model.evaluate_unmasked(*moved) - value) / np.maximum(scale, value)
            assert change.max() < 0.01, (axis, np.degrees([angle[change.max(axis=1).argmax()] for angle in angles]))


def test_steps_of_a_direction_change_the_value_by_less_than_one_per_cent() -> None:
    """Up to 80 degrees: beyond, a step of a direction turns the half vector by many times as much."""
    omega_in, omega_out = pairs(4000, seed=1)
    near = half_difference(omega_in, omega_out)[1] < np.radians(80.0)
    omega_in, omega_out = omega_in[near], omega_out[near]
    random, step = np.random.default_rng(2), np.radians(1e-3)
    sideways = np.cross(omega_in, random.normal(size=omega_in.shape))
    sideways /= np.linalg.norm(sideways, axis=1, keepdims=True)
    for seed in range(4):
        model = random_model(seed)
        value = model.evaluate_directions(omega_in, omega_out)
        there = [
            model.evaluate_directions(omega_in * np.cos(turn) + sideways * np.sin(turn), omega_out)
            for turn in np.radians([1e-3, -0.3, -0.2, -0.1, 0.1, 0.2, 0.3]).tolist()
        ]
        above = (omega_in * np.cos(step) + sideways * np.sin(step))[:, 2] > 0.0
        change = np.abs(there[0] - value)[above] / np.maximum(np.max(there, axis=0), value)[above]
        assert change.max() < 0.01


def test_knots_and_the_ends_of_the_angles_are_no_steps() -> None:
    model, tiny = random_model(), 1e-9
    half = np.linspace(0.0, 1.5, 40)
    for knot in [*KNOTS[1:].tolist(), *np.radians([50.0, 85.0]).tolist()]:
        below, above = (model.evaluate_unmasked(half, np.full(40, knot + s), half) for s in (-tiny, tiny))
        np.testing.assert_allclose(below, above, rtol=1e-5)
    for edge in (tiny, np.pi / 2 - tiny):
        near, at = (
            model.evaluate_unmasked(half, np.full(40, a), half) for a in (edge, round(edge * 2 / np.pi) * np.pi / 2)
        )
        np.testing.assert_allclose(near, at, rtol=1e-4)
    near, at = (model.evaluate_unmasked(np.full(40, a), half, half) for a in (tiny, 0.0))
    np.testing.assert_allclose(near, at, rtol=1e-5)


def test_below_the_horizon_is_zero_and_the_rest_of_the_batch_stays() -> None:
    model = random_model()
    values = model.evaluate([0.1, 1.4, 0.2], [0.1, 1.4, 0.3], [0.0, 0.0, 1.0])
    assert np.all(values[1] == 0.0)
    np.testing.assert_array_equal(values[0], model.evaluate(0.1, 0.1, 0.0))
    assert np.all(values[2] > 0.0)
    below = np.array([[0.0, 0.6, -0.8], [0.0, 0.6, 0.8]])
    up = np.array([0.0, 0.0, 1.0])
    for pair in ((below, up), (up, below)):
        values = model.evaluate_directions(*pair)
        assert np.all(values[0] == 0.0)
        assert np.all(values[1] > 0.0)
    # At the horizon itself there is light still.
    assert np.all(model.evaluate_directions([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]) > 0.0)


def test_default_phi_diff_is_always_above_the_horizon() -> None:
    theta_half, theta_diff = np.meshgrid(np.radians(np.arange(90.0)), np.radians(np.arange(90.0)))
    assert np.all(random_model().evaluate(theta_half, theta_diff) > 0.0)
    np.testing.assert_array_equal(
        random_model().evaluate(theta_half, theta_diff), random_model().evaluate(theta_half, theta_diff, np.pi / 2)
    )


# Calling it


def test_directions_give_the_values_of_their_angles() -> None:
    model = random_model()
    random = np.random.default_rng(2)
    theta_half, theta_diff = random.uniform(0.0, 0.7, (2, 50))
    phi_diff, phi_half = random.uniform(0.0, 2 * np.pi, (2, 50))
    omega_in, omega_out = directions(theta_half, theta_diff, phi_diff, phi_half)
    values = model.evaluate_directions(omega_in, omega_out)
    np.testing.assert_allclose(values, model.evaluate(theta_half, theta_diff, phi_diff), rtol=1e-9)
    one_to_many = model.evaluate_directions([0.0, 0.0, 1.0], omega_out)
    assert one_to_many.shape == (50, 3)
    np.testing.assert_allclose(one_to_many[7], model.evaluate_directions([0.0, 0.0, 1.0], omega_out[7]), rtol=1e-14)


def test_broadcasting_equals_a_loop_also_across_blocks() -> None:
    model = random_model()
    theta_half, theta_diff = np.linspace(0.0, 1.5, 211), np.linspace(0.0, np.pi / 2, 97)[:, None]
    phi_diff = np.linspace(0.0, 3.0, 5)[:, None, None]
    values = model.evaluate(theta_half, theta_diff, phi_diff)
    assert values.shape == (5, 97, 211, 3)
    for h, i, j in ((0, 0, 0), (1, 13, 1), (4, 50, 100), (3, 96, 210)):
        single = model.evaluate(float(theta_half[j]), float(theta_diff[i, 0]), float(phi_diff[h, 0, 0]))
        assert single.shape == (3,)
        np.testing.assert_allclose(values[h, i, j], single, rtol=1e-13)
    assert model.evaluate(np.empty((0, 4)), 0.3).shape == (0, 4, 3)


def test_model_without_lobes_is_its_delta() -> None:
    model = papers_model(n_lobes=0)
    assert model.n_lobes == 0
    assert np.all(model.evaluate([0.1, 1.0], 0.3) == 0.0)
    np.testing.assert_allclose(model.evaluate(0.0, SLICES[2]), model.delta[:, 2])
    assert np.all(papers_model().select((), with_delta=False).evaluate([0.0, 1.0], 0.3) == 0.0)


def test_table_holds_the_values_at_the_nodes_those_below_the_horizon_too() -> None:
    model = random_model()
    table = model.tabulate()
    assert table.shape == (3, *GRID_SHAPE)
    assert np.all(table > 0.0)
    for i, j, k in ((0, 0, 0), (9, 30, 17), (10, 89, 179), (89, 45, 90), (40, 60, 91), (88, 88, 0)):
        angles = (np.array([axis[n]]) for axis, n in ((THETA_HALF, i), (THETA_DIFF, j), (PHI_DIFF, k)))
        np.testing.assert_allclose(table[:, i, j, k], model.evaluate_unmasked(*angles)[0], rtol=1e-12)


def test_extreme_lobes_are_finite() -> None:
    theta = np.radians([0.0, 1e-4, 45.0, 89.999])
    for kappa, gamma in ((700.0, 1e7), (1e-9, 1e-9), (40.0, 0.0), (40.0, 1e-4)):
        one = np.ones((1, 1, 1))
        model = DSBRDF(np.zeros(1), 5.0 * np.ones((3, 1, 1)), kappa * one, gamma * one, interpolation="linear")
        values = model.evaluate(theta, theta)
        assert np.all(np.isfinite(values))
        assert values[0, 0] == pytest.approx(5.0, rel=1e-12)
        if gamma == 0.0:
            np.testing.assert_allclose(values, 5.0, rtol=1e-12)  # Lambertian to the horizon


def test_ninety_degrees_are_in_range_however_they_were_rounded() -> None:
    model = random_model()
    limit = model.evaluate(0.3, np.pi / 2)
    for rounded in (np.float32(np.pi / 2), np.nextafter(np.pi / 2, 2.0), np.radians(90.0)):
        np.testing.assert_allclose(model.evaluate(0.3, rounded), limit)
        assert np.isfinite(model.evaluate(rounded, rounded)).all()
        assert np.isfinite(model.albedo(rounded)).all()


# It is a value: equal, hashable, copied and stored whole


def test_copies_are_equal_read_only_and_hash_alike() -> None:
    for model in (random_model(), papers_model(), random_model(family="student")):
        model.evaluate(0.1, 0.2)  # what is computed once must not travel stale
        for other in (pickle.loads(pickle.dumps(model)), copy.deepcopy(model), copy.copy(model)):
            assert other == model
            assert hash(other) == hash(model)
            np.testing.assert_array_equal(other.evaluate(0.3, 0.4), model.evaluate(0.3, 0.4))
            with pytest.raises(ValueError, match="read-only"):
                other.kappa[0] = 2.0
        assert len(pickle.dumps(model)) < 3000 + 9 * sum(
            getattr(model, name).size for name in ("amplitude", "kappa", "gamma", "center", "elongation", "delta")
        )


def test_models_that_differ_in_anything_are_not_equal() -> None:
    model = random_model()
    state: list[Any] = list(model.__reduce__()[1])
    for index, value in enumerate(state):
        changed: Any = "student"
        if isinstance(value, np.ndarray):
            changed = value * (1.0 - 1e-12) if value.any() else value + 1e-12
        elif value != "hemi_epd":
            continue  # the interpolation cannot change alone
        other = DSBRDF(*state[:index], changed, *state[index + 1 :])
        assert other != model, index
        assert hash(other) != hash(model)
    assert model != "a model"
    negative_zero = DSBRDF(*state[:4], np.where(model.center == 0.0, -0.0, model.center), *state[5:])
    assert (negative_zero == model, hash(negative_zero)) == (True, hash(model))
    assert len({model, random_model(), random_model(1)}) == 2


def test_repr_is_short_and_says_what_it_is() -> None:
    text = repr(random_model())
    assert text == f"<DSBRDF: 4 lobes (hemi_epd), 4 knots, {random_model().n_numbers} numbers>"
    assert "1 lobe " in repr(random_model(n_lobes=1, family="student"))


def test_numbers_that_count() -> None:
    model = random_model()  # of the four lobes one has a center
    assert model.is_ring.tolist() == [False, True, False, False]
    assert model.n_numbers == 3 * 6 * 4 + 6 * 4 + 6 * 4 + 6 + 5 * 4
    assert papers_model().n_numbers == 3 * 4 * 3 * 3 + 3 * 4


def test_model_keeps_its_own_read_only_arrays() -> None:
    kappa = np.ones((3, 4, 2))
    model = DSBRDF(SLICES, kappa, kappa, kappa, interpolation="linear")
    kappa[:] = 5.0
    assert np.all(model.kappa == 1.0)
    for name in ("theta_diff", "amplitude", "kappa", "gamma", "center", "elongation", "delta"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(model, name)[...] = 2.0


# What it refuses


def parts(**changed: Any) -> dict[str, Any]:
    good: dict[str, Any] = {
        "theta_diff": [0.0, 0.5],
        "amplitude": np.ones((3, 2, 1)),
        "kappa": np.ones((1, 2, 1)),
        "gamma": np.ones((1, 2, 1)),
        "center": np.zeros((1, 2, 1)),
        "elongation": np.zeros((1, 1)),
        "delta": np.zeros((3, 2)),
        "interpolation": "linear",
    }
    return good | changed


ONE = np.ones((1, 2, 1))


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"theta_diff": []}, "theta_diff must be a sequence of at least one knot"),
        ({"theta_diff": 0.3}, "theta_diff must be a sequence of at least one knot"),
        ({"theta_diff": "many"}, "theta_diff must be an array of numbers"),
        ({"theta_diff": [0.5, 0.5]}, "knots theta_diff must increase from 0 or more to at most pi/2"),
        ({"theta_diff": [0.0, 1.6]}, "knots theta_diff must increase from 0 or more to at most pi/2"),
        ({"shape_theta_diff": [-0.1, 0.5]}, "knots shape_theta_diff must increase from 0 or more to at most pi/2"),
        ({"elongation_theta_diff": [0.0, np.nan]}, "knots elongation_theta_diff must increase from 0 or more"),
        ({"amplitude": np.ones((3, 3, 1))}, r"amplitude must have shape \(3, 2, 1\), not \(3, 3, 1\)"),
        ({"amplitude": np.ones((3, 2))}, "amplitude and kappa must have three axes: channel, control value and lobe"),
        ({"amplitude": np.ones((1, 2, 1))}, r"amplitude must have shape \(3, 2, 1\), not \(1, 2, 1\)"),
        ({"kappa": np.ones((2, 2, 1))}, r"kappa must have shape \(3, 2, 1\), not \(2, 2, 1\)"),
        ({"gamma": np.ones((1, 2, 2))}, r"gamma must have shape \(1, 2, 1\), not \(1, 2, 2\)"),
        ({"center": np.ones((3, 2, 1))}, r"center must have shape \(1, 2, 1\), not \(3, 2, 1\)"),
        ({"elongation": np.ones((2, 1))}, r"elongation must have shape \(1, 1\), not \(2, 1\)"),
        ({"delta": np.ones((3, 1))}, r"delta must have shape \(3, 2\), not \(3, 1\)"),
        ({"kappa": 0.0 * ONE}, "every kappa must be positive"),
        ({"kappa": np.inf * ONE}, "every kappa must be finite"),
        ({"kappa": 701.0 * ONE}, "no kappa may exceed 700: values would leave the range of numbers"),
        ({"gamma": -ONE}, "every gamma must be zero or positive"),
        ({"gamma": np.nan * ONE}, "every gamma must be finite"),
        ({"gamma": 2e100 * ONE}, r"no gamma may exceed 1e\+100"),
        ({"amplitude": -np.ones((3, 2, 1))}, "every amplitude must be zero or positive"),
        ({"delta": np.full((3, 2), -1e-9)}, "every delta must be zero or positive"),
        ({"delta": np.full((3, 2), np.inf)}, "every delta must be finite"),
        ({"center": 1.7 * ONE}, "every center must lie between -pi/2 and pi/2"),
        ({"elongation": np.full((1, 1), 11.0)}, "every elongation must lie between -10 and"),
        ({"interpolation": "magic"}, "interpolation must be one of linear, spline, not 'magic'"),
        ({"lobe": "gauss"}, "lobe must be one of hemi_epd, student, not 'gauss'"),
        (
            {"interpolation": "spline", "theta_diff": [0.3], "amplitude": np.zeros((3, 1, 1)), "kappa": ONE[:, :1],
             "gamma": ONE[:, :1], "center": None, "delta": None},
            "every amplitude must be positive for a spline, which is one of its logarithm",
        ),
    ],
)  # fmt: skip
def test_impossible_models_are_refused(changed: dict[str, Any], sentence: str) -> None:
    DSBRDF(**parts())
    with pytest.raises(InvalidArgumentError, match=sentence) as caught:
        DSBRDF(**parts(**changed))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("angle", [-1e-6, np.pi / 2 + 1e-5, np.nan, np.inf])
def test_angles_out_of_range_are_refused_by_name(angle: float) -> None:
    model = random_model()
    for name, call in (
        ("theta_half", lambda: model.evaluate([0.1, angle], 0.1)),
        ("theta_diff", lambda: model.evaluate(0.1, [0.1, angle])),
        ("theta_diff", lambda: model.parameters_at(angle)),
        ("theta_out", lambda: model.albedo(angle)),
    ):
        with pytest.raises(InvalidArgumentError, match=f"{name} must lie between 0 and 90 degrees"):
            call()


@pytest.mark.parametrize("phi_diff", [np.nan, np.inf])
def test_phi_diff_must_be_finite(phi_diff: float) -> None:
    with pytest.raises(InvalidArgumentError, match="phi_diff must be finite"):
        random_model().evaluate(0.1, 0.1, [0.0, phi_diff])


def test_what_is_not_a_direction_is_refused() -> None:
    model = random_model()
    with pytest.raises(InvalidArgumentError, match="omega_out must be of unit length"):
        model.evaluate_directions([0.0, 0.0, 1.0], [0.0, 0.0, 1.1])
    with pytest.raises(InvalidArgumentError, match="omega_in contains NaN or infinity"):
        model.evaluate_directions([0.0, 0.0, np.nan], [0.0, 0.0, 1.0])


def test_shapes_that_do_not_broadcast_are_refused() -> None:
    with pytest.raises(InvalidArgumentError, match=r"must broadcast together, not have \(2,\), \(3,\) and \(\)"):
        random_model().evaluate([0.1, 0.2], [0.1, 0.2, 0.3])
