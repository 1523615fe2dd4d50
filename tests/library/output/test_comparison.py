"""What is drawn and compared with one call, and what a notebook shows."""

import sys
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import dsbrdf
from dsbrdf import FitResult, FunctionModel, InvalidArgumentError, Measurement
from dsbrdf.components import DiffuseLayer, LayeredModel, SpecularLayer
from dsbrdf.data import directions, nodes_above_horizon
from dsbrdf.notebook_display import register
from dsbrdf.output import export_model
from dsbrdf.output.comparison import fit_ggx
from dsbrdf.output.notebook import html as html_of
from tests.support.models import mixture
from tests.support.reproduced import assert_reproduced

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
            "with holes": Measurement.from_values(measurement.values, measurement.valid & (np.arange(180) // 3 != 9)),
            # Directions further than 80 degrees from the normal do not count.
            "black": lambda i, o: np.where(np.minimum(i[:, 2:], o[:, 2:]) > np.cos(np.radians(80.5)), 0.0, 1e3),
        },
    )
    assert all((found[name].relative_rms or 0.0) < 5e-3 for name in ("model", "function"))
    assert all((found[name].psnr or 0.0) > 60.0 for name in ("model", "function"))
    assert 0.0 < (found["with holes"].relative_rms or 0.0) < 1e-4
    assert (found["ggx"].psnr or 0.0) > 50.0
    assert found["black"].relative_rms == pytest.approx(1.0)
    assert found["itself"].psnr == 200.0


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


PAINT = mixture(2, 0)


def test_a_running_notebook_shows_objects_as_html(two_lobe_fit: FitResult, monkeypatch: pytest.MonkeyPatch) -> None:
    shown: dict[str, Callable[[object], str]] = {}
    formatter = SimpleNamespace(for_type_by_name=lambda module, name, html: shown.update({f"{module}.{name}": html}))
    shell = SimpleNamespace(display_formatter=SimpleNamespace(formatters={"text/html": formatter}))
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    register()
    model = two_lobe_fit.model
    assert shown[f"{type(model).__module__}.{type(model).__name__}"](model) == html_of(model)
    assert all(hasattr(import_module(module), name) for module, _, name in (key.rpartition(".") for key in shown))


def test_a_notebook_shows_a_figure_at_80_dpi() -> None:
    figure = dsbrdf.plot(PAINT)
    preview = figure._repr_png_()  # type: ignore[attr-defined]
    assert int.from_bytes(preview[16:20]) == pytest.approx(80 * figure.get_size_inches()[0], abs=1)


def test_profiles_of_named_materials_are_means_of_their_channels(plastic: Measurement) -> None:
    (curve,) = [
        line for line in dsbrdf.plot({"paint": PAINT, "plastic": plastic}).axes[0].lines if line.get_label() == "paint"
    ]
    degrees, values = np.asarray(curve.get_xydata()).T
    expected = PAINT.evaluate(np.radians(np.abs(degrees)), 0.0).mean(axis=-1)
    np.testing.assert_allclose(values, expected, rtol=1e-9, atol=1e-12)


def test_measurements_of_the_same_bytes_and_name_are_equal(plastic: Measurement, metal: Measurement) -> None:
    same = replace(plastic, stored=plastic.stored.copy())
    assert plastic == same
    assert len({plastic, same, metal, replace(plastic, name="other")}) == 3


REFUSED: dict[str, Any] = {
    "a function of one channel": lambda _: FunctionModel(lambda i, _: i[:, 0]).evaluate(0.1, 0.2),
    "a function that returns NaN": lambda _: FunctionModel(lambda i, _: np.nan * i).evaluate(0.1, 0.2),
    "a number to compare with": lambda measured: dsbrdf.compare(measured, {"number": cast(Any, 3)}),
    "two measurements to draw": lambda measured: dsbrdf.plot(measured, measured),
    "a name to draw": lambda _: dsbrdf.plot(cast(Any, "nickel.binary")),
    "two models to draw": lambda _: dsbrdf.plot(PAINT, cast(Any, PAINT)),
    "eleven materials to draw": lambda _: dsbrdf.plot({f"paint {number}": PAINT for number in range(11)}),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_compared_or_drawn_is_refused(what: str, plastic: Measurement) -> None:
    with pytest.raises(InvalidArgumentError) as caught:
        REFUSED[what](plastic)
    assert_reproduced(f"refused/{what}", str(caught.value))
