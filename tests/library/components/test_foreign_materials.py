"""What docs/components.md says of real surfaces, on materials of others whose specular and diffuse light is known.

Their own values are decomposed: that a fit has them is asked of fits.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import cast

import numpy as np
import pytest

import dsbrdf
from dsbrdf import Decomposition
from dsbrdf.arrays import Array
from dsbrdf.components import LABELS
from dsbrdf.data import directions
from dsbrdf.model import ReflectanceModel
from tests.support.foreign_bsdfs import conductor, lambert
from tests.support.foreign_kinds import KINDS, compensation
from tests.support.foreign_materials import CATALOGUE, Material, plastic_material
from tests.support.foreign_truth import Judgement, Truth, judged

pytestmark = pytest.mark.slow

SPIKE, LOBE, DIFFUSE = LABELS
COMPONENTS = {
    "plastic_green_03": (SPIKE, DIFFUSE),
    "plastic_orange_25_beckmann": (LOBE, DIFFUSE),
    "plastic_white_50": (LOBE, DIFFUSE),
    "coloured_highlight": (LOBE, DIFFUSE),
    "principled_quarter_metal": (LOBE, DIFFUSE),
    "nickel_25": (LOBE,),
    "silver_15_beckmann": (LOBE,),
    "coat_on_copper": (SPIKE, LOBE),
    "car_paint_blue": (SPIKE, LOBE, DIFFUSE),
    "charlie_sheen": (DIFFUSE,),
    "oren_nayar_25": (DIFFUSE,),
}
IN_RANGE = ("plastic_green_03", "plastic_orange_25_beckmann", "nickel_25", "principled_quarter_metal")


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


def decomposed(material: Material) -> Decomposition:
    return dsbrdf.decompose(cast(dsbrdf.DSBRDF, Exact(material)))


@cache
def known(name: str) -> tuple[Decomposition, Judgement]:
    """The components of a material of the catalogue, and what is wrong with them."""
    parts = decomposed(CATALOGUE[name])
    return parts, judged(parts, Truth.of(CATALOGUE[name]))


@pytest.mark.parametrize("name", COMPONENTS)
def test_light_is_on_its_own_side_and_the_share_within_its_range(name: str) -> None:
    parts, found = known(name)
    assert parts.labels == COMPONENTS[name]
    assert found.moved.mean() < 0.03
    assert found.inside


@pytest.mark.parametrize("name", [*IN_RANGE, "silver_15_beckmann", "coloured_highlight"])
def test_roughness_and_reflectance_of_a_layer_come_out_as_they_were_put_in(name: str) -> None:
    parts, found = known(name)
    assert found.surface is not None
    assert found.surface.alpha == pytest.approx(0.0, abs=0.03)
    assert found.surface.f0 == pytest.approx(0.0, abs=0.10)
    material, component = CATALOGUE[name], parts[parts.labels[0]]
    assert found.surface.f70_inside
    assert found.surface.f70 == pytest.approx(0.0, abs=0.10)
    assert material.f0 is not None
    np.testing.assert_allclose(component.color, material.f0 / material.f0.max(), atol=0.06)
    surface = component.surfaces[0]
    assert surface.alpha_range is not None
    assert surface.f0_range is not None
    low, high = np.vstack([*surface.f0_range, surface.alpha_range]).T
    true = [*material.f0, material.alpha]
    assert np.all((low <= true) & (true <= high)) or name not in IN_RANGE
    assert surface.tail_exponent is not None  # 2 is the tail of GGX, more a shorter one
    assert (
        surface.tail_exponent > 4.0 if material.distribution == "beckmann" else abs(surface.tail_exponent - 2.0) < 0.15
    )


@pytest.mark.parametrize(
    ("name", "label", "color"),
    [
        ("coat_on_copper", SPIKE, (1.0, 1.0, 1.0)),
        ("coat_on_copper", LOBE, (1.0, 0.65, 0.54)),  # 0.95, 0.62, 0.51 of the metal
        ("car_paint_blue", SPIKE, (1.0, 1.0, 1.0)),
        ("car_paint_blue", LOBE, (1 / 3, 0.16 / 0.3, 1.0)),
    ],
)
def test_metal_and_flakes_colour_their_highlight_and_a_coat_none(
    name: str, label: str, color: tuple[float, float, float]
) -> None:
    np.testing.assert_allclose(known(name)[0][label].color, color, atol=0.1 if label == SPIKE else 0.04)


WHITE = (0.95, 0.95, 0.95)
GOLD = (0.95, 0.72, 0.30)
LOOK_DIFFUSE = {
    "black dielectric": lambda: Material((conductor(0.55, color=(0.04, 0.04, 0.04)),)),
    "white metal": lambda: Material((conductor(0.8, color=WHITE), compensation(0.8, WHITE))),
    "gold": lambda: Material((conductor(0.75, color=GOLD), compensation(0.75, GOLD))),
    "plastic": lambda: plastic_material(0.8, (0.3, 0.1, 0.05)),
}


@pytest.mark.parametrize("name", LOOK_DIFFUSE)
def test_it_is_said_that_nobody_can_part_very_rough_surfaces_and_diffuse_layers(name: str) -> None:
    material = LOOK_DIFFUSE[name]()
    found = judged(decomposed(material), Truth.of(material))
    assert found.inside
    assert found.is_warned or found.moved.mean() < 0.01


def test_two_coloured_highlights_over_grey_are_not_a_metal() -> None:
    first, second = conductor(0.15, color=(0.2, 0.05, 0.12)), conductor(0.4, color=(0.08, 0.15, 0.2))
    material = Material((first, second), (lambert((0.06, 0.06, 0.06)),))
    assert judged(decomposed(material), Truth.of(material)).moved.mean() < 0.03


@pytest.mark.parametrize("kind", KINDS)
def test_light_that_a_material_scatters_several_ways_is_on_its_own_side(kind: str) -> None:
    material = KINDS[kind]()
    found = judged(decomposed(material), Truth.of(material))
    assert found.moved.mean() < 0.03
    assert found.inside
