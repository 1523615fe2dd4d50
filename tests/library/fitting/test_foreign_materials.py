"""What docs/components.md says of real surfaces, on materials of others whose specular and diffuse light is known.

Their own values are decomposed: that a fit has them is asked of fits.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeVar, cast

import numpy as np
import pytest

import dsbrdf
from dsbrdf.arrays import Array
from dsbrdf.data.geometry import directions
from dsbrdf.fitting.decomposition import Decomposition
from dsbrdf.model.reflectance import ReflectanceModel
from tests.support.foreign_bsdfs import conductor
from tests.support.foreign_materials import CATALOGUE, Material
from tests.support.foreign_truth import RULES, Truth, judged

T = TypeVar("T")

pytestmark = pytest.mark.slow

COATED = ("plastic_green_03", "plastic_orange_25_beckmann")
METALS = ("nickel_25", "silver_15_beckmann")
CLOTH = ("charlie_sheen", "oren_nayar_25")
LAYERED = ("coat_on_copper", "car_paint_blue")
IN_RANGE = (*COATED, "nickel_25", "principled_quarter_metal")
NAMES = (*COATED, *METALS, *CLOTH, *LAYERED, "coloured_highlight", "principled_quarter_metal", "plastic_white_50")


@dataclass(frozen=True, eq=False)
class Exact(ReflectanceModel):
    """A material as a model."""

    material: Material

    def evaluate_unmasked(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        pair = np.clip(directions(theta_half, theta_diff, phi_diff), -1.0, 1.0)  # formulas take roots of 1 - cosine
        above, values = pair[..., 2].min(axis=0) > 1e-6, np.zeros((theta_half.size, 3))
        light, eye = pair[:, above]
        values[above] = self.material.specular_values(light, eye) + self.material.diffuse_values(light, eye)
        return values

    def evaluate_grid(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Iterator[Array]:
        raise NotImplementedError


@cache
def truth_of(name: str) -> Truth:
    return Truth.of(CATALOGUE[name])


@cache
def parts_of(name: str) -> Decomposition:
    return decomposed(CATALOGUE[name])


def decomposed(material: Material) -> Decomposition:
    return dsbrdf.decompose(cast(dsbrdf.DSBRDF, Exact(material)))


def present(found: T | None) -> T:
    assert found is not None
    return found


def albedo(values: tuple[Array, ...]) -> Array:
    """Of light at normal incidence."""
    return np.asarray(RULES[0][2] @ values[0])


def height(material: Material, theta_diff: float = 0.0) -> float:
    """Of the true highlight, red [1/sr]."""
    omega_in, omega_out = directions([0.0], [theta_diff], [np.pi / 2])
    return float(material.specular_values(omega_in, omega_out)[0, 0])


@pytest.mark.parametrize("name", NAMES)
def test_light_is_on_its_own_side_and_the_share_within_its_range(name: str) -> None:
    found = judged(parts_of(name), truth_of(name))
    assert found.moved.mean() < 0.03
    assert found.inside


@pytest.mark.parametrize("name", [*COATED, *METALS, "coloured_highlight", "principled_quarter_metal"])
def test_roughness_and_reflectance_of_a_layer_come_out_as_they_were_put_in(name: str) -> None:
    found = judged(parts_of(name), truth_of(name))
    assert found.alpha == pytest.approx(0.0, abs=0.03)
    assert found.f0 == pytest.approx(0.0, abs=0.10)
    material, ranges = CATALOGUE[name], parts_of(name)[parts_of(name).labels[0]].ranges
    stated, true = (*present(ranges.f0), present(ranges.alpha)), (*present(material.f0), present(material.alpha))
    within = [low <= value <= high for (low, high), value in zip(stated, true, strict=True)]
    assert all(within) or name not in IN_RANGE


@pytest.mark.parametrize("name", COATED)
def test_highlight_of_a_clear_coat_is_neutral_and_all_colour_in_the_body(name: str) -> None:
    parts, truth = parts_of(name), truth_of(name)
    assert "dielectric" in parts.structure
    highlight = present(parts.specular_spike or parts.specular_lobe)
    np.testing.assert_allclose(highlight.color, 1.0, atol=0.06)
    body = albedo(truth.diffuse)
    np.testing.assert_allclose(present(parts.diffuse).color, body / body.max(), atol=0.02)


@pytest.mark.parametrize("name", [*METALS, "coat_on_copper"])
def test_metals_have_no_diffuse_part_and_their_highlight_has_their_colour(name: str) -> None:
    parts, truth = parts_of(name), truth_of(name)
    assert parts.diffuse is None
    assert "metal" in parts.structure
    total = sum((component.albedo for component in parts), np.zeros(3))
    expected = albedo(truth.specular)
    np.testing.assert_allclose(total / total.max(), expected / expected.max(), atol=0.02)


@pytest.mark.parametrize("name", CLOTH)
def test_cloth_has_no_highlight(name: str) -> None:
    assert parts_of(name).labels == ("diffuse",)


@pytest.mark.parametrize("name", [*COATED, "nickel_25", "coloured_highlight"])
def test_albedo_is_the_share_of_light_that_a_component_reflects(name: str) -> None:
    parts, truth = parts_of(name), truth_of(name)
    specular = sum((component.albedo for component in parts if component.label != "diffuse"), np.zeros(3))
    np.testing.assert_allclose(specular, albedo(truth.specular), rtol=0.05)
    if parts.diffuse is not None:
        np.testing.assert_allclose(parts.diffuse.albedo, albedo(truth.diffuse), rtol=0.05, atol=0.002)


@pytest.mark.parametrize("name", [*COATED, *METALS])
def test_a_highlight_below_3_degrees_is_a_spike_and_has_the_half_width_of_its_facets(name: str) -> None:
    """1 / (1 + (tan(theta_half) / alpha)**2)**2 of GGX, and exp(-(tan(theta_half) / alpha)**2) of Beckmann, are 1/2."""
    material, parts = CATALOGUE[name], parts_of(name)
    half_tangent = {"ggx": np.sqrt(np.sqrt(2.0) - 1.0), "beckmann": np.sqrt(np.log(2.0))}[material.distribution]
    expected = np.arctan(present(material.alpha) * half_tangent)
    highlight = present(parts.specular_spike if expected < np.radians(3.0) else parts.specular_lobe)
    assert highlight.half_width == pytest.approx(expected, rel=0.06)


@pytest.mark.parametrize("name", COATED)
def test_a_highlight_grows_towards_grazing_angles_as_the_surface_does(name: str) -> None:
    highlight = parts_of(name)[parts_of(name).labels[0]]
    for theta_diff in np.radians([45.0, 70.0]).tolist():
        grows = highlight.evaluate(0.0, theta_diff)[0] / highlight.evaluate(0.0, 0.0)[0]
        true = height(CATALOGUE[name], theta_diff) / height(CATALOGUE[name])
        assert grows == pytest.approx(true, rel=0.1)
        assert true > 1.1


def test_the_tail_is_2_with_ggx_and_more_where_it_is_shorter() -> None:
    layers: list[Any] = [present(parts_of(name).specular_lobe).layer for name in METALS]
    long, short = layers
    assert long.kappa == pytest.approx(2.0, abs=0.15)
    assert short.kappa > 4.0


def test_a_clear_coat_over_metal_is_a_neutral_spike_on_a_coloured_lobe() -> None:
    parts = parts_of("coat_on_copper")
    assert parts.labels == ("specular_spike", "specular_lobe")
    np.testing.assert_allclose(present(parts.specular_spike).color, 1.0, atol=0.1)
    copper = present(parts.specular_lobe).color
    np.testing.assert_allclose(copper, [1.0, 0.65, 0.54], atol=0.04)  # 0.95, 0.62, 0.51 of the metal


def test_a_car_paint_has_all_three() -> None:
    parts = parts_of("car_paint_blue")
    assert parts.labels == ("specular_spike", "specular_lobe", "diffuse")
    np.testing.assert_allclose(present(parts.specular_spike).color, 1.0, atol=0.1)
    flakes = present(parts.specular_lobe).color
    np.testing.assert_allclose(flakes, [1 / 3, 0.16 / 0.3, 1.0], atol=0.06)


def test_what_an_open_split_is_worth_is_said() -> None:
    """A black dielectric of alpha 0.55, half as wide as a matte surface: its light may as well be diffuse."""
    black = Material((conductor(0.55, color=(0.04, 0.04, 0.04)),))
    assert judged(decomposed(black), Truth.of(black)).inside


def test_the_layers_are_a_model_near_the_fit() -> None:
    parts, truth = parts_of("plastic_orange_25_beckmann"), truth_of("plastic_orange_25_beckmann")
    for (light, eye, weight), specular, diffuse in zip(RULES, truth.specular, truth.diffuse, strict=True):
        error = np.abs(parts.layers.evaluate_directions(light, eye) - specular - diffuse)
        assert (weight @ error).sum() < 0.05 * (weight @ (specular + diffuse)).sum()
