"""Figures: what is drawn is the data and the model, and nothing global is touched."""

import subprocess
import sys
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import imread
from numpy.typing import NDArray

from dsbrdf import extras
from dsbrdf.data.geometry import above_horizon
from dsbrdf.data.grid import THETA_DIFF
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import Profiles, profiles
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.options import FitOptions
from dsbrdf.fitting.pipeline import fit
from dsbrdf.model.decomposition import decompose
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.figures import encode_figure, lobes_figure, overview_figure, profiles_figure
from dsbrdf.output.parameters_figure import parameters_figure
from dsbrdf.output.sphere_panels import compare_spheres

Fitted = tuple[Profiles, DSBRDF]


@pytest.fixture(scope="module")
def fitted(plastic: Measurement) -> Fitted:
    summary = profiles(plastic)
    # A delta term and two lobes of one component: what a picture must not lose.
    model = fit(summary, FitOptions(n_lobes=3, method="paper")).model
    return summary, replace(model, delta=np.full_like(model.delta, 0.25))


def lines_of(ax: Axes, label: str) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Angles [rad] and values of every line with this label."""
    return [
        (np.radians(np.asarray(line.get_xdata(), float)), np.asarray(line.get_ydata(), float))
        for line in ax.lines
        if line.get_label() == label
    ]


@pytest.mark.parametrize("theta_diff_deg", [0, 45])
def test_profiles_figure_draws_measured_means_and_the_fit(fitted: Fitted, theta_diff_deg: int) -> None:
    summary, model = fitted
    figure = profiles_figure(summary, model, theta_diff=[np.radians(theta_diff_deg)])
    assert len(figure.axes) == 2
    for ax in figure.axes:
        for index, channel in enumerate(("red", "green", "blue")):
            ((angles, values),) = lines_of(ax, f"{channel}, fit")
            assert angles.min() == pytest.approx(-np.pi / 2)
            expected = model.evaluate(np.abs(angles).clip(max=np.pi / 2), np.radians(theta_diff_deg))[:, index]
            np.testing.assert_allclose(values, expected, rtol=1e-9, atol=1e-12)
            ((angles, values),) = lines_of(ax, f"{channel}, measured")
            nodes = np.rint(np.sqrt(np.degrees(np.abs(angles)) * 90.0)).astype(int)  # theta_half = (i / 90)**2 * 90
            np.testing.assert_array_equal(values, summary.mean[index, theta_diff_deg, nodes])
            assert np.all(summary.weight[index, theta_diff_deg, nodes] > 0)


@pytest.fixture(scope="module")
def elongated(fitted: Fitted) -> DSBRDF:
    model = fitted[1]
    elongation = np.tile([[1.5, 0.5, -0.5]], (model.elongation.shape[0], 1))
    return replace(model, elongation=elongation, delta=np.zeros_like(model.delta))


def test_elongated_fit_is_drawn_as_the_mean_over_the_directions_that_were_measured(
    fitted: Fitted, elongated: DSBRDF
) -> None:
    summary, _ = fitted
    ax = profiles_figure(summary, elongated, theta_diff=[np.radians(45.0)]).axes[0]
    ((angles, values),) = lines_of(ax, "red, fit")
    phi_diff = np.radians(np.arange(0.05, 180.0, 0.1))
    assert summary.horizon_cutoff is not None
    peak = np.radians(2.0)
    assert abs(np.interp(peak, angles, values) / elongated.evaluate(peak, THETA_DIFF[45])[0] - 1.0) > 0.02
    for theta_half in np.radians([2.0, 20.0, 40.0, 60.0]):
        used = above_horizon(theta_half, THETA_DIFF[45], phi_diff, summary.horizon_cutoff)
        assert used.any()
        expected = elongated.evaluate(theta_half, THETA_DIFF[45], phi_diff[used])[:, 0].mean()
        assert np.interp(theta_half, angles, values) == pytest.approx(expected, rel=5e-3)


def test_parameters_figure_draws_every_lobe(elongated: DSBRDF) -> None:
    amplitudes, widths, elongations = parameters_figure(elongated, title="paint").axes
    n_lobes = elongated.n_lobes
    assert (len(amplitudes.lines), len(widths.lines), len(elongations.lines)) == (3 * n_lobes, n_lobes, n_lobes)
    at = np.radians(np.asarray(amplitudes.lines[0].get_xdata(), float))
    drawn = np.sort([np.asarray(line.get_ydata(), float) for line in amplitudes.lines], axis=0)
    expected = elongated.parameters_at(at)["amplitude"].reshape(at.size, -1)
    np.testing.assert_allclose(drawn, np.sort(expected, axis=1).T, rtol=1e-9)
    heights = sorted(float(np.asarray(line.get_ydata(), float)[0]) for line in elongations.lines)
    assert heights == [-0.5, 0.5, 1.5]
    labels = [str(line.get_label()) for line in widths.lines]
    for component in decompose(elongated):
        for lobe in component.lobes:
            (line,) = [line for line in widths.lines if str(line.get_label()).startswith(f"{lobe}: ")]
            assert component.label.replace("_", " ") in str(line.get_label())
            assert np.median(np.asarray(line.get_ydata(), float)) > 0.0
    assert len(set(labels)) == n_lobes


def test_drawn_lobes_sum_to_the_fit(fitted: Fitted) -> None:
    summary, model = fitted
    figure = lobes_figure(summary, model, theta_diff=[0.0], channel="green")
    ax = figure.axes[0]
    ((_, total),) = lines_of(ax, "fit, all lobes")
    labels = [str(line.get_label()) for line in ax.lines]
    lobes = [label for label in labels if "half width" in label or label == "delta term"]
    assert len(lobes) == len(set(lobes)) == model.n_lobes + 1
    parts = [values for label in lobes for _, values in lines_of(ax, label)]
    np.testing.assert_allclose(np.sum(parts, axis=0), total, rtol=1e-9, atol=1e-12)


def test_axis_limits_contain_all_data(fitted: Fitted) -> None:
    summary, model = fitted
    for ax in (panel for panel in overview_figure(summary, model).axes if panel.get_yscale() == "log"):
        low, high = ax.get_ylim()
        for line in ax.lines:
            if "measured" in str(line.get_label()):
                values = np.asarray(line.get_ydata(), float)
                assert low < values.min() < values.max() < high


def test_overview_has_two_panels_per_slice(fitted: Fitted) -> None:
    figure = overview_figure(*fitted, theta_diff=[0.0, 0.5, 1.0])
    assert len(figure.axes) == 2 * 3 * 2


def test_slice_without_data_is_drawn(fitted: Fitted) -> None:
    summary, model = fitted
    assert not np.any(summary.weight[:, 89])
    assert encode_figure(profiles_figure(summary, model, theta_diff=[np.pi / 2]), dpi=30).startswith(b"\x89PNG")


def test_flat_model_is_drawn_over_all_angles(fitted: Fitted) -> None:
    shape = (3, 1, 1)
    flat = DSBRDF(np.zeros(1), np.ones(shape), np.full(shape, 0.2), np.zeros(shape), interpolation="linear")
    peak = profiles_figure(fitted[0], flat, theta_diff=[0.0]).axes[1]
    assert peak.get_xlim() == (-90.0, 90.0)


def test_figures_are_encoded_as_png_svg_and_pdf(fitted: Fitted) -> None:
    figure = profiles_figure(*fitted, theta_diff=[0.0])
    width, height = figure.get_size_inches()
    image = imread(BytesIO(encode_figure(figure, dpi=50)), format="png")
    assert image.shape == (round(height * 50), round(width * 50), 4)
    assert image[..., :3].std() > 0.05
    assert b"<svg" in encode_figure(figure, "svg")
    assert encode_figure(figure, "pdf").startswith(b"%PDF")
    with pytest.raises(InvalidArgumentError, match="the image format must be png, svg or pdf, not 'bmp'"):
        encode_figure(figure, "bmp")


@pytest.mark.parametrize("theta_diff", [[], [-0.1], [2.0], [np.nan], [[0.0]]])
def test_theta_diff_out_of_range_is_refused(fitted: Fitted, theta_diff: list[float]) -> None:
    with pytest.raises(InvalidArgumentError, match="theta_diff must be one or more angles from 0 to pi/2"):
        profiles_figure(*fitted, theta_diff=theta_diff)


def test_an_unknown_channel_is_refused(fitted: Fitted) -> None:
    with pytest.raises(InvalidArgumentError, match="channel must be red, green or blue, not 'alpha'"):
        lobes_figure(*fitted, channel="alpha")


def test_missing_matplotlib_error_names_the_extra(fitted: Fitted, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    with pytest.raises(
        extras.MissingExtraError, match=r"matplotlib must be installed for figures: pip install 'dsbrdf\[plot\]'"
    ):
        profiles_figure(*fitted)


def test_figures_change_no_global_matplotlib_state() -> None:
    code = """
import sys, numpy as np
from dsbrdf.output.figures import encode_figure, overview_figure
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.data.reduction import FoldedProfiles, Profiles
ones = np.ones((3, 90, 90))
folded = FoldedProfiles(np.ones((3, 90, 90, 9)), np.ones((3, 90, 90, 9)), np.ones((90, 90, 9)))
model = DSBRDF([0.0], ones[:, :1, :1], ones[:1, :1, :1], ones[:1, :1, :1])
data = Profiles(ones, ones, ones * 0, folded, None, "plain", False, "flat", "")
encode_figure(overview_figure(data, model, theta_diff=[0.0]), dpi=30)
assert "matplotlib.pyplot" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_figures_are_independent_objects(fitted: Fitted) -> None:
    first, second = (profiles_figure(*fitted, theta_diff=[0.0]) for _ in range(2))
    assert isinstance(first, Figure)
    assert first is not second
    assert encode_figure(first, dpi=30) == encode_figure(second, dpi=30)


def test_overview_ends_with_spheres(fitted: Fitted) -> None:
    spheres = compare_spheres(fitted[1], fitted[1], size=16)
    figure = overview_figure(*fitted, spheres=spheres)
    assert [ax.get_title() for ax in figure.axes[-6:]] == list(spheres.panels)
    assert len(figure.axes) == len(overview_figure(*fitted).axes) + 6
    shown = figure.axes[-5].images[0].get_array()
    assert shown is not None
    np.testing.assert_array_equal(shown[..., :3], spheres.panels["fit"])
    assert set(np.unique(shown[..., 3])) == {0.0, 1.0}
