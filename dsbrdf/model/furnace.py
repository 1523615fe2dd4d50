"""White furnace and reciprocity: whether a model returns more light than it receives, and is the same both ways.

In a furnace whose walls are equally bright everywhere, a surface of albedo rho shows rho times that brightness, and
one that conserves energy is never brighter than the walls. A reciprocal BRDF does not change when the two directions
change places.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import random_directions
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.sampling import ANGLES

_ANGLES = ANGLES[:-1:2]  # 0 to 87 degrees; at the horizon itself nothing is seen
_PAIRS = 4096


@dataclass(frozen=True, eq=False)
class FurnaceReport:
    """Energy and reciprocity of a model.

    Attributes
    ----------
    theta_out : ndarray, shape (n,)
        Angles to the normal [rad].
    albedo : ndarray, shape (n, 3)
        Brightness in the furnace, as a share of the walls', in each channel.
    reciprocity_error : float
        Largest difference between values of swapped directions, as a share of the larger.
    """

    theta_out: Array
    albedo: Array
    reciprocity_error: float

    @property
    def largest_albedo(self) -> float:
        """The largest albedo of all angles and channels; at most 1 where energy is conserved."""
        return float(self.albedo.max())

    @property
    def conserves_energy(self) -> bool:
        """Whether no direction returns more than it receives."""
        return self.largest_albedo <= 1.0

    def __str__(self) -> str:
        row = int(self.albedo.max(axis=1).argmax())
        angle = float(np.degrees(self.theta_out[row]))
        verdict = "no direction returns" if self.conserves_energy else "some directions return"
        return (
            f"White furnace: {verdict} more than is received; the largest albedo is {self.largest_albedo:.3f}, at "
            f"{angle:.0f} degrees. Reciprocity: values of swapped directions differ by {self.reciprocity_error:.1e}."
        )


def white_furnace(model: DSBRDF) -> FurnaceReport:
    """Check the energy and the reciprocity of a model."""
    rng = np.random.default_rng(0)
    first, second = random_directions(rng, rng.random((2, _PAIRS)))
    values, swapped = model.evaluate_directions(first, second), model.evaluate_directions(second, first)
    scale = np.maximum(np.maximum(values, swapped), np.finfo(float).tiny)
    error = float(np.max(np.abs(values - swapped) / scale))
    return FurnaceReport(_ANGLES, model.albedo(_ANGLES), error)
