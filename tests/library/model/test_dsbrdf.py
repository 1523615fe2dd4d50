"""The model and blends as a user meets them: values, symmetry, edges, and what is no model."""

import copy
import pickle
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest

from dsbrdf import DSBRDF, InvalidArgumentError, blend
from dsbrdf.components import DiffuseLayer, LayeredModel, SpecularLayer
from dsbrdf.data import GRID_SHAPE, PHI_DIFF, THETA_DIFF, THETA_HALF, directions, incident_cosines
from dsbrdf.model import FAMILIES
from tests.support.models import SLICES, mixture, pairs_of_directions, papers_model, random_model, single_lobe
from tests.support.reproduced import assert_reproduced


@pytest.mark.parametrize("family", FAMILIES)
def test_every_value_is_positive_and_reciprocal_and_the_sum_of_its_lobes(family: str) -> None:
    omega_in, omega_out = pairs_of_directions(20_000, lowest=0.0)
    for seed in range(3):
        model = random_model(seed, family=family)
        values = model.evaluate_directions(omega_in, omega_out)
        assert values.min() > 0.0
        swapped = model.evaluate_directions(omega_out, omega_in)
        np.testing.assert_allclose(values, swapped, rtol=1e-12)
        parts = [model.select((k,), with_delta=False).evaluate_directions(omega_in, omega_out) for k in range(4)]
        assert min(part.min() for part in parts) >= 0.0
        np.testing.assert_allclose(np.sum(parts, axis=0), values, rtol=1e-12)


@pytest.mark.parametrize("family", FAMILIES)
def test_any_angles_give_a_finite_value_with_the_symmetry_of_phi_diff(family: str) -> None:
    ends = [0.0, 1e-300, 1e-9, np.pi / 4, np.pi / 2]
    edges = np.array(np.meshgrid(ends, ends, [*ends, np.pi])).reshape(3, -1)
    anywhere = np.random.default_rng(0).uniform((0.0, 0.0, -10.0), (np.pi / 2, np.pi / 2, 10.0), (5000, 3)).T
    theta_half, theta_diff, phi_diff = np.hstack([edges, anywhere])
    lowest = np.minimum(*incident_cosines(theta_half, theta_diff, phi_diff))
    above, below = lowest > 1e-9, lowest < -1e-9
    for seed in range(3):
        model = random_model(seed, family=family)
        values = model.evaluate(theta_half, theta_diff, phi_diff)
        assert np.isfinite(values).all()
        assert (values[above] > 0.0).all()
        assert (values[below] == 0.0).all()
        for same in (-phi_diff, np.pi - phi_diff, phi_diff + np.pi):
            turned = model.evaluate(theta_half, theta_diff, same)
            np.testing.assert_allclose(turned[above], values[above], rtol=1e-11)


def test_directions_give_the_values_of_their_angles_and_zero_below_the_horizon() -> None:
    model, up = random_model(), np.array([0.0, 0.0, 1.0])
    angles = np.random.default_rng(2).uniform(0.0, (0.7, 0.7, 6.2, 6.2), (50, 4)).T
    values = model.evaluate_directions(*directions(*angles))
    np.testing.assert_allclose(values, model.evaluate(*angles[:3]), rtol=1e-9)
    slanted = np.array([[0.0, 0.6, -0.8], [0.0, 0.6, 0.8], [1.0, 0.0, 0.0]])  # below, above and at the horizon
    for pair in ((slanted, up), (up, slanted)):
        assert (model.evaluate_directions(*pair) > 0.0).all(axis=1).tolist() == [False, True, True]
        assert not model.evaluate_directions(*pair)[0].any()


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
    np.testing.assert_array_equal(model.evaluate(theta_half, 0.3), model.evaluate(theta_half, 0.3, np.pi / 2))


@pytest.mark.parametrize("make", [random_model, papers_model])
def test_table_holds_the_values_at_the_nodes_those_below_the_horizon_too(make: Callable[[], DSBRDF]) -> None:
    model = make()
    table = model.tabulate()
    assert table.shape == (3, *GRID_SHAPE)
    assert np.all(table > 0.0)
    for i, j, k in ((0, 0, 0), (9, 30, 17), (10, 89, 179), (89, 45, 90), (40, 60, 91), (88, 88, 0)):
        angles = (np.array([axis[n]]) for axis, n in ((THETA_HALF, i), (THETA_DIFF, j), (PHI_DIFF, k)))
        np.testing.assert_allclose(table[:, i, j, k], model.evaluate_unmasked(*angles)[0], rtol=1e-12)
    (black,) = model.select((), with_delta=False).evaluate_grid(THETA_HALF, THETA_DIFF[:1], PHI_DIFF)
    assert not black.any()


def test_extreme_lobes_are_finite() -> None:
    theta = np.radians([0.0, 1e-4, 45.0, 89.999])
    for kappa, gamma in ((700.0, 1e7), (1e-9, 1e-9), (40.0, 0.0), (40.0, 1e-4)):
        values = single_lobe(kappa, gamma, 5.0).evaluate(theta, theta)
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


def test_copies_are_equal_read_only_and_hash_alike() -> None:
    for model in (random_model(), papers_model(), random_model(family="student")):
        model.evaluate(0.1, 0.2)  # what is computed once must not travel stale
        for other in (pickle.loads(pickle.dumps(model)), copy.deepcopy(model), copy.copy(model)):
            assert other == model
            assert hash(other) == hash(model)
            np.testing.assert_array_equal(other.evaluate(0.3, 0.4), model.evaluate(0.3, 0.4))
            assert not other.kappa.flags.writeable


def test_numbers_that_count() -> None:
    model = random_model()  # One of its four lobes has a center.
    assert model.is_ring.tolist() == [False, True, False, False]
    assert model.n_numbers == 3 * 6 * 4 + 6 * 4 + 6 * 4 + 6 + 5 * 4
    assert papers_model().n_numbers == 3 * 4 * 3 * 3 + 3 * 4


def test_a_model_has_arrays_of_its_own() -> None:
    kappa = np.ones((3, 4, 2))
    model = DSBRDF(SLICES, kappa, kappa, kappa, interpolation="linear")
    kappa[:] = 5.0
    assert np.all(model.kappa == 1.0)


def test_models_that_differ_in_anything_are_not_equal() -> None:
    model = random_model()
    state: list[Any] = list(model.__reduce__()[1])
    for index, value in enumerate(state):
        changed: Any = "student"
        if isinstance(value, np.ndarray):
            changed = value * (1.0 - 1e-12) if value.any() else value + 1e-12
        elif value != "hemi_epd":
            continue  # the interpolation cannot change alone
        other = DSBRDF(*[*state[:index], changed, *state[index + 1 :]])
        assert other != model, index
        assert hash(other) != hash(model)
    assert model != "a model"
    negative_zero = DSBRDF(*[*state[:4], np.where(model.center == 0.0, -0.0, model.center), *state[5:]])
    assert (negative_zero == model, hash(negative_zero)) == (True, hash(model))
    assert len({model, random_model(), random_model(1)}) == 2


ONE = np.ones((1, 2, 1))
SECOND = np.array([[[0.0], [1.0]]])  # One wrong value is enough.
AMPLITUDE = np.ones((3, 2, 1))
VALID: dict[str, Any] = {"theta_diff": [0.0, 0.5], "amplitude": AMPLITUDE, "kappa": ONE, "gamma": ONE}
VALID |= {"interpolation": "linear"}


IMPOSSIBLE: dict[str, tuple[Any, ...]] = {
    "theta_diff": (None, "many", [0.0, 1.6], [0.5, 0.5]),
    "elongation_theta_diff": ([0.0, np.nan],),
    "amplitude": (np.ones((3, 3, 1)), np.ones((3, 2)), -np.ones((3, 2, 1))),
    "kappa": (np.ones((2, 2, 1)), ONE - SECOND, ONE + 700.0 * SECOND),
    "gamma": (ONE - 2.0 * SECOND, np.nan * ONE, ONE + 2e100 * SECOND),
    "center": (np.ones((3, 2, 1)), 1.7 * SECOND),
    "delta": (np.ones((3, 1)),),
    "elongation": (np.full((1, 1), 11.0),),
    "interpolation": ("magic",),
    "lobe": ("gauss",),
}
BLACK = {"theta_diff": [0.3], "amplitude": np.zeros((3, 1, 1)), "kappa": ONE[:, :1], "gamma": ONE[:, :1]}


def test_impossible_models_are_refused() -> None:
    DSBRDF(**VALID)
    changes = {f"{name} {place}": {name: bad} for name, row in IMPOSSIBLE.items() for place, bad in enumerate(row)}
    said = {}
    for place, changed in (changes | {"black spline": BLACK | {"interpolation": "spline"}}).items():
        with pytest.raises(InvalidArgumentError) as caught:
            DSBRDF(**(VALID | changed))
        said[place] = str(caught.value)
    assert_reproduced("refused/models", said)


BEYOND = (-1e-6, np.pi / 2 + 1e-5, np.nan)


UP, UNKNOWN = [0, 0, 1], cast(DSBRDF, "")
REFUSED: dict[str, Any] = {
    **{f"theta_half {at}": lambda model, at=at: model.evaluate([0.1, at], 0.1) for at in BEYOND},
    **{f"theta_diff {at}": lambda model, at=at: model.evaluate(0.1, [0.1, at]) for at in BEYOND},
    "theta_diff of parameters": lambda model: model.parameters_at(-1e-6),
    "theta_out of an albedo": lambda model: model.albedo(1.6),
    "phi_diff": lambda model: model.evaluate(0.1, 0.1, [0.0, np.inf]),
    "omega_in that is NaN": lambda model: model.evaluate_directions([0, 0, np.nan], UP),
    "omega_out that is long": lambda model: model.evaluate_directions(UP, [0, 0, 1.00001]),
    "omega_in of two numbers": lambda model: model.evaluate_directions([0, 1], UP),
    "omega_in of words": lambda model: model.evaluate_directions(["a", "b", "c"], UP),
    "shapes": lambda model: model.evaluate([0.1, 0.2], [0.1, 0.2, 0.3]),
    "t of a blend": lambda model: blend(model, model, 1.5),
    "a blend with a word": lambda model: blend(model, UNKNOWN, 0.5),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_no_angle_direction_or_model_is_refused(what: str) -> None:
    with pytest.raises(InvalidArgumentError) as caught:
        REFUSED[what](random_model())
    assert_reproduced(f"refused/{what}", str(caught.value))


PAIRS = pairs_of_directions(500)
SURFACES = (SpecularLayer((0.5,) * 3, 1.0, alpha, 1e3, (0.0, 0.0), 0.5, 0.0) for alpha in (0.4, 0.1))
ROUGH, POLISHED = (LayeredModel((surface,)) for surface in SURFACES)


def test_ends_symmetry_and_reciprocity() -> None:
    a, b = mixture(3, 0), mixture(2, 1)
    for t, end in ((0.0, a), (1.0, b)):
        np.testing.assert_array_equal(blend(a, b, t).evaluate_directions(*PAIRS), end.evaluate_directions(*PAIRS))
    values = blend(a, b, 0.3).evaluate_directions(*PAIRS)
    np.testing.assert_allclose(blend(b, a, 0.7).evaluate_directions(*PAIRS), values, rtol=1e-12)
    np.testing.assert_allclose(blend(a, b, 0.3).evaluate_directions(*PAIRS[::-1]), values, rtol=1e-9)
    assert np.all(values > 0.0)
    paper = papers_model()  # Its values have kinks, at which the integral is divided.
    np.testing.assert_allclose(blend(a, paper, 1.0).albedo(0.7), paper.albedo(0.7), rtol=1e-12)
    node = blend(a, b, 0.3).tabulate()[:, 10, 20, 30]
    np.testing.assert_allclose(node, blend(a, b, 0.3).evaluate(*np.radians([10 / 9, 20, 30])), rtol=1e-12)


def test_values_lie_between_and_no_energy_is_made() -> None:
    a, b = mixture(3, 0), LayeredModel((*POLISHED.layers, DiffuseLayer((0.5, 0.4, 0.3), (0.0,) * 6)))
    middle = blend(a, b, 0.4)
    first, second, between = (one.evaluate_directions(*PAIRS) for one in (a, b, middle))
    low, high = np.minimum(first, second), np.maximum(first, second)
    assert np.all((between >= low * (1 - 1e-12)) & (between <= high * (1 + 1e-12)))
    angles = np.radians([0.0, 45.0, 75.0])
    assert np.all(middle.albedo(angles) <= 0.6 * a.albedo(angles) + 0.4 * b.albedo(angles) + 1e-9)


def test_between_polished_and_rough_lies_one_highlight_of_medium_width() -> None:
    theta_half = np.radians(np.linspace(0.0, 40.0, 400))
    widths = []
    for model in (POLISHED, blend(POLISHED, ROUGH, 0.5), ROUGH):
        values = model.evaluate(theta_half, 0.0)[:, 0]
        assert np.all(np.diff(values) < 0.0)
        widths.append(theta_half[np.argmax(values < values[0] / 2.0)])
    assert widths[0] * 1.2 < widths[1] < widths[2] / 1.2
