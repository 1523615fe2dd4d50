import re
from base64 import b64decode
from dataclasses import fields, replace

import matplotlib.figure
import numpy as np
import pytest

import dsbrdf
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import Profiles
from dsbrdf.fitting.report import FitResult


def thumbnail(html: str) -> bytes:
    (encoded,) = re.findall(r'src="data:image/png;base64,([\w+/=]+)"', html)
    return b64decode(encoded)


def test_repr_is_one_short_line(plastic: Measurement, plastic_profiles: Profiles, two_lobe_fit: FitResult) -> None:
    up = np.tile([0, 0, 1.0], (200, 1))
    samples = dsbrdf.ScatteredSamples.from_arrays(up, up, np.ones((200, 3)))
    light = dsbrdf.EnvironmentMap.from_pixels(np.ones((32, 64, 3)))
    model, report = two_lobe_fit.model, two_lobe_fit.report
    part = dsbrdf.decompose(model).diffuse
    for shown in (plastic, plastic_profiles, samples, light, two_lobe_fit, model, report, part):
        assert 10 < len(repr(shown)) < 260
        assert "\n" not in repr(shown)
        assert type(shown).__name__ in repr(shown)


def test_notebook_shows_a_sphere_and_the_metrics(plastic: Measurement, two_lobe_fit: FitResult) -> None:
    warned = replace(two_lobe_fit, report=replace(two_lobe_fit.report, warnings=("less than <1 %>",)))
    html = warned._repr_html_()
    assert thumbnail(html) == thumbnail(two_lobe_fit.model._repr_html_())
    assert thumbnail(html).startswith(b"\x89PNG")
    assert f"<th>relative_rms</th><td>{two_lobe_fit.report.metrics.relative_rms:.4g}</td>" in html
    for component in dsbrdf.decompose(two_lobe_fit):
        red, green, blue = component.albedo
        light = f"{component.light_share:.0%} of the light, albedo {red:.4f}, {green:.4f}, {blue:.4f}"
        width = component.half_width
        assert light + ("" if width is None else f", half width {np.degrees(width):.1f}°") + "</td>" in html
    layers = dsbrdf.decompose(two_lobe_fit).layers
    assert f"{len(layers.layers)} layers, {layers.n_numbers} numbers" in layers._repr_html_()
    assert thumbnail(layers._repr_html_()) != thumbnail(html)
    assert "<li>less than &lt;1 %&gt;</li>" in html
    assert warned.report._repr_html_() in html
    assert thumbnail(replace(plastic, name="<b>")._repr_html_()) != thumbnail(html)
    assert f"<td>{plastic.valid.mean():.1%}</td>" in plastic._repr_html_()
    assert "<td>&lt;b&gt;</td>" in replace(plastic, name="<b>")._repr_html_()
    diffuse = dsbrdf.decompose(two_lobe_fit.model).diffuse
    assert diffuse is not None
    assert f"<td>{diffuse.structure}</td>" in diffuse._repr_html_()
    assert thumbnail(diffuse._repr_html_()) != thumbnail(html)
    assert "0 lobes" in two_lobe_fit.model.select((), with_delta=False)._repr_html_()


def test_plot_draws_the_fit_or_the_parameters(plastic: Measurement, two_lobe_fit: FitResult) -> None:
    parameters, fitted = two_lobe_fit.plot(), two_lobe_fit.plot(plastic)
    assert isinstance(parameters, matplotlib.figure.Figure)
    assert [len(figure.findobj(matplotlib.axes.Axes)) for figure in (parameters, fitted)] == [2, 8]
    assert len(two_lobe_fit.model.plot().findobj(matplotlib.axes.Axes)) == 2
    parts = dsbrdf.decompose(two_lobe_fit)
    curves = [len(figure.axes[0].lines) for figure in (two_lobe_fit.model.plot(), parts["diffuse"].plot())]
    assert curves == [4 * len(parts), 4]  # three channels and a name each
    preview = parameters._repr_png_()  # type: ignore[attr-defined]
    assert int.from_bytes(preview[16:20]) == pytest.approx(80 * parameters.get_size_inches()[0], abs=1)


def test_plot_of_a_measurement_draws_its_means_and_what_is_between(plastic: Measurement) -> None:
    figure = plastic.plot()
    (axes, *_) = figure.findobj(matplotlib.axes.Axes)
    labels = axes.get_legend_handles_labels()[1]
    assert {"red, measured", "red, interpolated"} <= set(labels)
    lines = {str(line.get_label()): line for line in axes.lines}
    points, curve = (np.asarray(lines[f"green, {name}"].get_xydata()) for name in ("measured", "interpolated"))
    at_points = np.interp(points[:, 0], *curve.T)
    assert np.abs(at_points / points[:, 1] - 1.0).max() < 0.05


def test_help_on_fit_lists_the_options() -> None:
    text = dsbrdf.fit.__doc__ or ""
    for option in fields(dsbrdf.FitOptions):
        assert re.search(rf"^(\w+, )*{option.name}[ ,\n]", text, re.MULTILINE)


def test_measurements_of_the_same_bytes_and_name_are_equal(plastic: Measurement, metal: Measurement) -> None:
    same = replace(plastic, stored=plastic.stored.copy())
    assert plastic == same
    assert len({plastic, same, metal, replace(plastic, name="other")}) == 3
