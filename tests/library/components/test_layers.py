"""Layers: derivatives by finite differences, energy and symmetry; the test of exported layers has their formulas."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from dsbrdf.arrays import Array
from dsbrdf.components import DiffuseLayer, Layer, LayeredModel, RetroLayer, SheenLayer, SpecularLayer, TurningLayer
from dsbrdf.components.points import Points
from dsbrdf.data import directions, spherical

KINDS: dict[type[Layer], int] = {SpecularLayer: 12, TurningLayer: 16, DiffuseLayer: 9, SheenLayer: 5, RetroLayer: 4}
F0 = (0.9, 0.6, 0.2)


def angles(count: int = 60) -> tuple[Array, Array, Array]:
    random = np.random.default_rng(3)
    return random.uniform(0.0, 0.7, count), random.uniform(0.0, 0.7, count), random.uniform(0.0, np.pi, count)


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


@pytest.mark.parametrize("theta_diff", np.radians([0.0, 30.0, 60.0]))
def test_refraction_widens_a_highlight_as_snells_law_does(theta_diff: float) -> None:
    # Narrow facets that reflect all light, below a smooth coat: from outside, their slopes look 1.5 times larger.
    facets = SpecularLayer((1.0,) * 3, 1.0, 0.01, 2.0, (0.0, 0.0), 0.0)
    coated = replace(facets, alpha=0.015, refraction=1.0)
    at = np.linspace(0.0, 0.05, 30), np.full(30, theta_diff), np.full(30, np.pi / 2)
    inside = [omega[:, :2] / 1.5 for omega in directions(*at)]
    inside = [np.column_stack([xy, np.sqrt(1.0 - np.sum(xy**2, axis=1))]) for xy in inside]
    expected = LayeredModel((facets,)).evaluate_directions(*inside) / 1.5**2
    np.testing.assert_allclose(LayeredModel((coated,)).evaluate(*at), expected, rtol=1e-3)


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
            expected = np.broadcast_to(found.others[k - 3], slope.shape)
        else:
            expected = found.values * relative[:, k - shared]
        np.testing.assert_allclose(slope, expected, rtol=1e-5, atol=1e-8)


def test_a_layered_model_is_reciprocal_and_the_sum_of_its_layers() -> None:
    random = np.random.default_rng(0)
    layers = tuple(kind.from_unknowns(random.normal(-1.0, 0.3, count)) for kind, count in KINDS.items())
    model, at = LayeredModel(layers), angles()
    values = model.evaluate(*at)
    np.testing.assert_allclose(values, sum(LayeredModel((layer,)).evaluate(*at) for layer in layers), rtol=1e-12)
    np.testing.assert_allclose(model.evaluate(at[0], at[1], at[2] + np.pi), values, rtol=1e-9)
    assert model.n_numbers == 46
    grid = np.stack(list(model.evaluate_grid(at[0][:2], at[1][:3], at[2][:4])))
    expected = model.evaluate(at[0][:2, None, None], at[1][:3, None], at[2][:4])
    np.testing.assert_allclose(grid.transpose(2, 0, 3, 1), expected, rtol=1e-12)


def test_albedo_is_the_mean_weight_of_samples() -> None:
    metal = SpecularLayer((0.9, 0.6, 0.2), 1.0, 0.3, 2.0, (0.0, 0.0), 0.0, 0.0)
    model, towards = LayeredModel((metal,)), spherical(np.array([0.7]), np.array([0.0]))
    drawn = model.sample(np.broadcast_to(towards, (20_000, 3)), np.random.default_rng(0))
    np.testing.assert_allclose(drawn.weight.mean(axis=0), model.albedo(0.7), rtol=0.02)
    np.testing.assert_allclose(drawn.pdf, model.pdf(drawn.omega_in, towards), rtol=1e-9)


def test_the_reflectance_at_an_angle_has_the_slopes_of_finite_differences() -> None:
    x = np.random.default_rng(2).normal(-0.5, 0.3, KINDS[SpecularLayer])
    slopes = SpecularLayer.from_unknowns(x).reflectance_slopes(1.2)
    for k in range(x.size):
        step = 1e-6 * np.eye(x.size)[k]
        ends = (np.log(SpecularLayer.from_unknowns(x + sign * step).reflectance_at(1.2)) for sign in (1.0, -1.0))
        np.testing.assert_allclose(slopes[:, k], (next(ends) - next(ends)) / 2e-6, rtol=1e-5, atol=1e-8)
