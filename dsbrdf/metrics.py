"""How well a model fits a measurement.

Over all nodes that are valid, whose directions are both within the horizon cutoff of the normal, and whose
theta_half is at least 1 degree, the three channels pooled and every node weighing the same:

    relative_rms = sqrt( sum (f - fit)**2 / sum f**2 )
    floor        = relative_rms of the mean of f over phi_diff: no model that ignores phi_diff goes below it
    excess       = relative_rms / floor
    male         = mean | log(1 + f cos_in) - log(1 + fit cos_in) |

The first three need the `Profiles` only; male needs the samples.
"""

import numpy as np
from numpy.typing import NDArray

from dsbrdf.errors import InvalidArgumentError
from dsbrdf.geometry import incident_cosines
from dsbrdf.measurement import PHI_DIFF, THETA_DIFF, THETA_HALF, Measurement
from dsbrdf.model import DSBRDF
from dsbrdf.profiles import CENTER_CUTOFF, Profiles, used_nodes

Array = NDArray[np.float64]

_NO_FLOOR = 1e-12  # below this the data do not depend on phi_diff at all, and excess would divide by rounding errors
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
    return _relative_errors(on_grid(model), profiles, np.ones(THETA_DIFF.size, bool))


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
    return total / count


def _relative_errors(fit: Array, profiles: Profiles, rows: NDArray[np.bool_]) -> dict[str, float | None]:
    part = np.ix_(np.arange(3), rows, OUTSIDE_CENTER)
    mean, weight, within = profiles.mean[part], profiles.weight[part], profiles.within[part]
    power = float(np.sum(weight * mean**2 + within))
    if power == 0.0:
        raise InvalidArgumentError("there are no data to compare with: every sample used is zero or left out")
    scatter = float(within.sum())
    error = float(np.sum(weight * (mean - fit[part]) ** 2)) + scatter
    relative_rms, floor = float(np.sqrt(error / power)), float(np.sqrt(scatter / power))
    return {
        "relative_rms": relative_rms,
        "floor": floor,
        "excess": relative_rms / floor if floor > _NO_FLOOR else None,
    }
