"""What docs/components.md says of real surfaces, on materials of others whose specular and diffuse light is known.

Their own values are decomposed: that a fit has them is asked of fits.
"""

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
from dsbrdf.model import ReflectanceModel, directional_albedo
from tests.support.foreign_materials import (
    CATALOGUE,
    Color,
    Material,
    Part,
    charlie_sheen,
    conductor,
    dielectric_coat,
    lambert,
    plastic,
    plastic_material,
    under_coat,
)

pytestmark = pytest.mark.slow

WHITE = (0.95, 0.95, 0.95)
GOLD = (0.95, 0.72, 0.30)
ANGLES = np.radians([0.0, 40.0, 70.0])
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
class Light(ReflectanceModel):
    parts: tuple[Part, ...]

    def evaluate_unmasked(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        pair = np.clip(directions(theta_half, theta_diff, phi_diff), -1.0, 1.0)  # formulas take roots of 1 - cosine
        above, values = pair[..., 2].min(axis=0) > 1e-6, np.zeros((theta_half.size, 3))
        for part in self.parts:
            values[above] += part(*pair[:, above])
        return values


@dataclass(frozen=True)
class Split:
    """Components, the light on the wrong side as a fraction of all, and whether their range holds the diffuse share."""

    parts: Decomposition
    moved: float
    is_inside: bool

    @classmethod
    def of(cls, material: Material) -> "Split":
        diffuse, whole = Light(material.diffuse), Light((*material.specular, *material.diffuse))
        parts = dsbrdf.decompose(cast(dsbrdf.DSBRDF, whole))

        def wrong(*angles: Array) -> Array:
            found = 0.0 if parts.diffuse is None else parts.diffuse.evaluate_unmasked(*angles)
            return np.asarray(np.abs(found - diffuse.evaluate_unmasked(*angles)))

        functions = wrong, diffuse.evaluate_unmasked, whole.evaluate_unmasked
        moved, true, every = (directional_albedo(one, ANGLES).sum(axis=1) for one in functions)
        (low, high), share = parts.diffuse_range, true[0] / every[0]
        return cls(parts, float(np.mean(moved / every)), bool(low - 1e-3 <= share <= high + 1e-3))


@cache
def known(name: str) -> Split:
    return Split.of(CATALOGUE[name])


@pytest.mark.parametrize("name", COMPONENTS)
def test_light_is_on_its_own_side_and_the_share_within_its_range(name: str) -> None:
    found = known(name)
    assert found.parts.labels == COMPONENTS[name]
    assert found.moved < 0.03
    assert found.is_inside


@pytest.mark.parametrize("name", [*IN_RANGE, "silver_15_beckmann", "coloured_highlight"])
def test_roughness_and_reflectance_of_a_layer_come_out_as_they_were_put_in(name: str) -> None:
    material, component = CATALOGUE[name], next(iter(known(name).parts))
    (surface,), f0, f70 = component.surfaces, material.f0, material.f70
    assert surface.alpha == pytest.approx(material.alpha, rel=0.03)
    assert surface.f0 == pytest.approx(f0, rel=0.10)
    assert surface.f70 == pytest.approx(f70, rel=0.10)
    np.testing.assert_allclose(component.color, f0 / np.max(f0), atol=0.06)  # type: ignore[operator, arg-type]
    for (low, high), true in zip(surface.f70_range or (), f70, strict=True):  # type: ignore[arg-type]
        assert low <= true <= high
    assert surface.f0_range is not None
    assert surface.alpha_range is not None
    true = np.append(f0, material.alpha)  # type: ignore[arg-type]
    low, high = np.vstack([*surface.f0_range, surface.alpha_range]).T
    assert np.all((low <= true) & (true <= high)) or name not in IN_RANGE
    assert surface.tail_exponent is not None  # 2 is the tail of GGX, more a shorter one
    is_ggx = abs(surface.tail_exponent - 2.0) < 0.15
    assert is_ggx if material.distribution == "ggx" else surface.tail_exponent > 4.0


@pytest.mark.parametrize(
    ("name", "label", "color"),
    [
        ("coat_on_copper", SPIKE, (1.0, 1.0, 1.0)),
        ("coat_on_copper", LOBE, (1.0, 0.65, 0.54)),  # 0.95, 0.62, 0.51 of the metal
        ("car_paint_blue", SPIKE, (1.0, 1.0, 1.0)),
        ("car_paint_blue", LOBE, (1 / 3, 0.16 / 0.3, 1.0)),
    ],
)
def test_metal_and_flakes_colour_highlights_and_coats_none(name: str, label: str, color: Color) -> None:
    np.testing.assert_allclose(known(name).parts[label].color, color, atol=0.1 if label == SPIKE else 0.04)


LOOK_DIFFUSE = {
    "black dielectric": lambda: Material((conductor(0.55, color=(0.04, 0.04, 0.04)),)),
    "white metal": lambda: Material((conductor(0.8, color=WHITE),)),
    "gold": lambda: Material((conductor(0.75, color=GOLD),)),
    "plastic": lambda: plastic_material(0.8, (0.3, 0.1, 0.05)),
}


@pytest.mark.parametrize("name", LOOK_DIFFUSE)
def test_it_is_said_that_nobody_can_part_very_rough_surfaces_and_diffuse_layers(name: str) -> None:
    found = Split.of(LOOK_DIFFUSE[name]())
    assert found.is_inside
    is_said = any("does not determine how much of the light is diffuse" in remark for remark in found.parts.remarks)
    assert is_said or found.moved < 0.01


def test_two_coloured_highlights_over_grey_are_not_a_metal() -> None:
    first, second = conductor(0.15, color=(0.2, 0.05, 0.12)), conductor(0.4, color=(0.08, 0.15, 0.2))
    assert Split.of(Material((first, second), (lambert((0.06, 0.06, 0.06)),))).moved < 0.03


def dim(part: Part, factor: Color) -> Part:
    return lambda i, o: np.array(factor) * part(i, o)


def back_to_the_light(part: Part) -> Part:
    return lambda i, o: part(i, o * [-1.0, -1.0, 1.0])


def dyed(part: Part) -> Part:
    """A part under a film that absorbs light on its way in and out."""
    return lambda i, o: part(i, o) * np.exp(np.array((-0.05, -0.5, -0.6)) * (1.0 / i[:, 2:] + 1.0 / o[:, 2:]))


FINE, COARSE = (conductor(alpha, color=(0.15, 0.15, 0.16)) for alpha in (0.12, 0.4))
SCATTERED = {
    "between facets of a metal": Material((conductor(0.4, color=GOLD), dim(lambert(GOLD), (0.19, 0.14, 0.06)))),
    "by two roughnesses": Material(tuple(dim(conductor(alpha, color=GOLD), (0.5,) * 3) for alpha in (0.05, 0.25))),
    "by fibres beside a highlight": Material(
        plastic(0.15, (0.3, 0.05, 0.08))[:1],
        (plastic(0.15, (0.3, 0.05, 0.08))[1], charlie_sheen(0.3, (0.3, 0.25, 0.25))),
    ),
    "by flakes of two scales": Material(
        (dielectric_coat(0.01), under_coat(FINE), under_coat(COARSE)), (under_coat(lambert((0.02, 0.02, 0.02))),)
    ),
    "back to its source": Material(
        (plastic(0.1, (0.4, 0.4, 0.4))[0], back_to_the_light(conductor(0.1, color=(0.15, 0.15, 0.15)))),
        plastic(0.1, (0.4, 0.4, 0.4))[1:],
    ),
    "through a film": Material((dielectric_coat(0.15, 1.65), under_coat(dyed(conductor(0.15, "Al")), 1.65))),
}


@pytest.mark.parametrize("way", SCATTERED)
def test_light_that_a_material_scatters_several_ways_is_on_its_own_side(way: str) -> None:
    found = Split.of(SCATTERED[way])
    assert found.moved < 0.03
    assert found.is_inside
