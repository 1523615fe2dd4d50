"""Interpolate between two models."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.reflectance import RenderableModel


@dataclass(frozen=True)
class Blend(RenderableModel):
    """Evaluate the geometric mean ``first**(1 - t) second**t`` of two models."""

    first: RenderableModel
    second: RenderableModel
    t: float

    def evaluate_unmasked(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Array:
        """Return values (n, 3) [1/sr] at angles (n,) that are not checked, also for directions below the horizon."""
        angles = theta_half, theta_diff, phi_diff
        return self._mean(self.first.evaluate_unmasked(*angles), self.second.evaluate_unmasked(*angles))

    def evaluate_grid(self, theta_half: Array, theta_diff: Array, phi_diff: Array) -> Iterator[Array]:
        """Yield for each theta_half the values (3, D, P) [1/sr] at all pairs of theta_diff (D,) and phi_diff (P,)."""
        axes = theta_half, theta_diff, phi_diff
        return map(self._mean, self.first.evaluate_grid(*axes), self.second.evaluate_grid(*axes))

    @property
    def kinks(self) -> Array:
        """Angles theta_diff (n,) [rad] at which the values of the model have a kink."""
        return np.union1d(self.first.kinks, self.second.kinks)

    def _mean(self, first: Array, second: Array) -> Array:
        return np.asarray(first ** (1.0 - self.t) * second**self.t)


def blend(a: RenderableModel, b: RenderableModel, t: float) -> Blend:
    """Return a model whose values lie between the values of two models.

    Values are geometric means ``a**(1 - t) b**t``. A blend of a polished and a rough surface has one highlight of
    medium width; an arithmetic mean would have two highlights. Blends of positive, reciprocal models are positive and
    reciprocal. The albedo of a blend is at most the arithmetic mean of both albedos, so that a blend conserves energy
    if both models conserve energy.

    Parameters
    ----------
    a, b : DSBRDF, LayeredModel or Blend
    t : float
        Position of the blend, from 0 (`a`) to 1 (`b`).

    Raises
    ------
    InvalidArgumentError
        If t is out of range, or `a` or `b` is not a model.
    """
    for end in (a, b):
        if not isinstance(end, RenderableModel):
            raise InvalidArgumentError(f"only models, such as result.model, can be blended, not a {type(end).__name__}")
    if not 0.0 <= t <= 1.0:
        raise InvalidArgumentError(f"t must lie between 0 and 1, not at {t:g}")
    return Blend(a, b, float(t))
