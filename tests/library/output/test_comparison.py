"""Models, functions and GGX beside a measurement."""

import numpy as np
import pytest

import dsbrdf
from dsbrdf import FunctionModel, InvalidArgumentError, Measurement
from dsbrdf.components import DiffuseLayer, LayeredModel, SpecularLayer
from dsbrdf.components.ggx import fit_ggx
from dsbrdf.data import directions, nodes_above_horizon
from dsbrdf.output import export_model

pytestmark = pytest.mark.slow
# Two GGX highlights over a Lambertian ground: the tail exponent is 2, and the masking 0 is height-correlated.
SHARP_LAYER = SpecularLayer((0.04, 0.05, 0.06), 0.9, 0.05, 2.0, (0.0, 0.0), 0.0, 0.0)
ROUGH_LAYER = SpecularLayer((0.3, 0.2, 0.1), 0.8, 0.3, 2.0, (0.0, 0.0), 0.0, 0.0)
LAMBERT_LAYER = DiffuseLayer((0.3, 0.2, 0.1), (0.0,) * 6)
SURFACE = LayeredModel((SHARP_LAYER, ROUGH_LAYER, LAMBERT_LAYER))


@pytest.fixture(scope="module")
def measurement() -> Measurement:
    return Measurement.from_values(SURFACE.tabulate(), nodes_above_horizon(), "two highlights")


def test_a_function_ggx_a_model_and_a_measurement_are_compared(measurement: Measurement) -> None:
    found = dsbrdf.compare(
        measurement,
        {
            "model": SURFACE,
            "function": SURFACE.evaluate_directions,
            "ggx": "ggx",
            "itself": measurement,
            "grey": lambda i, _: i[:, :1] * 0,
        },
    )
    assert all((found[name].relative_rms or 0.0) < 5e-3 for name in ("model", "function"))
    assert all((found[name].psnr or 0.0) > 60.0 for name in ("model", "function"))
    assert 0.0 < (found["itself"].relative_rms or 0.0) < 1e-4
    assert (found["ggx"].psnr or 0.0) > 50.0
    assert found["grey"].relative_rms == pytest.approx(1.0)


def test_two_ggx_highlights_are_found_again() -> None:
    layers = fit_ggx(SURFACE.evaluate_unmasked).layers
    narrow, wide, ground = layers
    assert isinstance(narrow, SpecularLayer)
    assert isinstance(wide, SpecularLayer)
    assert isinstance(ground, DiffuseLayer)
    assert sorted([narrow.alpha, wide.alpha]) == pytest.approx([0.05, 0.3], rel=0.02)
    assert ground.albedo == pytest.approx(LAMBERT_LAYER.albedo, rel=0.02)
    assert [narrow.tail_exponent, wide.tail_exponent] == pytest.approx([2.0, 2.0])


def test_a_function_is_a_model_like_any_other_and_reciprocal() -> None:
    model = FunctionModel(lambda i, o: (0.2 + 0.1 * i[:, 2:]) / np.pi + 0.0 * o)
    assert model.albedo(0.0) == pytest.approx([0.2 + 0.05 + 0.1 / 3.0] * 3, rel=1e-3)
    first, second = directions(*np.radians([[30.0, 80.0], [40.0, 80.0], [20.0, 0.0]]))
    np.testing.assert_allclose(model.evaluate_directions(first, second), model.evaluate_directions(second, first))
    assert not model.evaluate_directions(first, second)[1].any()
    assert dsbrdf.render_sphere(model, size=16).shape == (16, 16, 3)
    with pytest.raises(InvalidArgumentError, match=r"glsl cannot contain a FunctionModel, .*: use merl, bsdf or"):
        export_model(model, "glsl")


@pytest.mark.parametrize("wrong", [lambda i, _: i[:, 0], lambda i, _: np.full((len(i), 3), np.nan)])
def test_a_function_that_returns_something_else_is_refused(wrong: object) -> None:
    with pytest.raises(InvalidArgumentError, match="the function must return finite values of the shape"):
        FunctionModel(wrong).evaluate(0.1, 0.2)  # type: ignore[arg-type]


def test_what_is_no_material_is_refused(measurement: Measurement) -> None:
    with pytest.raises(InvalidArgumentError, match='a function or "ggx" can be compared, not an object of type int'):
        dsbrdf.compare(measurement, {"number": 3})  # type: ignore[dict-item]
