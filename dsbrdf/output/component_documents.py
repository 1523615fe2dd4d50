"""Convert components to JSON documents and back, for the command line, stored fits and the HTTP service.

Angles in the documents are in degrees.
"""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from dsbrdf.components.component import Component
from dsbrdf.components.decomposition import decompose
from dsbrdf.components.description import Description
from dsbrdf.components.shares import ComponentRanges
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.output.typed_json import typed

LOBE_THETA_DIFF = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0)
"""Angles theta_diff [degrees] for which a document lists the component's values at theta_half = 0."""


def component_documents(model: DSBRDF) -> list[dict[str, Any]]:
    """Return the JSON documents of a model's components, the narrowest component first."""
    return [component_document(component) for component in decompose(model)]


def component_document(component: Component) -> dict[str, Any]:
    """Return the JSON document of one component: its fraction of the light, layers, surfaces, misfit and ranges."""
    width = component.half_width
    return {
        "label": component.label,
        "structure": component.structure,
        "light_share": component.light_share,
        "albedo": component.albedo.tolist(),
        "color": component.color.tolist(),
        "half_width_deg": None if width is None else float(np.degrees(width)),
        "layers": asdict(component.layers)["layers"],
        "surfaces": [asdict(surface) for surface in component.surfaces],
        "misfit": asdict(component.misfit),
        "remarks": list(component.remarks),
        "lobe": {
            "theta_diff_deg": list(LOBE_THETA_DIFF),
            "height": component.height(np.radians(LOBE_THETA_DIFF)).tolist(),
        },
        "ranges": asdict(component.ranges),
    }


def ranges_in(document: Mapping[str, Any]) -> ComponentRanges:
    """Read the 90 % ranges from a component's document.

    Raises ModelFormatError if the ranges are damaged, KeyError if the document has no ranges, and TypeError if the
    document is no mapping.
    """
    ranges: ComponentRanges = typed(ComponentRanges, document["ranges"], "ranges")
    return ranges


def description_in(document: Mapping[str, Any]) -> Description:
    """Read layers, surfaces and misfit from a component's document; raise the same errors as `ranges_in`."""
    parts = {name: document[name] for name in ("surfaces", "misfit")} | {"layers": {"layers": document["layers"]}}
    description: Description = typed(Description, parts, "description")
    return description
