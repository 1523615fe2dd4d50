"""The components of a model as JSON content: in what commands print, in stored fits and in the HTTP service's answers.

Angles are in degrees.
"""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from dsbrdf.components.decomposition import Component, decompose
from dsbrdf.components.ranges import ComponentRanges
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.typed_json import typed

LOBE_THETA_DIFF = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0)
"""theta_diff of the heights of components in JSON [degrees]."""


def component_documents(model: DSBRDF) -> list[dict[str, Any]]:
    """Return the components of a model, from narrow to wide, as they are written to JSON."""
    return [component_document(component) for component in decompose(model)]


def component_document(component: Component) -> dict[str, Any]:
    """Return one component as JSON content: light, physical parameters with ranges, heights at `LOBE_THETA_DIFF`."""
    ranges = asdict(component.ranges)
    widths = ranges.pop("half_width")
    height = component.height(np.radians(LOBE_THETA_DIFF))
    return {
        "label": component.label,
        "structure": component.structure,
        "light_share": component.light_share,
        "albedo": component.albedo.tolist(),
        "color": component.color.tolist(),
        "half_width_deg": None if component.half_width is None else float(np.degrees(component.half_width)),
        "alpha": component.alpha,
        "kappa": component.kappa,
        "f0": None if component.f0 is None else component.f0.tolist(),
        "f90": component.f90,
        "lobe": {"theta_diff_deg": list(LOBE_THETA_DIFF), "height": height.tolist()},
        "ranges": ranges | {"half_width_deg": None if widths is None else np.degrees(widths).tolist()},
    }


def ranges_in(document: Mapping[str, Any]) -> ComponentRanges:
    """Return the ranges in a component's document, but for rounding.

    Raises ModelFormatError if they are damaged, KeyError or TypeError if there are none.
    """
    ranges = dict(document["ranges"])
    widths = ranges.pop("half_width_deg")
    stored: ComponentRanges = typed(
        ComponentRanges, ranges | {"half_width": None if widths is None else np.radians(widths).tolist()}, "ranges"
    )
    return stored
