"""A measured isotropic BRDF on the angular grid of the MERL data base.

The grid is (theta_half, theta_diff, phi_diff) with 90 x 90 x 180 nodes. A node stands at the left edge of
its bin; ``theta_half`` is spaced by squares, which puts most rows into the highlight. ``phi_diff`` covers
half a turn: the other half follows from reciprocity.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dsbrdf.geometry import above_horizon

__all__ = [
    "CHANNELS",
    "GRID_SHAPE",
    "PHI_DIFF",
    "THETA_DIFF",
    "THETA_HALF",
    "Measurement",
    "nodes_above_horizon",
]

CHANNELS = ("red", "green", "blue")
GRID_SHAPE = (90, 90, 180)


def _read_only(array: NDArray[np.float64]) -> NDArray[np.float64]:
    array.flags.writeable = False
    return array


THETA_HALF = _read_only(np.deg2rad(np.arange(90) ** 2 / 90.0))
THETA_DIFF = _read_only(np.deg2rad(np.arange(90.0)))
PHI_DIFF = _read_only(np.deg2rad(np.arange(180.0)))


@cache
def nodes_above_horizon() -> NDArray[np.bool_]:
    """Nodes of the grid whose two directions are strictly above the horizon.

    Returns
    -------
    ndarray of bool, shape (90, 90, 180)
        Read-only; computed once.
    """
    above = np.empty(GRID_SHAPE, dtype=np.bool_)
    for row, theta_half in enumerate(THETA_HALF):  # the whole grid at once would take 50 MB for a moment
        above[row] = above_horizon(theta_half, THETA_DIFF[:, np.newaxis], PHI_DIFF)
    above.flags.writeable = False
    return above


@dataclass(frozen=True, eq=False)
class Measurement:
    """One measured material.

    Attributes
    ----------
    stored : ndarray, shape (3, 90, 90, 180)
        The numbers exactly as the file holds them, read-only; axes (channel, theta_half,
        theta_diff, phi_diff).
    scale : ndarray, shape (3,)
        Factor of each channel from ``stored`` to the BRDF in 1/sr.
    valid : ndarray of bool, shape (90, 90, 180)
        Nodes with all three channels >= 0 and both directions strictly above the horizon, read-only.
    name : str
        The material's name, by default that of its file.
    sha256 : str
        Hexadecimal digest of the file's bytes: the identity of the measurement.
    """

    stored: NDArray[np.float64]
    scale: NDArray[np.float64]
    valid: NDArray[np.bool_]
    name: str
    sha256: str

    @property
    def values(self) -> NDArray[np.float64]:
        """The BRDF in 1/sr, shape (3, 90, 90, 180); a new array (35 MB) at every call.

        Only the nodes in ``valid`` carry a measured value.
        """
        return self.stored * self.scale[:, np.newaxis, np.newaxis, np.newaxis]

    @classmethod
    def from_values(cls, values: ArrayLike, valid: ArrayLike | None = None, name: str = "measurement") -> "Measurement":
        """Make a measurement of an array, as if it had been written to a file and read back.

        Parameters
        ----------
        values : array_like, shape (3, 90, 90, 180)
            The BRDF in 1/sr, axes (channel, theta_half, theta_diff, phi_diff); negative where there is no
            value.
        valid : array_like of bool, shape (90, 90, 180), optional
            Nodes that carry a value; the others are marked with a negative number, whatever they hold.
        name : str
            The material's name.

        Returns
        -------
        Measurement
            Its ``sha256`` is that of the encoded bytes, its ``values`` equal the given ones to rounding.

        Raises
        ------
        MeasurementFormatError
            If a shape is wrong or the values are not an acceptable measurement.
        """
        # Imported here because the format builds on this module, not this module on the format.
        from dsbrdf.merl import encode_merl, parse_merl

        return parse_merl(encode_merl(values, valid), name)
