"""Figure 3: a sphere taken apart into the lobes of a 3-lobe fit, beside the components of the default fit.

Each row: the data; the paper's procedure with 3 lobes and its lobes by falling kappa (the delta term is shown with the
first); the default fit and those of specular spike, specular lobe and diffuse part that it has. One exposure a row.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.paper.base import (
    Claim,
    Computed,
    Material,
    Numbers,
    Row,
    draw_sphere,
    new_figure,
    preferred,
    sphere,
    to_bytes,
)
from dsbrdf import DSBRDF, Component, decompose
from dsbrdf.components import LABELS
from dsbrdf.rendering import exposure, sphere_normals

PREFERRED = (
    "nickel",
    "brass",
    "specular-blue-phenolic",
    "specular-orange-phenolic",
    "red-plastic",
    "satin_purple",
    "ilm_l3_37_matte",
    "vch_golden_yellow",
)
PARTS = ("lobe 1", "lobe 2", "lobe 3", *(label.replace("_", " ") for label in LABELS))
_N_MATERIALS = 8
_SIZE = 128
_MIN_COLOURED_ALBEDO_FRACTION = 0.02  # The colour of a darker part cannot be seen.
_MIN_SATURATION_OF_COLOURED = 0.4
_MAX_SATURATION_OF_GREY = 0.2


def choose(materials: Sequence[Material]) -> list[Material]:
    """Choose the materials of the figure."""
    return preferred(materials, PREFERRED, _N_MATERIALS)


def measure(material: Material) -> Numbers:
    """Spheres and albedo at 30 degrees of the data, both fits and their parts, in the order of the picture."""
    paper, default = material.fit(method="paper", n_lobes=3).model, material.fit().model
    lobes = [paper.select((k,), with_delta=k == 0) for k in range(paper.n_lobes)]
    found = decompose(default)
    components = [found[label] if label in found.labels else default.select((), with_delta=False) for label in LABELS]
    measured = sphere(material.measurement, _SIZE)
    factor = exposure(measured, sphere_normals(_SIZE)[1])
    models = [paper, *lobes, default, *components]  # black where a component is absent
    pictures = [measured, *(sphere(model, _SIZE) for model in models)]
    return {
        "spheres": np.stack([to_bytes(picture, factor) for picture in pictures]),
        "albedo": np.array([_albedo(model) for model in models]),
    }


def _albedo(part: DSBRDF | Component) -> NDArray[np.float64]:
    """Directional albedo at 30 degrees, RGB, shape (3,)."""
    angle = np.radians(30.0)
    return part.albedo(angle) if isinstance(part, DSBRDF) else part.directional_albedo(angle)


def saturation(albedo: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 1 - smallest / largest channel, 0 for grey or black and 1 for a pure colour; shapes (..., 3) and (...)."""
    largest = albedo.max(axis=-1)
    return (largest - albedo.min(axis=-1)) / np.where(largest > 0.0, largest, 1.0)


def _parts(one: Computed) -> dict[str, NDArray[np.float64]]:
    """Albedo of the parts with light by name: lobes, then components."""
    albedo = one["albedo"]
    parts = zip(PARTS, [*albedo[1:4], *albedo[5:8]], strict=True)
    return {name: values for name, values in parts if values.any()}


def table(computed: Sequence[Computed]) -> list[Row]:
    """Return the rows of the table."""
    rows: list[Row] = []
    for one in computed:
        for name, albedo in _parts(one).items():
            whole = one["albedo"][0 if name.startswith("lobe ") else 4]
            colours = dict(zip(("albedo_red", "albedo_green", "albedo_blue"), albedo.tolist(), strict=True))
            share = float(albedo.sum() / whole.sum())
            parts = {"share_of_albedo": share, "saturation": float(saturation(albedo))}
            rows.append({"material": one.name, "data": one.data, "part": name, **colours, **parts})
    return rows


def draw(computed: Sequence[Computed]) -> Figure:
    """Draw the figure."""
    figure = new_figure("Figure 3: parts of a sphere", 13.0, 1.6 * len(computed) + 0.5)
    names = ("data", "paper, 3 lobes", *PARTS[:3], "default fit", *PARTS[3:])
    axes = figure.subplots(len(computed), len(names), squeeze=False)
    for number, (row, one) in enumerate(zip(axes, computed, strict=True)):
        for ax, name, picture in zip(row, names, one["spheres"], strict=True):
            draw_sphere(ax, picture, "" if number else name)
            for image in ax.images:
                image.set_visible(bool(picture.any()))  # an absent component has no panel, but its column a title
        row[0].set_ylabel(one.label, fontsize=7)
    return figure


def _is_split(one: Computed, bright: Sequence[str], coloured: str) -> bool | None:
    """Whether colour sits in one part only; None for a material whose fit has no coloured part worth the name."""
    parts = _parts(one)
    total = sum(parts[name].sum() for name in (*bright, coloured) if name in parts)
    seen = [
        name
        for name in (*bright, coloured)
        if name in parts and parts[name].sum() > _MIN_COLOURED_ALBEDO_FRACTION * total
    ]
    found = {name: float(saturation(parts[name])) for name in seen}
    if max(found.values()) < _MIN_SATURATION_OF_COLOURED:
        return None
    return found.get(coloured, 0.0) >= _MIN_SATURATION_OF_COLOURED and all(
        found[name] < _MAX_SATURATION_OF_GREY for name in bright if name in found
    )


def _count(computed: Sequence[Computed], bright: Sequence[str], coloured: str) -> tuple[int, int]:
    """Number of materials whose colour sits in one part, and of those with colour."""
    answers = [_is_split(one, bright, coloured) for one in computed]
    return answers.count(True), len(answers) - answers.count(None)


def claims(computed: Sequence[Computed]) -> list[Claim]:
    """Judge the sentences of the paper."""
    split, of = _count(computed, PARTS[:2], PARTS[2])
    split_default, of_default = _count(computed, PARTS[3:5], PARTS[5])
    listed = "; ".join(
        f"{one.label} {', '.join(f'{name} {float(saturation(albedo)):.2f}' for name, albedo in _parts(one).items())}"
        for one in computed
    )
    return [
        Claim(
            "For materials with some matte appearance the 3rd lobe solely encodes the colour of the material.",
            "agrees" if of and split == of else "agrees in part" if split else "differs",
            f"Saturation of at least {_MIN_SATURATION_OF_COLOURED} in the last part and below"
            f" {_MAX_SATURATION_OF_GREY} in the others: on {split} of {of} coloured materials for"
            f" the 3 lobes of the paper's procedure, on {split_default} of {of_default} for the components of the"
            " default fit. Metals and effect paints are counted too: their highlights are coloured,"
            " and the sentence cannot hold for them. The paper's lobes are sorted by kappa, slice by slice and channel"
            f" by channel, and nothing else holds them together. Saturation of the parts: {listed}.",
        ),
        Claim(
            "Such a decomposition cannot be achieved with non-parametric models.",
            "agrees",
            "A table has no parts; the paper's fit is a sum of lobes, and every model, by lobes that are fitted to its"
            " values, a sum of components; the parts are non-negative and add up to the fit exactly.",
        ),
    ]
