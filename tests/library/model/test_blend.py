"""Blends of two models: ends, what a geometric mean promises, and what users are told about bad input."""

import numpy as np
import pytest

from dsbrdf import InvalidArgumentError, blend
from dsbrdf.components import DiffuseLayer, LayeredModel, SpecularLayer
from tests.support.known_models import pairs_of_directions, single_lobe
from tests.support.mixtures import mixture

PAIRS = pairs_of_directions(500)
ROUGH, POLISHED = (
    LayeredModel((SpecularLayer((0.5,) * 3, 1.0, alpha, 1e3, (0.0, 0.0), 0.5, 0.0),)) for alpha in (0.4, 0.1)
)


def test_ends_symmetry_and_reciprocity() -> None:
    a, b = mixture(3, 0), mixture(2, 1)
    for t, end in ((0.0, a), (1.0, b)):
        np.testing.assert_array_equal(blend(a, b, t).evaluate_directions(*PAIRS), end.evaluate_directions(*PAIRS))
    values = blend(a, b, 0.3).evaluate_directions(*PAIRS)
    np.testing.assert_allclose(blend(b, a, 0.7).evaluate_directions(*PAIRS), values, rtol=1e-12)
    np.testing.assert_allclose(blend(a, b, 0.3).evaluate_directions(*PAIRS[::-1]), values, rtol=1e-9)
    assert np.all(values > 0.0)
    table = blend(a, b, 0.3).tabulate()
    np.testing.assert_allclose(
        table[:, 10, 20, 30],
        blend(a, b, 0.3).evaluate(np.radians((10 / 90) ** 2 * 90), np.radians(20), np.radians(30)),
        rtol=1e-12,
    )


def test_values_lie_between_and_no_energy_is_made() -> None:
    a, b = mixture(3, 0), LayeredModel((*POLISHED.layers, DiffuseLayer((0.5, 0.4, 0.3), (0.0,) * 6)))
    middle = blend(a, b, 0.4)
    first, second, between = (one.evaluate_directions(*PAIRS) for one in (a, b, middle))
    assert np.all(
        (between >= np.minimum(first, second) * (1 - 1e-12)) & (between <= np.maximum(first, second) * (1 + 1e-12))
    )
    angles = np.radians([0.0, 45.0, 75.0])
    assert np.all(middle.albedo(angles) <= 0.6 * a.albedo(angles) + 0.4 * b.albedo(angles) + 1e-9)


def test_between_polished_and_rough_lies_one_highlight_of_medium_width() -> None:
    theta_half = np.radians(np.linspace(0.0, 40.0, 400))
    widths = []
    for model in (POLISHED, blend(POLISHED, ROUGH, 0.5), ROUGH):
        values = model.evaluate(theta_half, 0.0)[:, 0]
        assert np.all(np.diff(values) < 0.0)
        widths.append(theta_half[np.argmax(values < values[0] / 2.0)])
    assert widths[0] * 1.2 < widths[1] < widths[2] / 1.2


def test_bad_input() -> None:
    lobe = single_lobe(1.0, 1.0)
    with pytest.raises(InvalidArgumentError, match=r"t must lie between 0 and 1, not at 1\.5"):
        blend(lobe, lobe, 1.5)
    with pytest.raises(InvalidArgumentError, match=r"only models, such as result\.model, can be blended, not a str"):
        blend(lobe, "paint.json", 0.5)  # type: ignore[arg-type]
