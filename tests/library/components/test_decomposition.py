import itertools
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

import dsbrdf
from dsbrdf import DSBRDF, InvalidArgumentError, Measurement, decompose
from dsbrdf.components import LABELS
from dsbrdf.components.layers import DiffuseLayer, LayeredModel, SpecularLayer
from dsbrdf.components.shares import SPIKE_HALF_WIDTH, WeightedLayers
from dsbrdf.data import PHI_DIFF, THETA_DIFF, THETA_HALF, synthetic_measurement
from dsbrdf.model import FAMILIES
from dsbrdf.model.lobes import gamma_of_half_width
from tests.support.models import random_model, single_lobe
from tests.support.soak import repeats

pytestmark = pytest.mark.slow

ROUGHNESS = 0.06
RED = (0.40, 0.16, 0.10)
COAT = (0.04, 0.04, 0.04)


def student_model(*lobes: tuple[float, tuple[float, float, float]]) -> DSBRDF:
    """Round lobes of GGX's tails with these half widths [degrees] and heights [1/sr] at every theta_diff."""
    widths, heights = np.array([width for width, _ in lobes]), np.array([height for _, height in lobes])
    gamma = (np.sqrt(2.0) - 1.0) / np.tan(np.radians(widths)) ** 2
    kappa = np.full((1, 1, widths.size), 2.0)
    return DSBRDF(np.zeros(1), heights.T[:, np.newaxis], kappa, gamma[None, None], lobe="student")


def diffuse_albedo(albedo: float, reflectance: float) -> float:
    """Albedo at normal incidence of the diffuse term of `dsbrdf.data.synthetic`, by SciPy."""
    falls = quad(lambda cosine: cosine * (1.0 - (1.0 - cosine / 2.0) ** 5), 0.0, 1.0)[0]
    return 2.0 * np.pi * albedo * (1.0 - reflectance) * 28.0 / (23.0 * np.pi) * (1.0 - 0.5**5) * falls


@pytest.fixture(scope="module")
def paint() -> Measurement:
    return synthetic_measurement(roughness=ROUGHNESS, diffuse=RED, specular=COAT, noise=0.02)


@pytest.fixture(scope="module")
def paint_model(paint: Measurement) -> DSBRDF:
    return dsbrdf.fit(dsbrdf.profiles(paint)).model


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("n_lobes", [0, 1, 8])
def test_components_sum_to_the_model(n_lobes: int, family: str) -> None:
    random = np.random.default_rng(n_lobes)
    theta_half = np.concatenate([random.uniform(0.0, np.pi / 2, 500), np.radians([0.0, 0.5, 1.0])])
    theta_diff, phi_diff = random.uniform(0.0, np.pi / 2, 503), random.uniform(0.0, 3.2, 503)
    for seed in range(repeats(1, 3)):
        model = replace(random_model(seed, n_lobes, family), delta=random.uniform(0.0, 5.0, (3, 4)))
        whole, components = model.evaluate(theta_half, theta_diff, phi_diff), list(decompose(model))
        parts = [component.evaluate(theta_half, theta_diff, phi_diff) for component in components]
        np.testing.assert_allclose(np.sum(parts, axis=0), whole, rtol=1e-12, atol=1e-300)
        assert min(part.min() for part in parts) >= 0.0
        albedo = np.sum([component.albedo for component in components], axis=0)
        np.testing.assert_allclose(albedo, model.albedo(0.0), rtol=1e-9)


def test_values_on_a_grid_and_of_directions_are_those_at_angles(paint_model: DSBRDF) -> None:
    half, diff, phi = THETA_HALF[[0, 9, 40]], THETA_DIFF[[0, 45]], PHI_DIFF[[0, 30, 90]]
    pair, sums = ([0.6, 0.0, 0.8], [-0.48, 0.36, 0.8]), np.zeros(3)
    for component in decompose(paint_model):
        grid = np.stack(list(component.evaluate_grid(half, diff, phi))).transpose(2, 0, 3, 1)
        np.testing.assert_allclose(grid, component.evaluate(half[:, None, None], diff[:, None], phi), rtol=1e-12)
        sums += component.evaluate_directions(*pair)
    np.testing.assert_allclose(sums, paint_model.evaluate_directions(*pair), rtol=1e-12)


def test_red_paint_has_a_neutral_highlight_on_a_red_ground(paint_model: DSBRDF) -> None:
    parts = decompose(paint_model)
    assert parts.labels == ("specular_spike", "diffuse")
    spike, diffuse = parts["specular_spike"], parts["diffuse"]
    np.testing.assert_allclose(spike.color, 1.0, atol=0.05)
    assert spike.half_width == pytest.approx(np.arctan(ROUGHNESS * np.sqrt(np.sqrt(2.0) - 1.0)), rel=0.1)
    truth = [diffuse_albedo(albedo, reflectance) for albedo, reflectance in zip(RED, COAT, strict=True)]
    np.testing.assert_allclose(diffuse.albedo, truth, rtol=0.06)
    np.testing.assert_allclose(diffuse.color, np.divide(truth, max(truth)), atol=0.03)


def test_diffuse_part_has_no_dent_under_the_highlight(paint_model: DSBRDF) -> None:
    diffuse = decompose(paint_model)["diffuse"]
    for theta_diff in np.radians([0.0, 30.0, 45.0]).tolist():
        under = diffuse.evaluate(np.radians(np.linspace(0.0, 12.0, 49)), theta_diff)
        around = diffuse.evaluate(np.radians(np.linspace(8.0, 40.0, 65)), theta_diff).max(axis=0)
        np.testing.assert_allclose(under / around, 1.0, atol=0.15)


def test_components_stay_when_the_data_hardly_change(paint: Measurement, paint_model: DSBRDF) -> None:
    nearer = dsbrdf.fit(dsbrdf.profiles(paint, horizon_cutoff=np.radians(76.0)), horizon_cutoff_deg=76)
    for before, after in zip(decompose(paint_model), decompose(nearer), strict=True):
        assert before.label == after.label
        np.testing.assert_allclose(after.albedo, before.albedo, rtol=0.05)


MATTE = (60.0, (0.1, 0.2, 0.3))


@pytest.mark.parametrize(
    ("groups", "labels"),
    [
        ([[(1.0, (50.0, 45.0, 40.0))], [MATTE]], ("specular_spike", "diffuse")),
        ([[(9.0, (2.0, 2.0, 2.0))], [MATTE]], ("specular_lobe", "diffuse")),
        ([[(0.5, (400.0,) * 3)], [(8.0, (3.0,) * 3)], [MATTE]], LABELS),
        ([[(5.0, (1.0,) * 3), (6.5, (1.0,) * 3)], [MATTE]], ("specular_lobe", "diffuse")),
        ([[(80.0, (0.1, 0.2, 0.3))]], ("diffuse",)),
    ],
    ids=["spike", "lobe", "both", "of nearly one width", "matte"],
)
def test_known_lobes_get_their_labels_and_come_back(groups: Any, labels: tuple[str, ...]) -> None:
    parts = decompose(student_model(*itertools.chain(*groups)))
    assert parts.labels == labels
    for component, lobes in zip(parts, groups, strict=True):
        np.testing.assert_allclose(component.albedo, student_model(*lobes).albedo(0.0), rtol=0.15)
        if component.half_width is not None:
            assert np.degrees(component.half_width) == pytest.approx(lobes[0][0], rel=0.15)


def test_no_lobe_is_narrower_than_the_spike() -> None:
    for part in decompose(random_model(182)):  # Its layers' labels contradict the widths of 2.7 and 5.4 degrees.
        width = part.description.surface_half_width
        assert width is None or (part.label == "specular_spike") == (width < SPIKE_HALF_WIDTH)


def test_a_component_says_its_physical_parameters_with_ranges(paint_model: DSBRDF) -> None:
    parts = decompose(paint_model)
    assert parts.structure == "dielectric over diffuse"
    spike, diffuse = parts["specular_spike"], parts["diffuse"]
    (surface,) = spike.surfaces
    assert surface.alpha == pytest.approx(ROUGHNESS, rel=0.05)
    assert surface.tail_exponent == pytest.approx(2.0, rel=0.1)
    assert surface.f0 is not None
    np.testing.assert_allclose(surface.f0, COAT, rtol=0.15)
    assert surface.alpha_range is not None
    assert surface.alpha_range[0] < ROUGHNESS < surface.alpha_range[1]
    assert surface.f0_range is not None
    assert all(low < value < high for value, (low, high) in zip(COAT, surface.f0_range, strict=True))
    assert (diffuse.surfaces, diffuse.half_width) == ((), None)
    for component in parts:
        low, high = component.ranges.light_share
        assert low <= component.light_share <= high < low + 0.1
        np.testing.assert_allclose(component.albedo, np.mean(component.ranges.albedo, axis=1), rtol=0.2)
        own = component.layers.evaluate(0.0, np.radians([0.0, 40.0]))
        np.testing.assert_allclose(component.height(np.radians([0.0, 40.0])), own, rtol=1e-12)


def test_absent_and_unknown_labels(paint_model: DSBRDF) -> None:
    black, parts = decompose(single_lobe(1.0, 1.0, 0.0)), decompose(paint_model)
    assert (list(black), len(black), black.labels, black.layers.layers) == ([], 0, (), ())
    assert (black.structure, black.remarks) == ("no light", ())
    assert (parts.specular_lobe, parts.diffuse) == (None, parts["diffuse"])
    for found, label, words in (
        (black, "diffuse", "no component diffuse: it has no light"),
        (parts, "specular_lobe", "no component specular_lobe: it has specular_spike and diffuse"),
        (parts, "gloss", "must be one of specular_spike, specular_lobe, diffuse, not 'gloss'"),
    ):
        with pytest.raises(InvalidArgumentError, match=words):
            found[label]
    with pytest.raises(InvalidArgumentError, match="not a str"):
        decompose("paint.json")  # type: ignore[arg-type]


def test_split_that_is_open_is_said() -> None:
    gamma = gamma_of_half_width(np.radians(60.0), np.array(2.0), "hemi_epd")
    parts = decompose(single_lobe(2.0, float(gamma), 0.1))  # fibres, or a rough surface over a ground
    assert parts.diffuse is not None
    low, high = parts.diffuse.ranges.light_share
    assert 0.6 < low < 0.9 < high
    said = f"The measurement does not determine how much of the light is diffuse: it may be {low:.0%} to {high:.0%}. "
    assert parts.remarks[0].startswith(said)
    assert parts.structure in parts.remarks[0]
    assert parts.structure == max(parts.structures, key=lambda one: one.weight).name


METAL = WeightedLayers("metal", 0.6, LayeredModel((SpecularLayer(RED, 1.0, 0.2, 2.0, (0.0,) * 2, 0.0, 0.0),)), (False,))
MATTE_LAYERS = WeightedLayers("diffuse", 0.4, LayeredModel((DiffuseLayer(RED, (0.0,) * 6),)), (True,))


@pytest.mark.parametrize(
    ("labels", "diffuse_range", "is_said"),
    [
        (LABELS[1:2], (0.0, 0.04), False),
        (LABELS[1:2], (0.0, 0.06), True),  # A diffuse part may be missing.
        (LABELS[2:], (0.91, 1.0), False),
        (LABELS[2:], (0.89, 1.0), True),  # Its part of the light is wide open.
        (LABELS[2:], (0.0, 0.09), True),  # It may not be there at all.
    ],
)
def test_an_open_split_is_said_from_a_tenth_or_where_a_part_may_be_missing(
    labels: tuple[str, ...], diffuse_range: tuple[float, float], is_said: bool, paint_model: DSBRDF
) -> None:
    parts = replace(decompose(paint_model), labels=labels, diffuse_range=diffuse_range, descriptions=(), ranges=())
    alone = replace(
        parts, descriptions=decompose(paint_model).descriptions[:1], ranges=decompose(paint_model).ranges[:1]
    )
    assert any(found.code == "open-split" for found in alone.findings) == is_said


@pytest.mark.parametrize(
    ("elongation", "gamma", "is_said"), [(2.0, 500.0, True), (0.0, 500.0, False), (2.0, 20.0, False)]
)
def test_a_narrow_highlight_that_is_not_round_is_told(elongation: float, gamma: float, is_said: bool) -> None:
    model = single_lobe(1.0, gamma, 5.0, elongation=elongation)
    found = [one for one in decompose(model).findings if one.code == "elongated-highlight"]
    assert bool(found) == is_said
    if is_said:
        along, across = (
            brentq(lambda angle, phi=phi: model.evaluate(angle, np.pi / 6, phi)[0] - 2.5, 0.0, 1.0)
            for phi in (0.0, np.pi / 2)
        )
        assert found[0].numbers["ratio"] == pytest.approx(across / along, rel=0.02)


def test_layers_belong_to_the_nearest_component_and_a_component_to_a_structure_that_has_it(paint_model: DSBRDF) -> None:
    parts = decompose(paint_model)
    for labels, receivers in (
        (LABELS[1:], LABELS[1:2] + LABELS[1:]),
        (LABELS[::2], (LABELS[0], LABELS[0], LABELS[2])),
        (LABELS[:2], (*LABELS[:2], LABELS[1])),
        (LABELS[2:], LABELS[2:] * 3),
    ):
        assert tuple(replace(parts, labels=labels).receiver(label) for label in LABELS) == receivers
    mixed = replace(parts, structures=(METAL, MATTE_LAYERS))
    assert [part.structure for part in mixed] == ["metal", "diffuse"]
    assert mixed.structure == "metal"


@pytest.mark.parametrize(("ground", "is_tail"), [((0.15, 0.11, 0.07), True), ((0.1, 0.1, 0.1), False)])
def test_a_dim_ground_of_the_colour_of_a_metal_may_be_its_tail(ground: tuple[float, ...], is_tail: bool) -> None:
    gold = SpecularLayer((0.95, 0.70, 0.42), 1.0, 0.2, 2.0, (0.0, 0.0), 0.0, 0.0)
    red, green, blue = ground
    material = LayeredModel((gold, DiffuseLayer((red, green, blue), (0.5, 0.0, 0.0, 0.0, 0.0, 0.0))))
    parts = decompose(cast(DSBRDF, material))
    assert parts.diffuse is not None
    low, high = parts.diffuse_range
    assert (low == 0.0) == is_tail
    assert low <= parts.diffuse.light_share <= high
    assert parts.alternatives == (("metal with a long tail",) if is_tail else ())
    assert bool(parts.remarks) == is_tail
