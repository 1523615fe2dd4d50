"""The warp of the RGL files against its definition."""

import numpy as np
import pytest

from dsbrdf.data.rgl_warp import Warp, bilinear


def test_share_of_samples_is_the_integral_of_the_density() -> None:
    random = np.random.default_rng(0)
    warp = Warp.of(random.uniform(0.0, 1.0, (4, 6)) ** 3)
    x, y = warp.sample(*random.random((2, 200_000)))
    middles = (np.arange(200) + 0.5) / 200
    for left, low in ((0.1, 0.2), (0.5, 0.6), (0.8, 0.05)):
        inside = np.mean((x > left) & (x < left + 0.15) & (y > low) & (y < low + 0.2))
        # The density is continuous and piecewise bilinear: the error of so many midpoints is far below the deviation.
        a, b = np.meshgrid(left + 0.15 * middles, low + 0.2 * middles)
        expected = 0.15 * 0.2 * bilinear(warp.density, a.ravel(), b.ravel()).mean()
        assert inside == pytest.approx(expected, abs=4.0 * np.sqrt(expected / 200_000))


def test_uniform_density_leaves_samples_where_they_are() -> None:
    given = np.random.default_rng(1).random((2, 100))
    assert np.allclose(Warp.of(np.full((5, 7), 3.0)).sample(*given), given)


def test_corners_stay() -> None:
    x, y = Warp.of(np.random.default_rng(2).random((5, 7))).sample(np.array([0.0, 1.0]), np.array([0.0, 1.0]))
    assert np.allclose([x, y], [[0.0, 1.0], [0.0, 1.0]])
