"""Layers against the textbook: GGX and Beckmann by their own formulas, derivatives by finite differences."""

import numpy as np
import pytest
from scipy.integrate import quad

from dsbrdf.arrays import Array
from dsbrdf.components import DiffuseLayer, Layer, LayeredModel, RetroLayer, SheenLayer, SpecularLayer, TurningLayer
from dsbrdf.components.points import Points
from dsbrdf.data import directions, spherical

KINDS: dict[type[Layer], int] = {SpecularLayer: 10, TurningLayer: 14, DiffuseLayer: 9, SheenLayer: 5, RetroLayer: 4}
F0 = (0.9, 0.6, 0.2)


def angles(count: int = 60) -> tuple[Array, Array, Array]:
    random = np.random.default_rng(3)
    return random.uniform(0.0, 0.7, count), random.uniform(0.0, 0.7, count), random.uniform(0.0, np.pi, count)


def metal(alpha: float, tail_exponent: float = 2.0) -> LayeredModel:
    return LayeredModel((SpecularLayer(F0, 1.0, alpha, tail_exponent, (0.0, 0.0), 0.0, 0.0),))


def glass(theta: Array) -> Array:
    """Reflectance of glass, the mean of both polarisations, by Snell's law and the sines and tangents of the angles."""
    refracted = np.arcsin(np.sin(theta) / 1.5)
    crossed = np.sin(theta - refracted) / np.sin(theta + refracted)
    within = np.tan(theta - refracted) / np.tan(theta + refracted)
    return np.asarray(0.5 * (crossed**2 + within**2))


def microfacets(theta_half: Array, theta_diff: Array, phi_diff: Array, alpha: float, slopes: Array) -> Array:
    """Cook and Torrance's model with Fresnel's equations and GGX's height-correlated masking; (n, 3)."""
    omega_in, omega_out = directions(theta_half, theta_diff, phi_diff)
    height = 1.0 / np.pi / alpha**2 / np.cos(theta_half) ** 4 * slopes
    length = [0.5 * (np.sqrt(1.0 + alpha**2 * (1.0 / w[:, 2] ** 2 - 1.0)) - 1.0) for w in (omega_in, omega_out)]
    masking = 1.0 / (1.0 + length[0] + length[1])
    fresnel = np.array(F0) + (1.0 - np.array(F0)) * (glass(theta_diff)[:, None] - 0.04) / 0.96
    return fresnel * (height * masking / (4.0 * omega_in[:, 2] * omega_out[:, 2]))[:, None]


def test_tail_exponent_2_is_ggx() -> None:
    at = angles()
    slopes = (1.0 + (np.tan(at[0]) / 0.3) ** 2) ** -2.0
    np.testing.assert_allclose(metal(0.3).evaluate(*at), microfacets(*at, 0.3, slopes), rtol=2e-3)


def test_a_large_tail_exponent_is_beckmanns_distribution() -> None:
    at = angles()
    slopes = np.exp(-((np.tan(at[0]) / 0.3) ** 2))
    near = slopes > 0.05
    found = metal(0.3, 1000.0).evaluate(*at)[near]
    np.testing.assert_allclose(found, microfacets(*at, 0.3, slopes)[near], rtol=1e-2)


def test_points_have_the_cosines_and_the_fresnel_terms_of_their_directions() -> None:
    at = angles()
    points, (omega_in, omega_out) = Points.at(*at), directions(*at)
    cosines = np.stack([omega_in[:, 2], omega_out[:, 2]])
    to_in, to_out, fresnel = ((glass(theta) - 0.04) / 0.96 for theta in (*np.arccos(cosines), at[1]))
    passed, rise = np.log((1.0 - to_in) * (1.0 - to_out)), 1.0 - np.cos(at[1])
    opposite = np.sum(omega_in * omega_out, axis=1) - np.prod(cosines, axis=0)  # Oren and Nayar's s and t
    across = np.where(opposite > 0.0, cosines.max(axis=0), 1.0)
    ground = (
        *(passed, (1.0 - rise) ** 2 * (to_in + to_out), fresnel, np.log(2.0 / cosines.sum(axis=0))),
        *(np.sin(at[0]) ** 2, opposite / across),
    )
    np.testing.assert_allclose(points.cosines, cosines, rtol=1e-12)
    np.testing.assert_allclose(points.squared_sines, np.sin(np.arccos(cosines)) ** 2, rtol=1e-9)
    np.testing.assert_allclose(points.passed, passed + 2.0 * np.log(0.96), rtol=1e-9)
    np.testing.assert_allclose(points.rise, [rise, rise**2], rtol=1e-9)
    np.testing.assert_allclose(points.ground, ground, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(points.fibres, np.log([np.maximum(rise, 1e-3), np.maximum(np.sin(at[0]), 0.03)]))


@pytest.mark.parametrize("tail_exponent", [1.5, 2.0, 6.0])
def test_facets_project_to_the_area(tail_exponent: float) -> None:
    # The facets' value at equal directions, over masking and Fresnel: the integral of D cos is 1.
    layer = SpecularLayer((1.0, 1.0, 1.0), 1.0, 0.2, tail_exponent, (0.0, 0.0), 1.0, 0.0)

    def facets(theta: float) -> float:
        points = Points.at(np.array([theta]), np.zeros(1), np.zeros(1))
        cosine = np.cos(theta)
        masked = (cosine + np.sqrt(0.04 + 0.96 * cosine**2)) ** 2  # over 4 cos_in cos_out
        value = LayeredModel((layer,)).layer_values(points)[0, 0, 0]
        return float(value * masked * cosine * np.sin(theta) * 2.0 * np.pi)

    assert quad(facets, 0.0, 1.5, limit=200)[0] == pytest.approx(1.0, rel=0.03)


def test_the_half_width_halves_the_slopes() -> None:
    layer = SpecularLayer((1.0, 1.0, 1.0), 1.0, 0.2, 1.7, (0.0, 0.0), 0.0, 0.0)
    tangent = np.tan(layer.half_width)
    assert (1.0 + tangent**2 / (0.7 * 0.2**2)) ** -1.7 == pytest.approx(0.5, rel=1e-2)


@pytest.mark.parametrize(("kind", "count"), KINDS.items())
def test_derivatives_are_those_of_finite_differences(kind: type[Layer], count: int) -> None:
    points, x = Points.at(*angles()), np.random.default_rng(1).normal(-0.5, 0.3, count)
    found = kind.linearize(points, x)
    np.testing.assert_allclose(found.values, LayeredModel((kind.from_unknowns(x),)).layer_values(points)[0], rtol=1e-12)
    np.testing.assert_allclose(kind.from_unknowns(x).unknowns, x, rtol=1e-12)
    relative = np.broadcast_to(found.relative(), (3, *found.relative().shape[-2:]))
    shared = count - relative.shape[1]
    for k in range(count):
        step = 1e-6 * np.eye(count)[k]
        slope = (kind.linearize(points, x + step).values - kind.linearize(points, x - step).values) / 2e-6
        if k < 3:
            expected = found.own * (np.arange(3)[:, None] == k)
        elif k < shared:
            expected = np.broadcast_to(found.grazing, slope.shape)
        else:
            expected = found.values * relative[:, k - shared]
        np.testing.assert_allclose(slope, expected, rtol=1e-5, atol=1e-8)


def test_a_retro_layer_is_ggx_about_the_direction_of_the_light() -> None:
    random = np.random.default_rng(2)
    (theta_in, theta_out), (phi_in, phi_out) = (random.uniform(0.0, end, (2, 40)) for end in (1.0, 6.0))
    omega_in, omega_out = spherical(theta_in, phi_in), spherical(theta_out, phi_out)
    white = LayeredModel((SpecularLayer((1.0, 1.0, 1.0), 1.0, 0.2, 2.0, (0.0, 0.0), 0.0, 0.0),))
    retro = LayeredModel((RetroLayer((1.0, 1.0, 1.0), 0.2),))
    turned = omega_out * [-1.0, -1.0, 1.0]
    found = retro.evaluate_directions(omega_in, omega_out)
    np.testing.assert_allclose(found, white.evaluate_directions(omega_in, turned), rtol=1e-6)


def test_a_layered_model_is_reciprocal_and_the_sum_of_its_layers() -> None:
    random = np.random.default_rng(0)
    layers = tuple(kind.from_unknowns(random.normal(-1.0, 0.3, count)) for kind, count in KINDS.items())
    model, at = LayeredModel(layers), angles()
    values = model.evaluate(*at)
    np.testing.assert_allclose(values, sum(LayeredModel((layer,)).evaluate(*at) for layer in layers), rtol=1e-12)
    np.testing.assert_allclose(model.evaluate(at[0], at[1], at[2] + np.pi), values, rtol=1e-9)
    assert model.n_numbers == 42
    grid = np.stack(list(model.evaluate_grid(at[0][:2], at[1][:3], at[2][:4])))
    expected = model.evaluate(at[0][:2, None, None], at[1][:3, None], at[2][:4])
    np.testing.assert_allclose(np.moveaxis(grid, 1, -1), expected, rtol=1e-12)


def test_albedo_is_the_mean_weight_of_samples() -> None:
    model, towards = metal(0.3), spherical(np.array([0.7]), np.array([0.0]))
    drawn = model.sample(np.broadcast_to(towards, (20_000, 3)), np.random.default_rng(0))
    np.testing.assert_allclose(drawn.weight.mean(axis=0), model.albedo(0.7), rtol=0.02)
    np.testing.assert_allclose(drawn.pdf, model.pdf(drawn.omega_in, towards), rtol=1e-9)


def test_the_reflectance_at_an_angle_has_the_slopes_of_finite_differences() -> None:
    x = np.random.default_rng(2).normal(-0.5, 0.3, 10)
    slopes = SpecularLayer.from_unknowns(x).reflectance_slopes(1.2)
    for k in range(10):
        step = 1e-6 * np.eye(10)[k]
        ends = (np.log(SpecularLayer.from_unknowns(x + sign * step).reflectance_at(1.2)) for sign in (1.0, -1.0))
        np.testing.assert_allclose(slopes[:, k], (next(ends) - next(ends)) / 2e-6, rtol=1e-5, atol=1e-8)
