"""Define the angular grid of the MERL database: its axes, the nodes above the horizon, and cutoff angles.

The grid has 90 x 90 x 180 nodes over (theta_half, theta_diff, phi_diff). ``theta_half`` is spaced quadratically, so
that most nodes are in the highlight. ``phi_diff`` covers 180 degrees only, because by reciprocity a BRDF is equal at
``phi_diff`` and ``phi_diff`` + 180 degrees. The MERL database divides the angles into bins, and the node of a bin is
the lower edge of the bin.
"""

from functools import lru_cache

import numpy as np

from dsbrdf.arrays import Array, Mask
from dsbrdf.data.geometry import above_horizon

CHANNELS = ("red", "green", "blue")
GRID_SHAPE = (90, 90, 180)
DEFAULT_HORIZON_CUTOFF = float(np.radians(80.0))
"""By default, samples with a direction further than this from the surface normal are left out [rad]."""
CENTER_CUTOFF = float(np.radians(1.0))
"""The paper's procedure and the metrics leave out samples with a smaller theta_half [rad] (Nishino 2009, section 6)."""


def _read_only(array: Array) -> Array:
    array.flags.writeable = False
    return array


THETA_HALF = _read_only(np.deg2rad(np.arange(90) ** 2 / 90.0))
THETA_DIFF = _read_only(np.deg2rad(np.arange(90.0)))
PHI_DIFF = _read_only(np.deg2rad(np.arange(180.0)))
QUARTER = PHI_DIFF.size // 2 + 1
"""Number of nodes of phi_diff from 0 to 90 degrees; models have equal values at phi_diff and pi - phi_diff."""


@lru_cache(maxsize=4)
def nodes_above_horizon(cutoff: float = np.pi / 2) -> Mask:
    """Return a mask (90, 90, 180) of the nodes with both directions above the horizon and within the cutoff.

    The mask is cached, and therefore read-only. A direction is within the cutoff if its angle to the normal [rad] is at
    most `cutoff`.
    """
    above = np.empty(GRID_SHAPE, dtype=np.bool_)
    # The mask is computed for one theta_half at a time, because arrays for the whole grid would need 50 MB.
    for row, theta_half in enumerate(THETA_HALF):
        above[row, :, :QUARTER] = above_horizon(theta_half, THETA_DIFF[:, np.newaxis], PHI_DIFF[:QUARTER], cutoff)
    above[:, :, QUARTER:] = above[:, :, QUARTER - 2 : 0 : -1]
    above.flags.writeable = False
    return above
