"""Ranges of a component's light: from the draws, and from light that no layer explains."""

from dataclasses import replace

import numpy as np
import pytest

from dsbrdf.components import LABELS, DiffuseLayer, Layer, LayeredModel, SheenLayer, SpecularLayer
from dsbrdf.components.layer_fit import FittedStructure
from dsbrdf.components.points import NORMAL, Points
from dsbrdf.components.shares import DrawnLayers, WeightedLayers
from dsbrdf.components.structures import RARE_STRUCTURES, STRUCTURES, LayerStructure

SURFACE = SpecularLayer((0.04, 0.05, 0.06), 0.9, 0.3, 2.0, (0.0, 0.0), 0.5, 0.0)
GROUND = DiffuseLayer((0.3, 0.2, 0.1), (0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
LAYERS = WeightedLayers("dielectric over diffuse", 1.0, LayeredModel((SURFACE, GROUND)), (False, True))


def test_missed_light_is_doubtful_where_both_sides_have_light() -> None:
    points = Points.at(np.radians([0.0, 20.0, 50.0]), np.radians([30.0, 30.0, 10.0]), np.radians([90.0, 90.0, 40.0]))
    surface, ground = LAYERS.model.layer_values(points)
    expected = 0.2 * 4.0 * surface * ground / (surface + ground)  # the sum of both times the product of both fractions
    for labels in (LABELS[:2], LABELS[2:]):
        np.testing.assert_allclose(LAYERS.doubtful(0.8 * (surface + ground), points, labels), expected, rtol=1e-9)
    np.testing.assert_allclose(LAYERS.doubtful(0.8 * (surface + ground), points, LABELS), 0.0, atol=1e-12)


def test_a_range_has_the_spread_of_the_draws_and_the_doubtful_light() -> None:
    share = np.linspace(0.5, 0.7, 201)  # The central 90 % are 0.51 to 0.69, that is 0.6 +- 0.09.
    albedos = np.stack([np.zeros_like(share), 1.0 - share, share], axis=1)[..., np.newaxis] * np.full(3, 0.4)
    exact = LAYERS.model.layer_values(NORMAL.points).sum(axis=0)
    for missed in (0.0, 0.3, 5.0):
        drawn = DrawnLayers([LAYERS] * 201, np.full(201, 1 / 201), albedos, [LAYERS], (1.0 + missed) * exact)
        doubtful = LAYERS.doubtful(drawn.values, NORMAL.points, LABELS[2:]) @ NORMAL.weight
        half = np.hypot(0.09, doubtful.sum() / 1.2)
        expected = max(0.6 - half, 0.0), min(0.6 + half, 1.0)
        assert drawn.light_range(LABELS[2:]) == pytest.approx(expected, abs=1e-3)
        half = np.hypot(0.09 * 0.4, doubtful[0])
        assert drawn.ranges(LABELS[2:]).albedo[0] == pytest.approx((max(0.24 - half, 0.0), 0.24 + half), abs=1e-3)


def test_rough_layers_and_sheen_are_drawn_wider() -> None:
    names = "dielectric over diffuse", "dielectric over diffuse with sheen"
    plain, with_sheen = (next(one for one in (*STRUCTURES, *RARE_STRUCTURES) if one.name == name) for name in names)

    def deviation(structure: LayerStructure, alpha: float, *others: Layer) -> float:
        layers = replace(SURFACE, alpha=alpha), GROUND, *others
        unknowns = np.concatenate([layer.unknowns for layer in layers])
        found = FittedStructure(structure, unknowns, 0.01, 0.0, 1e4 * np.eye(unknowns.size))
        drawn = DrawnLayers.of(LAYERS.model.layer_values(NORMAL.points).sum(axis=0), [found])
        return float(np.std([one.model.layers[0].unknowns[6] for one in drawn.layers]))

    smooth, rough = deviation(plain, 0.1), deviation(plain, 0.4)
    assert rough > 2.0 * smooth
    assert deviation(with_sheen, 0.1, SheenLayer((0.02, 0.02, 0.02), (2.5, 2.5))) > rough


def test_a_colour_that_layers_miss_is_not_the_colour_of_a_faint_highlight() -> None:
    points = Points.at(np.radians([12.0, 20.0, 28.0]), np.radians([10.0, 30.0, 20.0]), np.radians([90.0, 60.0, 40.0]))
    surface, ground = LAYERS.model.layer_values(points)
    surface = 0.05 * surface
    layers = replace(SURFACE, f0=(0.002, 0.0025, 0.003), f90=0.045)
    faint = WeightedLayers("dielectric over diffuse", 1.0, LayeredModel((layers, GROUND)), (False, True))
    tint = np.array([[1.06], [1.0], [0.94]])
    _, lobe, diffuse = faint.split((surface + ground) * tint, points)
    np.testing.assert_allclose(lobe / surface, lobe.sum(axis=0) / surface.sum(axis=0) * np.ones((3, 1)), rtol=0.4)
    np.testing.assert_allclose(lobe + diffuse, (surface + ground) * tint, rtol=1e-12)


def test_light_that_layers_miss_near_the_mirror_direction_belongs_to_the_highlight() -> None:
    points = Points.at(np.radians([0.0, 0.5, 1.0]), np.radians([10.0, 30.0, 20.0]), np.radians([90.0, 60.0, 40.0]))
    surface, ground = LAYERS.model.layer_values(points)
    for factor in (0.8, 1.5):
        _, lobe, diffuse = LAYERS.split(factor * surface + ground, points)
        np.testing.assert_allclose(lobe, factor * surface, rtol=1e-3)
        np.testing.assert_allclose(diffuse, ground, rtol=1e-3)


def test_a_surplus_belongs_to_the_highlight_further_out_than_a_lack() -> None:
    points = Points.at(np.radians([15.0, 20.0, 25.0]), np.radians([10.0, 30.0, 20.0]), np.radians([90.0, 60.0, 40.0]))
    values = LAYERS.model.layer_values(points).sum(axis=0)
    exact, more, less = (LAYERS.split(factor * values, points)[2].sum(axis=0) for factor in (1.0, 1.1, 0.9))
    assert np.all(more - exact < 0.5 * (exact - less))
