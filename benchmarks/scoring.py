"""Errors of anything that gives values at the nodes of the grid, with the definitions of `dsbrdf.fitting.metrics`.

They are summed over the samples, not over profiles: what is compared here may depend on phi_diff.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dsbrdf.data.geometry import incident_cosines
from dsbrdf.data.grid import PHI_DIFF, THETA_DIFF, THETA_HALF
from dsbrdf.data.measurement import Measurement
from dsbrdf.data.reduction import used_samples
from dsbrdf.fitting.metrics import OUTSIDE_CENTER
from dsbrdf.model.dsbrdf import DSBRDF

Array = NDArray[np.float64]
RowPredictor = Callable[[int], Array]
"""Values on the theta_half row i: shape (3, 90, 180), or (3, 90, 1) of what does not depend on phi_diff [1/sr]."""

ALL_ROWS = THETA_DIFF.size
PAPER_RANGE = 76
"""Rows theta_diff 0 to 75 degrees: the paper's slices that have data within the cutoff, without extrapolation."""


def used_nodes(measurement: Measurement, i: int, horizon_cutoff: float | None) -> NDArray[np.bool_]:
    """Nodes of the theta_half row ``i`` that count in every channel, shape (90 theta_diff, 180 phi_diff)."""
    return np.asarray(used_samples(measurement, i, horizon_cutoff).all(axis=0))


@dataclass(frozen=True)
class Score:
    """Metrics as in `dsbrdf.fitting.metrics`."""

    relative_rms: float
    floor: float
    male: float

    @property
    def excess(self) -> float:
        """relative_rms over the floor; NaN without a floor."""
        return self.relative_rms / self.floor if self.floor > 1e-12 else float("nan")


@dataclass(frozen=True, eq=False)
class Errors:
    """Sums over the samples of each theta_diff row, shape (5, 90).

    Squared error, squared signal, squared deviation from the mean over phi_diff, absolute logarithmic error, number.
    """

    sums: Array

    def score(self, rows: int = ALL_ROWS) -> Score:
        """Return the metrics of the first rows of theta_diff."""
        error, power, scatter, logarithmic, count = self.sums[:, :rows].sum(axis=1)
        return Score(float(np.sqrt(error / power)), float(np.sqrt(scatter / power)), float(logarithmic / count))


def errors(measurement: Measurement, predict: RowPredictor, horizon_cutoff: float | None) -> Errors:
    """Compare predictions with all samples that the metrics use.

    Parameters
    ----------
    measurement : Measurement
    predict : callable
        See `RowPredictor`.
    horizon_cutoff : float or None
        As in `dsbrdf.FitOptions` [rad].

    Returns
    -------
    Errors
    """
    sums = np.zeros((5, ALL_ROWS))
    for i in np.flatnonzero(OUTSIDE_CENTER).tolist():
        used = used_nodes(measurement, i, horizon_cutoff)
        row, _ = np.nonzero(used)
        cosine = incident_cosines(THETA_HALF[i], THETA_DIFF[:, None], PHI_DIFF)[0][used]
        values = measurement.stored[:, i][:, used] * measurement.scale[:, None]
        fit = np.broadcast_to(predict(i), (3, *used.shape))[:, used]
        members = np.bincount(row, minlength=ALL_ROWS)
        means = np.array([np.bincount(row, channel, ALL_ROWS) for channel in values]) / np.maximum(members, 1)
        logarithmic = np.abs(np.log1p(values * cosine) - np.log1p(np.maximum(fit, 0.0) * cosine))
        terms = ((values - fit) ** 2, values**2, (values - means[:, row]) ** 2, logarithmic)
        sums[:4] += [np.bincount(row, term.sum(axis=0), ALL_ROWS) for term in terms]
        sums[4] += 3 * members
    return Errors(sums)


def of_profile(profile: Array) -> RowPredictor:
    """Return the predictor for a table (3, 90 theta_diff, 90 theta_half)."""
    return lambda i: profile[:, :, i, None]


def of_model(model: DSBRDF) -> RowPredictor:
    """Return the predictor of a model."""
    table = model.tabulate()
    return lambda i: table[:, i]
