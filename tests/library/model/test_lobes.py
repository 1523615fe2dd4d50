"""The lobes of height 1 and their derivatives against mpmath with 60 digits."""

from typing import Any

import mpmath  # type: ignore[import-untyped]
import numpy as np
import pytest

from dsbrdf.model import FAMILIES, MAX_CENTER, gamma_of_half_width, half_width
from dsbrdf.model.lobes import GRAZING_COSINE, lobe_curves, lobe_values, log_cosine, reach_of_width, width_of_reach

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
