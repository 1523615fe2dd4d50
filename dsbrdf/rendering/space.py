"""Map the space of materials by their visual distances (Nishino 2009, section 7).

The paper maps materials by their parameters, which requires equal numbers of lobes and equal slices. Here the distance
of two materials is the difference of their lit spheres, under three lights and under a sky. Therefore any models and
measurements can be compared, and invisible parameters have no effect. Colour and brightness have no effect either, as
in the paper, which maps the shapes of lobes: the luminance of a sphere is divided by its mean. The cube root of this
luminance, similar to CIE L*, is compared, so that neither highlights nor dark parts dominate.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import connected_components, shortest_path
from scipy.spatial.distance import cdist

from dsbrdf.arrays import Array
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.rendering.environment import LUMINANCE
from dsbrdf.rendering.sphere import LIGHTINGS, Source, render_sphere, sphere_normals

MEAN_LUMINANCE = 0.2
"""Every sphere is scaled to this mean luminance, about the mean of a white sphere under three lights."""
_SPHERE_SIZE_PX = 48
_MIN_NEIGHBORS = 7  # The graph of Isomap has at least this number of edges at each material.
_MIN_EDGE_LENGTH = 1e-6  # Shorter edges of the graph are lengthened, because SciPy ignores edges below 1e-8.


@dataclass(frozen=True, eq=False)
class MaterialSpace:
    """Materials, their distances and their coordinates on a map.

    Attributes
    ----------
    names : tuple of str
    distance : ndarray, shape (n, n)
        Root mean square difference in lightness between the spheres of two materials; white has lightness 1.
    places : ndarray, shape (n, 2)
        Coordinates on a map that preserves distances along chains of neighbours; the first increases with gloss.
    """

    names: tuple[str, ...]
    distance: Array
    places: Array

    def nearest(self, name: str, count: int = 3) -> list[tuple[str, float]]:
        """Return the `count` nearest materials with their likeness [dB], which is 20 dB for a distance of 0.1.

        Raises InvalidArgumentError if the space has no such name.
        """
        if name not in self.names:
            raise InvalidArgumentError(f"the space has no material {name!r}")
        row = self.distance[self.names.index(name)]
        others = [index for index in np.argsort(row, kind="stable").tolist() if self.names[index] != name]
        with np.errstate(divide="ignore"):
            return [(self.names[index], float(-20.0 * np.log10(row[index]))) for index in others[:count]]


def space(models: Mapping[str, Source]) -> MaterialSpace:
    """Compare materials by their lit spheres, and compute a map of the materials.

    Parameters
    ----------
    models : mapping of str to DSBRDF, FitResult, Measurement or another source of `render_sphere`
        Materials by their names.

    Raises
    ------
    InvalidArgumentError
        If there are no materials, or a material reflects no light.
    """
    if not models:
        raise InvalidArgumentError("a space needs at least one material")
    _, mask = sphere_normals(_SPHERE_SIZE_PX)
    lightness = []
    for name, model in models.items():
        spheres = (render_sphere(model, lighting=lighting, size=_SPHERE_SIZE_PX) for lighting in LIGHTINGS)
        rows = [sphere[mask] @ LUMINANCE for sphere in spheres]
        if not all(row.mean() > 0.0 for row in rows):
            raise InvalidArgumentError(f"{name}: the material reflects no light; leave it out")
        lightness.append(np.concatenate([np.cbrt(MEAN_LUMINANCE * row / row.mean()) for row in rows]))
    seen = np.array(lightness)
    distance = cdist(seen, seen) / np.sqrt(seen.shape[1])
    return MaterialSpace(tuple(models), distance, _places(distance, gloss=seen.max(axis=1)))


def _places(distance: Array, gloss: Array) -> Array:
    """Return the map (n, 2) of Isomap (Tenenbaum, de Silva and Langford 2000): classical scaling of shortest paths."""
    count = len(distance)
    places = np.zeros((count, 2))
    # Neighbours are added until the graph is connected, because separate parts would have no distance.
    for neighbors in range(min(_MIN_NEIGHBORS, count - 1), count):
        farthest = np.sort(distance, axis=1)[:, neighbors, np.newaxis]
        graph = np.where(distance <= farthest, np.maximum(distance, _MIN_EDGE_LENGTH), 0.0)
        if connected_components(graph, directed=False)[0] == 1:
            break
    squared = shortest_path(graph, directed=False) ** 2
    centered = squared - squared.mean(axis=0) - squared.mean(axis=1)[:, np.newaxis] + squared.mean()
    sizes, axes = np.linalg.eigh(-0.5 * centered)
    found = (axes * np.sqrt(np.maximum(sizes, 0.0)))[:, ::-1][:, :2]
    places[:, : found.shape[1]] = found
    # The signs of eigenvectors are arbitrary, so gloss and the order of the materials determine the signs.
    reference = np.stack([gloss - gloss.mean(), np.arange(count) - (count - 1) / 2.0], axis=1)
    return places * np.where(np.sum(places * reference, axis=0) < 0.0, -1.0, 1.0)
