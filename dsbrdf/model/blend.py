"""Materials between two others."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.reflectance import RenderableModel


@dataclass(frozen=True)
class Blend(RenderableModel):
    """The geometric mean ``first**(1 - t) second**t`` of two models."""

    first: RenderableModel
    second: RenderableModel
    t: float

    def evaluate_unmasked(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Values of the formula (n, 3) for angles (n,) that are not checked, below the horizon too [1/sr]."""
        angles = theta_half, theta_diff, phi_diff
        return self._mean(self.first.evaluate_unmasked(*angles), self.second.evaluate_unmasked(*angles))

    def evaluate_grid(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Iterator[Array]:
        """Yield the formula's values (3, D, P) at each angle theta_half (H,) for all theta_diff (D,), phi_diff (P,)."""
        axes = theta_half, theta_diff, phi_diff
        return map(self._mean, self.first.evaluate_grid(*axes), self.second.evaluate_grid(*axes))

    @property
    def kinks(self) -> Array:
        """Angles theta_diff at which values have a kink (n,) [rad]."""
        return np.union1d(self.first.kinks, self.second.kinks)

    def _mean(self, first: Array, second: Array) -> Array:
        return np.asarray(first ** (1.0 - self.t) * second**self.t)


def blend(a: RenderableModel, b: RenderableModel, t: float) -> Blend:
    """Return a material between two.

    Values are geometric means. Between a polished and a rough surface lies one highlight of medium width, where the
    arithmetic mean would show two. Values stay positive and reciprocal; the albedo is at most the arithmetic mean of
    both albedos, so that a blend conserves energy where its ends do.

    Parameters
    ----------
    a, b : DSBRDF, LayeredModel or Blend
    t : float
        From 0, which is `a`, to 1, which is `b`.

    Raises
    ------
    InvalidArgumentError
        If t is out of range or an end is no model.
    """
    for end in (a, b):
        if not isinstance(end, RenderableModel):
            raise InvalidArgumentError(f"only models can be blended, not an object of type {type(end).__name__}")
    if not 0.0 <= t <= 1.0:
        raise InvalidArgumentError(f"t must lie between 0 and 1, not at {t:g}")
    return Blend(a, b, float(t))
