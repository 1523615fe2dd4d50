"""Summarise how a table of samples was read, before the samples are fitted."""

from typing import Any

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import CHANNELS
from dsbrdf.samples.doubts import sample_doubts
from dsbrdf.samples.reading import ReadTable
from dsbrdf.samples.scattered_samples import ScatteredSamples

ANGLE_NAMES = ("theta_in_deg", "theta_out_deg", "phi_deg")
"""Names of the angles of a sample in a summary; phi is the azimuth from omega_in to omega_out, 0 to 360 degrees."""
_N_SHOWN_SAMPLES = 5
_MAX_LISTED_ANGLES = 12  # A summary lists the angles of incidence only if there are at most this many.
_MAX_IN_PLANE_DISTANCE_DEG = 0.5  # A sample at most this far from the plane of incidence counts as in the plane.


def summary_of_table(found: ReadTable) -> dict[str, Any]:
    """Return columns, ranges, warnings and the first samples of a table as JSON content.

    A row of ``first`` has the angles `ANGLE_NAMES`, then red, green and blue [1/sr] of one sample. The object
    ``ranges`` has the minimum and maximum over all samples of each of these columns.
    """
    samples = found.samples
    angles = _angles(samples)
    incidence = np.unique(angles[:, 0].round(1))
    rows = np.column_stack([angles, samples.values])
    aside = np.abs(np.sin(np.radians(angles[:, 2]))) * np.sin(np.radians(angles[:, 1]))
    return {
        "n_rows": found.n_rows,
        "n_samples": len(samples.values),
        "columns": [{"name": name, "read_as": meaning or None, "unit": unit} for name, meaning, unit in found.columns],
        "ranges": {
            name: [float(column.min()), float(column.max())]
            for name, column in zip((*ANGLE_NAMES, *CHANNELS), rows.T, strict=True)
        },
        "angles_of_incidence_deg": incidence.tolist() if incidence.size <= _MAX_LISTED_ANGLES else None,
        "in_plane_of_incidence": float(np.mean(aside <= np.sin(np.radians(_MAX_IN_PLANE_DISTANCE_DEG)))),
        "warnings": [*samples.notes, *sample_doubts(samples).sentences],
        "first": rows[:_N_SHOWN_SAMPLES].tolist(),
    }


def _angles(samples: ScatteredSamples) -> Array:
    """Return the angles of samples [degrees], shape (n, 3), in the order of `ANGLE_NAMES`."""
    first, second = samples.omega_in, samples.omega_out
    phi_in, phi_out = (np.arctan2(side[:, 1], side[:, 0]) for side in (first, second))
    theta_in, theta_out = (np.arccos(np.clip(side[:, 2], -1.0, 1.0)) for side in (first, second))
    difference = np.degrees(phi_out - phi_in).round(9) % 360.0
    return np.column_stack([np.degrees(theta_in), np.degrees(theta_out), difference])
