"""What a component says describes it: its surfaces are those of its own values, or are withheld."""

from dataclasses import replace
from typing import cast

import numpy as np
import pytest

import dsbrdf
from dsbrdf.arrays import Array
from dsbrdf.components import (
    LABELS,
    Component,
    DiffuseLayer,
    Layer,
    LayeredModel,
    RetroLayer,
    SheenLayer,
    SpecularLayer,
    TurningLayer,
)
from dsbrdf.components.description import describe
from dsbrdf.components.layer_data import grid_values
from dsbrdf.components.points import Points
from dsbrdf.components.shares import SurfaceSpread
from dsbrdf.components.surfaces import MAX_PEAK_MISFIT, PROFILE, OwnValues, albedo_of
from dsbrdf.model import ReflectanceModel
from tests.support.models import mixture, random_model, surface

GREEN = (0.02, 0.14, 0.08)
GROUND = DiffuseLayer((0.3, 0.25, 0.28), (0.5, 0.0, 0.0, 0.0, 0.0, 0.0))


def decomposed(*layers: Layer) -> dsbrdf.Decomposition:
    return dsbrdf.decompose(cast(dsbrdf.DSBRDF, LayeredModel(layers)))


def test_two_highlights_of_nearly_one_width_are_one_component() -> None:
    """Both sides of 3 degrees, 2.6 and 3.9 degrees; a cut between them would show colours that the material has not."""
    pair = surface((0.10, 0.04, 0.12), 0.07), surface((0.13, 0.08, 0.02), 0.105)
    parts = decomposed(*pair, GROUND)
    assert len(parts) == 2
    lobe, _ = parts
    assert (lobe.label == "specular_spike") == (lobe.half_width is not None and lobe.half_width < np.radians(3.0))
    low, high = np.sort([np.divide(one.f0, one.f0[0]) for one in pair], axis=0)
    peak = lobe.evaluate(0.0, np.radians([0.0, 30.0, 50.0]))
    hue = peak / peak[:, :1]
    assert np.all((0.9 * low < hue) & (hue < 1.1 * high))
    apart = decomposed(surface((0.10, 0.04, 0.12), 0.03), surface((0.13, 0.08, 0.02), 0.12), GROUND)
    assert apart.labels == LABELS


def test_surfaces_of_nearly_one_roughness_are_stated_as_one() -> None:
    """An interference film: no surface has a colour that changes with theta_diff in this way, but two together have."""
    film = SpecularLayer((0.60, 0.02, 0.50), 0.9, 0.15, 2.0, (1.5, -0.5), 0.5, 0.0)
    parts = decomposed(film, replace(film, f0=(0.02, 0.60, 0.02), rise=(-1.5, 1.0)))
    ((found,),) = (part.surfaces for part in parts)
    assert found.alpha == pytest.approx(0.15, rel=0.05)
    assert found.f0_range is not None
    for (low, high), true in zip(found.f0_range, (0.62, 0.62, 0.52), strict=True):
        assert low < true < high


def test_the_range_of_alpha_contains_the_truth_where_two_surfaces_describe_one() -> None:
    for alpha in (0.1, 0.2):
        turn = (1.0, 0.0, -1.0), (0.0, 0.0, 0.0)
        parts = decomposed(TurningLayer((0.7, 0.6, 0.5), 0.95, alpha, 2.0, (0.0, 0.0), 0.5, turn=turn))
        ((first, _),) = (part.surfaces for part in parts)
        assert first.alpha_range is not None
        assert first.alpha_range[0] < alpha < first.alpha_range[1]


class Rings(ReflectanceModel):
    """A mirror highlight 0.29 degrees wide with rings that no layer has."""

    def evaluate_unmasked(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        peak = 400.0 * (1.0 + (theta_half / np.radians(0.45)) ** 2) ** -2.0
        off = np.degrees(theta_half)[:, np.newaxis] - (15.0, 25.0, 40.0)
        rings = np.exp(-((off / 2.0) ** 2)).sum(axis=1, keepdims=True)
        return np.asarray(0.02 + peak[:, np.newaxis] * (0.01, 1.0, 0.7) + 0.05 * rings)


def test_a_mirror_highlight_that_no_layer_has_is_a_spike_and_not_diffuse() -> None:
    parts = dsbrdf.decompose(cast(dsbrdf.DSBRDF, Rings()))
    assert parts.labels == ("specular_spike", "diffuse")
    assert parts["specular_spike"].light_share > 0.6
    assert "diffuse" not in {one.name for one in parts.structures}


def test_a_peak_with_haze_has_two_surfaces() -> None:
    parts = decomposed(surface((0.3, 0.25, 0.1), 0.06), surface((0.5, 0.4, 0.2), 0.25))
    alphas = sorted(found.alpha or 0.0 for part in parts for found in part.surfaces)
    assert alphas[0] == pytest.approx(0.06, rel=0.05)
    assert alphas[-1] == pytest.approx(0.25, rel=0.05)


def test_a_highlight_with_a_faint_ground_below_it_keeps_its_f0() -> None:
    """Of a metallic paint, whose layers without a ground would miss the albedo by 15 %."""
    (lobe,) = dsbrdf.decompose(dsbrdf.load_material("vch_golden_yellow"))
    assert [type(layer) for layer in lobe.layers.layers] == [SpecularLayer, SpecularLayer, DiffuseLayer]
    assert lobe.misfit.albedo < 0.13
    assert lobe.surfaces[0].f0 is not None


def test_layers_of_all_components_are_as_bright_as_the_model() -> None:
    model = LayeredModel((surface(GREEN, 0.05), surface((0.1, 0.1, 0.1), 0.3), GROUND))
    layers = decomposed(*model.layers).layers
    angles = np.radians([0.0, 30.0, 60.0])
    np.testing.assert_allclose(layers.evaluate(0.0, angles), model.evaluate(0.0, angles), rtol=0.05)
    np.testing.assert_allclose(layers.albedo(angles), model.albedo(angles), rtol=0.05)


def test_a_coat_stays_white_over_a_lobe_that_no_layer_describes() -> None:
    """Light that passes a coloured film twice changes its colour with the angle, which no layer's reflectance does."""
    coat, gold = surface((0.04,) * 3, 0.04), surface((0.95, 0.72, 0.30), 0.15)

    class Coated(Rings):
        def evaluate_unmasked(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
            angles, points = (theta_half, theta_diff, phi_diff), Points.at(theta_half, theta_diff, phi_diff)
            path = np.sum(1.0 / points.cosines, axis=0)
            film = np.exp(-path[:, np.newaxis] * (0.02, 0.4, 0.5))
            below = film * LayeredModel((gold,)).evaluate_unmasked(*angles)
            return np.asarray(coat.linearize(points, coat.unknowns).values.T + below)

    spike = dsbrdf.decompose(cast(dsbrdf.DSBRDF, Coated()))["specular_spike"]
    np.testing.assert_allclose(spike.color, 1.0, atol=0.4)


@pytest.mark.parametrize(
    ("layer", "code"),
    [(SheenLayer((0.5,) * 3, (1.0, 1.0)), "sheen"), (RetroLayer((0.3,) * 3, 0.1), "retro-reflection")],
)
def test_sheen_and_retro_reflection_are_told(layer: Layer, code: str) -> None:
    found = {one.code: one.numbers for one in decomposed(layer, GROUND).findings}
    assert found.keys() & {"sheen", "retro-reflection"} == {code}
    light = [LayeredModel(layers).albedo(0.0).sum() for layers in ((layer,), (layer, GROUND))]
    assert found[code]["fraction"] == pytest.approx(light[0] / light[1], rel=0.2)


def test_the_spread_over_probable_layers_widens_the_ranges() -> None:
    model = LayeredModel((surface(GREEN, 0.12),))
    own = OwnValues(grid_values(model.evaluate_unmasked), model.evaluate_unmasked(*PROFILE).T, albedo_of(model))
    spreads = SurfaceSpread(0.0, np.zeros(3), np.zeros(3)), SurfaceSpread(0.3, np.full(3, 0.2), np.full(3, 0.1))
    (narrow,), (wide,) = (describe(own, spread, is_diffuse=False).surfaces for spread in spreads)
    for name, deviation in (("alpha", 0.3), ("f0", 0.2), ("f70", 0.1)):
        values, ranges = ([np.ravel(getattr(one, name + end)) for one in (narrow, wide)] for end in ("", "_range"))
        before, after = (np.log(found[1] / value[0]) for value, found in zip(values, ranges, strict=True))
        assert after**2 - before**2 == pytest.approx((1.645 * deviation) ** 2, rel=1e-3)


def test_a_lobe_below_a_spike_has_no_dent() -> None:
    parts = decomposed(surface((0.04,) * 3, 0.02), surface((0.3, 0.2, 0.1), 0.2), GROUND)
    lobe = parts["specular_lobe"].evaluate(np.radians(np.linspace(0.0, 4.0, 30)), 0.0)
    assert np.all(np.diff(lobe, axis=0) < 1e-3 * lobe[0])


def test_a_spike_ends_where_its_highlight_does() -> None:
    """A lobe of 1.5 degrees lies on one of 8 degrees, neither of which has the form of a layer."""
    parts = dsbrdf.decompose(mixture(3, 2))
    angles = np.radians([10.0, 12.0, 15.0])
    spike, lobe = (parts[f"specular_{name}"].evaluate(angles, 0.0).sum(axis=1) for name in ("spike", "lobe"))
    assert np.all(spike < 0.03 * (spike + lobe))


def misfit_of(part: Component) -> tuple[float, float]:
    """Peak and albedo of a component's layers over its own, less 1, as the misfit defines them."""
    angles = np.radians([0.0, 15.0, 30.0, 45.0])
    own, layers = (one.evaluate(0.0, angles).sum() for one in (part, part.layers))
    albedos = [part.directional_albedo(np.radians([0.0, 45.0])), part.layers.albedo(np.radians([0.0, 45.0]))]
    off = np.abs(albedos[1] - albedos[0]).max() / albedos[0].max()
    return max(own / layers, layers / own) - 1.0, float(off)


def test_parameters_that_do_not_describe_are_withheld_with_a_sentence() -> None:
    withheld = 0
    for seed in range(4):
        for part in dsbrdf.decompose(random_model(seed, 3)):
            if part.misfit.peak is None or not part.surfaces:
                continue
            peak, albedo = misfit_of(part)
            assert part.misfit.peak == pytest.approx(peak, rel=0.02, abs=0.005)
            assert part.misfit.albedo == pytest.approx(albedo, rel=0.05, abs=0.005)
            is_withheld = part.surfaces[0].f0 is None
            assert is_withheld or part.misfit.peak <= MAX_PEAK_MISFIT
            assert any("F0" in sentence for sentence in part.remarks) == is_withheld
            withheld += is_withheld
    assert withheld > 0


def test_a_black_channel_has_finite_ranges() -> None:
    """Nothing determines the blue F0; a standard deviation of its logarithm in the thousands must not overflow."""
    plain = mixture(3, 1)
    amplitude = plain.amplitude * np.array([1.0, 1.0, 1e-300])[:, np.newaxis, np.newaxis]
    shape = (plain.kappa, plain.gamma, plain.center, plain.elongation)
    model = dsbrdf.DSBRDF(plain.theta_diff, amplitude, *shape, delta=plain.delta)
    surfaces = [one for part in dsbrdf.decompose(model) for one in part.surfaces]
    assert surfaces
    for one in surfaces:
        assert one.f0_range is None or np.all(np.isfinite(one.f0_range))
