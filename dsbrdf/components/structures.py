"""List the structures of layers that materials have.

A price is added to the cost (see `layer_fit`) of a structure with more freedom, so that the simplest structure wins
unless the values of the material contradict it.
"""

import itertools
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from dsbrdf.arrays import Array, Indices
from dsbrdf.components.layer_priors import (
    CLEAR_COAT,
    COAT,
    DIELECTRIC,
    FIBRES,
    GROUND,
    HIGHLIGHT,
    HIGHLIGHT_UNDER_COAT,
    INTERREFLECTION,
    INTERREFLECTION_LOG_SCALE,
    INTERREFLECTION_POWER,
    METAL,
    METAL_UNDER_COAT,
    RETRO,
    SHEEN,
    VERY_ROUGH_METAL,
    YARN,
    LayerPrior,
    turning,
)
from dsbrdf.components.layers import ALPHA_INDEX, N_TURNS, LayeredModel, SpecularLayer, TurningLayer

_MAX_START_HALF_WIDTH_DEG = 35.0
_MAX_FIRST_ALPHA_FACTOR = 3.0  # A fit hardly changes the roughness of its start by a larger factor.


@dataclass(frozen=True, eq=False)
class LayerStructure:
    """Describe the layers of a kind of material by U unknowns.

    Attributes
    ----------
    name : str
        The structure in words.
    layers : tuple of LayerPrior
        Priors of the layers of the structure.
    price : float
        Addition to the cost for the structure's freedom.
    starts : tuple of tuple of float
        Start values of the specular layers' half widths, one tuple for each start [degrees].
    interreflects : bool
        Whether the last layer is light reflected several times between the facets of the first layer.
    parent : str or None
        Name of a structure that is fitted before; a fit starts from the half widths of its layers.
    start_factors : tuple of tuple
        For each specular layer, the index of the parent's specular layer and the factor of its half width.
    only_in_ranges : bool
        Whether the structure widens the ranges without taking part in the split, because it is too rare.
    other_sides : tuple of bool or None
        Another answer to `is_diffuse`, for light that may count as specular or as diffuse; half of the draws use it.
    """

    name: str
    layers: tuple[LayerPrior, ...]
    price: float = 0.0
    starts: tuple[tuple[float, ...], ...] = ((),)
    interreflects: bool = False
    parent: str | None = None
    start_factors: tuple[tuple[int, float], ...] = ((0, 1.0),)
    only_in_ranges: bool = False
    other_sides: tuple[bool, ...] | None = None

    @property
    def turns(self) -> bool:
        """Whether the structure is its parent with a surface whose colour may also turn with the angles."""
        return any(layer.kind is TurningLayer for layer in self.layers)

    def turned(self, unknowns: Array) -> Array:
        """Return the unknowns (U,) for the unknowns of the parent, whose colours do not turn."""
        end = next(own.stop for own, layer in zip(self.slices, self.layers, strict=True) if layer.kind is TurningLayer)
        return np.insert(unknowns, end - N_TURNS, np.zeros(N_TURNS))

    def started_from(self, parent: LayeredModel) -> "LayerStructure | None":
        """Return the structure with a start at its parent's half widths; None if these are far below its own bounds."""
        if parent.layers[0].unknowns[ALPHA_INDEX] < self.layers[0].lower[ALPHA_INDEX] - np.log(_MAX_FIRST_ALPHA_FACTOR):
            return None
        widths = [float(np.degrees(one.half_width)) for one in parent.layers if isinstance(one, SpecularLayer)]
        start = tuple(min(widths[number] * factor, _MAX_START_HALF_WIDTH_DEG) for number, factor in self.start_factors)
        return replace(self, starts=(start,))

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        """Slices that divide the unknowns of the structure among its layers."""
        ends = np.cumsum([0, *(layer.mean.size for layer in self.layers)]).tolist()
        return tuple(slice(start, stop) for start, stop in itertools.pairwise(ends))

    @cached_property
    def mean(self) -> Array:
        """Means of the priors of all unknowns (U,)."""
        mean = np.concatenate([layer.mean for layer in self.layers])
        if self.interreflects:
            mean[self.slices[-1]][:3] = (
                2.0 * mean[:3] + INTERREFLECTION_POWER * mean[ALPHA_INDEX] + INTERREFLECTION_LOG_SCALE
            )
        return mean

    @cached_property
    def root(self) -> Array:
        """Matrix (U, U) that turns deviations of the unknowns from `mean` into independent numbers of variance 1."""
        root = np.asarray(block_diag(*(layer.root for layer in self.layers)))
        if self.interreflects:
            rows = self.slices[-1].start + np.arange(3)
            own = root[np.ix_(rows, rows)]
            root[np.ix_(rows, np.arange(3))] = -2.0 * own
            root[rows, ALPHA_INDEX] = -INTERREFLECTION_POWER * own.sum(axis=1)
        return root

    @cached_property
    def freedom(self) -> Array:
        """Degrees of freedom of Student's t prior for each of the independent numbers that `root` makes (U,)."""
        return np.concatenate([layer.freedom for layer in self.layers])

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Lower bounds (U,) and upper bounds (U,) of all unknowns."""
        lower, upper = zip(*((layer.lower, layer.upper) for layer in self.layers), strict=True)
        return np.concatenate(lower), np.concatenate(upper)

    @cached_property
    def of_channel(self) -> tuple[Indices, Indices, Indices]:
        """Indices of the unknowns that affect each channel: one channel of each colour, and all other parameters."""
        places = [np.arange(part.start, part.stop) for part in self.slices]
        red, green, blue = (np.concatenate([np.r_[p[channel], p[3:]] for p in places]) for channel in range(3))
        return red, green, blue

    @cached_property
    def log_determinant(self) -> float:
        """Log determinant of the normal equations of the prior without data, at the mean of the prior."""
        return 2.0 * float(np.linalg.slogdet(self.root)[1])

    def model(self, unknowns: Array) -> LayeredModel:
        """Make the layers of the structure from values of the unknowns (U,)."""
        parts = zip(self.layers, self.slices, strict=True)
        return LayeredModel(tuple(layer.kind.from_unknowns(unknowns[part]) for layer, part in parts))

    def of_samples(self, min_half_width: float) -> "LayerStructure":
        """Return the structure for scattered samples, with a lower bound of the half widths of surfaces, as GGX [rad].

        Coats do not refract, because few samples do not tell a refracted highlight from a rougher one.
        """
        min_log_alpha = np.log(np.tan(min_half_width) / np.sqrt(np.sqrt(2.0) - 1.0))
        return replace(self, layers=tuple(layer.unrefracted(min_log_alpha) for layer in self.layers))

    @property
    def is_diffuse(self) -> tuple[bool, ...]:
        """Whether the light of each layer counts as diffuse."""
        return tuple(layer.is_diffuse for layer in self.layers)


_ONE_SURFACE_STARTS_DEG = ((0.3,), (1.5,), (6.0,), (18.0,))
_BOTH = ((0, 1.0), (1, 1.0))  # Both specular layers start from those of the parent.
_TWO_SURFACE_STARTS_DEG = ((0.15, 12.0), (1.0, 6.0), (1.0, 16.0), (4.0, 16.0))

STRUCTURES = (
    LayerStructure("diffuse", (GROUND,)),
    LayerStructure("diffuse with sheen", (GROUND, SHEEN), 2.0),
    LayerStructure("diffuse with retro-reflection", (RETRO, GROUND), 6.0, other_sides=(True, True)),
    LayerStructure("fibres", (FIBRES, YARN), 5.0, other_sides=(False, True)),
    LayerStructure("dielectric over diffuse", (DIELECTRIC, GROUND), 0.0, _ONE_SURFACE_STARTS_DEG),
    LayerStructure("metal", (METAL,), 0.0, _ONE_SURFACE_STARTS_DEG),
    LayerStructure("dielectric", (DIELECTRIC,), 0.0, _ONE_SURFACE_STARTS_DEG, parent="metal"),
    LayerStructure(
        "highlight over diffuse", (HIGHLIGHT, GROUND), 6.0, _ONE_SURFACE_STARTS_DEG, parent="dielectric over diffuse"
    ),
    LayerStructure(
        "coat over highlight over diffuse", (COAT, HIGHLIGHT_UNDER_COAT, GROUND), 8.0, _TWO_SURFACE_STARTS_DEG
    ),
    LayerStructure("coat over metal", (COAT, METAL_UNDER_COAT), 2.0, _TWO_SURFACE_STARTS_DEG),
    LayerStructure(
        "two highlights over diffuse",
        (COAT, DIELECTRIC, GROUND),
        2.0,
        _TWO_SURFACE_STARTS_DEG,
        parent="coat over highlight over diffuse",
        start_factors=_BOTH,
    ),
)
"""Usual structures; a parent stands before the structure that starts from it."""

RARE_STRUCTURES = (
    LayerStructure(
        "dielectric over diffuse with sheen", (DIELECTRIC, GROUND, SHEEN), 4.0, parent="dielectric over diffuse"
    ),
    LayerStructure(
        "dielectric over diffuse with retro-reflection",
        (DIELECTRIC, RETRO, GROUND),
        6.0,
        parent="dielectric over diffuse",
    ),
    LayerStructure("metal with interreflection", (METAL, INTERREFLECTION), 2.0, interreflects=True, parent="metal"),
    LayerStructure(
        "very rough metal",
        (VERY_ROUGH_METAL, INTERREFLECTION),
        6.0,
        interreflects=True,
        parent="metal",
        only_in_ranges=True,
    ),
    LayerStructure("metal of two roughnesses", (METAL, METAL), 4.0, ((1.0, 8.0), (4.0, 16.0))),
    LayerStructure(
        "two coloured highlights over diffuse",
        (HIGHLIGHT, HIGHLIGHT, GROUND),
        12.0,
        parent="metal of two roughnesses",
        start_factors=_BOTH,
    ),
    LayerStructure("metal of turning colour", (turning(METAL),), 6.0, parent="metal"),
    LayerStructure(
        "highlight of turning colour over diffuse", (turning(HIGHLIGHT), GROUND), 12.0, parent="highlight over diffuse"
    ),
    LayerStructure(
        "coat over metal of turning colour",
        (COAT, turning(METAL_UNDER_COAT)),
        8.0,
        parent="coat over metal",
        start_factors=_BOTH,
    ),
    LayerStructure(
        "coat over highlight of turning colour over diffuse",
        (COAT, turning(HIGHLIGHT_UNDER_COAT), GROUND),
        14.0,
        parent="coat over highlight over diffuse",
        start_factors=_BOTH,
    ),
    LayerStructure(
        "coat over flakes of two scales over diffuse",
        (CLEAR_COAT, HIGHLIGHT_UNDER_COAT, HIGHLIGHT_UNDER_COAT, GROUND),
        8.0,
        parent="coat over highlight over diffuse",
        start_factors=((0, 1.0), (1, 0.7), (1, 2.0)),
    ),
)
"""Rare structures; most of them start from the half widths of a usual structure."""
