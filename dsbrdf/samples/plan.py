"""Write pairs of directions to measure next as a table to fill in, with the columns of the table measured before."""

import csv
import io
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import half_difference, spherical
from dsbrdf.fitting.report import SuggestedPair
from dsbrdf.samples.columns import PHIS, SPHERICAL, THETAS, Column, FoundColumns, find_columns
from dsbrdf.samples.directions import in_radians
from dsbrdf.samples.names import ANGLE_UNITS, COSINE, HALF_DIFFERENCE, VECTORS
from dsbrdf.samples.reading import cells_of
from dsbrdf.samples.table_options import TableOptions


def plan_table(content: bytes, options: TableOptions, pairs: Sequence[SuggestedPair]) -> bytes:
    """Return a table of pairs of directions, sorted by theta_in, whose values are left to fill in.

    The table has the columns, units, separator and decimal sign of the table in `content`, so that both can be read
    together with the same `options`. Spectra have a row for each wavelength and pair.
    """
    table = cells_of(content, options)
    table = table.with_columns({name: np.full(table.n_rows, number) for name, number in options.held().items()})
    found = find_columns(table, options)
    names = [name for name in table.names if name not in options.held()]
    meanings = {column.written: meaning for meaning, column in found.columns.items()}
    if not table.rows:  # The file of a program has no line of names.
        names = [*SPHERICAL, *(found.columns[name].written for name in found.values)]
        meanings, found = {name: name for name in SPHERICAL}, replace(found, columns={})
    angles = _angles(pairs, found, is_turned=options.phi == "mirror")
    wavelengths = np.unique(found.columns["wavelength"].numbers).tolist() if "wavelength" in found.columns else [0.0]
    separator = table.separator if table.rows else ","
    decimal = "," if separator != "," and any("," in cell for row in table.rows[:9] for cell in row) else "."
    text = io.StringIO()
    writer = csv.writer(text, delimiter=separator, lineterminator="\n")
    if not names[0].isdecimal():
        writer.writerow(names)
    for at in range(len(pairs)):
        for wavelength in wavelengths:
            row = {name: column[at] for name, column in angles.items()} | {"wavelength": wavelength, "weight": 1.0}
            cells = [
                _cell(row[meaning], found.columns.get(meaning)) if (meaning := meanings.get(name, "")) in row else ""
                for name in names
            ]
            # Empty cells between blanks would be no cells.
            writer.writerow([cell.replace(".", decimal) or ("nan" if separator == " " else "") for cell in cells])
    return text.getvalue().encode()


def _angles(pairs: Sequence[SuggestedPair], found: FoundColumns, *, is_turned: bool) -> dict[str, Array]:
    """Return the angles [degrees] and the vectors of sorted pairs by meaning; `is_turned` as by the option phi."""
    rows = sorted((pair.theta_in_deg, pair.theta_out_deg, pair.phi_deg) for pair in pairs)
    theta_in, theta_out, phi = np.array(rows).reshape(-1, 3).T
    known = np.degrees(in_radians(found.columns["phi_in"])) if "phi_in" in found.columns else np.zeros(1)
    phi_in = np.full_like(phi, known[np.isfinite(known)][0] if np.isfinite(known).any() else 0.0)
    phi_out = (phi_in + phi + 180.0 * is_turned) % 360.0
    omega_in, omega_out = spherical(*np.radians([theta_in, phi_in])), spherical(*np.radians([theta_out, phi_out]))
    if found.columns.keys() >= {*THETAS} and not found.columns.keys() & {*PHIS, "phase"}:
        theta_out = theta_out * np.where((phi > 90.0) != is_turned, 1.0, -1.0)  # One plane has signs, not azimuths.
    return {
        **dict(zip(SPHERICAL, (theta_in, phi_in, theta_out, phi_out), strict=True)),
        **dict(zip(HALF_DIFFERENCE, np.degrees(half_difference(omega_in, omega_out)), strict=True)),
        **dict(zip(VECTORS, [*omega_in.T, *omega_out.T], strict=True)),
        "phase": np.degrees(np.arccos(np.clip(np.sum(omega_in * omega_out, axis=1), -1.0, 1.0))),
        "theta_from_mirror": theta_out - theta_in,
    }


def _cell(number: float, column: Column | None) -> str:
    """Return a number as text, an angle [degrees] in the unit of its column."""
    if column is not None and column.is_elevation:
        number = 90.0 - number
    if column is not None and column.unit == COSINE:
        number = float(np.cos(np.radians(number)))
    elif column is not None and column.unit in ANGLE_UNITS:
        number = float(np.radians(number)) / ANGLE_UNITS[column.unit]
    return f"{round(number, 9):.10g}"
