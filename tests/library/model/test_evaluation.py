"""Lobes and their derivatives against mpmath with 60 digits, values of models against SciPy and the definition."""

from typing import Any

import mpmath  # type: ignore[import-untyped]
import numpy as np
import pytest
from scipy.interpolate import BSpline

from dsbrdf import DSBRDF
from dsbrdf.arrays import Array
from dsbrdf.model import FAMILIES, MAX_CENTER, gamma_of_half_width, half_width
from dsbrdf.model.lobes import GRAZING_COSINE, lobe_curves, lobe_values, log_cosine, reach_of_width, width_of_reach
from dsbrdf.model.splines import n_control_values
from tests.support.models import single_lobe

Number = Any  # mpmath has no types

mp = mpmath.MPContext()
mp.dps = 60

ANGLES = np.array([0.0, 1e-6, 0.003, 0.1, 0.5, 0.9, 1.3, 1.55])
CENTERS = [None, -0.25, -0.02, 0.0, 0.3, 1.2]
SHAPES = [(kappa, gamma) for kappa in (1e-2, 0.5, 10.0) for gamma in (1e-2, 1.0, 40.0, 2e4)]
NAMES = ("value", "by_log_kappa", "by_log_gamma", "by_center", "by_squared_tangent")


def exact(family: str, squared: Number, kappa: Number, gamma: Number, center: Number) -> Number:
    """The formula of the module; beyond a right angle from the center it is at its smallest."""
    top = min(center, mp.mpf(0))
    offset = mp.atan(mp.sqrt(squared)) - center if center >= 0 else mp.atan(mp.sqrt(squared) - mp.tan(center))
    if abs(offset) >= mp.pi / 2:
        return mp.mpf(0)
    if family == "student":
        return ((1 + gamma * mp.tan(offset) ** 2) / (1 + gamma * mp.tan(top) ** 2)) ** -kappa
    return mp.expm1(kappa * mp.cos(offset) ** gamma) / mp.expm1(kappa * mp.cos(top) ** gamma)


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("center", CENTERS)
def test_values_and_derivatives_against_60_digits(family: str, center: float | None) -> None:
    # Behind the lobe all is constant; tested below.
    before = np.flatnonzero(np.abs(ANGLES - (center or 0.0)) <= np.pi / 2 - 1e-3)
    for kappa, gamma in SHAPES:
        middle = None if center is None else np.array(center)
        values, slopes = lobe_curves(np.tan(ANGLES) ** 2, np.array(kappa), np.array(gamma), middle, family)
        parts = [np.broadcast_to(part, ANGLES.shape) for part in (values, *slopes())]
        for n in before.tolist():
            squared = float(np.tan(ANGLES[n]) ** 2)
            point = (mp.log(kappa), mp.log(gamma), mp.mpf(center or 0.0), mp.mpf(squared))

            def curve(a: Number, b: Number, c: Number, s: Number) -> Number:
                return exact(family, s, mp.exp(a), mp.exp(b), c)

            orders = [(0, 0, 0, 0), (1, 0, 0, 0), (0, 1, 0, 0)]
            if center:  # at center 0 the derivatives of a ring and of a cusp differ
                orders.append((0, 0, 1, 0))
            scale = 1e-9 * (1.0 + np.sqrt(gamma) + kappa)
            for name, part, order in zip(NAMES, parts, orders, strict=False):
                value = float(mp.diff(curve, point, order))
                assert part[n] == pytest.approx(value, rel=1e-7, abs=scale * 1e-3), (name, kappa, gamma, n)
            if squared > 0.0 or center is None:
                step = {"h": mp.mpf(10) ** -25, "direction": 1} if squared == 0.0 else {}
                slope = float(mp.diff(lambda s, p=point: curve(p[0], p[1], p[2], s), point[3], **step))
                assert parts[4][n] == pytest.approx(slope, rel=1e-6, abs=scale * gamma), (kappa, gamma, n)
            else:  # infinite, but by_elongation is 0 there: any finite number will do
                assert np.isfinite(parts[4][n])


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("center", CENTERS)
def test_values_fall_from_height_1_to_the_horizon_and_derivatives_are_finite(family: str, center: float | None) -> None:
    peak = max(center or 0.0, 0.0)
    angles = np.sort(np.append(np.linspace(0.0, np.pi / 2, 721), peak))
    squared, top = np.minimum(np.tan(angles), 1e15) ** 2, np.searchsorted(angles, peak)
    middle = None if center is None else np.array(center)
    for kappa, gamma in SHAPES:
        values, slopes = lobe_curves(squared, np.array(kappa), np.array(gamma), middle, family)
        assert all(np.isfinite(part).all() for part in slopes())
        assert values[top] == pytest.approx(1.0, abs=1e-12)
        assert np.all(values >= 0.0)
        assert np.all(np.diff(values[: top + 1]) >= -1e-12)
        assert np.all(np.diff(values[top:]) <= 1e-12)


def test_cosine_of_the_stretch_is_that_of_theta_diff_held_above_its_value_at_grazing_angles() -> None:
    assert np.exp(log_cosine(np.array(np.pi / 2))) == pytest.approx(GRAZING_COSINE)
    np.testing.assert_allclose(np.exp(log_cosine(np.radians([0.0, 60.0, 75.0]))), [1.0, 0.5, np.cos(1.309)], rtol=3e-3)


@pytest.mark.parametrize("family", FAMILIES)
def test_ring_at_the_horizon_does_not_depend_on_rounding(family: str) -> None:
    squared, kappa, gamma = np.tan(np.radians([10.0, 60.0, 88.0])) ** 2, np.array(0.1), np.array(0.01)
    centers = [np.array(MAX_CENTER * (1.0 + turn)) for turn in (-1e-7, 0.0, 1e-7)]
    values = [lobe_values(squared, kappa, gamma, center, family) for center in centers]
    np.testing.assert_allclose(values[0], values[1], rtol=1e-5)
    np.testing.assert_allclose(values[2], values[1], rtol=1e-5)


@pytest.mark.parametrize("family", FAMILIES)
def test_half_width_is_where_a_lobe_has_half_its_height_and_gamma_follows_from_it(family: str) -> None:
    for kappa, gamma in ((0.3, 2.0), (1.0, 30.0), (9.0, 3e4)):
        width = half_width(np.array(kappa), np.array(gamma), family)
        value = lobe_values(np.tan(width) ** 2, np.array(kappa), np.array(gamma), None, family)
        assert value == pytest.approx(0.5, rel=1e-9)
        assert gamma_of_half_width(width, np.array(kappa), family) == pytest.approx(gamma, rel=1e-9)
        assert width_of_reach(reach_of_width(width, family), family) == pytest.approx(float(width), rel=1e-12)


KNOTS = np.radians([0.0, 20.0, 40.0, 55.0, 65.0, 72.0, 77.0, 81.0, 89.0])
SHAPE_KNOTS = np.radians([0.0, 33.0, 60.0, 80.0])
ELONGATION_KNOTS = np.radians([10.0, 60.0])


def random_model(
    interpolation: str = "spline",
    *,
    rings: tuple[int, ...] = (1,),
    shapes: int = 1,
    knots: Array = KNOTS,
    family: str = "hemi_epd",
) -> DSBRDF:
    """Four lobes that change wildly from knot to knot, cusps among the rings."""
    random = np.random.default_rng(0)
    count = n_control_values if interpolation == "spline" else int
    shape = (shapes, count(SHAPE_KNOTS.size), 4)
    center = np.zeros(shape)
    center[:, :, list(rings)] = random.uniform(-0.2, 1.2, (*shape[:2], len(rings)))
    return DSBRDF(
        knots,
        amplitude=np.exp(random.uniform(-4.0, 5.0, (3, count(knots.size), 4))),
        kappa=np.exp(random.uniform(-4.0, 2.0, shape)),
        gamma=np.exp(random.uniform(-2.0, 8.0, shape)),
        center=center,
        elongation=random.uniform(-0.5, 1.5, (count(ELONGATION_KNOTS.size), 4)),
        shape_theta_diff=SHAPE_KNOTS,
        elongation_theta_diff=ELONGATION_KNOTS,
        delta=random.uniform(0.0, 2.0, (3, knots.size)),
        interpolation=interpolation,
        lobe=family,
    )


def curve(model: DSBRDF, knots: Array, values: Array, theta_diff: Array) -> Array:
    values = np.moveaxis(values, -2, 0)
    if knots.size == 1:
        return values.repeat(theta_diff.size, axis=0)
    degree = 3 if model.interpolation == "spline" else 1
    clamped = np.pad(knots, degree, mode="edge")
    return np.asarray(BSpline(clamped, values, degree)(np.clip(theta_diff, knots[0], knots[-1])))


def expected_values(model: DSBRDF, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
    at = model.parameters_at(theta_diff)
    cosine = (np.cos(theta_diff) ** 4 * (1.0 - GRAZING_COSINE**4) + GRAZING_COSINE**4) ** 0.25
    along = cosine[:, None] ** at["elongation"]
    turned = np.cos(phi_diff[:, None]) ** 2 / along + np.sin(phi_diff[:, None]) ** 2 * along
    squared = (np.tan(theta_half[:, None]) ** 2 * turned)[:, None]
    kappa, gamma, center = at["kappa"], at["gamma"], at["center"]
    top = np.minimum(center, 0.0)
    offset = np.arctan(np.sqrt(squared) - np.tan(top)) - np.maximum(center, 0.0)
    # A right angle from the center is behind the lobe: the formula holds to within a thousandth of a radian.
    if model.lobe == "student":
        square = np.where(model.is_ring, np.tan(np.minimum(offset, 1.57)) ** 2, squared)
        value = ((1.0 + gamma * square) / (1.0 + gamma * np.tan(top) ** 2)) ** -kappa
    else:
        power = np.maximum(np.cos(offset), 1e-12) ** gamma
        value = np.expm1(kappa * power) / np.expm1(kappa * np.cos(top) ** gamma)
    inside = theta_half[:, None] < np.radians(1.0)
    return np.asarray((at["amplitude"] * value).sum(axis=2) + np.where(inside, at["delta"], 0.0))


def points(count: int, seed: int = 1) -> tuple[Array, Array, Array]:
    """Angles all over the range, among them the knots, the edges, and more than enough near the normal."""
    random = np.random.default_rng(seed)
    theta_half, theta_diff = random.uniform(0.0, np.pi / 2, (2, count))
    theta_half[::7] *= 0.02
    theta_half[1:4] = 0.0, 1.5707, np.radians(1.0)
    theta_diff[2:5] = 0.0, 1.57, np.pi / 2
    theta_diff[5 : 5 + KNOTS.size] = KNOTS
    return theta_half, theta_diff, random.uniform(-7.0, 7.0, count)


INTERPOLATIONS = pytest.mark.parametrize("interpolation", ["linear", "spline"])
ANY_KNOTS = [np.radians([7.0, 70.0]), np.array([0.4]), np.linspace(0.0, 1.5, 400)]
CHANGES: list[dict[str, Any]] = [
    *({"rings": rings, "shapes": shapes} for rings in ((), (1,), (0, 1, 2, 3)) for shapes in (1, 3)),
    *({"knots": knots} for knots in ANY_KNOTS),
]


@pytest.mark.parametrize("family", FAMILIES)
@INTERPOLATIONS
@pytest.mark.parametrize("changed", CHANGES)
def test_many_points_have_the_values_of_definition(interpolation: str, changed: dict[str, Any], family: str) -> None:
    model = random_model(interpolation, family=family, **changed)
    angles = points(4000)
    found = model.evaluate_unmasked(*angles)
    # A cosine close to 1 is rounded to 1e-16, which its power by gamma, 3000, makes 3e-13.
    np.testing.assert_allclose(found, expected_values(model, *angles), rtol=2e-10, atol=1e-60)


@pytest.mark.parametrize("knots", ANY_KNOTS)
@INTERPOLATIONS
def test_parameters_are_the_curves_of_their_control_values(interpolation: str, knots: Array) -> None:
    model = random_model(interpolation, shapes=3, rings=(0, 2), knots=knots)
    angles = np.radians([[0.0, 3.0, 33.0], [60.0, 88.0, 90.0]])
    of_logarithm = (np.log, np.exp) if interpolation == "spline" else (np.log1p, np.expm1)
    of_shape = (np.log, np.exp) if interpolation == "spline" else (np.asarray, np.asarray)
    deltas = np.stack([np.interp(angles, knots, row) for row in model.delta], axis=-1)
    np.testing.assert_allclose(model.parameters_at(angles)["delta"], deltas, rtol=1e-12)
    for name, at, (scale, back) in (
        ("amplitude", knots, of_logarithm),
        ("kappa", SHAPE_KNOTS, of_shape),
        ("gamma", SHAPE_KNOTS, of_shape),
        ("center", SHAPE_KNOTS, (np.asarray, np.asarray)),
        ("elongation", ELONGATION_KNOTS, (np.asarray, np.asarray)),
    ):
        expected = back(curve(model, at, scale(getattr(model, name)), angles.ravel()))
        found = model.parameters_at(angles)[name]
        assert found.shape == (2, 3, *expected.shape[1:])
        np.testing.assert_allclose(found.reshape(expected.shape), expected, rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("count", [3, 5000])
def test_what_is_too_faint_for_a_number_is_zero_or_nearly(count: int, family: str) -> None:
    values = single_lobe(200.0, 1e7, 2.0, family=family).evaluate(np.linspace(0.2, 1.0, count), 0.5)
    assert np.all((values >= 0.0) & (values < 1e-80))
    assert not np.any(np.signbit(values))
