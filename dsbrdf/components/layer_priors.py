"""Define the priors on the parameters of each kind of layer.

The prior of a layer is a distribution of its unknowns (see `layers`). The mean of the logarithms of a colour's channels
has a Student's t prior with 4 degrees of freedom, whose heavy tails admit unusual materials. The differences between
the channels have a Gaussian prior, because a dielectric highlight is neutral. All other unknowns are independent, with
a Student's t prior of 4 degrees of freedom.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from scipy.linalg import block_diag

from dsbrdf.arrays import Array
from dsbrdf.components.layers import (
    ALPHA_INDEX,
    CONTRASTS,
    N_TURNS,
    DiffuseLayer,
    Layer,
    RetroLayer,
    SheenLayer,
    SpecularLayer,
    TurningLayer,
)

_STUDENT_T_FREEDOM = 4.0
_GAUSSIAN_FREEDOM = 1e9  # With so many degrees of freedom, Student's t distribution is a Gaussian.
_FIXED_DEVIATION = 1e-3  # A prior with this standard deviation practically fixes an unknown.
_RISE_AXES = np.array([[-0.6, 0.8], [0.8, 0.6]])
"""Axes of the plane of the exponents q1 and q2; on the first axis, the reflectance of a metal falls before it rises."""

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

    def unrefracted(self, min_log_alpha: float = -np.inf) -> "LayerPrior":
        """Return the prior with a minimum roughness and without refraction, if the layer is a surface."""
        if not issubclass(self.kind, SpecularLayer):
            return self
        is_alpha, is_refraction = (np.arange(self.mean.size) == index for index in (ALPHA_INDEX, 11))
        return replace(
            self,
            mean=np.where(is_refraction, 0.0, self.mean),
            root=np.where(is_refraction, np.eye(self.mean.size) / _FIXED_DEVIATION, self.root),
            lower=np.where(is_alpha, np.maximum(self.lower, min_log_alpha), self.lower),
        )


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
    colors = np.vstack([np.full((1, 3), 1.0 / 3.0) / color[1], CONTRASTS / tint])
    whiten = np.diag(1.0 / deviations)
    if issubclass(kind, SpecularLayer):
        whiten[2:4, 2:4] = whiten[2:4, 2:4] @ _RISE_AXES
    return LayerPrior(
        kind,
        is_diffuse,
        np.concatenate([np.full(3, color[0]), means]),
        block_diag(colors, whiten),
        np.array([_STUDENT_T_FREEDOM, *[_GAUSSIAN_FREEDOM] * 2, *[_STUDENT_T_FREEDOM] * means.size]),
        lower,
        upper,
    )


MAX_ALPHA = 0.7
"""Maximum roughness of a surface, because a rougher surface looks like a matte ground."""
_DIELECTRIC_LOG_F0_BOUNDS = (-12.0, np.log(0.2))  # Diamond, the brightest dielectric, has F0 = 0.17.
_LOG_F0_BOUNDS = (-12.0, np.log(3.0))
# Priors of the part m of Schlick's law in a surface's reflectance, and of the exponents q1 and q2 along two axes.
_RISE_PRIOR = ((0.0, 0.5), (0.0, 0.7), (0.0, 0.15))
_SCHLICK_BOUNDS = (-0.5, 1.0)  # With a part above 1, the reflectance could be negative.
_REFRACTION = (0.0, 0.2)  # The exponent is 1 for a coat of glass, but most materials are described as well without.
_REFRACTION_BOUNDS = (-0.2, 1.2)
# Bounds of log F90, m, q1, q2, log alpha, log tau, masking, under_coat and refraction: a surface's unknowns but colour.
_SPECULAR_BOUNDS = (
    (-5.0, 0.0), _SCHLICK_BOUNDS, (-1.5, 1.5), (-1.5, 1.5), (np.log(0.002), np.log(MAX_ALPHA)),
    (np.log(0.6), np.log(60.0)), (-0.5, 1.5), (-0.5, 2.0), _REFRACTION_BOUNDS,
)  # fmt: skip

_TURN_DEVIATION = 0.7  # From the mirror direction to the horizon, the ratio of two channels may change threefold.
_MAX_TURN = 4.0


def _specular(color: Pair, tint: float, *, strength: Pair = _LOG_F0_BOUNDS, under_coat: bool = False) -> LayerPrior:
    """Make the prior of a surface whose roughness is at most `MAX_ALPHA`."""
    bounds = (strength, *_SPECULAR_BOUNDS)
    others = (
        (-0.1, 0.4),  # log F90
        *_RISE_PRIOR,
        (np.log(0.12), 1.5),  # log alpha
        (np.log(2.0), 0.5),  # log tau; a tail exponent of 2 makes GGX
        (0.5, 0.3),  # masking
        (1.0, 0.3) if under_coat else (0.0, _FIXED_DEVIATION),
        _REFRACTION if under_coat else (0.0, _FIXED_DEVIATION),
    )
    return _prior(SpecularLayer, color, tint, others, bounds, is_diffuse=False)


def turning(prior: LayerPrior) -> LayerPrior:
    """Return the prior of a surface whose colour may also turn with the angles."""
    return LayerPrior(
        TurningLayer,
        prior.is_diffuse,
        np.append(prior.mean, np.zeros(N_TURNS)),
        block_diag(prior.root, np.eye(N_TURNS) / _TURN_DEVIATION),
        np.append(prior.freedom, np.full(N_TURNS, _STUDENT_T_FREEDOM)),
        np.append(prior.lower, np.full(N_TURNS, -_MAX_TURN)),
        np.append(prior.upper, np.full(N_TURNS, _MAX_TURN)),
    )


def _diffuse(exponents: Sequence[Pair]) -> LayerPrior:
    bounds = ((-14.0, np.log(2.0)), (-1.0, 2.0), (-1.0, 2.0), (-2.5, 4.0), (-1.0, 2.0), (-2.5, 2.5), (-1.0, 1.5))
    return _prior(DiffuseLayer, (np.log(0.15), 1.5), 1.0, exponents, bounds)


DIELECTRIC = _specular((np.log(0.045), 0.35), 0.03, strength=_DIELECTRIC_LOG_F0_BOUNDS)
COAT = _specular((np.log(0.045), 0.35), 0.03)  # The bounds of F0 include the peak of a metal with haze.
CLEAR_COAT = replace(COAT, upper=np.where(np.arange(COAT.upper.size) == ALPHA_INDEX, np.log(0.08), COAT.upper))
"""Prior of a clear coat whose alpha is at most 0.08, so that the coat is smoother than the layer below it."""
METAL = _specular((np.log(0.6), 0.6), 1.0)
VERY_ROUGH_METAL = replace(
    METAL,
    lower=np.where(np.arange(METAL.lower.size) == ALPHA_INDEX, np.log(0.6), METAL.lower),
    upper=np.where(np.arange(METAL.upper.size) == ALPHA_INDEX, 0.0, METAL.upper),
)
"""Prior of a metal whose alpha is between 0.6 and 1, which looks like a matte ground."""
METAL_UNDER_COAT = _specular((np.log(0.6), 0.6), 1.0, under_coat=True)
HIGHLIGHT = _specular((np.log(0.5), 0.8), 0.7)
HIGHLIGHT_UNDER_COAT = _specular((np.log(0.15), 1.2), 0.7, under_coat=True)
GROUND = _diffuse(((0.5, 0.5), (0.0, 0.4), (0.0, 0.4), (0.0, 0.3), (0.0, 0.25), (0.0, 0.4)))
YARN = _diffuse(((0.0, 0.2), (0.0, 0.4), (0.0, 0.8), (0.0, 0.4), (0.0, 0.6), (0.0, 0.4)))
SHEEN = _prior(SheenLayer, (np.log(0.02), 1.5), 0.5, ((2.5, 2.0),) * 2, ((-12.0, 2.0), (0.0, 8.0), (0.0, 8.0)))
RETRO = _prior(
    RetroLayer, (np.log(0.05), 1.5), 0.5, ((np.log(0.12), 0.5),), ((-12.0, 1.0), (np.log(0.02), np.log(0.4))),
    is_diffuse=False,
)  # fmt: skip
# The fibres of cloth point in all directions, so their surfaces make a rough highlight, which counts as diffuse.
FIBRES = _prior(
    SpecularLayer, (np.log(0.045), 0.35), 0.05,
    (
        (-0.1, 0.4), *_RISE_PRIOR, (np.log(0.65), 0.2), (np.log(2.0), 0.2), (1.0, 0.3), (0.0, _FIXED_DEVIATION),
        (0.0, _FIXED_DEVIATION),
    ),
    (
        _DIELECTRIC_LOG_F0_BOUNDS, *_SPECULAR_BOUNDS[:4], (np.log(0.5), 0.0), (np.log(0.6), np.log(3.0)),
        *_SPECULAR_BOUNDS[6:],
    ),
)  # fmt: skip

INTERREFLECTION_POWER = 2.4  # Light reflected several times between facets grows with this power of alpha.
INTERREFLECTION_LOG_SCALE = float(np.log(0.106) - INTERREFLECTION_POWER * np.log(0.3))
INTERREFLECTION = replace(
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
        (-0.1, 0.8), (0.0, 1.0), (0.0, 1.5), (0.0, 0.6), (np.log(0.12), 3.0), (np.log(2.0), 1.0), (0.5, 0.4),
        (0.0, _FIXED_DEVIATION), _REFRACTION,
    ),
    (
        _LOG_F0_BOUNDS, (np.log(0.02), 0.0), _SCHLICK_BOUNDS, (-3.0, 3.0), (-3.0, 3.0), (np.log(0.001), np.log(0.9)),
        (np.log(0.6), np.log(60.0)), (-0.5, 1.5), (0.0, 0.0), _REFRACTION_BOUNDS,
    ),
    is_diffuse=False,
)  # fmt: skip
OWN_PRIORS: dict[type[Layer], LayerPrior] = {
    SpecularLayer: _OWN_SURFACE,
    DiffuseLayer: _diffuse(((0.5, 0.7), (0.0, 0.6), (0.0, 0.6), (0.0, 0.5), (0.0, 0.4), (0.0, 0.6))),
    SheenLayer: SHEEN,
    RetroLayer: RETRO,
}
"""Weak priors of layers, for fits to the values of a single component or of all components together."""
