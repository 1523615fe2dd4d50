"""How well a model fits a measurement.

Over all nodes that are valid, whose directions are both within the horizon cutoff of the normal, and whose
theta_half is at least 1 degree, the three channels pooled and every node weighing the same:

    relative_rms = sqrt( sum (f - fit)**2 / sum f**2 )
    floor        = relative_rms of the mean of f over phi_diff: no model that ignores phi_diff goes below it
    excess       = relative_rms / floor
    male         = mean | log(1 + f cos_in) - log(1 + fit cos_in) |

The first three need the `Profiles` only; male needs the samples.
"""

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dsbrdf.data.geometry import incident_cosines
from dsbrdf.data.grid import CENTER_CUTOFF, CHANNELS, PHI_DIFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import Profiles, used_nodes
from dsbrdf.errors import InvalidArgumentError
from dsbrdf.model.dsbrdf import DSBRDF

Array = NDArray[np.float64]

_NO_FLOOR = 1e-12  # below this the data do not depend on phi_diff at all, and excess would divide by rounding errors
BANDS = np.radians([0.0, 15.0, 30.0, 45.0, 60.0, 70.0, 75.0, 80.0, 85.0, 90.0])
"""Bands of theta_diff that errors are reported for [rad]."""
OUTSIDE_CENTER = THETA_HALF >= CENTER_CUTOFF
"""Nodes of the theta_half axis that the metrics, and the fit of the lobes, use; shape (90,)."""


def on_grid(model: DSBRDF) -> Array:
    """Values of the model at the profile nodes, shape (3, 90 theta_diff, 90 theta_half) [1/sr]."""
    return np.moveaxis(model.evaluate(THETA_HALF, THETA_DIFF[:, None]), -1, 0)


def relative_errors(model: DSBRDF, profiles: Profiles) -> dict[str, float | None]:
    """Squared-error metrics of a model on plain profiles.

    Parameters
    ----------
    model : DSBRDF
    profiles : Profiles
        With plain weighting and without outlier weights, as the definitions ask.

    Returns
    -------
    dict
        ``relative_rms``, ``floor``, ``excess`` (None where the floor is zero).

    Raises
    ------
    InvalidArgumentError
        If the profiles are weighted, or hold no data.
    """
    if profiles.weighting != "plain" or profiles.robust:
        raise InvalidArgumentError("the metrics are defined on plain profiles without outlier weights")
    every = np.ones(THETA_DIFF.size, bool)
    errors = _relative_errors(on_grid(model), profiles, slice(None), every)
    if errors is None:
        raise InvalidArgumentError("there are no data to compare with: every sample used is zero or left out")
    return errors


def error_tables(model: DSBRDF, profiles: Profiles) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Squared-error metrics of each channel and of bands of theta_diff.

    Parameters
    ----------
    model : DSBRDF
    profiles : Profiles
        Plain, as for `relative_errors`.

    Returns
    -------
    by_channel : list of dict
        ``channel`` and the metrics, for channels that are not black.
    by_theta_diff : list of dict
        ``theta_diff``: first and last angle of the band [rad], the last one excluded, and the metrics, for bands with
        data.
    """
    fit, every = on_grid(model), np.ones(THETA_DIFF.size, bool)
    by_channel = []
    for index, channel in enumerate(CHANNELS):
        errors = _relative_errors(fit, profiles, slice(index, index + 1), every)
        if errors is not None:
            by_channel.append({"channel": channel} | errors)
    by_theta_diff = []
    for first, last in pairwise(BANDS):
        errors = _relative_errors(fit, profiles, slice(None), (THETA_DIFF >= first - 1e-9) & (THETA_DIFF < last - 1e-9))
        if errors is not None:
            by_theta_diff.append({"theta_diff": [float(first), float(last)]} | errors)
    return by_channel, by_theta_diff


def mean_absolute_log_error(model: DSBRDF, measurement: Measurement, horizon_cutoff: float | None) -> float:
    """Mean absolute logarithmic error (male) of a model over the samples.

    Parameters
    ----------
    model : DSBRDF
    measurement : Measurement
    horizon_cutoff : float or None
        Largest angle of either direction to the normal [rad]; None is the horizon.

    Returns
    -------
    float

    Raises
    ------
    InvalidArgumentError
        If the cutoff leaves no samples.
    """
    fit = np.maximum(on_grid(model), 0.0)
    total, count = 0.0, 0
    for i in np.flatnonzero(OUTSIDE_CENTER).tolist():
        used = used_nodes(measurement, i, horizon_cutoff)
        cos_in, _ = incident_cosines(THETA_HALF[i], THETA_DIFF[:, None], PHI_DIFF)
        row, _ = np.nonzero(used)
        cosine = cos_in[used]
        samples = measurement.stored[:, i][:, used] * measurement.scale[:, None]
        difference = np.log1p(samples * cosine) - np.log1p(fit[:, row, i] * cosine)
        total += float(np.abs(difference).sum())
        count += difference.size
    if count == 0:
        raise InvalidArgumentError("there are no data to compare with: the horizon cutoff leaves no valid sample")
    return total / count


def _relative_errors(
    fit: Array, profiles: Profiles, channels: slice, rows: NDArray[np.bool_]
) -> dict[str, float | None] | None:
    """Metrics of some channels and rows; None where there is nothing but zeros."""
    part = np.ix_(np.arange(3)[channels], rows, OUTSIDE_CENTER)
    mean, weight, within = profiles.mean[part], profiles.weight[part], profiles.within[part]
    power = float(np.sum(weight * mean**2 + within))
    if power == 0.0:
        return None
    scatter = float(within.sum())
    error = float(np.sum(weight * (mean - fit[part]) ** 2)) + scatter
    relative_rms, floor = float(np.sqrt(error / power)), float(np.sqrt(scatter / power))
    return {
        "relative_rms": relative_rms,
        "floor": floor,
        "excess": relative_rms / floor if floor > _NO_FLOOR else None,
    }
