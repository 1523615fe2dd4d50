"""The truth itself: formulas against Mitsuba and closed forms, and what is said of components that are known."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.foreign_catalogue import CATALOGUE, burley_diffuse
from benchmarks.judgement import RULES, Truth, judged
from benchmarks.truth import drawn, load_truth, save_truth
from dsbrdf.arrays import Array
from dsbrdf.data import spherical
from tests.support.foreign_materials import Material, dielectric_transmittance, lambert, oren_nayar, principled_diffuse

OCHRE = (0.6, 0.4, 0.2)
EACH_FORMULA = (
    "ashikhmin_shirley_25", "burley_smooth_under_coat", "car_paint_champagne", "charlie_sheen", "coat_on_oren_nayar",
    "molybdenum_45", "nickel_in_rust", "oren_nayar_50", "plastic_brown_15_mixed", "principled_clearcoat",
    "principled_sheen", "ward_duer_25_metal",
)  # fmt: skip
AIR = 1.000277  # refractive index around a dielectric in Mitsuba


@pytest.fixture
def pairs() -> tuple[Array, Array]:
    random = np.random.default_rng(0)
    theta, phi = np.radians(random.uniform(0.0, 80.0, (2, 300))), random.uniform(0.0, 2.0 * np.pi, (2, 300))
    first, second = spherical(theta, phi)
    return first, second


@pytest.mark.parametrize("name", EACH_FORMULA)
def test_a_material_is_reciprocal_and_reflects_no_more_than_all_light(name: str, pairs: tuple[Array, Array]) -> None:
    material, (light, eye) = CATALOGUE[name], pairs
    for values in (material.specular_values, material.diffuse_values):
        np.testing.assert_allclose(values(light, eye), values(eye, light), rtol=2e-3, atol=2e-6)
    truth = Truth.of(material)
    for (_, _, weight), specular, diffuse in zip(RULES, truth.specular, truth.diffuse, strict=True):
        assert min(specular.min(), diffuse.min()) >= 0.0
        assert (weight @ (specular + diffuse)).max() < 1.01


def test_formulas_that_others_have_too(pairs: tuple[Array, Array]) -> None:
    matte = lambert(OCHRE)(*pairs)
    np.testing.assert_allclose(matte, np.broadcast_to(np.array(OCHRE) / np.pi, matte.shape), rtol=1e-6)
    np.testing.assert_allclose(oren_nayar(0.0, OCHRE)(*pairs), matte, rtol=1e-6)
    np.testing.assert_allclose(burley_diffuse(0.4, OCHRE)(*pairs), principled_diffuse(OCHRE, 0.4)(*pairs), rtol=1e-3)


def test_reflectance_at_the_normal_is_that_of_the_refractive_index() -> None:
    for name, ior in (("plastic_green_03", 1.5), ("plastic_orange_25_beckmann", 1.55), ("plastic_brown_15_mixed", 1.7)):
        expected = ((ior - AIR) / (ior + AIR)) ** 2
        assert CATALOGUE[name].f0 == pytest.approx([expected] * 3, rel=1e-5)
    assert CATALOGUE["coat_on_copper"].f0 is None


def test_reflectance_at_70_degrees_is_that_of_the_refractive_index() -> None:
    for name, ior in (("plastic_green_03", 1.5), ("plastic_orange_25_beckmann", 1.55), ("plastic_brown_15_mixed", 1.7)):
        expected = 1.0 - dielectric_transmittance(np.cos(np.radians([[70.0]])), ior / AIR)[0, 0, 0]
        assert CATALOGUE[name].f70 == pytest.approx([expected] * 3, rel=1e-3)
    assert CATALOGUE["coat_on_copper"].f70 is None


def test_a_seed_draws_the_same_materials_and_more_of_them_follow() -> None:
    few, many, others = drawn(7, 3), drawn(12, 3), drawn(7, 4)
    assert list(few) == list(many)[:7]
    assert [material.alpha for material in few.values()] == [many[name].alpha for name in few]
    assert [material.alpha for material in few.values()] != [material.alpha for material in others.values()]


class KnownParts(list[Any]):
    """A decomposition that reflects a share of the diffuse light and states a range and a surface."""

    structure = "known"
    remarks = ("The measurement does not determine how much of the light is diffuse: it may be 0% to 90%.",)

    def __init__(self, material: Material, share: float, stated: tuple[float, float], alpha: float) -> None:
        assert material.f0 is not None
        f0 = tuple(np.array([1.1, 1.0, 0.95]) * material.f0)
        f70 = None if material.f70 is None else tuple(1.05 * material.f70)
        surface = SimpleNamespace(
            alpha=alpha,
            alpha_range=(0.9 * alpha, alpha),
            f0=f0,
            f0_range=[(0.96 * one, 1.04 * one) for one in f0],
            f70=f70,
            f70_range=[(0.95 * one, 1.05 * one) for one in f70 or ()],
        )
        self.diffuse = SimpleNamespace(
            light_share=0.9,
            surfaces=(),
            evaluate_directions=lambda light, eye: share * material.diffuse_values(light, eye),
        )
        self.diffuse_range = stated
        super().__init__([self.diffuse, SimpleNamespace(light_share=0.1, surfaces=(surface,))])


def test_what_is_wrong_is_found(tmp_path: Path) -> None:
    material = CATALOGUE["plastic_green_03"]
    save_truth(Truth.of(material), tmp_path / "truth.npz")
    truth = load_truth(tmp_path / "truth.npz")
    share = truth.diffuse_share
    for kept, stated, alpha, inside in ((1.0, (share, share), 0.03, True), (0.9, (0.0, 0.9 * share), 0.04, False)):
        parts = KnownParts(material, kept, stated, alpha)
        found = judged(parts, truth)  # type: ignore[arg-type]
        assert found.moved[0] == pytest.approx((1.0 - kept) * share, rel=1e-6)
        assert (found.inside, found.is_warned) == (inside, True)
        assert found.surface is not None
        assert [found.share, found.surface.alpha, found.surface.f0, found.surface.f70] == pytest.approx(
            [kept * share, alpha / 0.03 - 1.0, 0.1, 0.05]
        )
        assert (found.surface.alpha_inside, found.surface.f0_inside, found.surface.f70_inside) == (inside, False, True)


def test_a_missing_surface_is_an_error_of_all_of_it() -> None:
    material = CATALOGUE["nickel_25"]
    parts = KnownParts(material, 0.0, (0.0, 0.0), 0.25)
    parts[:] = [SimpleNamespace(light_share=1.0, surfaces=())]
    found = judged(parts, Truth.of(material)).surface  # type: ignore[arg-type]
    assert found is not None
    assert (found.alpha, found.f0, found.alpha_inside, found.f0_inside) == (1.0, 1.0, False, False)
