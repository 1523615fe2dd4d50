"""Directional albedo against closed forms and against brute force over omega_in about the mirror direction.

The code integrates over half vectors; the references never do.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf.data.measurement import Measurement
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import fit
from dsbrdf.model.albedo import directional_albedo
from dsbrdf.model.dsbrdf import DSBRDF

Array = NDArray[np.float64]
Bivariate = Callable[[Array, Array], Array]

ANGLES = np.radians([0.0, 20.0, 50.0, 85.0])


def gauss(ends: Array, nodes: int) -> tuple[Array, Array]:
    """Composite Gauss-Legendre nodes and weights."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    places = [0.5 * (b - a) * (1.0 + x) + a for a, b in pairwise(ends.tolist())]
    weights = [0.5 * (b - a) * w for a, b in pairwise(ends.tolist())]
    return np.concatenate(places), np.concatenate(weights)


def brute_force(evaluate: Bivariate, theta_out: float, n_azimuth: int = 720, n_polar: int = 40) -> Array:
    """Integrate f cos(theta_in) over omega_in in polar coordinates about the mirror direction, graded towards it."""
    ends = np.concatenate([[0.0], np.geomspace(1e-5, 0.3, 40), np.linspace(0.3, np.pi, n_polar)[1:]])
    polar, polar_weight = gauss(ends, 12)
    azimuth = (np.arange(n_azimuth) + 0.5) * np.pi / n_azimuth  # the other half is its mirror image
    out = np.array([np.sin(theta_out), 0.0, np.cos(theta_out)])
    mirror, across = out * [-1.0, 0.0, 1.0], np.array([np.cos(theta_out), 0.0, np.sin(theta_out)])
    total = np.zeros(3)
    for angle, weight in zip(polar.tolist(), (polar_weight * np.sin(polar)).tolist(), strict=True):
        omega_in = np.cos(angle) * mirror + np.sin(angle) * np.cos(azimuth)[:, None] * across
        omega_in[:, 1] = np.sin(angle) * np.sin(azimuth)
        omega_in = omega_in[omega_in[:, 2] > 0.0]
        if omega_in.size == 0:
            continue
        half, difference = omega_in + out, omega_in - out
        theta_half = np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2])
        theta_diff = np.arctan2(np.linalg.norm(difference, axis=1), np.linalg.norm(half, axis=1))
        values = evaluate(np.minimum(theta_half, np.pi / 2), np.minimum(theta_diff, np.pi / 2))
        total += weight * 2.0 * np.pi / n_azimuth * (omega_in[:, 2] @ values)
    return total


def single_lobe(kappa: float, gamma: float, center: float = 0.0, delta: float = 0.0) -> DSBRDF:
    shape = (3, 1, 1)
    return DSBRDF(
        np.zeros(1), np.full(shape, kappa), np.full(shape, gamma), np.full(shape, center), np.full((3, 1), delta)
    )


def grey(function: Callable[[Array, Array], Array]) -> Bivariate:
    def evaluate(theta_half: Array, theta_diff: Array) -> Array:
        values = function(*np.broadcast_arrays(theta_half, theta_diff))
        return np.repeat(values[..., None], 3, axis=-1)

    return evaluate


def test_lambertian_reflector_has_its_albedo_at_every_angle() -> None:
    theta_out = np.radians([0.0, 1e-3, 10.0, 45.0, 80.0, 89.9, 90.0])
    found = single_lobe(float(np.log1p(0.18 / np.pi)), 0.0).directional_albedo(theta_out)
    np.testing.assert_allclose(found, 0.18, rtol=1e-8)
    plain = directional_albedo(grey(lambda half, _: np.full(half.shape, 1.0 / np.pi)), theta_out, np.zeros(0))
    np.testing.assert_allclose(plain, 1.0, rtol=1e-8)


@pytest.mark.parametrize("power", [0.5, 1.0, 8.0, 1000.0])
def test_power_of_the_half_angle_at_normal_incidence(power: float) -> None:
    # With omega_out at the normal theta_in = 2 theta_half: 2 pi int c**p cos(2 t) sin(2 t) 2 dt, c = cos t, t to pi/4.
    def primitive(c: float) -> float:
        return 2.0 * c ** (power + 4) / (power + 4) - c ** (power + 2) / (power + 2)

    expected = 8.0 * np.pi * (primitive(1.0) - primitive(float(np.cos(np.pi / 4))))
    found = directional_albedo(grey(lambda half, _: np.cos(half) ** power), np.zeros(()), np.zeros(0))
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.parametrize(("kappa", "gamma"), [(1.0, 1.0), (4.0, 30.0), (8.0, 1e3), (0.01, 5.0)])
def test_lobes_against_brute_force(kappa: float, gamma: float) -> None:
    model = single_lobe(kappa, gamma)
    for angle in ANGLES.tolist():
        np.testing.assert_allclose(model.directional_albedo(angle), brute_force(model.evaluate, angle), rtol=1e-5)


@pytest.mark.parametrize("gamma", [1e4, 1e5, 1e6])
def test_spikes_against_brute_force(gamma: float) -> None:
    model = single_lobe(8.0, gamma)
    for angle in ANGLES.tolist():
        np.testing.assert_allclose(model.directional_albedo(angle), brute_force(model.evaluate, angle, 240), rtol=1e-5)


@pytest.mark.parametrize(("degrees", "gamma"), [(90.0, 5.0), (30.0, 50.0), (45.0, 2000.0)])
def test_ring_lobes_against_brute_force(degrees: float, gamma: float) -> None:
    model = single_lobe(1.0, gamma, float(np.radians(degrees)))
    for angle in ANGLES[1::2].tolist():
        reference = brute_force(model.evaluate, angle)
        np.testing.assert_allclose(model.directional_albedo(angle), reference, rtol=1e-5)


def test_gloss_that_depends_on_both_angles_against_brute_force() -> None:
    # A GGX distribution with Schlick's Fresnel term: bivariate, and no lobe of ours.
    alpha = 0.15

    def glossy(theta_half: Array, theta_diff: Array) -> Array:
        slope = np.sin(theta_half) ** 2 + alpha**2 * np.cos(theta_half) ** 2
        return alpha**2 / (np.pi * slope**2) * (0.04 + 0.96 * (1.0 - np.cos(theta_diff)) ** 5)

    for angle in ANGLES.tolist():
        found = directional_albedo(grey(glossy), np.array(angle), np.zeros(0))
        np.testing.assert_allclose(found, brute_force(grey(glossy), angle), rtol=1e-5)


@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_kinks_of_the_interpolation_cost_no_accuracy(interpolation: str) -> None:
    knots = np.radians([0.0, 12.0, 31.0, 44.0, 58.0, 77.0])
    kappa = np.array([1.0, 3.0, 1.5, 2.5, 0.5, 4.0])[:, None] * np.ones((3, 1, 1))
    gamma = np.array([20.0, 90.0, 10.0, 200.0, 30.0, 5.0])[:, None] * np.ones((3, 1, 1))
    model = DSBRDF(knots, kappa, gamma, np.zeros_like(kappa), np.zeros((3, 6)), interpolation)
    for angle in np.radians([0.0, 40.0]).tolist():
        # The reference does not know where the kinks are: it needs many nodes in all directions.
        reference = brute_force(model.evaluate, angle, 360, 400)
        np.testing.assert_allclose(model.directional_albedo(angle), reference, rtol=2e-5)


@pytest.mark.parametrize("degrees", [0.0, 15.0, 45.0, 75.0, 87.0])
def test_delta_term_against_its_closed_form(degrees: float) -> None:
    # The cone theta_half < 1 degree: 4 int (o.h) (2 (o.h) cos(theta_half) - cos(theta_out)) d omega_half, u = cos.
    def primitive(u: float) -> float:
        cos2, sin2 = np.cos(np.radians(degrees)) ** 2, np.sin(np.radians(degrees)) ** 2
        return float(cos2 * (u**4 - u**2) / 2.0 + sin2 * (u**2 / 2.0 - u**4 / 4.0))

    expected = 5.0 * 8.0 * np.pi * (primitive(1.0) - primitive(float(np.cos(np.radians(1.0)))))
    found = single_lobe(1e-9, 0.0, delta=5.0).directional_albedo(np.radians(degrees))
    np.testing.assert_allclose(found - np.pi * np.expm1(1e-9), expected, rtol=1e-7)


@pytest.mark.filterwarnings("ignore::dsbrdf.errors.ConvergenceWarning")
def test_fitted_model_against_brute_force(plastic: Measurement) -> None:
    model = fit(plastic, FitOptions(method="paper", n_lobes=3, horizon_cutoff=None)).model
    bare = model.select((0, 1, 2), with_delta=False)
    for angle in np.radians([33.0]).tolist():
        reference = brute_force(bare.evaluate, angle, 360, 400)
        np.testing.assert_allclose(bare.directional_albedo(angle), reference, rtol=2e-5)


def test_angles_of_any_shape_equal_a_loop() -> None:
    model = single_lobe(3.0, 40.0)
    whole = model.directional_albedo(ANGLES[:4].reshape(2, 2))
    assert whole.shape == (2, 2, 3)
    for i in range(4):
        np.testing.assert_array_equal(whole.reshape(4, 3)[i], model.directional_albedo(float(ANGLES[i])))
    assert model.directional_albedo(0.3).shape == (3,)
    assert model.directional_albedo([]).shape == (0, 3)


def test_channels_do_not_mix() -> None:
    kappa = np.array([0.1, 1.0, 5.0])[:, None, None]
    model = DSBRDF(np.zeros(1), kappa, np.full((3, 1, 1), 50.0), np.zeros((3, 1, 1)), np.zeros((3, 1)))
    found = model.directional_albedo(0.5)
    for channel in range(3):
        expected = single_lobe(float(kappa[channel, 0, 0]), 50.0).directional_albedo(0.5)
        assert found[channel] == pytest.approx(expected[0], rel=1e-12)
