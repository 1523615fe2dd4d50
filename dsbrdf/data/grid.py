"""The angular grid of the MERL data base: its axes, which of its nodes count, and the cutoffs in angle.

The grid is (theta_half, theta_diff, phi_diff) with 90 x 90 x 180 nodes. A node stands at the left edge of
its bin; ``theta_half`` is spaced by squares, which puts most rows into the highlight. ``phi_diff`` covers
half a turn: the other half follows from reciprocity.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from dsbrdf.data.geometry import above_horizon

__all__ = [
    "CENTER_CUTOFF",
    "CHANNELS",
    "DEFAULT_HORIZON_CUTOFF",
    "GRID_SHAPE",
    "PHI_DIFF",
    "THETA_DIFF",
    "THETA_HALF",
    "nodes_above_horizon",
]

CHANNELS = ("red", "green", "blue")
GRID_SHAPE = (90, 90, 180)
DEFAULT_HORIZON_CUTOFF = float(np.radians(80.0))
"""Directions further than this from the normal are left out by default [rad]."""
CENTER_CUTOFF = float(np.radians(1.0))
"""The paper's procedure and metrics leave out samples with theta_half below this [rad] (Nishino 2009, section 6)."""


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
