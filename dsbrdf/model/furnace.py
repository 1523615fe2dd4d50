"""Check that a model conserves energy in a white furnace, and that it is reciprocal.

In a furnace with uniformly bright walls, a surface with the directional albedo rho has rho times the brightness of the
walls. A surface that conserves energy is never brighter than the walls. A reciprocal BRDF has equal values for swapped
directions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import random_directions
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.sampling import ANGLES

_FURNACE_THETA_OUT = ANGLES[:-1:2]  # angles to the normal from 0 to 87 degrees [rad]
_N_SWAPPED_PAIRS = 4096


@dataclass(frozen=True, eq=False)
class FurnaceReport:
    """Report the energy and the reciprocity of a model.

    Attributes
    ----------
    theta_out : ndarray, shape (n,)
        Angles to the normal [rad].
    albedo : ndarray, shape (n, 3)
        Brightness in the furnace, relative to the walls, in each channel.
    reciprocity_error : float
        Largest difference between values of swapped directions, relative to the larger value.
    """

    theta_out: Array
    albedo: Array
    reciprocity_error: float

    @property
    def largest_albedo(self) -> float:
        """Largest albedo over angles and channels; at most 1 if the model conserves energy."""
        return float(self.albedo.max())

    @property
    def conserves_energy(self) -> bool:
        """Whether the albedo is at most 1 at all angles and in all channels."""
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
    first, second = random_directions(rng, rng.random((2, _N_SWAPPED_PAIRS)))
    values, swapped = model.evaluate_directions(first, second), model.evaluate_directions(second, first)
    scale = np.maximum(np.maximum(values, swapped), np.finfo(float).tiny)
    error = float(np.max(np.abs(values - swapped) / scale))
    return FurnaceReport(_FURNACE_THETA_OUT, model.albedo(_FURNACE_THETA_OUT), error)
