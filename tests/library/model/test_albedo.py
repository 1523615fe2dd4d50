"""Directional albedo against closed forms and against brute force over omega_in about the mirror direction.

The code integrates over half vectors; the references never do.
"""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from dsbrdf import DSBRDF, white_furnace
from dsbrdf.arrays import Array, Evaluate
from dsbrdf.data import half_difference
from dsbrdf.model import FAMILIES
from tests.support.models import mixture, single_lobe


def gauss(ends: Array, nodes: int) -> tuple[Array, Array]:
    x, w = np.polynomial.legendre.leggauss(nodes)
    places = [0.5 * (b - a) * (1.0 + x) + a for a, b in pairwise(ends.tolist())]
    weights = [0.5 * (b - a) * w for a, b in pairwise(ends.tolist())]
    return np.concatenate(places), np.concatenate(weights)


def brute_force(evaluate: Evaluate, theta_out: float, n_azimuth: int = 360, n_polar: int = 40) -> Array:
    """Integrate f cos(theta_in) over omega_in in polar coordinates about the mirror direction, graded towards it."""
    ends = np.concatenate([[0.0], np.geomspace(1e-5, 0.3, 40), np.linspace(0.3, np.pi, n_polar)[1:]])
    polar, polar_weight = gauss(ends, 12)
    azimuth = (np.arange(n_azimuth) + 0.5) * np.pi / n_azimuth  # the other half is its mirror image
    out = np.array([np.sin(theta_out), 0.0, np.cos(theta_out)])
    mirror, across = out * [-1.0, 0.0, 1.0], np.array([np.cos(theta_out), 0.0, np.sin(theta_out)])
    total = np.zeros(3)
    for part in np.array_split(np.arange(polar.size), 20):
        angle, weight = polar[part][:, None, None], (polar_weight * np.sin(polar))[part]
        omega_in = np.cos(angle) * mirror + np.sin(angle) * np.cos(azimuth)[:, None] * across
        omega_in[..., 1] = np.sin(polar[part])[:, None] * np.sin(azimuth)
        above = omega_in[..., 2] > 0.0
        omega_in = omega_in[above]
        theta_half, theta_diff, phi_diff = half_difference(omega_in, out)
        values = evaluate(np.minimum(theta_half, np.pi / 2), np.minimum(theta_diff, np.pi / 2), phi_diff)
        shares = np.broadcast_to(weight[:, None], above.shape)[above] * omega_in[:, 2]
        total += 2.0 * np.pi / n_azimuth * (shares @ values)
    return total


def test_lambertian_reflector_has_its_albedo_at_every_angle() -> None:
    theta_out = np.radians([0.0, 1e-3, 10.0, 45.0, 80.0, 89.9, 90.0])
    found = single_lobe(float(np.log1p(0.18 / np.pi)), 0.0).albedo(theta_out)
    np.testing.assert_allclose(found, 0.18, rtol=1e-8)


STUDENT: dict[str, Any] = {"amplitude": 10.0, "family": "student"}
LOBES: list[tuple[float, float, dict[str, Any], tuple[float, ...], float]] = [
    *((kappa, gamma, {}, (0.0, 50.0, 85.0), 1e-5) for kappa, gamma in ((1, 1), (4, 30), (8, 1e3), (0.01, 5), (8, 1e6))),
    *((kappa, gamma, STUDENT, (0.0, 50.0, 85.0), 1e-4) for kappa, gamma in ((2, 1e3), (1.5, 30), (3, 2e4))),
    *(
        (kappa, gamma, {"amplitude": 5.0, "family": family, "elongation": elongation}, angles, 5e-4)
        for kappa, gamma, angles in ((2, 20, (30.0, 75.0)), (3, 2e3, (75.0,)))
        for family in FAMILIES
        for elongation in (-1.0, 1.5)
    ),
    *(
        (1.0, gamma, {"center": float(np.radians(center))}, (50.0,), 5e-4)
        for center, gamma in ((89.9, 5.0), (30.0, 50.0), (45.0, 2e3))
    ),
]


@pytest.mark.parametrize(("kappa", "gamma", "more", "degrees", "tolerance"), LOBES)
def test_lobes_against_brute_force(
    kappa: float, gamma: float, more: dict[str, Any], degrees: tuple[float, ...], tolerance: float
) -> None:
    model = single_lobe(kappa, gamma, **more)
    for angle in np.radians(degrees).tolist():
        reference = brute_force(model.evaluate_unmasked, angle, 240)
        np.testing.assert_allclose(model.albedo(angle), reference, rtol=tolerance)


def test_knots_cost_little_accuracy() -> None:
    knots = np.radians([0.0, 12.0, 31.0, 44.0, 58.0, 77.0])
    kappa = np.array([1.0, 3.0, 1.5, 2.5, 0.5, 4.0, 1.0, 3.0])[:, None] * np.ones((3, 1, 1))
    gamma = np.array([20.0, 90.0, 10.0, 200.0, 30.0, 5.0, 20.0, 90.0])[:, None] * np.ones((3, 1, 1))
    for interpolation, count in (("linear", 6), ("spline", 8)):
        parts = (np.expm1(kappa)[:, :count], kappa[:, :count], gamma[:, :count])
        model = DSBRDF(knots, *parts, interpolation=interpolation)
        for angle in np.radians([40.0, 70.0]).tolist():
            # The reference does not know where the knots are: it needs many nodes in all directions.
            reference = brute_force(model.evaluate_unmasked, angle, 240, 250)
            np.testing.assert_allclose(model.albedo(angle), reference, rtol=1e-4)


@pytest.mark.parametrize("degrees", [0.0, 15.0, 45.0, 75.0, 87.0])
def test_delta_term_against_its_closed_form(degrees: float) -> None:
    # The cone theta_half < 1 degree: 4 int (o.h) (2 (o.h) cos(theta_half) - cos(theta_out)) d omega_half, u = cos.
    def primitive(u: float) -> float:
        cos2, sin2 = np.cos(np.radians(degrees)) ** 2, np.sin(np.radians(degrees)) ** 2
        return float(cos2 * (u**4 - u**2) / 2.0 + sin2 * (u**2 / 2.0 - u**4 / 4.0))

    expected = 5.0 * 8.0 * np.pi * (primitive(1.0) - primitive(float(np.cos(np.radians(1.0)))))
    found = single_lobe(1e-9, 0.0, delta=5.0).albedo(np.radians(degrees))
    np.testing.assert_allclose(found - np.pi * np.expm1(1e-9), expected, rtol=1e-7)


def test_angles_of_any_shape_equal_a_loop() -> None:
    model, angles = single_lobe(3.0, 40.0, elongation=0.7), np.radians([[0.0, 20.0], [50.0, 85.0]])
    one_by_one = np.reshape([model.albedo(angle) for angle in angles.ravel().tolist()], (2, 2, 3))
    np.testing.assert_allclose(model.albedo(angles), one_by_one, rtol=1e-13)
    assert model.albedo([]).shape == (0, 3)


@pytest.mark.parametrize(
    ("albedo", "words"),
    [
        (0.8, "no direction returns more than is received; the largest albedo is 0.800"),
        (1.0, "no direction returns more than is received; the largest albedo is 1.000"),
        (1.1, "some directions return more than is received"),
    ],
)
def test_a_surface_that_returns_too_much_is_found(albedo: float, words: str) -> None:
    report = white_furnace(single_lobe(1.0, 1e-12, albedo / np.pi))  # A lobe with gamma 1e-12 is a constant.
    assert report.albedo == pytest.approx(albedo, rel=1e-5)
    assert report.conserves_energy == (albedo <= 1.0)
    assert words in str(report)


def test_models_are_reciprocal_and_the_error_is_a_share_of_the_larger_value(monkeypatch: pytest.MonkeyPatch) -> None:
    assert white_furnace(mixture(3, 1)).reciprocity_error < 1e-9

    def one_way(_: DSBRDF, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return np.where(first[:, :1] > second[:, :1], 2.0, 1.0) * np.ones(3)

    monkeypatch.setattr(DSBRDF, "evaluate_directions", one_way)
    assert white_furnace(mixture(1, 0)).reciprocity_error == 0.5
