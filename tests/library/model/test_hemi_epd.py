"""The lobe against mpmath with 60 digits."""

from typing import Any

import mpmath  # type: ignore[import-untyped]
import numpy as np
import pytest
from numpy.typing import NDArray

from dsbrdf.fitting.em import half_width, lobe

Array = NDArray[np.float64]
Number = Any  # mpmath has no types

mp = mpmath.MPContext()
mp.dps = 60

KAPPAS = [1e-6, 1e-4, 0.01, 0.3, 1.0, 3.0, 8.0, 20.0, 50.0]
GAMMAS = [0.0, 1e-4, 0.03, 0.5, 1.0, 2.0, 7.0, 50.0, 1e3, 1e4, 1e5, 1e6, 1e7]


def exact_lobe(theta: Number, kappa: Number, gamma: Number) -> Number:
    return mp.expm1(kappa * mp.cos(theta) ** gamma)


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
