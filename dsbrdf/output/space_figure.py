"""Draw a map of materials, with a lit sphere at the coordinates of each material."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dsbrdf.output.figure_parts import empty_figure
from dsbrdf.output.sphere_panels import cut_out
from dsbrdf.rendering.image_metrics import displayed, exposure
from dsbrdf.rendering.sphere import Source, render_sphere, sphere_normals

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.figure import Figure

    from dsbrdf.rendering.space import MaterialSpace

_FIGURE_HEIGHT_IN = 8.0
_SPHERE_SIZE_PX = 64
_SPHERE_ZOOM = 0.38


def space_figure(found: MaterialSpace, models: Mapping[str, Source]) -> Figure:
    """Draw a map: at the coordinates of each material, its sphere under three lights, with an exposure of its own."""
    from matplotlib.offsetbox import AnnotationBbox, OffsetImage

    figure = empty_figure(
        "materials by likeness of their lit spheres, glossy ones to the right", 2, height=_FIGURE_HEIGHT_IN
    )
    ax = figure.subplots()
    ax.plot(*found.places.T, ".", color="0.8", markersize=1.0)  # Matplotlib sets the axis limits by these points.
    ax.margins(0.06)
    ax.set(aspect="equal", adjustable="datalim", xticks=[], yticks=[])
    mask = sphere_normals(_SPHERE_SIZE_PX)[1]
    for name, place in zip(found.names, found.places, strict=True):
        sphere = render_sphere(models[name], size=_SPHERE_SIZE_PX)
        picture = cut_out(displayed(sphere, exposure(sphere, mask)))
        ax.add_artist(AnnotationBbox(OffsetImage(picture, zoom=_SPHERE_ZOOM), place, frameon=False))
        ax.annotate(
            name, place, (0, -14), textcoords="offset points", ha="center", va="top", fontsize=4.5, parse_math=False
        )
    return figure
