"""What figures draw of a model: its components, each with its own lobe, or the model's lobes."""

from dataclasses import dataclass

import numpy as np

from dsbrdf.fitting.decomposition import LABELS, decompose
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.lobes import half_width
from dsbrdf.model.reflectance import ReflectanceModel

COMPONENT_COLOURS = dict(zip(LABELS, ("#e8590c", "#7048e8", "#0c8599"), strict=True))
LOBE_COLOURS = ("#e8590c", "#7048e8", "#0c8599", "#c2255c", "#5c940d", "#a0522d", "#4263eb", "#868e96")


@dataclass(frozen=True)
class FigurePart:
    """A curve of one part of a model.

    Attributes
    ----------
    source : ReflectanceModel
    colour, style : str
        As matplotlib has them.
    label : str, optional
        A curve without one is thin and not named in the legend.
    """

    source: ReflectanceModel
    colour: str
    style: str
    label: str = ""


def component_parts(model: DSBRDF) -> list[FigurePart]:
    """Components of a model, and below each, dashed, its own lobe."""
    parts = []
    for component in decompose(model):
        colour = COMPONENT_COLOURS[component.label]
        width = f"half width {np.degrees(component.half_width):.2g}°"
        parts += [
            FigurePart(component.lobe, colour, "--"),
            FigurePart(component, colour, "-", f"{component.label.replace('_', ' ')}, {width}"),
        ]
    return parts


def lobe_parts(model: DSBRDF, channel: int) -> list[FigurePart]:
    """The lobes of a model, rings and cusps dashed, with their width at theta_diff = 0, and the delta term."""
    at = model.parameters_at(0.0)
    kappa, gamma, center = (
        at[name][channel if model.kappa.shape[0] == 3 else 0] for name in ("kappa", "gamma", "center")
    )
    widths, centers = np.degrees(half_width(kappa, gamma, model.lobe)), np.degrees(center)
    parts = []
    for lobe, is_ring in enumerate(model.is_ring):
        name = f"lobe {lobe}"
        if is_ring:
            name = f"cusp {lobe}" if centers[lobe] < 0.0 else f"ring lobe {lobe} at {centers[lobe]:.2g}°"
        label = f"{name}, half width {widths[lobe]:.2g}°"
        colour = LOBE_COLOURS[lobe % len(LOBE_COLOURS)]
        parts.append(FigurePart(model.select((lobe,), with_delta=False), colour, "--" if is_ring else "-", label))
    if model.delta.any():
        parts.append(FigurePart(model.select((), with_delta=True), LOBE_COLOURS[-1], ":", "delta term"))
    return parts
