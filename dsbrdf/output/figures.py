"""Draw figures of a fit in the style of Nishino 2009, Figure 1, and the parameters of a model over theta_diff.

Every function returns a new `matplotlib.figure.Figure`. Neither pyplot nor other global state is used, so that figures
can be made in any thread. The extra ``plot`` installs Matplotlib.

A profile is the mean of the measurement or the model over phi_diff. A profile is drawn over theta_half and mirrored to
-90..90 degrees, as in the paper. Because values span orders of magnitude, every slice of theta_diff has two panels: all
angles on a logarithmic axis, which shows the diffuse part, and the peak on a linear axis, as in the paper.
"""

from __future__ import annotations

from itertools import compress, cycle
from typing import TYPE_CHECKING

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.components.decomposition import decompose
from dsbrdf.components.shares import LABELS
from dsbrdf.data.geometry import CHANNELS, DEFAULT_HORIZON_CUTOFF, THETA_DIFF, THETA_HALF
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.output.figure_panels import (
    CHANNEL_COLOURS,
    CURVE_THETA_HALF,
    LINE_STYLES,
    LOBE_COLOURS,
    ROW_HEIGHT_IN,
    SLICE_ROWS,
    draw_curve,
    draw_legend,
    draw_points,
    empty_figure,
    figure_of_rows,
    finish_row,
    measured_means,
    panel_pairs,
    set_limits,
    set_ticks,
    slice_means,
)
from dsbrdf.output.report_text import lobes_in_channel
from dsbrdf.output.sphere_panels import SphereComparison, cut_out
from dsbrdf.rendering.sphere import displayed, exposure, render_sphere, sphere_normals

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from matplotlib.figure import Figure, FigureBase

    from dsbrdf.components.component import Component
    from dsbrdf.data.reduction import Profiles
    from dsbrdf.data.synthetic import Reflectance
    from dsbrdf.model.dsbrdf import DSBRDF
    from dsbrdf.model.reflectance import ReflectanceModel

    _Part = tuple[ReflectanceModel, str, str, str]  # model, colour, line style and label of a curve

COMPONENT_COLOURS = dict(zip(LABELS, LOBE_COLOURS, strict=False))
_SPHERES_HEIGHT_IN = 2.5
_SPHERE_SIZE_PX = 256
_MAX_COLOURED_RESIDUAL_PERCENT = 100.0  # All larger residuals have one colour, the last of the colour scale.
_RESIDUAL_TICKS_DEG = (0, 5, 20, 45, 90)  # ticks on the axis of theta_half in the figure of residuals


def profiles_figure(profiles: Profiles, model: Reflectance, *, curves: str = "fit") -> Figure:
    """Draw only row (a) of `overview_figure`, the profiles; `curves` names the model in the legend."""
    figure, (row,) = figure_of_rows(profiles.name, [ROW_HEIGHT_IN])
    _profiles_row(row, profiles, model, curves)
    return figure


def overview_figure(
    profiles: Profiles, model: DSBRDF, *, model_lobes: bool = False, spheres: SphereComparison | None = None
) -> Figure:
    """Draw both rows of Nishino 2009, Figure 1, and optionally lit spheres in a third row.

    Row (a) compares the measurement, averaged over phi_diff, with the model's means over the same directions, in all
    channels. Row (b) shows the fit and its components with their layers, or with `model_lobes` the lobes of the model,
    in the red channel. Raises MissingExtraError if Matplotlib is not installed.
    """
    heights = [ROW_HEIGHT_IN, ROW_HEIGHT_IN] if spheres is None else [ROW_HEIGHT_IN, ROW_HEIGHT_IN, _SPHERES_HEIGHT_IN]
    figure, (above, below, *rest) = figure_of_rows(profiles.name, heights)
    above.suptitle("(a) measured (squares) and fit (lines), means over $\\phi_\\mathrm{diff}$", fontsize=10)
    parts = "lobes of the model" if model_lobes else "components of the fit (dashed: their own layers)"
    below.suptitle(f"(b) {parts}, red channel", fontsize=10)
    _profiles_row(above, profiles, model)
    _parts_row(below, profiles, model, model_lobes)
    if spheres is not None:
        likeness = f"PSNR {spheres.psnr:.1f} dB, SSIM {spheres.ssim:.3f} {spheres.light}"
        rest[0].suptitle(f"(c) lit spheres; the fit compared with the measurement: {likeness}", fontsize=10)
        _spheres_row(rest[0], spheres.seen)
    return figure


def materials_figure(materials: Mapping[str, Reflectance]) -> Figure:
    """Draw several materials, given by name: the mean of their channels in two slices, and their lit spheres.

    All spheres have one exposure. Raises InvalidArgumentError if there is no material, or if there are more materials
    than colours.
    """
    if not 1 <= len(materials) <= len(LOBE_COLOURS):
        raise InvalidArgumentError(
            f"a figure compares 1 to {len(LOBE_COLOURS)} materials, not {len(materials)}; dsbrdf map shows more"
        )
    figure, (above, below) = figure_of_rows("", [ROW_HEIGHT_IN, _SPHERES_HEIGHT_IN])
    above.suptitle("(a) means of the channels and over $\\phi_\\mathrm{diff}$", fontsize=10)
    below.suptitle("(b) lit spheres under three lights, with the exposure of the first", fontsize=10)
    pairs = panel_pairs(above)
    within = CURVE_THETA_HALF <= DEFAULT_HORIZON_CUTOFF
    for row, pair in zip(SLICE_ROWS, pairs, strict=True):
        curves = [slice_means(one, row, DEFAULT_HORIZON_CUTOFF).mean(axis=1) for one in materials.values()]
        set_limits(pair, row, np.stack(curves, axis=1), np.stack(curves)[:, within])
        for ax in pair:
            for name, colour, style, curve in zip(materials, LOBE_COLOURS, cycle(LINE_STYLES), curves, strict=False):
                draw_curve(ax, curve, colour, style=style, label=name)
    finish_row(above, [pairs[0][0]], columns=4)
    spheres = [render_sphere(one, size=_SPHERE_SIZE_PX) for one in materials.values()]
    factor = exposure(spheres[0], sphere_normals(_SPHERE_SIZE_PX)[1])
    _spheres_row(below, {name: displayed(one, factor) for name, one in zip(materials, spheres, strict=True)})
    return figure


def residual_figure(profiles: Profiles, model: DSBRDF) -> Figure:
    """Draw the relative difference between the profiles of fit and measurement for each channel.

    The axes are theta_half and theta_diff. All nodes of the grid are drawn equally wide, which enlarges the peak,
    because more nodes are there. Nodes without data are grey.
    """
    figure = empty_figure(profiles.name, ROW_HEIGHT_IN)
    fitted = np.stack([slice_means(model, row, profiles.horizon_cutoff, THETA_HALF) for row in range(THETA_DIFF.size)])
    measured = np.moveaxis(profiles.mean, 0, -1)
    used = (np.moveaxis(profiles.weight, 0, -1) > 0) & (measured > 0)
    percent = np.where(used, 100.0 * (fitted / np.where(used, measured, 1.0) - 1.0), np.nan)
    axes = figure.subplots(1, len(CHANNELS), sharey=True)
    for ax, channel, values in zip(axes, CHANNELS, np.moveaxis(percent, -1, 0), strict=True):
        limits = -_MAX_COLOURED_RESIDUAL_PERCENT, _MAX_COLOURED_RESIDUAL_PERCENT
        pixels = {"origin": "lower", "aspect": "auto", "interpolation": "nearest"}
        image = ax.imshow(values, cmap="RdBu_r", clim=limits, **pixels)
        ax.set(facecolor="0.85", yticks=range(0, 91, 15), xlabel=r"$\theta_\mathrm{half}$ [degrees]")
        ax.set_xticks(np.interp(np.radians(_RESIDUAL_TICKS_DEG), THETA_HALF, range(90)), map(str, _RESIDUAL_TICKS_DEG))
        ax.set_title(channel, fontsize=9)
        ax.tick_params(labelsize=8)
    axes[0].set_ylabel(r"$\theta_\mathrm{diff}$ [degrees]")
    bar = figure.colorbar(image, ax=axes, label="(fit - measured) / measured [%]", extend="both")
    bar.ax.tick_params(labelsize=8)
    return figure


def _profiles_row(figure: FigureBase, profiles: Profiles, model: Reflectance, curves: str = "fit") -> None:
    pairs = panel_pairs(figure)
    for row, pair in zip(SLICE_ROWS, pairs, strict=True):
        fitted = slice_means(model, row, profiles.horizon_cutoff)
        data = [measured_means(profiles, row, channel) for channel in range(3)]
        set_limits(pair, row, fitted, np.concatenate([measured for _, measured in data]))
        for ax in pair:
            for channel, colour, points, curve in zip(CHANNELS, CHANNEL_COLOURS, data, fitted.T, strict=True):
                draw_points(ax, *points, colour, "s", f"{channel}, measured")
                draw_curve(ax, curve, colour, label=f"{channel}, {curves}")
    finish_row(figure, [pairs[0][0]], columns=6)


def _parts_row(figure: FigureBase, profiles: Profiles, model: DSBRDF, model_lobes: bool) -> None:
    """Draw components or lobes in the red channel, two panels for each slice, with a legend of the visible curves."""
    parts = _lobe_parts(model) if model_lobes else _component_parts(model)
    pairs = panel_pairs(figure)
    for row, pair in zip(SLICE_ROWS, pairs, strict=True):
        points = measured_means(profiles, row, 0)
        fitted = slice_means(model, row, profiles.horizon_cutoff)[:, 0]
        set_limits(pair, row, fitted, points[1])
        curves = [slice_means(source, row, profiles.horizon_cutoff)[:, 0] for source, *_ in parts]
        seen = [curve.max() > pair[0].get_ylim()[0] for curve in curves]
        for ax in pair:
            # The line of the fit is wide, so that it stays visible behind the line of a single component.
            draw_curve(ax, fitted, "0.75", label="fit", width=3.5)
            # The colour of the axis labels is visible on light and dark backgrounds.
            draw_points(ax, *points, str(ax.xaxis.label.get_color()), "o", "measured")
            for (_, colour, style, label), curve in compress(zip(parts, curves, strict=True), seen):
                draw_curve(ax, curve, colour, style=style, label=label)
    finish_row(figure, [pair[0] for pair in pairs], columns=4)


def _component_parts(model: DSBRDF) -> list[_Part]:
    """Return the curves of a model's components, each preceded by a dashed curve of the component's layers."""
    parts: list[_Part] = []
    for component in decompose(model):
        colour, name = COMPONENT_COLOURS[component.label], component.label.replace("_", " ")
        width = component.half_width
        label = name if width is None else f"{name}, half width {np.degrees(width):.2g}°"
        parts += [(component.layers, colour, "--", ""), (component, colour, "-", label)]
    return parts


def _lobe_parts(model: DSBRDF) -> list[_Part]:
    """Return the curves of a model's lobes and of the paper's delta term; rings and cusps are dashed.

    The label of a lobe has the half width of the lobe at theta_diff = 0.
    """
    at = lobes_in_channel(model, 0.0, 0)
    widths, centers = np.degrees(at["half_width"]), np.degrees(at["center"])
    parts: list[_Part] = []
    for lobe, is_ring in enumerate(model.is_ring):
        name = f"lobe {lobe}"
        if is_ring:
            name = f"cusp {lobe}" if centers[lobe] < 0.0 else f"ring lobe {lobe} at {centers[lobe]:.2g}°"
        label = f"{name}, half width {widths[lobe]:.2g}°"
        colour = LOBE_COLOURS[lobe % len(LOBE_COLOURS)]
        parts.append((model.select((lobe,), with_delta=False), colour, "--" if is_ring else "-", label))
    if model.delta.any():
        parts.append((model.select((), with_delta=True), LOBE_COLOURS[-1], ":", "delta term"))
    return parts


def _spheres_row(figure: FigureBase, panels: dict[str, Array]) -> None:
    axes = figure.subplots(1, len(panels), squeeze=False)[0]
    figure.subplots_adjust(left=0.02, right=0.98, bottom=0.02, top=0.82, wspace=0.1)
    for ax, (title, picture) in zip(axes, panels.items(), strict=True):
        ax.imshow(cut_out(picture), interpolation="antialiased")
        ax.set_title(title, fontsize=9, parse_math=False)
        ax.set_axis_off()


_CURVE_THETA_DIFF = np.radians(np.linspace(0.0, 85.0, 200))


def parameters_figure(model: DSBRDF, *, title: str = "", model_lobes: bool = False) -> Figure:
    """Draw the RGB values of a model's components at theta_half = 0, and their directional albedo.

    With `model_lobes`, draw the amplitude, half width, kappa and elongation of the model's lobes instead. The amplitude
    is the mean of the channels; half width and kappa are from the green channel.
    """
    return _lobes_figure(model, title) if model_lobes else components_figure(decompose(model), title)


def components_figure(components: Iterable[Component], title: str) -> Figure:
    """Draw the RGB values of components at theta_half = 0 over theta_diff, and their directional albedo."""
    figure = empty_figure(title, ROW_HEIGHT_IN)
    heights, albedos = figure.subplots(1, 2)
    degrees, seen = np.degrees(_CURVE_THETA_DIFF), np.linspace(0.0, 80.0, 17)
    for number, part in enumerate(components):
        style = LINE_STYLES[number % len(LINE_STYLES)]
        reflected = part.directional_albedo(np.radians(seen))
        for ax, angles, values in ((heights, degrees, part.height(_CURVE_THETA_DIFF)), (albedos, seen, reflected)):
            for channel_colour, curve in zip(CHANNEL_COLOURS, values.T, strict=True):
                ax.plot(angles, curve, style, color=channel_colour, linewidth=1.2)
        low, high = np.transpose(part.ranges.albedo)
        places = 1.0 + 3.0 * number + np.arange(3)  # The albedo ranges of the three channels are drawn side by side.
        albedos.vlines(places, low, high, colors=CHANNEL_COLOURS, linewidth=2.5, alpha=0.5)
        heights.plot([], [], style, color="0.5", linewidth=1.2, label=part.label.replace("_", " "))
    heights.set(yscale="log", title=r"height at $\theta_\mathrm{half}$ = 0 [1/sr]")
    albedos.set(title="directional albedo; at the left its 90 % ranges at 0°")
    albedos.set_ylim(bottom=0.0)
    for ax, angle in ((heights, "diff"), (albedos, "out")):
        ax.set(xlim=(0, 90), xlabel=rf"$\theta_\mathrm{{{angle}}}$ [degrees]")
        ax.title.set_fontsize(9)
        set_ticks(ax)
    draw_legend(figure, [heights], 4, "outside lower center")
    return figure


def _lobes_figure(model: DSBRDF, title: str) -> Figure:
    figure = empty_figure(title, 1.7 * ROW_HEIGHT_IN)
    heights, widths, kappas, elongations = figure.subplots(2, 2).flat
    degrees = np.degrees(_CURVE_THETA_DIFF)
    amplitude = model.parameters_at(_CURVE_THETA_DIFF)["amplitude"].mean(axis=-2)
    at = lobes_in_channel(model, _CURVE_THETA_DIFF, 1)
    for lobe, is_ring in enumerate(model.is_ring):
        style, colour = LINE_STYLES[lobe % len(LINE_STYLES)], LOBE_COLOURS[lobe % len(LOBE_COLOURS)]
        label = f"{'ring lobe' if is_ring else 'lobe'} {lobe}"
        shapes = (amplitude, np.degrees(at["half_width"]), at["kappa"], at["elongation"])
        for ax, values in zip((heights, widths, kappas, elongations), shapes, strict=True):
            ax.plot(degrees, values[:, lobe], style, color=colour, linewidth=1.2, label=label)
    heights.set(yscale="log", title="height, mean of the channels [1/sr]")
    widths.set(yscale="log", title="half width [degrees]")
    kappas.set(title="kappa")
    elongations.set(title="elongation, 0 for a round lobe")
    for ax, low, high in ((kappas, 0.0, 2.5), (elongations, -0.25, 1.25)):  # Small variations shall look small.
        bottom, top = ax.get_ylim()
        ax.set_ylim(min(low, bottom), max(high, top))
    for ax in (heights, widths, kappas, elongations):
        ax.set(xlim=(0, 90), xlabel=r"$\theta_\mathrm{diff}$ [degrees]")
        ax.title.set_fontsize(9)
        set_ticks(ax)
    draw_legend(figure, [widths], 4, "outside lower center")
    return figure
