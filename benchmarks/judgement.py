"""What is wrong with the components of a model whose specular and diffuse light is known."""

from dataclasses import dataclass

import numpy as np

import dsbrdf
from benchmarks.foreign_kinds import directional_rule
from dsbrdf.arrays import Array
from dsbrdf.components.layers import Color
from dsbrdf.components.shares import RgbRange
from tests.support.foreign_materials import Material

ANGLES_DEG = (0.0, 40.0, 70.0)
MIN_F0 = 0.02  # Below it, the relative error of a channel says nothing.
MIN_LIGHT_OF_COMPONENT = 1e-3  # A part with a smaller fraction of all light is no component.


RULES = tuple(directional_rule(float(np.radians(angle))) for angle in ANGLES_DEG)


@dataclass(frozen=True, eq=False)
class Truth:
    """Specular and diffuse values (n, 3) at the nodes of each of `RULES` [1/sr], and the layer if there is only one."""

    specular: tuple[Array, ...]
    diffuse: tuple[Array, ...]
    alpha: float | None
    f0: Array | None
    f70: Array | None

    @classmethod
    def of(cls, material: Material) -> "Truth":
        """Evaluate the parts of a material."""
        specular = tuple(material.specular_values(light, eye) for light, eye, _ in RULES)
        diffuse = tuple(material.diffuse_values(light, eye) for light, eye, _ in RULES)
        return cls(specular, diffuse, material.alpha, material.f0, material.f70)

    @property
    def diffuse_share(self) -> float:
        """Share of the diffuse light in all light at normal incidence."""
        diffuse, specular = (RULES[0][2] @ side[0].sum(axis=1) for side in (self.diffuse, self.specular))
        return float(diffuse / (diffuse + specular))


@dataclass(frozen=True)
class SurfaceJudgement:
    """Relative errors of a surface's roughness and of F0's and F70's worst channels, and whether ranges hold the truth.

    All are None if the parameter is withheld, and for F0 and F70 if the true surface is black.
    """

    alpha: float | None
    alpha_inside: bool | None
    f0: float | None
    f0_inside: bool | None
    f70: float | None
    f70_inside: bool | None


@dataclass(frozen=True)
class Judgement:
    """What is wrong with one decomposition: light moved at `ANGLES_DEG`, and the brightest specular surface.

    `share` and its stated range are fractions of the diffuse light at normal incidence; a sentence may say that
    the split is open.
    """

    structure: str
    moved: Array
    surface: SurfaceJudgement | None
    share: float
    true_share: float
    range: tuple[float, float]
    is_warned: bool

    @property
    def inside(self) -> bool:
        """Whether the range holds the true share."""
        low, high = self.range
        return low - MIN_LIGHT_OF_COMPONENT <= self.true_share <= high + MIN_LIGHT_OF_COMPONENT


def judged(parts: dsbrdf.Decomposition, truth: Truth) -> Judgement:
    """Compare the components of a model with the truth."""
    moved, shares = [], []
    for (light, eye, weight), diffuse, specular in zip(RULES, truth.diffuse, truth.specular, strict=True):
        found = np.zeros_like(diffuse) if parts.diffuse is None else parts.diffuse.evaluate_directions(light, eye)
        every = weight @ (diffuse + specular).sum(axis=1)
        moved.append(weight @ np.abs(found - diffuse).sum(axis=1) / every)
        shares.append(weight @ found.sum(axis=1) / every)
    return Judgement(
        parts.structure,
        np.array(moved),
        surface_judgement(parts, truth),
        float(shares[0]),
        truth.diffuse_share,
        parts.diffuse_range,
        any("does not determine how much of the light is diffuse" in sentence for sentence in parts.remarks),
    )


def surface_judgement(parts: dsbrdf.Decomposition, truth: Truth) -> SurfaceJudgement | None:
    """Compare the brightest surface with the truth, which counts as missed without any surface."""
    if truth.alpha is None or truth.f0 is None or truth.f70 is None:
        return None
    found = [part for part in parts if part.surfaces]
    if not found:
        missed = (1.0, False) if (truth.f0 > MIN_F0).any() else (None, None)
        return SurfaceJudgement(1.0, False, *missed, *missed)
    surface = max(found, key=lambda part: part.light_share).surfaces[0]
    alpha, alpha_inside = None, None
    if surface.alpha is not None and surface.alpha_range is not None:
        low, high = surface.alpha_range
        alpha, alpha_inside = surface.alpha / truth.alpha - 1.0, low <= truth.alpha <= high
    of_f0 = _reflectance_judgement(surface.f0, surface.f0_range, truth.f0)
    return SurfaceJudgement(
        alpha, alpha_inside, *of_f0, *_reflectance_judgement(surface.f70, surface.f70_range, truth.f70)
    )


def _reflectance_judgement(
    found: Color | None, stated: RgbRange | None, true: Array
) -> tuple[float, bool] | tuple[None, None]:
    """Return the relative error of the worst channel, and whether the ranges of all channels hold the truth."""
    bright = true > MIN_F0
    if found is None or stated is None or not bright.any():
        return None, None
    lows, highs = np.transpose(stated)
    error = float(np.abs(np.array(found) / true - 1.0)[bright].max())
    return error, bool(np.all(((lows <= true) & (true <= highs))[bright]))
