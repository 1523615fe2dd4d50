"""Figures and lit spheres: what is drawn is the data and the model, and nothing global is touched."""

import io
import itertools
import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import imread
from numpy.typing import NDArray
from PIL import Image

from dsbrdf import InvalidArgumentError, Profiles, decompose
from dsbrdf.data import CHANNELS, THETA_DIFF, above_horizon
from dsbrdf.output import encode_figure
from dsbrdf.output.figures import overview_figure, parameters_figure, profiles_figure
from dsbrdf.output.sphere_panels import SphereComparison, compare_spheres, encode_png
from tests.support.models import mixture, papers_model

pytestmark = pytest.mark.slow

MODEL = papers_model()  # It has a delta term, and a shape for each channel.
PAINT = mixture(2, 0)
ELONGATED = replace(MODEL, elongation=np.array([[1.5, 0.5, -0.5]]), delta=np.zeros_like(MODEL.delta))


@pytest.fixture(scope="module")
def overview(plastic_profiles: Profiles) -> Figure:
    """At theta_diff of 0 and 45 degrees: axes 0 to 3 show profiles, 4 to 7 components in red, then come spheres."""
    return overview_figure(plastic_profiles, MODEL, spheres=compare_spheres(MODEL, MODEL, size=16))


@pytest.fixture(scope="module")
def lobes(plastic_profiles: Profiles) -> Figure:
    """The same slices, with the lobes of the model in axes 4 to 7."""
    return overview_figure(plastic_profiles, MODEL, model_lobes=True)


def lines_of(ax: Axes, label: str) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    lines = [line for line in ax.lines if line.get_label() == label]
    return [(np.radians(np.asarray(line.get_xdata(), float)), np.asarray(line.get_ydata(), float)) for line in lines]


def test_overview_draws_means_and_the_fit_within_its_limits(overview: Figure, plastic_profiles: Profiles) -> None:
    for (at, ax), (index, channel) in itertools.product(enumerate(overview.axes[:4]), enumerate(CHANNELS)):
        row = (0, 0, 45, 45)[at]
        ((angles, values),) = lines_of(ax, f"{channel}, fit")
        assert angles.min() == pytest.approx(-np.pi / 2)
        expected = MODEL.evaluate(np.abs(angles).clip(max=np.pi / 2), np.radians(row))[:, index]
        np.testing.assert_allclose(values, expected, rtol=1e-9, atol=1e-12)
        ((angles, values),) = lines_of(ax, f"{channel}, measured")
        nodes = np.rint(np.sqrt(np.degrees(np.abs(angles)) * 90.0)).astype(int)  # theta_half = (i / 90)**2 * 90
        np.testing.assert_array_equal(values, plastic_profiles.mean[index, row, nodes])
        assert np.all(plastic_profiles.weight[index, row, nodes] > 0)
        low, high = ax.get_ylim()
        assert ax.get_yscale() == "linear" or low < values.min() < values.max() < high


def test_elongated_fit_is_drawn_as_the_mean_over_the_directions_that_were_measured(plastic_profiles: Profiles) -> None:
    ax = profiles_figure(plastic_profiles, ELONGATED).axes[2]
    ((angles, values),) = lines_of(ax, "red, fit")
    phi_diff = np.radians(np.arange(0.05, 180.0, 0.1))
    assert plastic_profiles.horizon_cutoff is not None
    peak = np.radians(2.0)
    assert abs(np.interp(peak, angles, values) / ELONGATED.evaluate(peak, THETA_DIFF[45])[0] - 1.0) > 0.02
    for theta_half in np.radians([2.0, 20.0, 40.0, 60.0]):
        used = above_horizon(theta_half, THETA_DIFF[45], phi_diff, plastic_profiles.horizon_cutoff)
        assert used.any()
        expected = ELONGATED.evaluate(theta_half, THETA_DIFF[45], phi_diff[used])[:, 0].mean()
        assert np.interp(theta_half, angles, values) == pytest.approx(expected, rel=5e-3)


def test_drawn_parts_sum_to_the_fit_in_the_red_channel(overview: Figure, lobes: Figure) -> None:
    for ax, count in ((overview.axes[4], len(decompose(MODEL))), (lobes.axes[4], MODEL.n_lobes + 1)):
        ((_, total),) = lines_of(ax, "fit")
        np.testing.assert_array_equal(total, lines_of(overview.axes[0], "red, fit")[0][1])
        named = [str(line.get_label()) for line in ax.lines]
        parts = [label for label in named if label not in ("fit", "measured") and not label.startswith("_")]
        assert len(parts) == len(set(parts)) == count
        values = [values for label in parts for _, values in lines_of(ax, label)]
        np.testing.assert_allclose(np.sum(values, axis=0), total, rtol=1e-9, atol=1e-12)


def test_figures_are_encoded_as_png_svg_and_pdf_without_pyplot(lobes: Figure, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)  # an import of it fails
    monkeypatch.delattr("matplotlib.pyplot", raising=False)
    width, height = lobes.get_size_inches()
    image = imread(io.BytesIO(encode_figure(lobes, dpi=50)), format="png")
    assert image.shape == (round(height * 50), round(width * 50), 4)
    assert image[..., :3].std() > 0.05
    assert b"<svg" in encode_figure(lobes, "svg")
    black = PAINT.select((), with_delta=False)
    assert encode_figure(parameters_figure(black), "pdf").startswith(b"%PDF")
    with pytest.raises(InvalidArgumentError, match="the image format must be png, svg or pdf, not 'bmp'"):
        encode_figure(lobes, "bmp")


def test_component_that_nobody_can_see_has_no_sphere() -> None:
    titles = ("measured", "fit", "difference x 4", "specular spike", "diffuse")
    brightest = (1.0, 1.0, 0.02, 1.0, 0.05)
    panels = {title: np.full((8, 8, 3), value) for title, value in zip(titles, brightest, strict=True)}
    assert list(SphereComparison(panels, 1.0, 40.0, 1.0, "under three lights").seen) == list(titles[:4])


def test_panels_of_components_add_up_to_the_fit_and_a_model_equals_itself() -> None:
    found = compare_spheres(PAINT, PAINT, size=24, factor=0.002)
    assert (found.psnr, found.exposure) == (float("inf"), 0.002)
    panels = found.panels.values()
    radiance = [np.where(seen > 0.04045, ((seen + 0.055) / 1.055) ** 2.4, seen / 12.92) for seen in panels]
    _, whole, difference, *parts = radiance
    assert not difference.any()
    assert len(parts) >= 2
    assert whole.max() < 1.0  # nothing is clipped
    np.testing.assert_allclose(np.sum(parts, axis=0), whole, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("channels", "mode"), [(3, "RGB"), (4, "RGBA")])
def test_pillow_reads_the_pixels_of_a_png(channels: int, mode: str) -> None:
    levels = np.random.default_rng(0).integers(0, 256, (5, 7, channels), dtype=np.uint8)
    values = levels / 255.0
    values[0, :3, 0], levels[0, :3, 0] = (-1.0, 0.5, 7.0), (0, 128, 255)  # values are clipped
    with Image.open(io.BytesIO(encode_png(values))) as image:
        assert image.mode == mode
        assert np.array_equal(np.asarray(image), levels)
