"""The parameters of a model as comma-separated values, for spreadsheets and statistics."""

import numpy as np

from dsbrdf.data.grid import CHANNELS
from dsbrdf.model.dsbrdf import DSBRDF
from dsbrdf.model.lobes import half_width

_THETA_DIFF = np.radians([*range(0, 90, 5), 89.0])
_COLUMNS = (
    "lobe",
    "channel",
    "theta_diff_deg",
    "amplitude",
    "kappa",
    "gamma",
    "center_deg",
    "elongation",
    "half_width_deg",
)


def parameters_csv(model: DSBRDF) -> str:
    """Return a table with one row for each lobe, channel and theta_diff.

    Parameters
    ----------
    model : DSBRDF

    Returns
    -------
    str
        The first line names the columns.  theta_diff runs in steps of 5 degrees; the amplitude is in 1/sr, the half
        width is counted from the center.
    """
    found = model.parameters_at(_THETA_DIFF)
    widths = np.degrees(half_width(found["kappa"], found["gamma"], model.lobe))
    lines = [",".join(_COLUMNS)]
    for lobe in range(model.n_lobes):
        for column, channel in enumerate(CHANNELS):
            shape = column if found["kappa"].shape[1] == len(CHANNELS) else 0
            table = (
                np.degrees(_THETA_DIFF),
                found["amplitude"][:, column, lobe],
                found["kappa"][:, shape, lobe],
                found["gamma"][:, shape, lobe],
                np.degrees(found["center"][:, shape, lobe]),
                found["elongation"][:, lobe],
                widths[:, shape, lobe],
            )
            lead = f"{lobe},{channel},"
            lines += [lead + ",".join(f"{value:.9g}" for value in row) for row in np.stack(table, axis=1).tolist()]
    return "\n".join(lines) + "\n"
