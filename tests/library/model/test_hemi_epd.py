"""The lobe against mpmath with 60 digits.

The references are the closed form 1/C = 2 pi [1F1(1/gamma; 1 + 1/gamma; kappa) - 1] and plain quadrature of the
lobe; the code sums a series and uses neither.
"""

from collections.abc import Callable
from typing import Any

import mpmath  # type: ignore[import-untyped]
import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.hemi_epd import cdf, energy, half_width, lobe

Array = NDArray[np.float64]
Number = Any  # mpmath has no types

mp = mpmath.MPContext()
mp.dps = 60
QUICK = mpmath.MPContext()
QUICK.dps = 12

KAPPAS = [1e-6, 1e-4, 0.01, 0.3, 1.0, 3.0, 8.0, 20.0, 50.0]
GAMMAS = [0.0, 1e-4, 0.03, 0.5, 1.0, 2.0, 7.0, 50.0, 1e3, 1e4, 1e5, 1e6, 1e7]
ANGLES = [1e-8, 1e-5, 1e-3, 0.02, 0.3, 1.0, 1.5, np.pi / 2 - 1e-6, np.pi / 2]


def exact_lobe(theta: Number, kappa: Number, gamma: Number, center: Number = 0) -> Number:
    return mp.expm1(kappa * mp.cos(theta - center) ** gamma)


def integral_to(u: Number, kappa: Number, gamma: Number) -> Number:
    """Integral of exp(kappa v**gamma) - 1 over v from 0 to u."""
    if gamma == 0:
        return u * mp.expm1(kappa)
    a = 1 / mp.mpf(gamma)
    return u * (mp.hyp1f1(a, 1 + a, kappa * u ** mp.mpf(gamma)) - 1)


def exact_energy(kappa: float, gamma: float) -> Number:
    return 2 * mp.pi * integral_to(mp.mpf(1), mp.mpf(kappa), mp.mpf(gamma))


def worst(values: Array, references: list[Number]) -> float:
    """Largest relative error, the differences taken with all digits."""
    pairs = zip(values.ravel().tolist(), references, strict=True)
    return max(float(abs(mp.mpf(value) / reference - 1)) for value, reference in pairs)


def test_value_against_60_digits_from_flat_to_mirror_and_down_to_tiny_lobes() -> None:
    theta = np.array([0.0, 1e-9, 1e-4, 0.01, 0.5, 1.2, 1.57])
    for kappa in (1e-9, 0.2, 7.0, 700.0):
        for gamma in (0.0, 0.3, 1.0, 40.0, 1e4, 1e7):
            values = lobe(theta, kappa, gamma)
            for angle, value in zip(theta.tolist(), values.tolist(), strict=True):
                reference = exact_lobe(mp.mpf(angle), mp.mpf(kappa), mp.mpf(gamma))
                if reference < 1e-290:
                    assert value < 1e-289
                else:
                    # The exponent gamma log(cos) carries a rounding error of its own size.
                    size = abs(mp.mpf(gamma) * mp.log(mp.cos(mp.mpf(angle)))) + kappa + 1
                    assert abs(value / reference - 1) < 1e-14 * size


def test_ring_lobe_is_the_same_function_of_the_distance_to_its_center() -> None:
    theta = np.linspace(0.0, np.pi / 2, 50)
    center = 0.7
    expected = [np.expm1(2.0 * max(np.cos(t - center), 0.0) ** 30.0) for t in theta]
    np.testing.assert_allclose(lobe(theta, 2.0, 30.0, center), expected, rtol=1e-12)
    assert theta[np.argmax(lobe(theta, 2.0, 30.0, theta[20]))] == theta[20]


def test_energy_against_the_closed_form() -> None:
    kappa, gamma = np.meshgrid(KAPPAS, GAMMAS, indexing="ij")
    references = [exact_energy(k, g) for k, g in zip(kappa.ravel().tolist(), gamma.ravel().tolist(), strict=True)]
    assert worst(energy(kappa, gamma), references) < 1e-13


@pytest.mark.parametrize(("kappa", "gamma"), [(0.01, 0.5), (2.0, 1.0), (8.0, 30.0), (50.0, 2.0), (5.0, 1e4)])
def test_energy_is_the_integral_of_the_lobe_over_the_hemisphere(kappa: float, gamma: float) -> None:
    ends = [0, *(mp.mpf(10) ** mp.mpf(e) for e in (-3, -2.5, -2, -1.5, -1, -0.5)), mp.pi / 2]
    integral = mp.quad(lambda t: exact_lobe(t, kappa, gamma) * mp.sin(t), ends)
    assert worst(energy(kappa, gamma), [2 * mp.pi * integral]) < 1e-13


def test_limits_of_the_energy() -> None:
    kappa = np.array(KAPPAS)
    np.testing.assert_allclose(energy(kappa, 0.0), 2 * np.pi * np.expm1(kappa), rtol=1e-13)
    np.testing.assert_allclose(energy(kappa, 1e-12), 2 * np.pi * np.expm1(kappa), rtol=1e-10)
    assert np.all(energy(kappa, np.inf) == 0.0)
    # Towards the mirror 1/C falls as 1/gamma, with the sum of kappa**n / (n! n) as its factor.
    factor = float(mp.ei(8) - mp.euler - mp.log(8))
    assert float(energy(8.0, 1e15)) * 1e15 == pytest.approx(2 * np.pi * factor, rel=1e-12)


def test_energy_up_to_the_largest_numbers() -> None:
    for kappa, gamma in ((300.0, 2.0), (700.0, 1.0), (700.0, 1e7), (720.0, 1e7)):
        assert worst(energy(kappa, gamma), [exact_energy(kappa, gamma)]) < 1e-12
    assert float(energy(720.0, 1.0)) == np.inf  # above 1e308


def test_cdf_against_the_closed_form_also_where_it_is_tiny() -> None:
    error = 0.0
    for kappa in KAPPAS[::2]:
        for gamma in GAMMAS:
            total = integral_to(mp.mpf(1), mp.mpf(kappa), mp.mpf(gamma))
            references = [1 - integral_to(mp.cos(mp.mpf(t)), mp.mpf(kappa), mp.mpf(gamma)) / total for t in ANGLES]
            error = max(error, worst(cdf(ANGLES, kappa, gamma), references))
    assert error < 1e-13


def test_cdf_runs_from_0_to_1_without_falling() -> None:
    theta = np.linspace(0.0, np.pi / 2, 500)
    for kappa, gamma in ((1e-3, 0.0), (5.0, 1.0), (8.0, 1e5), (700.0, 10.0)):
        values = cdf(theta, kappa, gamma)
        assert values[0] == 0.0
        assert values[-1] == pytest.approx(1.0, abs=1e-14)
        assert np.all(np.diff(values) >= 0.0)


def test_limits_of_the_cdf() -> None:
    theta = np.linspace(0.0, np.pi / 2, 20)
    np.testing.assert_allclose(cdf(theta, 3.0, 0.0), 2.0 * np.sin(theta / 2) ** 2, rtol=1e-13)
    assert cdf([0.0, 1e-9, 1.0], 3.0, np.inf).tolist() == [0.0, 1.0, 1.0]


def test_half_width_solves_its_equation() -> None:
    error = 0.0
    for kappa in [*KAPPAS, 1e-9, 9e-4, 1.1e-3, 700.0]:
        for gamma in GAMMAS[1:]:
            half_peak = mp.log1p(mp.expm1(mp.mpf(kappa)) / 2) / mp.mpf(kappa)
            angle = mp.acos(half_peak ** (1 / mp.mpf(gamma)))
            error = max(error, worst(half_width(kappa, gamma), [angle]))
    assert error < 1e-11


def test_half_width_in_its_limits() -> None:
    assert half_width([1e-6, 1.0, 50.0], 0.0).tolist() == [np.pi / 2] * 3  # a flat lobe never falls to half its peak
    assert float(half_width(1.0, np.inf)) == 0.0
    # A small kappa makes the lobe kappa cos(theta)**gamma.
    assert float(half_width(1e-9, 1.0)) == pytest.approx(np.pi / 3, rel=1e-9)


def test_broadcasting_equals_a_loop() -> None:
    theta, kappa, gamma = np.linspace(0.1, 1.5, 4), np.array([0.1, 5.0, 30.0])[:, None], np.array([[0.0], [9.0], [1e5]])
    for function in (lobe, cdf):
        whole = function(theta, kappa, gamma)
        for i in range(3):
            for j in range(4):
                assert whole[i, j] == pytest.approx(float(function(theta[j], kappa[i, 0], gamma[i, 0])), rel=1e-13)
    # The series of a batch is summed as far as its largest kappa needs.
    for i in range(3):
        assert energy(kappa, gamma)[i, 0] == pytest.approx(float(energy(kappa[i, 0], gamma[i, 0])), rel=1e-14)
    assert energy(np.empty(0), np.empty(0)).shape == (0,)


@pytest.mark.parametrize("kappa", [0.0, -1.0, np.nan, np.inf])
@pytest.mark.parametrize("function", [energy, half_width])
def test_kappa_must_be_positive_and_finite(function: Callable[[float, float], Array], kappa: float) -> None:
    with pytest.raises(InvalidArgumentError, match="kappa must be positive and finite"):
        function(kappa, 1.0)


@pytest.mark.parametrize("gamma", [-1e-9, np.nan, -np.inf])
def test_gamma_must_not_be_negative(gamma: float) -> None:
    with pytest.raises(InvalidArgumentError, match="gamma must be zero or positive"):
        lobe(0.1, 1.0, gamma)
    with pytest.raises(InvalidArgumentError, match="gamma must be zero or positive"):
        energy(1.0, gamma)


@pytest.mark.parametrize("theta", [-1e-9, 1.6, np.nan])
def test_cdf_is_defined_on_the_hemisphere(theta: float) -> None:
    with pytest.raises(InvalidArgumentError, match="theta must lie between 0 and pi/2"):
        cdf(theta, 1.0, 1.0)


# Ring lobes


@pytest.mark.parametrize("center", [0.01, 0.5, np.pi / 2])
def test_energy_of_a_ring_lobe_is_its_integral_over_the_hemisphere(center: float) -> None:
    for kappa in (1e-3, 3.0, 30.0):
        for gamma in (1.0, 60.0, 1e5):
            width = float(half_width(kappa, gamma))
            steps = [center + side * width * x for side in (-1, 1) for x in (0.0, 0.2, 0.5, 1.0, 2.0, 4.0, 8.0)]
            ends = sorted({0.0, np.pi / 2, *(min(max(end, 0.0), np.pi / 2) for end in steps)})
            fine = [mp.mpf(end) for end in ends]
            integral = QUICK.quad(
                lambda t, k=kappa, g=gamma: QUICK.expm1(k * QUICK.cos(t - center) ** g) * QUICK.sin(t), fine
            )
            assert float(energy(kappa, gamma, center)) == pytest.approx(float(2 * QUICK.pi * integral), rel=1e-7)


def test_energy_takes_rings_and_centred_lobes_together() -> None:
    center = np.array([0.0, 0.4, 0.0])
    found = energy([[1.0], [5.0]], 30.0, center)
    assert found.shape == (2, 3)
    np.testing.assert_allclose(found[:, [0, 2]], np.tile(energy([[1.0], [5.0]], 30.0), 2), rtol=1e-15)
    assert found[1, 1] == pytest.approx(float(energy(5.0, 30.0, 0.4)), rel=1e-14)
