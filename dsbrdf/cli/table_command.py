"""The command ``dsbrdf table``: what is understood of a table of samples, before it is fitted."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.cli.arguments import print_json
from dsbrdf.cli.parameters import NO_TABLE_FLAGS, AboutTable, Json, named_in_errors
from dsbrdf.data.grid import CHANNELS
from dsbrdf.data.sample_tables import TABLE_SUFFIXES, ReadTable, is_table, read_table
from dsbrdf.data.scattered_samples import ScatteredSamples
from dsbrdf.errors import InvalidArgumentError, one_of
from dsbrdf.fitting.sample_units import sample_units

_SHOWN = 5  # first samples
_FEW = 12  # angles of incidence that are listed
_ANGLES = ("theta_in", "theta_out", "phi_out - phi_in")
_IN_PLANE = 0.5  # degrees from the plane of incidence


def table(file: Path, /, *, json: Json = False, options: AboutTable = NO_TABLE_FLAGS) -> None:
    """Print what is understood of a table of samples: columns, units, ranges, what is missing, the first samples.

    Parameters
    ----------
    file
        A .csv, .tsv or .txt file, or a .bsdf file of Zemax.
    """
    with named_in_errors(file):
        if not is_table(file):
            raise InvalidArgumentError(f"a table of samples ends in {one_of(TABLE_SUFFIXES)}")
        found = read_table(file.read_bytes(), file.stem, options)
    about = _document(found)
    if json:
        print_json({"file": str(file)} | about)
    else:
        print(f"{file.stem}: {about['n_rows']} rows, {about['n_samples']} samples", "", *_text(about), sep="\n")


def _document(found: ReadTable) -> dict[str, Any]:
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
            for name, column in zip((*_ANGLES, *CHANNELS), rows.T, strict=True)
        },
        "angles_of_incidence": incidence.tolist() if incidence.size <= _FEW else None,
        "in_plane_of_incidence": float(np.mean(aside <= np.sin(np.radians(_IN_PLANE)))),
        "warnings": [*samples.notes, *sample_units(samples).sentences],
        "first": rows[:_SHOWN].tolist(),
    }


def _angles(samples: ScatteredSamples) -> Array:
    """Return theta_in, theta_out and the difference of phi, 0 to 360, shape (n, 3) [degrees]."""
    first, second = samples.omega_in, samples.omega_out
    phi_in, phi_out = (np.arctan2(side[:, 1], side[:, 0]) for side in (first, second))
    theta_in, theta_out = (np.arccos(np.clip(side[:, 2], -1.0, 1.0)) for side in (first, second))
    difference = np.degrees(phi_out - phi_in).round(9) % 360.0
    return np.column_stack([np.degrees(theta_in), np.degrees(theta_out), difference])


def _text(about: dict[str, Any]) -> Iterator[str]:
    width = max(len(column["name"]) for column in about["columns"]) + 2
    yield f"{'column':<{width}}{'read as':<13}unit"
    for column in about["columns"]:
        yield f"{column['name']:<{width}}{column['read_as'] or 'not read':<13}{column['unit']}".rstrip()
    yield ""
    for name, (low, high) in about["ranges"].items():
        unit = "1/sr" if name in CHANNELS else "degrees"
        yield f"{name:<18}{low:.4g} to {high:.4g} {unit}"
    if about["angles_of_incidence"]:
        yield "angles of incidence: " + ", ".join(f"{angle:g}" for angle in about["angles_of_incidence"])
    yield f"in the plane of incidence: {about['in_plane_of_incidence']:.0%} of the samples"
    yield ""
    yield from (f"warning: {sentence}" for sentence in about["warnings"])
    yield "".join(f"{name:>18}" for name in _ANGLES) + "".join(f"{name:>12}" for name in CHANNELS)
    for row in about["first"]:
        yield "".join(f"{angle:>18.2f}" for angle in row[:3]) + "".join(f"{value:>12.4g}" for value in row[3:])
