"""Components sum to the model, and a lobe gets its label from how far it reaches and what reaches as far."""

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
    lobe_reaches,
    lobe_widths,
    weighted_median,
)
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.hemi_epd import energy
from dsbrdf.model.lobes import FAMILIES

Array = NDArray[np.float64]

KNOTS = np.radians([0.0, 30.0, 60.0, 85.0])


def gamma_of(degrees: float, kappa: float = 1.0, family: str = "hemi_epd") -> float:
    """Shape of the lobe about the normal that falls to a half at this angle."""
    if family == "student":
        return float((0.5 ** (-1.0 / kappa) - 1.0) / np.tan(np.radians(degrees)) ** 2)
    return float(np.log(np.log1p(np.expm1(kappa) / 2.0) / kappa) / np.log(np.cos(np.radians(degrees))))


def model_of(
    degrees: list[float], centers: list[float] | None = None, family: str = "hemi_epd", **changed: Any
) -> DSBRDF:
    """Lobes of these half widths and centers [degrees], the same at every theta_diff, all equally high."""
    k = len(degrees)
    gamma = np.array([gamma_of(width, family=family) for width in degrees]).reshape(1, 1, k)
    fields: dict[str, Any] = {
        "amplitude": np.ones((3, 4, k)),
        "kappa": np.ones((1, 4, k)),
        "gamma": np.tile(gamma, (1, 4, 1)),
        "center": np.tile(np.radians(centers or [0.0] * k), (1, 4, 1)),
        "interpolation": "linear",
        "lobe": family,
    }
    return DSBRDF(KNOTS, **(fields | changed))


def random_model(seed: int, n_lobes: int, family: str = "hemi_epd") -> DSBRDF:
    random = np.random.default_rng(seed)
    shape = (1, 6, n_lobes)
    return DSBRDF(
        KNOTS,
        np.exp(random.uniform(-4.0, 5.0, (3, 6, n_lobes))),
        random.uniform(0.01, 8.0, shape),
        np.exp(random.uniform(-2.0, 9.0, n_lobes) + random.normal(0.0, 0.3, shape)),
        random.uniform(-0.1, 1.0, shape) * (random.uniform(size=n_lobes) < 0.3),
        random.uniform(-0.5, 1.5, (1, n_lobes)),
        delta=random.uniform(0.0, 5.0, (3, 4)),
        lobe=family,
    )


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("n_lobes", [0, 1, 3, 8])
def test_components_sum_to_the_model(n_lobes: int, family: str) -> None:
    random = np.random.default_rng(n_lobes)
    theta_half = np.concatenate([random.uniform(0.0, np.pi / 2, 500), np.radians([0.0, 0.5, 1.0])])
    theta_diff, phi_diff = random.uniform(0.0, np.pi / 2, 503), random.uniform(0.0, 3.2, 503)
    for seed in range(5):
        model = random_model(seed, n_lobes, family)
        whole = model.evaluate(theta_half, theta_diff, phi_diff)
        parts = [component.evaluate(theta_half, theta_diff, phi_diff) for component in decompose(model)]
        np.testing.assert_allclose(np.sum(parts, axis=0), whole, rtol=1e-12, atol=1e-300)
        assert min(part.min() for part in parts) >= 0.0
        albedo = np.sum([component.albedo for component in decompose(model)], axis=0)
        np.testing.assert_allclose(albedo, model.albedo(0.0), rtol=1e-12, atol=1e-300)


def test_every_lobe_is_in_exactly_one_component() -> None:
    for seed in range(10):
        lobes = [k for component in decompose(random_model(seed, 6)) for k in component.lobes]
        assert sorted(lobes) == list(range(6))


def labels(model: DSBRDF, **thresholds: float) -> list[tuple[int, ...]]:
    return [component.lobes for component in decompose(model, **thresholds)]


@pytest.mark.parametrize("family", FAMILIES)
def test_obvious_mixtures_get_their_labels_in_any_order(family: str) -> None:
    assert labels(model_of([0.5, 8.0, 60.0], family=family)) == [(0,), (1,), (2,)]
    assert labels(model_of([60.0, 0.5, 8.0], family=family)) == [(1,), (2,), (0,)]
    assert labels(model_of([0.5, 0.8, 10.0, 12.0, 50.0, 70.0], family=family)) == [(0, 1), (2, 3), (4, 5)]
    assert labels(model_of([1.0], family=family)) == [(0,), (), ()]
    assert labels(model_of([50.0], family=family)) == [(), (), (0,)]


def test_height_of_the_lobes_does_not_matter() -> None:
    amplitude = np.tile([1e-3, 1e3, 1.0], (3, 4, 1))
    assert labels(model_of([0.5, 8.0, 60.0], amplitude=amplitude)) == [(0,), (1,), (2,)]


def test_flat_lobe_is_diffuse() -> None:
    assert decompose(model_of([60.0], gamma=np.zeros((1, 4, 1)))).diffuse.lobes == (0,)


def test_ring_lobe_is_as_wide_as_its_center_is_far_and_a_cusp_narrower_than_its_lobe() -> None:
    assert labels(model_of([2.0] * 3, [0.2, 10.0, 80.0])) == [(0,), (1,), (2,)]
    ring = decompose(model_of([2.0], [60.0])).diffuse
    assert ring.half_width == pytest.approx(np.radians(62.0), rel=0.03)
    cusp, whole = lobe_widths(model_of([4.0, 4.0], [-8.0, 0.0]))
    assert cusp < 0.6 * whole


def test_lobes_beside_a_threshold_stay_together() -> None:
    """One peak made of lobes of similar width on both sides of a threshold is one component."""
    assert labels(model_of([2.7, 3.3, 60.0])) in ([(0, 1), (), (2,)], [(), (0, 1), (2,)])
    assert labels(model_of([0.5, 22.0, 28.0])) in ([(0,), (1, 2), ()], [(0,), (), (1, 2)])


@pytest.mark.parametrize("widths", [[0.6, 6.0, 50.0], [1.5, 2.4, 9.0, 45.0, 70.0], [0.4, 3.4, 12.0, 40.0]])
def test_small_changes_move_no_lobe(widths: list[float]) -> None:
    random, expected = np.random.default_rng(0), labels(model_of(widths))
    for _ in range(20):
        changed = [width * factor for width, factor in zip(widths, random.uniform(0.93, 1.07, 9), strict=False)]
        assert labels(model_of(changed)) == expected
        assert all(part.margin is None or part.margin > 0.05 for part in decompose(model_of(changed)))


def test_margin_says_how_far_the_border_is() -> None:
    clear, close = decompose(model_of([0.1, 60.0])), decompose(model_of([2.9, 60.0]))
    assert clear.specular_spike.margin is not None
    assert close.specular_spike.margin is not None
    assert clear.specular_spike.margin == pytest.approx(np.log2(30.0), rel=0.05)
    assert close.specular_spike.margin < clear.specular_spike.margin
    assert clear.specular_lobe.margin is None


def test_thresholds_can_be_chosen() -> None:
    model = model_of([2.0, 10.0, 40.0])
    strict = labels(model, spike_half_width=float(np.radians(1.0)), diffuse_half_width=float(np.radians(5.0)))
    assert strict == [(), (0,), (1, 2)]
    wide = labels(model, spike_half_width=float(np.radians(75.0)), diffuse_half_width=float(np.pi / 2))
    assert wide == [(0, 1, 2), (), ()]


@pytest.mark.parametrize("thresholds", [(0.0, 0.5), (0.5, 0.5), (0.6, 0.5), (0.1, 1.6), (np.nan, 0.5), (0.1, np.nan)])
def test_impossible_thresholds_are_refused(thresholds: tuple[float, float]) -> None:
    with pytest.raises(InvalidArgumentError, match="0 < spike_half_width < diffuse_half_width <= pi/2"):
        decompose(model_of([2.0]), spike_half_width=thresholds[0], diffuse_half_width=thresholds[1])


def test_one_label_holds_at_every_theta_diff_and_light_decides_which() -> None:
    changing, other = [gamma_of(width) for width in (1.0, 1.0, 50.0, 50.0)], [gamma_of(8.0)] * 4
    gamma = np.stack([changing, other], axis=-1)[None]
    falling, same = [1.0, 1.0, 1e-9, 1e-9], [1e-4] * 4
    for heights, expected in ((falling, [(0,), (1,), ()]), (falling[::-1], [(), (1,), (0,)])):
        amplitude = np.tile(np.stack([heights, same], axis=-1), (3, 1, 1))
        assert labels(model_of([1.0, 8.0], gamma=gamma, amplitude=amplitude)) == expected


def test_reach_is_the_half_width_and_light_the_projected_integral() -> None:
    model = model_of([0.5, 8.0, 60.0])
    reach, light = lobe_reaches(model)
    np.testing.assert_allclose(reach, np.tile(np.radians([0.5, 8.0, 60.0]), (len(reach), 1)), rtol=0.03)
    kappa, gamma = 1.0, model.gamma[0, 0]
    # Where cos(theta_half) is nearly 1 the projected integral is the energy, by 2 pi and the lobe's height.
    np.testing.assert_allclose(light[0, 0], energy(kappa, gamma[0]) / (2 * np.pi * np.expm1(kappa)), rtol=0.02)


def test_weighted_median_is_that_of_repeated_values() -> None:
    random = np.random.default_rng(5)
    for _ in range(20):
        values, counts = random.normal(size=7), random.integers(0, 5, 7)
        counts[0] += 1
        repeated = np.sort(np.repeat(values, counts))
        assert weighted_median(values, counts.astype(float)) == repeated[(repeated.size - 1) // 2]


def test_delta_term_belongs_to_the_spike() -> None:
    model = model_of([60.0], delta=np.full((3, 4), 5.0))
    parts = decompose(model)
    assert parts.specular_spike.lobes == ()
    assert parts.specular_spike.evaluate(0.0, 0.3).tolist() == [5.0] * 3
    assert parts.specular_spike.half_width == pytest.approx(np.radians(1.0), rel=0.03)
    assert np.all(parts.specular_spike.albedo > 0.0)
    assert np.all(parts.diffuse.model.delta == 0.0)


def test_empty_components_are_black_and_have_no_width() -> None:
    part = decompose(model_of([60.0])).specular_lobe
    assert (part.lobes, part.half_width, part.margin) == ((), None, None)
    assert part.albedo.tolist() == [0.0] * 3
    assert np.all(part.evaluate([0.0, 0.5], 0.1) == 0.0)


def test_component_has_a_colour() -> None:
    amplitude = np.ones((3, 4, 2))
    amplitude[:, :, 1] = np.array([0.8, 0.4, 0.1])[:, None]
    parts = decompose(model_of([1.0, 60.0], amplitude=amplitude))
    np.testing.assert_allclose(parts.diffuse.albedo / parts.diffuse.albedo[0], [1.0, 0.5, 0.125], rtol=1e-12)
    np.testing.assert_allclose(parts.specular_spike.albedo, parts.specular_spike.albedo[0], rtol=1e-12)


def test_components_are_found_by_name_in_order_and_from_directions() -> None:
    parts = decompose(model_of([0.5, 8.0, 60.0]))
    assert isinstance(parts, Decomposition)
    assert tuple(component.label for component in parts) == LABELS
    for label in LABELS:
        assert parts[label] is getattr(parts, label)
        assert isinstance(parts[label], Component)
    with pytest.raises(
        InvalidArgumentError, match="label must be one of specular_spike, specular_lobe, diffuse, not 'gloss'"
    ):
        parts["gloss"]
    up = [0.0, 0.0, 1.0]
    np.testing.assert_allclose(parts.diffuse.evaluate_directions(up, up), parts.diffuse.evaluate(0.0, 0.0))
    assert 0.0 < SPIKE_HALF_WIDTH < DIFFUSE_HALF_WIDTH


def test_a_result_of_a_fit_is_taken_too() -> None:
    class Result:
        model = model_of([0.5, 60.0])

    assert labels(Result()) == labels(Result.model)  # type: ignore[arg-type]
