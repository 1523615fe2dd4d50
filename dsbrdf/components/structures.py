"""List the structures of layers that materials have, with a prior on the parameters of each layer.

The prior of a layer is a distribution of its unknowns (see `layers`). The mean of the logarithms of a colour's channels
has a Student's t prior with 4 degrees of freedom, whose heavy tails admit unusual materials. The differences between
the channels have a Gaussian prior, because a dielectric highlight is neutral. All other unknowns are independent, with
a Student's t prior of 4 degrees of freedom.

A price is added to the cost (see `layer_fit`) of a structure with more freedom, so that the simplest structure wins
unless the values of the material contradict it.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
from scipy.linalg import block_diag

from dsbrdf.arrays import Array, Indices
from dsbrdf.components.layers import DiffuseLayer, Layer, LayeredModel, RetroLayer, SheenLayer, SpecularLayer

_STUDENT_T_FREEDOM = 4.0
_GAUSSIAN_FREEDOM = 1e9  # With so many degrees of freedom, Student's t distribution is a Gaussian.
_FIXED_DEVIATION = 1e-3  # A prior with this standard deviation practically fixes an unknown.
_CHANNEL_CONTRASTS = np.array([[1.0, 1.0, 1.0], [3.0, -3.0, 0.0], [1.0, 1.0, -2.0]]) / np.sqrt([[9.0], [18.0], [6.0]])
"""Matrix from three log channels of a colour to their mean and two normalised differences."""
_RISE_AXES = np.array([[-0.6, 0.8], [0.8, 0.6]])
"""Axes of the plane of the exponents q1 and q2, in which glass is at 0, and Schlick's law at 1.5 on the first axis."""

Pair: TypeAlias = tuple[float, float]
"""Mean and standard deviation of an unknown, or its lower and upper bound."""


@dataclass(frozen=True, eq=False)
class LayerPrior:
    """The prior on the U unknowns of a layer."""

    kind: type[Layer]
    is_diffuse: bool
    mean: Array
    root: Array  # matrix (U, U) that turns unknowns minus their prior mean into independent numbers of variance 1
    freedom: Array  # degrees of freedom of Student's t distribution for each of these numbers
    lower: Array
    upper: Array


def _prior(
    kind: type[Layer],
    color: Pair,
    tint: float,
    others: Sequence[Pair],
    bounds: Sequence[Pair],
    *,
    is_diffuse: bool = True,
) -> LayerPrior:
    """Make the prior of a layer.

    `color` is the prior of the mean log colour, `tint` the standard deviation of differences between channels, and
    `others` the priors of the other unknowns. `bounds` are the bounds of the log colour and of the other unknowns.
    """
    means, deviations = np.array(others).T
    lower, upper = np.array([bounds[0]] * 3 + list(bounds[1:])).T
    colors = _CHANNEL_CONTRASTS / np.array([[color[1]], [tint], [tint]])
    whiten = np.diag(1.0 / deviations)
    if kind is SpecularLayer:
        whiten[1:3, 1:3] = whiten[1:3, 1:3] @ _RISE_AXES
    return LayerPrior(
        kind,
        is_diffuse,
        np.concatenate([np.full(3, color[0]), means]),
        block_diag(colors, whiten),
        np.concatenate(
            [[_STUDENT_T_FREEDOM, _GAUSSIAN_FREEDOM, _GAUSSIAN_FREEDOM], np.full(means.size, _STUDENT_T_FREEDOM)]
        ),
        lower,
        upper,
    )


_DIELECTRIC_LOG_F0_BOUNDS = (-12.0, np.log(0.2))  # Diamond, the brightest dielectric, has F0 = 0.17.
_LOG_F0_BOUNDS = (-12.0, np.log(3.0))
_RISE_PRIOR = ((0.0, 1.0), (0.0, 0.15))  # priors of a surface's exponents q1 and q2, along two axes of their plane
# Bounds of log F90, q1, q2, log alpha, log tau, masking and under_coat, the unknowns of a surface after its colour.
_SPECULAR_BOUNDS = (
    (-5.0, 0.0), (-1.5, 1.5), (-1.5, 1.5), (np.log(0.002), np.log(0.7)), (np.log(0.6), np.log(60.0)),
    (-0.5, 1.5), (-0.5, 2.0),
)  # fmt: skip


def _specular(color: Pair, tint: float, *, strength: Pair = _LOG_F0_BOUNDS, under_coat: bool = False) -> LayerPrior:
    """Make the prior of a surface up to roughness 0.7; a rougher surface looks like a matte ground."""
    bounds = (strength, *_SPECULAR_BOUNDS)
    others = (
        (-0.1, 0.4),  # log F90
        *_RISE_PRIOR,
        (np.log(0.12), 1.5),  # log alpha
        (np.log(2.0), 0.5),  # log tau; a tail exponent of 2 makes GGX
        (0.5, 0.3),  # masking
        (1.0, 0.3) if under_coat else (0.0, _FIXED_DEVIATION),
    )
    return _prior(SpecularLayer, color, tint, others, bounds, is_diffuse=False)


def _diffuse(exponents: Sequence[Pair]) -> LayerPrior:
    bounds = ((-14.0, np.log(2.0)), (-1.0, 2.0), (-1.0, 2.0), (-2.5, 4.0), (-1.0, 2.0), (-2.5, 2.5), (-1.0, 1.5))
    return _prior(DiffuseLayer, (np.log(0.15), 1.5), 1.0, exponents, bounds)


_DIELECTRIC = _specular((np.log(0.045), 0.35), 0.03, strength=_DIELECTRIC_LOG_F0_BOUNDS)
_COAT = _specular((np.log(0.045), 0.35), 0.03)  # The bounds of F0 include the peak of a metal with haze.
_CLEAR_COAT = replace(_COAT, upper=np.where(np.arange(_COAT.upper.size) == 6, np.log(0.08), _COAT.upper))
"""Prior of a clear coat whose alpha is at most 0.08, so that the coat is smoother than the layer below it."""
_METAL = _specular((np.log(0.6), 0.6), 1.0)
_VERY_ROUGH_METAL = replace(
    _METAL,
    lower=np.where(np.arange(_METAL.lower.size) == 6, np.log(0.6), _METAL.lower),
    upper=np.where(np.arange(_METAL.upper.size) == 6, 0.0, _METAL.upper),
)
"""Prior of a metal whose alpha is between 0.6 and 1, which looks like a matte ground."""
_METAL_UNDER_COAT = _specular((np.log(0.6), 0.6), 1.0, under_coat=True)
_HIGHLIGHT = _specular((np.log(0.5), 0.8), 0.7)
_HIGHLIGHT_UNDER_COAT = _specular((np.log(0.15), 1.2), 0.7, under_coat=True)
_GROUND = _diffuse(((0.5, 0.5), (0.0, 0.4), (0.0, 0.4), (0.0, 0.3), (0.0, 0.25), (0.0, 0.4)))
_YARN = _diffuse(((0.0, 0.2), (0.0, 0.4), (0.0, 0.8), (0.0, 0.4), (0.0, 0.6), (0.0, 0.4)))
_SHEEN = _prior(SheenLayer, (np.log(0.02), 1.5), 0.5, ((2.5, 2.0),) * 2, ((-12.0, 2.0), (0.0, 8.0), (0.0, 8.0)))
_RETRO = _prior(
    RetroLayer, (np.log(0.05), 1.5), 0.5, ((np.log(0.12), 0.5),), ((-12.0, 1.0), (np.log(0.02), np.log(0.4))),
    is_diffuse=False,
)  # fmt: skip
# The fibres of cloth point in all directions, so their surfaces make a rough highlight, which counts as diffuse.
_FIBRES = _prior(
    SpecularLayer, (np.log(0.045), 0.35), 0.05,
    ((-0.1, 0.4), *_RISE_PRIOR, (np.log(0.65), 0.2), (np.log(2.0), 0.2), (1.0, 0.3), (0.0, _FIXED_DEVIATION)),
    (
        _DIELECTRIC_LOG_F0_BOUNDS, *_SPECULAR_BOUNDS[:3], (np.log(0.5), 0.0), (np.log(0.6), np.log(3.0)),
        *_SPECULAR_BOUNDS[5:],
    ),
)  # fmt: skip


_MAX_START_HALF_WIDTH_DEG = 35.0
_MAX_FIRST_ALPHA_FACTOR = 3.0  # A fit hardly changes the roughness of its start by a larger factor.
_INTERREFLECTION_POWER = 2.4  # Light reflected several times between facets grows with this power of alpha.
_INTERREFLECTION_LOG_SCALE = float(np.log(0.106) - _INTERREFLECTION_POWER * np.log(0.3))
_INTERREFLECTION = replace(
    _prior(
        DiffuseLayer,
        (0.0, 0.3),
        0.2,
        ((0.4, 0.2), (-0.1, 0.15), (0.0, 0.1), (0.6, 0.5), (0.2, 0.2), (-0.05, 0.1)),
        ((-14.0, np.log(2.0)), (-1.0, 2.0), (-1.0, 2.0), (-2.5, 4.0), (-1.0, 2.5), (-2.5, 2.5), (-1.0, 1.5)),
    ),
    is_diffuse=False,
    freedom=np.array([_GAUSSIAN_FREEDOM] * 3 + [_STUDENT_T_FREEDOM] * 6),
)
"""Prior of light that leaves a metal after several reflections (Kulla and Conty 2017), whose colour is F0 squared."""


_OWN_SURFACE = _prior(
    SpecularLayer, (np.log(0.15), 2.0), 2.0,
    (
        (-0.1, 0.8), (0.0, 1.5), (0.0, 0.6), (np.log(0.12), 3.0), (np.log(2.0), 1.0), (0.5, 0.4),
        (0.0, _FIXED_DEVIATION),
    ),
    (
        _LOG_F0_BOUNDS, (np.log(0.02), 0.0), (-3.0, 3.0), (-3.0, 3.0), (np.log(0.001), np.log(0.9)),
        (np.log(0.6), np.log(60.0)), (-0.5, 1.5), (0.0, 0.0),
    ),
    is_diffuse=False,
)  # fmt: skip
OWN_PRIORS: dict[type[Layer], LayerPrior] = {
    SpecularLayer: _OWN_SURFACE,
    DiffuseLayer: _diffuse(((0.5, 0.7), (0.0, 0.6), (0.0, 0.6), (0.0, 0.5), (0.0, 0.4), (0.0, 0.6))),
    SheenLayer: _SHEEN,
    RetroLayer: _RETRO,
}
"""Weak priors of layers, for fits to the values of a single component."""


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

    def started_from(self, parent: LayeredModel) -> "LayerStructure | None":
        """Return the structure with a start at its parent's half widths; None if these are far below its own bounds."""
        if parent.layers[0].unknowns[6] < self.layers[0].lower[6] - np.log(_MAX_FIRST_ALPHA_FACTOR):
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
            mean[self.slices[-1]][:3] = 2.0 * mean[:3] + _INTERREFLECTION_POWER * mean[6] + _INTERREFLECTION_LOG_SCALE
        return mean

    @cached_property
    def root(self) -> Array:
        """Matrix (U, U) that turns deviations of the unknowns from `mean` into independent numbers of variance 1."""
        root = np.asarray(block_diag(*(layer.root for layer in self.layers)))
        if self.interreflects:
            rows = self.slices[-1].start + np.arange(3)
            own = root[np.ix_(rows, rows)]
            root[np.ix_(rows, np.arange(3))] = -2.0 * own
            root[rows, 6] = -_INTERREFLECTION_POWER * own.sum(axis=1)
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
        return LayeredModel(
            tuple(
                layer.kind.from_unknowns(unknowns[part]) for layer, part in zip(self.layers, self.slices, strict=True)
            )
        )

    def no_narrower(self, half_width: float) -> "LayerStructure":
        """Return the structure with a lower bound of the half widths of its specular layers, as GGX [rad]."""
        least = np.log(np.tan(half_width) / np.sqrt(np.sqrt(2.0) - 1.0))
        layers = tuple(
            replace(
                layer, lower=np.where(np.arange(layer.lower.size) == 6, np.maximum(layer.lower, least), layer.lower)
            )
            if layer.kind is SpecularLayer
            else layer
            for layer in self.layers
        )
        return replace(self, layers=layers)

    @property
    def is_diffuse(self) -> tuple[bool, ...]:
        """Whether the light of each layer counts as diffuse."""
        return tuple(layer.is_diffuse for layer in self.layers)


_ONE_SURFACE_STARTS_DEG = ((0.3,), (1.5,), (6.0,), (18.0,))
_TWO_SURFACE_STARTS_DEG = ((0.15, 12.0), (1.0, 6.0), (1.0, 16.0), (4.0, 16.0))

STRUCTURES = (
    LayerStructure("diffuse", (_GROUND,)),
    LayerStructure("diffuse with sheen", (_GROUND, _SHEEN), 2.0),
    LayerStructure("diffuse with retro-reflection", (_RETRO, _GROUND), 6.0, other_sides=(True, True)),
    LayerStructure("fibres", (_FIBRES, _YARN), 5.0, other_sides=(False, True)),
    LayerStructure("dielectric over diffuse", (_DIELECTRIC, _GROUND), 0.0, _ONE_SURFACE_STARTS_DEG),
    LayerStructure("metal", (_METAL,), 0.0, _ONE_SURFACE_STARTS_DEG),
    LayerStructure("dielectric", (_DIELECTRIC,), 0.0, _ONE_SURFACE_STARTS_DEG, parent="metal"),
    LayerStructure(
        "highlight over diffuse", (_HIGHLIGHT, _GROUND), 6.0, _ONE_SURFACE_STARTS_DEG, parent="dielectric over diffuse"
    ),
    LayerStructure(
        "coat over highlight over diffuse", (_COAT, _HIGHLIGHT_UNDER_COAT, _GROUND), 8.0, _TWO_SURFACE_STARTS_DEG
    ),
    LayerStructure("coat over metal", (_COAT, _METAL_UNDER_COAT), 2.0, _TWO_SURFACE_STARTS_DEG),
    LayerStructure(
        "two highlights over diffuse",
        (_COAT, _DIELECTRIC, _GROUND),
        2.0,
        _TWO_SURFACE_STARTS_DEG,
        parent="coat over highlight over diffuse",
        start_factors=((0, 1.0), (1, 1.0)),
    ),
)
"""Usual structures; a parent stands before the structure that starts from it."""

RARE_STRUCTURES = (
    LayerStructure(
        "dielectric over diffuse with sheen", (_DIELECTRIC, _GROUND, _SHEEN), 4.0, parent="dielectric over diffuse"
    ),
    LayerStructure(
        "dielectric over diffuse with retro-reflection",
        (_DIELECTRIC, _RETRO, _GROUND),
        6.0,
        parent="dielectric over diffuse",
    ),
    LayerStructure("metal with interreflection", (_METAL, _INTERREFLECTION), 2.0, interreflects=True, parent="metal"),
    LayerStructure(
        "very rough metal",
        (_VERY_ROUGH_METAL, _INTERREFLECTION),
        6.0,
        interreflects=True,
        parent="metal",
        only_in_ranges=True,
    ),
    LayerStructure("metal of two roughnesses", (_METAL, _METAL), 4.0, ((1.0, 8.0), (4.0, 16.0))),
    LayerStructure(
        "two coloured highlights over diffuse",
        (_HIGHLIGHT, _HIGHLIGHT, _GROUND),
        12.0,
        parent="metal of two roughnesses",
        start_factors=((0, 1.0), (1, 1.0)),
    ),
    LayerStructure(
        "coat over flakes of two scales over diffuse",
        (_CLEAR_COAT, _HIGHLIGHT_UNDER_COAT, _HIGHLIGHT_UNDER_COAT, _GROUND),
        12.0,
        parent="coat over highlight over diffuse",
        start_factors=((0, 1.0), (1, 0.7), (1, 2.0)),
    ),
)
"""Rare structures; most of them start from the half widths of a usual structure."""
