"""Where the parameters of the global fit have their knots.

Knots belong where the data are and where they matter: real materials put nearly all of their squared signal
into the last degrees before the horizon cutoff, and change fastest there.  The knots share out the integral of
a density proportional to the cube root of the squared signal of each theta_diff row, so that they adapt to the
measurement, to its cutoff and to missing regions.  Each stands on a row of the grid.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_DENSITY_POWER = 1.0 / 3.0
_DENSITY_FLOOR = 1e-4  # of the whole signal: rows with less still need their share of knots
_DENSITY_WINDOW = 7  # rows averaged, so that noise in single rows places no knots


def place_knots(mean: Array, weight: Array, count: int) -> NDArray[np.intp]:
    """Rows of the theta_diff axis to put knots on.

    Parameters
    ----------
    mean, weight : ndarray, shape (3, 90, N)
        Profiles [1/sr] and weights, 0 for what is not used.
    count : int
        Number of knots asked for.

    Returns
    -------
    ndarray of int, shape (<= count,)
        Increasing; the first and the last row with data are among them.  Fewer than asked for where they would fall
        on the same row.
    """
    rows = np.flatnonzero(weight.sum(axis=(0, 2)) > 0)
    signal = np.einsum("crn,crn->r", weight[:, rows], mean[:, rows] ** 2)
    share = np.log(signal / max(signal.sum(), np.finfo(float).tiny) + _DENSITY_FLOOR)
    half = _DENSITY_WINDOW // 2
    smooth = np.convolve(np.pad(share, half, mode="edge"), np.ones(_DENSITY_WINDOW) / _DENSITY_WINDOW, "valid")
    density = np.exp(_DENSITY_POWER * smooth)
    steps = 0.5 * (density[1:] + density[:-1])  # by rows with data: a gap without data takes no knots
    cumulative = np.concatenate([[0.0], np.cumsum(steps)])
    places = np.interp(np.linspace(0.0, cumulative[-1], count), cumulative, np.arange(rows.size))
    return rows[np.unique(np.round(places).astype(np.intp))]
