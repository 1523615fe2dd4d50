"""Components sum to the model, and a lobe gets its label from its width and nothing else."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.decomposition import (
    DIFFUSE_HALF_WIDTH,
    LABELS,
    SPIKE_HALF_WIDTH,
    Component,
    Decomposition,
    decompose,
    lobe_extents,
    lobe_widths,
)
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.hemi_epd import energy, half_width

Array = NDArray[np.float64]

KNOTS = np.radians([0.0, 30.0, 60.0, 85.0])


def model_of(lobes: list[tuple[float, float, float]], delta: float = 0.0, **changed: Any) -> DSBRDF:
    """Lobes (kappa, gamma, center), the same in all channels and at all knots."""
    kappa, gamma, center = (np.tile(part, (3, 4, 1)) for part in np.reshape(lobes, (-1, 3)).T)
    fields: dict[str, Any] = {"kappa": kappa, "gamma": gamma, "center": center} | changed
    return DSBRDF(KNOTS, **fields, delta=np.full((3, 4), delta))


def gamma_of(width: float, kappa: float) -> float:
    """Shape of the lobe about the normal with this half width [rad]."""
    return float(np.log(np.log1p(np.expm1(kappa) / 2.0) / kappa) / np.log(np.cos(width)))


def lobe_of(degrees: float, kappa: float = 1.0) -> tuple[float, float, float]:
    return kappa, gamma_of(float(np.radians(degrees)), kappa), 0.0


def random_model(seed: int, n_lobes: int, interpolation: str = "linear") -> DSBRDF:
    generator = np.random.default_rng(seed)
    shape = (3, 4, n_lobes)
    return DSBRDF(
        KNOTS,
        generator.uniform(0.01, 8.0, shape),
        np.exp(generator.uniform(-2.0, 11.0, n_lobes) + generator.normal(0.0, 0.3, shape)),
        generator.uniform(0.0, 1.5, shape) * (generator.uniform(size=n_lobes) < 0.3),
        generator.uniform(-0.01, 5.0, shape[:2]),
        interpolation,
    )


@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
@pytest.mark.parametrize("n_lobes", [0, 1, 3, 8])
def test_components_sum_to_the_model(n_lobes: int, interpolation: str) -> None:
    generator = np.random.default_rng(n_lobes)
    theta_half = np.concatenate([generator.uniform(0.0, np.pi / 2, 500), np.radians([0.0, 0.5, 1.0])])
    theta_diff = generator.uniform(0.0, np.pi / 2, 503)
    for seed in range(5):
        model = random_model(seed, n_lobes, interpolation)
        whole = model.evaluate(theta_half, theta_diff)
        total = sum(component.evaluate(theta_half, theta_diff) for component in decompose(model))
        assert np.abs(total - whole).max() <= 1e-12 * max(1.0, float(np.abs(whole).max()))
        np.testing.assert_allclose(total, whole, rtol=1e-12, atol=1e-14)


def test_every_lobe_is_in_exactly_one_component() -> None:
    for seed in range(10):
        lobes = [k for component in decompose(random_model(seed, 6)) for k in component.lobes]
        assert sorted(lobes) == list(range(6))


def test_lobes_are_labelled_by_their_half_width() -> None:
    parts = decompose(model_of([lobe_of(0.5), lobe_of(2.9), lobe_of(3.1), lobe_of(24.5), lobe_of(25.5), lobe_of(60.0)]))
    assert parts.specular_spike.lobes == (0, 1)
    assert parts.specular_lobe.lobes == (2, 3)
    assert parts.diffuse.lobes == (4, 5)


def test_order_and_height_of_the_lobes_do_not_matter() -> None:
    parts = decompose(model_of([lobe_of(60.0, 6.0), lobe_of(1.0, 0.01), lobe_of(10.0, 0.1)]))
    assert [component.lobes for component in parts] == [(1,), (2,), (0,)]


def test_flat_lobe_is_diffuse() -> None:
    assert decompose(model_of([(0.3, 0.0, 0.0)])).diffuse.lobes == (0,)


def test_ring_lobe_is_as_wide_as_its_center_is_far() -> None:
    narrow = gamma_of(float(np.radians(2.0)), 1.0)
    parts = decompose(model_of([(1.0, narrow, float(np.radians(c))) for c in (0.5, 10.0, 80.0)]))
    assert [component.lobes for component in parts] == [(0,), (1,), (2,)]
    assert parts.diffuse.half_width == pytest.approx(np.radians(82.0), rel=1e-9)


def test_thresholds_can_be_chosen() -> None:
    model = model_of([lobe_of(2.0), lobe_of(10.0), lobe_of(40.0)])
    strict = decompose(model, spike_half_width=float(np.radians(1.0)), diffuse_half_width=float(np.radians(5.0)))
    assert [component.lobes for component in strict] == [(), (0,), (1, 2)]
    wide = decompose(model, spike_half_width=float(np.radians(50.0)), diffuse_half_width=float(np.pi / 2))
    assert [component.lobes for component in wide] == [(0, 1, 2), (), ()]


@pytest.mark.parametrize("thresholds", [(0.0, 0.5), (0.5, 0.5), (0.6, 0.5), (0.1, 1.6), (np.nan, 0.5), (0.1, np.nan)])
def test_impossible_thresholds_are_refused(thresholds: tuple[float, float]) -> None:
    with pytest.raises(InvalidArgumentError, match="0 < spike_half_width < diffuse_half_width <= pi/2"):
        decompose(model_of([lobe_of(2.0)]), spike_half_width=thresholds[0], diffuse_half_width=thresholds[1])


def test_label_holds_for_all_channels_and_knots_by_power() -> None:
    # A lobe that is narrow where it is strong and wide in one channel where it hardly exists stays in one component.
    kappa, gamma = np.full((3, 4, 1), 3.0), np.full((3, 4, 1), gamma_of(float(np.radians(1.0)), 3.0))
    kappa[2], gamma[2] = 1e-6, gamma_of(float(np.radians(50.0)), 1e-6)
    parts = decompose(model_of([lobe_of(1.0)], kappa=kappa, gamma=gamma))
    assert parts.specular_spike.lobes == (0,)
    assert parts.specular_spike.half_width == pytest.approx(np.radians(1.0), rel=1e-9)
    # With the power the other way round it is the wide channel that speaks.
    kappa[:2], kappa[2], gamma[2] = 1e-6, 3.0, gamma_of(float(np.radians(50.0)), 3.0)
    assert decompose(model_of([lobe_of(1.0)], kappa=kappa, gamma=gamma)).diffuse.lobes == (0,)


def test_power_of_the_narrowest_lobes_counts() -> None:
    # Half of a hundredth of a degree: no grid of angles sees it, its energy does.
    widths = np.radians([0.005, 0.005, 0.005, 0.02])
    gamma = np.tile([[gamma_of(float(width), 6.0)] for width in widths], (3, 1, 1))
    kappa = np.full((3, 4, 1), 6.0)
    kappa[:, 3] = 12.0
    model = model_of([lobe_of(1.0)], kappa=kappa, gamma=gamma)
    extent, power = lobe_extents(model)
    np.testing.assert_allclose(power, energy(kappa, gamma), rtol=1e-12)
    np.testing.assert_allclose(extent, half_width(kappa, gamma), rtol=1e-12)
    # Nearly all power is at the last knot, but it stands for a quarter of the range only.
    assert lobe_widths(model)[0][0] == pytest.approx(float(half_width(6.0, gamma[0, 0, 0])), rel=1e-9)


def test_delta_belongs_to_the_spike_also_without_a_narrow_lobe() -> None:
    parts = decompose(model_of([lobe_of(60.0)], delta=4.0))
    assert parts.specular_spike.lobes == ()
    np.testing.assert_allclose(parts.specular_spike.evaluate(0.0, 0.3), 4.0)
    assert np.all(parts.specular_spike.evaluate(0.1, 0.3) == 0.0)
    assert np.all(parts.diffuse.delta == 0.0)
    assert np.all(parts.specular_lobe.delta == 0.0)
    # A cone of one degree about the normal: f pi sin(2 degrees)**2 at normal incidence.
    expected = 4.0 * np.pi * np.sin(np.radians(2.0)) ** 2
    np.testing.assert_allclose(parts.specular_spike.albedo, expected, rtol=1e-9)


def test_components_report_albedo_half_width_and_margin() -> None:
    model = model_of([lobe_of(1.0), lobe_of(12.0), lobe_of(50.0), lobe_of(60.0, 0.1)])
    parts = decompose(model)
    for component in parts:
        np.testing.assert_allclose(component.albedo, component.directional_albedo(0.0), rtol=1e-12)
        assert component.albedo.shape == (3,)
    np.testing.assert_allclose(sum(component.albedo for component in parts), model.directional_albedo(0.0), rtol=1e-6)
    assert parts.specular_spike.half_width == pytest.approx(np.radians(1.0), rel=1e-9)
    assert parts.specular_lobe.half_width == pytest.approx(np.radians(12.0), rel=1e-9)
    assert parts.diffuse.half_width == pytest.approx(np.radians(50.0), rel=1e-9)  # the stronger of the two
    assert parts.specular_spike.margin == pytest.approx(np.log2(3.0), rel=1e-9)  # a third of the threshold
    assert parts.specular_lobe.margin == pytest.approx(np.log2(25.0 / 12.0), rel=1e-9)  # the nearer threshold
    assert parts.diffuse.margin == pytest.approx(1.0, rel=1e-9)  # twice the threshold
    assert (SPIKE_HALF_WIDTH, DIFFUSE_HALF_WIDTH) == pytest.approx((np.radians(3.0), np.radians(25.0)))


def test_empty_components_are_dark() -> None:
    parts = decompose(model_of([lobe_of(50.0)]))
    for component in (parts.specular_spike, parts.specular_lobe):
        assert (component.half_width, component.margin, component.n_lobes) == (None, None, 0)
        assert component.albedo.tolist() == [0.0, 0.0, 0.0]
        assert np.all(component.evaluate([0.0, 0.5], 0.2) == 0.0)


def test_components_are_looked_up_by_label_and_iterated_in_order() -> None:
    parts = decompose(model_of([lobe_of(50.0)]))
    assert isinstance(parts, Decomposition)
    assert [component.label for component in parts] == list(LABELS) == ["specular_spike", "specular_lobe", "diffuse"]
    for label in LABELS:
        assert parts[label] is getattr(parts, label)
        assert isinstance(parts[label], Component)
    with pytest.raises(
        InvalidArgumentError, match="label must be one of specular_spike, specular_lobe, diffuse, not 'gloss'"
    ):
        parts["gloss"]
