"""Figure 6: the space of materials, an Isomap embedding of the parameters of 3-lobe fits.

The coordinates of a material are log(kappa) and log(gamma) of the three lobes of each channel, at theta_diff = 0 (18
numbers, the paper's figure) or at all slices (324 numbers). Logarithms, because both run over orders of magnitude;
every coordinate is divided by its standard deviation over the materials.

Isomap embeddings of the parameters of the paper's procedure with 3 lobes, a sphere of the data at the place of each
material. Above: parameters at theta_diff = 0, as in the paper. Below: those of all slices. Glossier materials are to
the right.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.offsetbox import AnnotationBbox, OffsetImage
from scipy.spatial.distance import cdist

from benchmarks.paper.base import (
    Claim,
    Computed,
    Material,
    Numbers,
    Row,
    new_figure,
    sphere,
    to_bytes,
)
from dsbrdf.arrays import Array
from dsbrdf.rendering import exposure, sphere_normals

SPACES = ("theta_diff_0", "all_slices")
_N_LOBES = 3
_SIZE = 64
_NEIGHBORS = 7
_N_NEAREST = 3
# Lobes beyond these ranges all look flat, dark or like a mirror.
_KAPPA_RANGE = (1e-3, 20.0)
_GAMMA_RANGE = (1e-2, 1e5)


def choose(materials: Sequence[Material]) -> list[Material]:
    """Choose all materials."""
    return list(materials)


def measure(material: Material) -> Numbers:
    """Log kappa and log gamma (3, 18, K, 2), a sphere, and how glossy and how bright the material is."""
    model = material.fit(method="paper", n_lobes=_N_LOBES).model
    kappa, gamma = np.clip(model.kappa, *_KAPPA_RANGE), np.clip(model.gamma, *_GAMMA_RANGE)
    picture = sphere(material.measurement, _SIZE)
    mirror, aside = (material.fit().model.evaluate(np.radians(angle), 0.0).mean() for angle in (0.0, 45.0))
    return {
        "parameters": np.log(np.stack([kappa, gamma], axis=-1)),
        "sphere": to_bytes(picture, exposure(picture, sphere_normals(_SIZE)[1])),
        "gloss": np.array(np.log10(mirror / max(aside, 1e-9))),
    }


def features(computed: Sequence[Computed], space: str) -> Array:
    """Coordinates of the materials, shape (materials, numbers), each with standard deviation 1."""
    slices = slice(0, 1) if space == SPACES[0] else slice(None)
    rows = np.array([one["parameters"][:, slices].ravel() for one in computed])
    deviation = rows.std(axis=0)
    return (rows - rows.mean(axis=0)) / np.where(deviation > 0.0, deviation, 1.0)


def embedding(computed: Sequence[Computed], space: str) -> Array:
    """Isomap embedding (materials, 2); the first axis points to the glossier materials."""
    from sklearn.manifold import Isomap  # type: ignore[import-untyped]  # takes a second to import

    neighbors = min(_NEIGHBORS, len(computed) - 1)
    places: Array = Isomap(n_neighbors=neighbors, n_components=2).fit_transform(features(computed, space))
    if places[:, 0] @ _gloss(computed) < 0.0:
        places[:, 0] *= -1.0
    return places


def nearest(computed: Sequence[Computed], space: str) -> list[list[int]]:
    """Indices of the 3 nearest materials of each, by the distance of the coordinates themselves."""
    rows = features(computed, space)
    order = np.argsort(cdist(rows, rows), axis=1)
    return [[other for other in line if other != own][:_N_NEAREST] for own, line in enumerate(order.tolist())]


def _gloss(computed: Sequence[Computed]) -> Array:
    """Log10 of the peak over the value at 45 degrees, minus its mean."""
    gloss = np.array([float(one["gloss"]) for one in computed])
    return gloss - gloss.mean()


def table(computed: Sequence[Computed]) -> list[Row]:
    """Return the rows of the table."""
    places = {space: embedding(computed, space) for space in SPACES}
    near = {space: nearest(computed, space) for space in SPACES}
    return [
        {
            "material": one.name,
            "data": one.data,
            "gloss": float(one["gloss"]),
            **{
                f"{axis}_{space}": places[space][index, number]
                for space in SPACES
                for number, axis in enumerate(("x", "y"))
            },
            **{f"nearest_{space}": " ".join(computed[other].name for other in near[space][index]) for space in SPACES},
        }
        for index, one in enumerate(computed)
    ]


def draw(computed: Sequence[Computed]) -> Figure:
    """Draw the figure."""
    figure = new_figure("Figure 6: the space of materials (Isomap of 3-lobe parameters)", 12.0, 13.5)
    titles = ("theta_diff = 0: 18 numbers a material", "all slices: 324 numbers a material")
    for ax, space, title in zip(figure.subplots(2, 1), SPACES, titles, strict=True):
        _draw_space(ax, computed, embedding(computed, space))
        ax.set_title(title, fontsize=9)
    return figure


def _draw_space(ax: Axes, computed: Sequence[Computed], places: Array) -> None:
    _, mask = sphere_normals(_SIZE)
    ax.plot(*places.T, ".", color="white")  # sets the limits
    ax.margins(0.05)
    for one, place in zip(computed, places, strict=True):
        picture = np.dstack([one["sphere"], 255 * mask.astype(np.uint8)])
        ax.add_artist(AnnotationBbox(OffsetImage(picture, zoom=0.42), place, frameon=False))
        name = one.label.partition("_")[2] or one.label
        ax.annotate(name, place, (0, -15), textcoords="offset points", ha="center", va="top", fontsize=5)
    ax.tick_params(labelsize=7)


def claims(computed: Sequence[Computed]) -> list[Claim]:
    """Judge the sentences of the paper."""
    gloss = _gloss(computed)
    found: dict[str, Any] = {}
    for space in SPACES:
        places = embedding(computed, space)
        found[space] = [abs(_rank_correlation(places[:, axis], gloss)) for axis in range(2)]
    first, second = found[SPACES[0]]
    matte = gloss < np.quantile(gloss, 0.25)
    places = embedding(computed, SPACES[0])
    spread = [float(np.linalg.norm(places[chosen].std(axis=0))) for chosen in (matte, ~matte)]
    alike = _share_alike(computed, nearest(computed, SPACES[0]))
    return [
        Claim(
            "The embedding lays out a spectrum of materials by their specularity in the horizontal direction.",
            "agrees" if first > 0.8 else "agrees in part" if first > 0.4 else "differs",
            f"Rank correlation of the first coordinate with gloss (log10 of the peak over the value at 45 degrees):"
            f" {first:.2f}, of the second {second:.2f}. With the parameters of all slices:"
            f" {found[SPACES[1]][0]:.2f} and {found[SPACES[1]][1]:.2f}.",
        ),
        Claim(
            "A dense cluster on the left contains most purely matte materials.",
            "agrees" if spread[0] < 0.5 * spread[1] else "agrees in part" if spread[0] < spread[1] else "differs",
            f"Spread (standard deviation) of the least glossy quarter {spread[0]:.2f}, of the others {spread[1]:.2f}.",
        ),
        Claim(
            "The parameters characterize the space of materials.",
            "agrees" if alike > 0.5 else "agrees in part",
            f"For {alike:.0%} of the materials the nearest one differs in gloss by less than a quarter of a decade;"
            " the CSV file lists the three nearest of each.",
        ),
    ]


def _rank_correlation(first: Array, second: Array) -> float:
    """Spearman's coefficient of numbers that all differ."""
    apart = np.argsort(np.argsort(first)) - np.argsort(np.argsort(second))
    return float(1.0 - 6.0 * np.sum(apart**2) / (first.size * (first.size**2 - 1)))


def _share_alike(computed: Sequence[Computed], near: list[list[int]]) -> float:
    gloss = _gloss(computed)
    return float(np.mean([abs(gloss[own] - gloss[others[0]]) < 0.25 for own, others in enumerate(near)]))
