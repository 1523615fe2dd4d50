"""Structures and parameters come back from values of their own layers; ranges have the spread of what layers miss."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from dsbrdf.components import DiffuseLayer, Layer, LayeredModel, RetroLayer, SheenLayer, SpecularLayer, TurningLayer
from dsbrdf.components.layer_data import LayerData, component_data, grid_values, material_data, renderer_data
from dsbrdf.components.layer_fit import FittedStructure, fit_structures, structure_weights
from dsbrdf.components.layers import ALPHA_INDEX
from dsbrdf.components.points import NORMAL, Points, light_rules
from dsbrdf.components.shares import LABELS, DrawnLayers, WeightedLayers
from dsbrdf.components.structures import RARE_STRUCTURES, STRUCTURES, LayerStructure
from tests.support.models import surface

GLASS = (0.045, 0.045, 0.045)
COPPER = (0.3, 0.2, 0.1)
GOLD = (0.95, 0.75, 0.35)
GROUND = DiffuseLayer((0.4, 0.15, 0.05), (0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
YARN = DiffuseLayer((0.4, 0.15, 0.05), (0.0, 0.0, 0.6, 0.0, 0.5, 0.0))
COAT = surface(GLASS, 0.02)
PLASTIC = surface(GLASS, 0.2)
METAL = surface(GOLD, 0.15)
MATERIALS: dict[str, tuple[Layer, ...]] = {
    "diffuse": (GROUND,),
    "diffuse with sheen": (GROUND, SheenLayer((0.3, 0.3, 0.3), (2.0, 3.0))),
    "diffuse with retro-reflection": (RetroLayer((0.2, 0.2, 0.2), 0.1), GROUND),
    "fibres": (surface(GLASS, 0.65), YARN),
    "dielectric over diffuse": (PLASTIC, GROUND),
    "dielectric": (PLASTIC,),
    "metal": (METAL,),
    "highlight over diffuse": (surface(COPPER, 0.15), GROUND),
    "coat over highlight over diffuse": (COAT, surface(COPPER, 0.25, 1.0), GROUND),
    "coat over metal": (COAT, surface(GOLD, 0.25, 1.0)),
    "two highlights over diffuse": (COAT, surface(GLASS, 0.3), GROUND),
}


def data_of(*layers: Layer) -> LayerData:
    data = material_data(grid_values(LayeredModel(layers).evaluate_unmasked))
    assert data is not None
    return data


def fitted(*layers: Layer) -> list[FittedStructure]:
    return fit_structures(data_of(*layers))


@pytest.mark.parametrize("name", [structure.name for structure in STRUCTURES])
def test_the_structure_of_known_layers_is_found(name: str) -> None:
    found = fitted(*MATERIALS[name])
    assert found[0].structure.name == name
    assert structure_weights(found)[0] > 0.5
    assert found[0].error < 0.01


def test_a_highlight_that_turns_its_colour_is_no_diffuse_light() -> None:
    turning = TurningLayer(**vars(METAL), turn=((0.6, -0.2, -0.4), (-0.3, 0.5, -0.2)))
    best = fit_structures(data_of(turning), (*STRUCTURES, *RARE_STRUCTURES), quick=True)[0]
    (layer,) = best.model.layers
    assert best.structure.name == "metal of turning colour"
    assert isinstance(layer, TurningLayer)
    np.testing.assert_allclose(layer.turn, turning.turn, atol=0.03)


def test_refraction_is_found_with_the_roughness() -> None:
    flakes = replace(surface(COPPER, 0.2, 1.0), refraction=1.0)
    best = fitted(COAT, flakes, GROUND)[0]
    _, found, ground = best.model.layers
    assert best.structure.name == "coat over highlight over diffuse"
    assert isinstance(found, SpecularLayer)
    assert isinstance(ground, DiffuseLayer)
    assert (found.alpha, found.refraction) == pytest.approx((0.2, 1.0), rel=0.02)
    np.testing.assert_allclose(ground.albedo, GROUND.albedo, rtol=0.02)


def test_a_structure_is_not_tried_far_below_the_widths_that_it_may_have() -> None:
    rough = next(one for one in RARE_STRUCTURES if one.name == "very rough metal")
    assert rough.started_from(LayeredModel((surface(GOLD, 0.15),))) is None
    started = rough.started_from(LayeredModel((surface(GOLD, 0.4),)))
    assert started is not None
    np.testing.assert_allclose(started.starts, [[np.degrees(surface(GOLD, 0.4).half_width)]])


def test_layers_for_renderers_are_fitted_to_the_albedo() -> None:
    model, rules = LayeredModel((PLASTIC, GROUND)), light_rules()[:2]
    data = renderer_data(model.evaluate_unmasked, rules)
    assert data is not None
    first = data.points.fresnel.size - sum(rule.weight.size for rule in rules)
    values = model.layer_values(data.points).sum(axis=0)
    assert data.squared_error(values) == pytest.approx(0.0, abs=1e-12)
    values[:, first : first + rules[0].weight.size] *= 1.1  # The albedo at normal incidence alone is wrong by 10 %.
    albedo = model.albedo(0.0)
    # The weight is 4, for three channels of two albedos.
    expected = 4.0 / 6.0 * np.sum((0.1 * albedo / albedo.max()) ** 2)
    assert data.squared_error(values) == pytest.approx(expected, rel=0.02)


def test_the_descent_ends_in_a_minimum_of_the_documented_cost() -> None:
    data = data_of(PLASTIC, GROUND)
    assert np.sum(data.weighted**2) == pytest.approx(1.0)  # Errors are shares of the signal.
    structure = next(one for one in STRUCTURES if one.name == "dielectric over diffuse")
    (found,) = fit_structures(data, [structure])

    def cost(x: np.ndarray) -> float:
        values = structure.model(x).layer_values(data.points).sum(axis=0)
        error = np.sum((values * data.root_weight - data.weighted) ** 2)
        off = structure.root @ (x - structure.mean)
        return float(50.0 * np.log(error + 0.005**2) + structure.freedom @ np.log1p(off**2 / structure.freedom))

    here = cost(found.unknowns)
    better = minimize(cost, found.unknowns, method="L-BFGS-B", bounds=list(zip(*structure.bounds, strict=True)))
    assert here - better.fun < 0.2
    sign, determinant = np.linalg.slogdet(found.normal_equations)
    assert sign > 0
    assert found.evidence == pytest.approx(here + determinant - structure.log_determinant + structure.price, abs=1e-6)


def test_draws_spread_as_the_normal_equations_say() -> None:
    found = fitted(PLASTIC, GROUND)[0]
    drawn = found.draw(np.random.default_rng(0), 2000)
    alphas = np.log([layer.alpha for model in drawn for layer in model.layers if isinstance(layer, SpecularLayer)])
    expected = np.sqrt(np.linalg.inv(found.normal_equations)[ALPHA_INDEX, ALPHA_INDEX])
    assert alphas.std() == pytest.approx(expected, rel=0.1)


def test_draws_do_not_hang_on_which_eigenvectors_a_library_finds() -> None:
    found = fitted(METAL)[0]
    size = found.unknowns.size
    alphas = []
    for seed in (1, 2):  # all directions are alike but for rounding, which decides on the vectors
        noise = 1e-13 * np.random.default_rng(seed).standard_normal((size, size))
        alike = replace(found, normal_equations=100.0 * (np.eye(size) + noise + noise.T))
        models = alike.draw(np.random.default_rng(0), 5)
        alphas.append([layer.alpha for model in models for layer in model.layers if isinstance(layer, SpecularLayer)])
    np.testing.assert_allclose(alphas[0], alphas[1], rtol=1e-9)


def test_a_model_without_light_has_no_data() -> None:
    dark = grid_values(LayeredModel(()).evaluate_unmasked)
    assert material_data(dark) is None
    assert component_data(dark, has_peak=True) is None


SURFACE = surface((0.04, 0.05, 0.06), 0.3)
BASE = DiffuseLayer((0.3, 0.2, 0.1), (0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
LAYERS = WeightedLayers("dielectric over diffuse", 1.0, LayeredModel((SURFACE, BASE)), (False, True))


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
        layers = replace(SURFACE, alpha=alpha), BASE, *others
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
    faint = WeightedLayers("dielectric over diffuse", 1.0, LayeredModel((layers, BASE)), (False, True))
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
