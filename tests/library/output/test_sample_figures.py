"""Samples beside a fit: what is drawn is where the samples are and what the model gives there."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

import dsbrdf
from dsbrdf import FitResult, ScatteredSamples
from dsbrdf.data import half_difference, spherical
from dsbrdf.output.plots import MAX_DRAWN_DISTANCE_DEG, samples_figure, samples_residual_figure

pytestmark = pytest.mark.slow

LIGHT = np.repeat([20.0, 50.0], 80)
VIEWER = np.tile(np.linspace(-80.0, 80.0, 80), 2)  # negative on the side of the light


@pytest.fixture(scope="module")
def samples(two_lobe_fit: FitResult) -> ScatteredSamples:
    """Of a goniometer in one plane, a quarter brighter than the fit."""
    directions = spherical(np.radians(LIGHT), np.pi), spherical(np.radians(VIEWER), 0.0)
    return ScatteredSamples.from_arrays(*directions, 1.25 * two_lobe_fit.model.evaluate_directions(*directions))


def axes_of(figure: Figure) -> list[Axes]:
    return [ax for ax in figure.findobj(Axes) if isinstance(ax, Axes)]


def test_samples_near_slices_and_planes_are_drawn_with_the_fit(
    samples: ScatteredSamples, two_lobe_fit: FitResult
) -> None:
    *slices, first, second, _, _ = axes_of(dsbrdf.plot(two_lobe_fit, samples))
    theta_half, theta_diff, _ = np.degrees(half_difference(samples.omega_in, samples.omega_out))
    for ax in slices:
        place = float(ax.get_title().partition(" = ")[2].partition("°")[0])
        near = np.abs(theta_diff - place) <= MAX_DRAWN_DISTANCE_DEG
        assert near.sum() > 10
        np.testing.assert_allclose(
            np.asarray(ax.lines[0].get_xydata()), np.stack([theta_half, samples.values[:, 0]], 1)[near]
        )
    for ax, theta_in in ((first, 20.0), (second, 50.0)):
        near = LIGHT == theta_in
        np.testing.assert_allclose(
            np.asarray(ax.lines[0].get_xydata()), np.stack([VIEWER, samples.values[:, 0]], 1)[near]
        )
        drawn = np.interp(VIEWER[near], *np.transpose(ax.lines[1].get_xydata()))
        np.testing.assert_allclose(drawn, 0.8 * samples.values[near, 0], rtol=0.01)


def test_residual_is_drawn_at_every_sample(samples: ScatteredSamples, two_lobe_fit: FitResult) -> None:
    axes = axes_of(samples_residual_figure(samples, two_lobe_fit.model))
    for ax, angles in zip(axes, half_difference(samples.omega_in, samples.omega_out)[:2], strict=True):
        for line in ax.lines[1:]:
            np.testing.assert_allclose(
                np.transpose(line.get_xydata()), [np.degrees(angles), np.full(len(LIGHT), -20.0)]
            )


def test_samples_out_of_their_plane_and_black_ones_are_drawn_without_a_warning(
    samples: ScatteredSamples, two_lobe_fit: FitResult
) -> None:
    aside = replace(samples, omega_out=spherical(np.radians(np.maximum(np.abs(VIEWER), 10.0)), np.pi / 2))
    dark = replace(aside, values=np.where(samples.values > np.median(samples.values), samples.values, 0.0))
    drawn = samples_figure(dark, two_lobe_fit.model).findobj(Text)
    assert "no sample is near its plane of incidence" in [text.get_text() for text in drawn if isinstance(text, Text)]
