"""Draw measurements, models, components and fits, a fit beside its samples or measurement, and several materials.

Samples are drawn near slices of theta_diff and in planes of incidence, with the residual of the fit.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from dsbrdf.arrays import Array, Mask
from dsbrdf.components.component import Component, Decomposition
from dsbrdf.components.decomposition import decompose
from dsbrdf.data.geometry import CHANNELS, half_difference, spherical
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import profiles
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.fitting.options import FitOptions
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.reflectance import ReflectanceModel
from dsbrdf.output.figure_panels import CHANNEL_COLOURS, ROW_HEIGHT_IN, draw_legend, figure_of_rows, set_ticks
from dsbrdf.output.figures import components_figure, materials_figure, overview_figure, profiles_figure
from dsbrdf.result import FitResult
from dsbrdf.samples.prediction import thinned
from dsbrdf.samples.scattered_samples import ScatteredSamples

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase

    from dsbrdf.data.synthetic import Reflectance


Shown: TypeAlias = Measurement | ReflectanceModel | Decomposition | FitResult


def plot(shown: Shown | Mapping[str, Shown], measured: Measurement | ScatteredSamples | None = None) -> Figure:
    """Draw a measurement, a model, components or a fit, or compare several materials; needs matplotlib.

    Parameters
    ----------
    shown : Measurement, DSBRDF, Component, Decomposition, FitResult or another model, or a mapping of names to these
        A measurement is drawn as profiles, which are means over phi_diff, with interpolated curves; a model, its
        components or one of them as values at theta_half = 0 and directional albedo. Of a mapping, and of layers and
        blends, profiles and lit spheres are drawn, with a colour for each name.
    measured : Measurement or ScatteredSamples, optional
        Data to compare with a model or a fit. For a measurement, the figure has the profiles, the fit and its
        components; for samples, it has the samples, the fit and the residual.

    Raises
    ------
    InvalidArgumentError
        If an object has another type, or `measured` is given and `shown` is neither a model nor a fit.
    """
    if isinstance(shown, Mapping):
        return materials_figure({name: _reflectance(one) for name, one in shown.items()})
    options = shown.report.options if isinstance(shown, FitResult) else FitOptions()
    model = shown.model if isinstance(shown, FitResult) else shown
    if measured is not None:
        if not isinstance(measured, Measurement | ScatteredSamples):
            raise InvalidArgumentError('to compare materials, name them: plot({"first": ..., "second": ...})')
        if not isinstance(model, DSBRDF):
            raise InvalidArgumentError("only a model or a fit can be drawn together with a measurement")
        return plot_fit(model, measured, options)
    match model:
        case Measurement():
            return profiles_figure(profiles(model), model.interpolated, curves="interpolated")
        case Component():
            return components_figure([model], "")
        case DSBRDF() | Decomposition():
            return components_figure(decompose(model) if isinstance(model, DSBRDF) else model, "")
    return materials_figure({type(model).__name__: _reflectance(model)})


def _reflectance(shown: Shown) -> Reflectance:
    """Return an object whose values can be evaluated at all angles."""
    match shown:
        case Measurement():
            return shown.interpolated
        case FitResult() | Decomposition():
            return shown.model
        case ReflectanceModel():
            return shown
    raise InvalidArgumentError(
        f"a measurement, model, component or fit can be drawn, not an object of type {type(shown).__name__}"
    )


def plot_fit(
    model: DSBRDF, measured: Measurement | ScatteredSamples, options: FitOptions, *, model_lobes: bool = False
) -> Figure:
    """Draw a fit against its data: profiles with components or lobes, or samples with the residual."""
    if isinstance(measured, ScatteredSamples):
        return samples_figure(measured, model)
    data = profiles(measured, horizon_cutoff=options.horizon_cutoff, robust=options.robust)
    return overview_figure(data, model, model_lobes=model_lobes)


MAX_DRAWN_DISTANCE_DEG = 3.0
"""A panel shows only samples at most this far from its slice of theta_diff, or from its plane of incidence."""
_MAX_DRAWN_SAMPLES = 3000  # If there are more samples, a random subset of this size is drawn.
# The drawn slices have two of these theta_diff, and the drawn planes of incidence two of these theta_in.
_SLICE_CANDIDATES_DEG = np.arange(0.0, 86.0, 5.0)
_MIN_SLICE_DISTANCE_DEG = 15.0  # Two drawn slices differ at least by this in theta_diff, and two planes in theta_in.
_CURVE_ANGLES_DEG = np.linspace(0.0, 89.0, 357)
_CURVE_PHI_DIFF = np.radians(np.arange(0.0, 181.0, 15.0))
_MAX_RESIDUAL_AXIS_PERCENT = 100.0  # Larger residuals are drawn at the edge of the axis.


def samples_figure(samples: ScatteredSamples, model: DSBRDF) -> Figure:
    """Draw samples and fit near two slices of theta_diff and at two angles of incidence, and all residuals.

    The theta_diff and the theta_in with the most samples are drawn. Samples are squares. In a slice, the line is the
    mean of the fit over phi_diff, and the band is the range of the fit over phi_diff. In a plane of incidence, the line
    is the fit for light at the mean theta_in of the samples.
    """
    figure, (slices, planes, below) = figure_of_rows(samples.name, [ROW_HEIGHT_IN] * 3)
    near = f"samples (squares) within {MAX_DRAWN_DISTANCE_DEG:g}°"
    over_phi = r"fit, mean (lines) and range (shaded) over $\phi_\mathrm{diff}$"
    slices.suptitle(rf"(a) {near} of $\theta_\mathrm{{diff}}$; {over_phi}", fontsize=10)
    planes.suptitle(f"(b) {near} of the plane of incidence; fit (lines)", fontsize=10)
    below.suptitle("(c) difference of fit and samples", fontsize=10)
    shown = thinned(samples, _MAX_DRAWN_SAMPLES)
    angles = _angles(shown)
    _slice_row(slices, shown, model, angles)
    _plane_row(planes, shown, model)
    _residual_row(below, shown, model, angles)
    return figure


def samples_residual_figure(samples: ScatteredSamples, model: DSBRDF) -> Figure:
    """Draw row (c) of `samples_figure` alone: relative differences over theta_half and theta_diff."""
    figure, (row,) = figure_of_rows(samples.name, [ROW_HEIGHT_IN])
    shown = thinned(samples, _MAX_DRAWN_SAMPLES)
    _residual_row(row, shown, model, _angles(shown))
    return figure


def _angles(samples: ScatteredSamples) -> Array:
    """Return theta_half and theta_diff of samples, shape (2, n) [degrees]."""
    return np.degrees(half_difference(samples.omega_in, samples.omega_out)[:2])


def _densest(values: Array) -> list[float]:
    """Return at most two of the candidate angles, those with the most values nearby, in ascending order."""
    places = _SLICE_CANDIDATES_DEG
    counts = np.count_nonzero(np.abs(values - places[:, np.newaxis]) <= MAX_DRAWN_DISTANCE_DEG, axis=1)
    first = int(np.argmax(counts))
    second = int(np.argmax(np.where(np.abs(places - places[first]) >= _MIN_SLICE_DISTANCE_DEG, counts, 0)))
    return sorted(float(places[one]) for one in {first, second} if counts[one])


def _slice_row(row: FigureBase, samples: ScatteredSamples, model: DSBRDF, angles: Array) -> None:
    theta_half, theta_diff = angles

    def draw(ax: Axes, place: float) -> None:
        values = model.evaluate(np.radians(_CURVE_ANGLES_DEG)[:, np.newaxis], np.radians(place), _CURVE_PHI_DIFF)
        around = np.ma.masked_equal(values, 0.0)  # The mean leaves out zeros, which are below the horizon.
        near = np.abs(theta_diff - place) <= MAX_DRAWN_DISTANCE_DEG
        _draw(ax, theta_half[near], samples.values[near], _CURVE_ANGLES_DEG, around.mean(axis=1))
        for colour, low, high in zip(CHANNEL_COLOURS, around.min(axis=1).T, around.max(axis=1).T, strict=True):
            ax.fill_between(_CURVE_ANGLES_DEG, low, high, color=colour, alpha=0.15, linewidth=0)
        ax.set(xlim=(0.0, 90.0), xlabel=r"$\theta_\mathrm{half}$ [degrees]")
        ax.set_title(rf"$\theta_\mathrm{{diff}}$ = {place:.0f}°: {_count(near)}", fontsize=9)

    _draw_row(row, _densest(theta_diff), draw, "")


def _plane_row(row: FigureBase, samples: ScatteredSamples, model: DSBRDF) -> None:
    first, second = samples.omega_in, samples.omega_out
    theta_in = np.degrees(np.arccos(np.clip(first[:, 2], -1.0, 1.0)))
    normal = np.cross(first, (0.0, 0.0, 1.0))  # normal of the plane of incidence; 0 if omega_in is the surface normal
    aside = np.sum(normal * second, axis=1) / np.maximum(np.linalg.norm(normal, axis=1), 1e-9)
    in_plane = np.abs(np.degrees(np.arcsin(np.clip(aside, -1.0, 1.0)))) <= MAX_DRAWN_DISTANCE_DEG
    # The drawn theta_out is negative if omega_out is on the same side of the surface normal as omega_in.
    sign = np.where(np.sum(first[:, :2] * second[:, :2], axis=1) > 0.0, -1.0, 1.0)
    theta_out = sign * np.degrees(np.arccos(np.clip(second[:, 2], -1.0, 1.0)))

    def draw(ax: Axes, place: float) -> None:
        near = in_plane & (np.abs(theta_in - place) <= MAX_DRAWN_DISTANCE_DEG)
        mean = float(theta_in[near].mean())
        signed = np.concatenate([-_CURVE_ANGLES_DEG[:0:-1], _CURVE_ANGLES_DEG])
        into = np.broadcast_to(spherical(np.radians(mean), np.pi), (signed.size, 3))
        fitted = model.evaluate_directions(into, spherical(np.radians(signed), 0.0))
        _draw(ax, theta_out[near], samples.values[near], signed, fitted)
        ax.axvline(-mean, color="0.6", linestyle=":", linewidth=1.0)
        ax.set(xlim=(-90.0, 90.0), xlabel=r"$\theta_\mathrm{out}$ [degrees], negative on the side of the light")
        ax.set_title(rf"$\theta_\mathrm{{in}}$ = {mean:.0f}° (dotted): {_count(near)}", fontsize=9)

    _draw_row(row, _densest(theta_in[in_plane]), draw, "no sample is near its plane of incidence")


def _residual_row(row: FigureBase, samples: ScatteredSamples, model: DSBRDF, angles: Array) -> None:
    fitted = model.evaluate_directions(samples.omega_in, samples.omega_out)
    lit = samples.values > 0.0
    percent = 100.0 * (fitted / np.where(lit, samples.values, 1.0) - 1.0)
    end = float(np.clip(np.quantile(np.abs(percent[lit]), 0.98), 5.0, _MAX_RESIDUAL_AXIS_PERCENT))
    names = (r"$\theta_\mathrm{half}$ [degrees]", r"$\theta_\mathrm{diff}$ [degrees]")
    axes = row.subplots(1, 2, sharey=True)
    for ax, name, at in zip(axes, names, angles, strict=True):
        ax.axhline(0.0, color="0.5", linewidth=0.8)
        for channel, colour, kept, values in zip(CHANNELS, CHANNEL_COLOURS, lit.T, percent.T, strict=True):
            shown = np.clip(values[kept], -end, end)
            ax.plot(at[kept], shown, ".", color=colour, markersize=2.5, alpha=0.5, label=channel)
        ax.set(xlim=(0.0, 90.0), xlabel=name, ylim=(-1.05 * end, 1.05 * end))
    axes[0].set_ylabel("(fit - sample) / sample [%]")
    _finish(row, axes)


def _draw_row(row: FigureBase, places: list[float], draw: Callable[[Axes, float], None], without: str) -> None:
    axes = row.subplots(1, 2)
    for ax, place in zip(axes, places, strict=False):
        draw(ax, place)
    for ax in axes[len(places) :]:
        ax.set_axis_off()
        ax.text(0.5, 0.5, without, ha="center", fontsize=9, transform=ax.transAxes)
    axes[0].set_ylabel("BRDF [1/sr]")
    _finish(row, axes)


def _draw(ax: Axes, degrees: Array, values: Array, at: Array, fitted: Array) -> None:
    """Draw samples and fit in three channels, on a logarithmic axis that includes all positive samples."""
    for channel, colour, points, curve in zip(CHANNELS, CHANNEL_COLOURS, values.T, fitted.T, strict=True):
        kept = points > 0.0
        ax.plot(degrees[kept], points[kept], "s", color=colour, mfc="none", ms=3.4, mew=0.6, label=f"{channel}, sample")
        ax.plot(at, curve, "-", color=colour, linewidth=1.2, label=f"{channel}, fit")
    lit = np.concatenate([values[values > 0.0], [fitted.max()]])
    ax.set(yscale="log", ylim=(0.5 * lit.min(), 2.0 * lit.max()))


def _finish(row: FigureBase, axes: Sequence[Axes]) -> None:
    for ax in axes:
        set_ticks(ax)
    draw_legend(row, axes, 6, "lower center")
    row.subplots_adjust(left=0.07, right=0.98, bottom=0.24, top=0.82, wspace=0.2)


def _count(near: Mask) -> str:
    number = int(np.count_nonzero(near))
    return f"{number} {'sample' if number == 1 else 'samples'}"
