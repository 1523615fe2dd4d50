"""Draw lit spheres: a measurement, its fit, the difference and the components side by side, or a map of materials.

By default, all spheres have the exposure that scales the 99th percentile of the measurement's sphere to 1. Radiance is
multiplied by the exposure, clipped to [0, 1] and shown with the sRGB curve.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.components.decomposition import decompose
from dsbrdf.data.measurement import Measurement
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.reflectance import RenderableModel
from dsbrdf.output.figure_panels import empty_figure
from dsbrdf.rendering.environment import EnvironmentMap
from dsbrdf.rendering.sphere import Source, displayed, exposure, render_sphere, sphere_likeness, sphere_normals
from dsbrdf.samples.scattered_samples import ScatteredSamples

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dsbrdf.rendering.space import MaterialSpace


DIFFERENCE_GAIN = 4.0
"""The panel of the difference shows the difference between two spheres multiplied by this gain."""

_MIN_VISIBLE_VALUE = 0.1  # The panel of a component is left out if all its displayed values, 0 to 1, are smaller.
_LIGHTING_PHRASES = {"three_lights": "under three lights", "environment": "in the environment"}
_NAME_HEIGHT_PX = 20
_MIN_NAMED_PANEL_PX = 128  # Smaller panels have no names, because the text would not fit.
_THUMBNAIL_SIZE_PX = 112
_EDGE_WIDTH_PX = 1.5  # Pixels this close to a sphere's edge may be black, and take the colour of inner pixels.


Panels: TypeAlias = dict[str, Array]


@dataclass(frozen=True, eq=False)
class SphereComparison:
    """Lit spheres of a measurement and its fit, or of any two materials.

    The dict `panels` has pictures by title: measured, fit, difference, and optionally each component of the fit. PSNR
    and SSIM are computed by `dsbrdf.rendering.sphere.sphere_likeness`; `light` describes the lighting in words.
    """

    panels: dict[str, Array]  # picture of each sphere by title, axes (row, column, channel)
    exposure: float  # factor by which radiance is multiplied before it is displayed
    psnr: float
    ssim: float
    light: str

    @property
    def seen(self) -> dict[str, Array]:
        """The dict `panels` without the components that are too dark to be visible."""
        whole = list(self.panels)[:3]
        return {
            title: panel for title, panel in self.panels.items() if title in whole or panel.max() > _MIN_VISIBLE_VALUE
        }


def compare_spheres(
    measured: Measurement | RenderableModel,
    fit: Measurement | RenderableModel,
    *,
    names: tuple[str, str] = ("measured", "fit"),
    with_components: bool = True,
    lighting: str | EnvironmentMap = "three_lights",
    size: int = 256,
    factor: float | Literal["auto"] = "auto",
) -> SphereComparison:
    """Draw a measurement, or a model, beside a fit or another measurement.

    The first two panels are titled with `names`. If the fit is a model, `with_components` adds a panel for each of its
    components. Lighting and size are as for `dsbrdf.render_sphere`. With the exposure `factor` "auto", all spheres have
    the exposure of the measured sphere.
    """
    reference, fitted = (render_sphere(source, lighting=lighting, size=size) for source in (measured, fit))
    factor = exposure(reference, sphere_normals(size)[1]) if factor == "auto" else factor
    seen, compared = displayed(reference, factor), displayed(fitted, factor)
    difference = np.clip(DIFFERENCE_GAIN * np.abs(seen - compared), 0.0, 1.0)
    panels = {names[0]: seen, names[1]: compared, f"difference x {DIFFERENCE_GAIN:g}": difference}
    for component in decompose(fit) if with_components and isinstance(fit, DSBRDF) else ():
        part = render_sphere(component, lighting=lighting, size=size)
        panels[component.label.replace("_", " ")] = displayed(part, factor)
    light = _LIGHTING_PHRASES[lighting] if isinstance(lighting, str) else "in a panorama"
    return SphereComparison(panels, factor, *sphere_likeness(reference, fitted), light)


def side_by_side(panels: Mapping[str, Array]) -> Array:
    """Join panels of equal size side by side; name them if Matplotlib is installed and the panels are large."""
    picture = np.concatenate(list(panels.values()), axis=1)
    is_named = len(picture) >= _MIN_NAMED_PANEL_PX and find_spec("matplotlib") is not None
    return np.concatenate([_names(panels, picture.shape[1]), picture]) if is_named else picture


def one_below_another(rows: Sequence[Mapping[str, Array]]) -> Array:
    """Join rows of panels into one picture; rows with fewer panels are filled with black."""
    pictures = [side_by_side(row) for row in rows if row]
    width = max(picture.shape[1] for picture in pictures)
    return np.concatenate([np.pad(one, ((0, 0), (0, width - one.shape[1]), (0, 0))) for one in pictures])


def component_panels(model: DSBRDF, name: str, lighting: str | EnvironmentMap, size: int, factor: float) -> Panels:
    """Draw a model's components with one exposure; a title has the names of the model and of the component."""
    spheres = {part.label: render_sphere(part, lighting=lighting, size=size) for part in decompose(model)}
    return {f"{name}: {label.replace('_', ' ')}": displayed(one, factor) for label, one in spheres.items()}


def _names(panels: Mapping[str, Array], width: int) -> Array:
    """Draw the names of panels as white text on black, each above its panel."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    canvas = FigureCanvasAgg(Figure(figsize=(width / 100.0, _NAME_HEIGHT_PX / 100.0), dpi=100.0, facecolor="black"))
    for number, name in enumerate(panels):
        place = (number + 0.5) / len(panels)
        canvas.figure.text(place, 0.5, name, color="white", fontsize=8, ha="center", va="center", parse_math=False)
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.asarray(canvas.buffer_rgba())[..., :3] / 255.0  # type: ignore[no-untyped-call]


def cut_out(picture: Array) -> Array:
    """Return a picture (size, size, 3) of a sphere as (size, size, 4), transparent outside, with a smooth edge.

    The last channel is the fraction of each pixel that the sphere covers. Pixels at the edge of the sphere have the
    colour of the nearest inner pixel.
    """
    size = len(picture)
    rows, columns = np.indices((size, size)) + 0.5 - size / 2.0
    radius = np.hypot(rows, columns)
    inward = np.minimum(1.0, (size / 2.0 - _EDGE_WIDTH_PX) / np.maximum(radius, 1.0))
    nearest = ((part * inward + size / 2.0).astype(int) for part in (rows, columns))
    covered = np.clip(size / 2.0 - radius + 0.5, 0.0, 1.0)
    return np.concatenate([picture[tuple(nearest)], covered[..., np.newaxis]], axis=-1)


def thumbnail(model: DSBRDF, measured: Measurement | ScatteredSamples) -> bytes:
    """Return a PNG of the fit's sphere under three lights; a measurement on a grid replaces the left half."""
    image = render_sphere(model, size=_THUMBNAIL_SIZE_PX)
    factor = exposure(image, sphere_normals(_THUMBNAIL_SIZE_PX)[1])
    if isinstance(measured, Measurement):
        half = _THUMBNAIL_SIZE_PX // 2
        image[:, :half] = render_sphere(measured, size=_THUMBNAIL_SIZE_PX)[:, :half]
    return encode_png(displayed(image, factor))


def encode_png(image: Array) -> bytes:
    """Return the bytes of a PNG file with displayed values from 0 to 1, RGB (height, width, 3) or RGBA."""
    levels = np.rint(255.0 * np.clip(image, 0.0, 1.0)).astype(np.uint8)
    height, width, channels = levels.shape
    # In the PNG format, a row begins with a byte for its filter; 0 means no filter.
    rows = np.concatenate([np.zeros((height, 1), np.uint8), levels.reshape(height, -1)], axis=1)
    head = struct.pack(">IIBBBBB", width, height, 8, {3: 2, 4: 6}[channels], 0, 0, 0)
    chunks = ((b"IHDR", head), (b"sRGB", b"\0"), (b"IDAT", zlib.compress(rows.tobytes(), 6)), (b"IEND", b""))
    file = b"\x89PNG\r\n\x1a\n"
    for kind, data in chunks:
        file += struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    return file


_FIGURE_HEIGHT_IN = 8.0
_SPHERE_SIZE_PX = 64
_SPHERE_ZOOM = 0.38


def space_figure(found: MaterialSpace, models: Mapping[str, Source]) -> Figure:
    """Draw a map of materials as spheres under three lights, each with its own exposure."""
    from matplotlib.offsetbox import AnnotationBbox, OffsetImage

    figure = empty_figure("materials by likeness of their lit spheres, glossy ones to the right", _FIGURE_HEIGHT_IN)
    ax = figure.subplots()
    edge = 0.06 * np.ptp(found.places, axis=0).max()
    ax.plot(*np.concatenate([found.places - edge, found.places + edge]).T, alpha=0.0)  # These points set the limits.
    ax.set(aspect="equal", adjustable="datalim", xticks=[], yticks=[])
    mask, scale = sphere_normals(_SPHERE_SIZE_PX)[1], float(np.clip(40.0 / len(found.names), 1.0, 1.6))
    for name, place in zip(found.names, found.places, strict=True):
        sphere = render_sphere(models[name], size=_SPHERE_SIZE_PX)
        picture = cut_out(displayed(sphere, exposure(sphere, mask)))
        ax.add_artist(AnnotationBbox(OffsetImage(picture, zoom=scale * _SPHERE_ZOOM), place, frameon=False))
        below, size = (0.0, -14.0 * scale), 4.5 * scale
        ax.annotate(name, place, below, "data", "offset points", ha="center", va="top", size=size, parse_math=False)
    return figure
