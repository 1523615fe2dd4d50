"""Read directions [rad] and RGB values from the columns of a table of scattered samples.

A direction is a unit vector, or spherical coordinates in degrees, with the normal along z:

    omega = (sin(theta) cos(phi), sin(theta) sin(phi), cos(theta)).

If the table has no phi, both directions lie in one plane, on opposite sides of the normal: theta_out = theta_in is the
mirror direction. A negative angle lies on the other side of the normal.
"""

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import CHANNELS, directions, spherical
from dsbrdf.errors import MeasurementFormatError
from dsbrdf.samples.cells import TextTable
from dsbrdf.samples.columns import (
    FROM_MIRROR,
    GREY,
    PHIS,
    SPHERICAL,
    THETAS,
    Column,
    Description,
    FoundColumns,
    find_columns,
)
from dsbrdf.samples.names import ANGLE_UNITS, COSINE, HALF_DIFFERENCE, TRISTIMULUS, VECTORS, includes_cosine
from dsbrdf.samples.table_options import TableOptions
from dsbrdf.samples.values import (
    NO_UNIT,
    about_gamut,
    about_values,
    in_nanometres,
    largest_of,
    of_rows,
    rgb_of,
    written_values,
)

_SIDE_NAME = re.compile(r"(?i)(?:scatter(?:ed|ing)?[ _]?)?(?:side|hemisphere)")
# Words of a column for light that is transmitted, and for the back of the sample.
_TRANSMITTED = re.compile(r"(?i)btdf|trans(?:m\w*)?")
_BACK = re.compile(r"(?i)back(?:ward|side)?|rear|rück\w*")
_MAX_MATERIALS = 20  # A column with more different words does not name materials, but samples or dates.
_MAX_THETA_RAD = 1.6  # A table without a larger theta and without units is refused: its angles look like radians.
_MAX_SCAN_DEG = 100.0  # Instruments move the viewer a little beyond the horizon, but no further.
_HALF_TURN_GON = 200.0
_MIN_AZIMUTHS = 3  # A table with fewer azimuths gives no sign of its unit.
_WHOLE_DEG = 0.05  # This difference from a whole number of degrees is rounding.
# If more than this fraction of the rows is at or below the horizon, the columns theta and phi may be exchanged.
_DOUBTFUL_FRACTION = 0.5
# A phase angle may lie outside of its possible range by this much, because of rounding.
_PHASE_TOLERANCE = np.radians(1.0)
# An example of the option columns is given only if it yields different directions in this fraction of the rows.
_MIN_DIFFERENT_FRACTION = 0.9
_WIDE_COSINE = np.cos(np.radians(10.0))  # Without a viewer further from the normal, an example is not given either.
LOWEST_COSINE = 1e-6
"""A direction whose cosine to the normal is smaller counts as at the horizon, because of rounding errors."""


@dataclass(frozen=True, eq=False)
class SampleRows:
    """Rows of samples, and a description of the columns of the table that contained the rows.

    The columns of `numbers` (n, 10) are omega_in (3) and omega_out (3), not yet of unit length, the values of red,
    green and blue, and the weight. A missing number is NaN.
    """

    numbers: Array
    written: Array  # values as written in the file, axes (row, band)
    notes: tuple[str, ...]  # a sentence on each decision of the reader
    columns: Description
    n_rows: int  # number of rows in the file, also unusable rows
    is_grey: bool  # whether the file has one value for all channels
    is_clean: bool = False  # whether all rows are samples of a file of samples
    gap: str = ""  # name of the column that lacks most numbers, if one lacks any


def read_columns(table: TextTable, options: TableOptions) -> SampleRows:
    """Return the directions of the samples in a table as vectors, and their values as RGB.

    Raises MeasurementFormatError if a column is missing, occurs twice, or has an unknown unit.
    """
    if table.names[:2] == ("1", "2") and not options.columns:
        raise _unnamed(table, options)
    table = table.with_columns({name: np.full(table.n_rows, number) for name, number in options.held().items()})
    found = find_columns(table, options)
    columns = found.columns
    _refuse_other_side(table, {column.written for column in columns.values()})
    notes = list(table.notes)
    written = written_values(found, options, notes)
    weight = columns["weight"].numbers if "weight" in columns else np.ones(table.n_rows)
    numbers = np.column_stack([*_vectors(columns, found.form), rgb_of(found, written), weight])
    wavelengths = found.wavelengths
    if "wavelength" in columns:
        numbers, wavelengths = of_rows(numbers, in_nanometres(columns["wavelength"]))
    first = columns[found.values[0]].written
    if includes_cosine(first) and options.cosine is None:
        numbers[:, 6:9] /= np.maximum(numbers[:, 5:6], LOWEST_COSINE)
        notes.append(f"The column {first!r} has the BRDF times the cosine of theta_out, and was divided by it.")
    notes += (
        *_about_directions(found, is_turned=options.phi == "mirror"),
        *_about_unread(table, columns, found.values),
        *about_values(found, wavelengths, options),
        *(about_gamut(numbers[:, 6:9]) if wavelengths.size > 1 or found.values == TRISTIMULUS else ()),
    )
    is_grey = found.values == GREY and wavelengths.size == 0
    lacking = {column.written: np.count_nonzero(~np.isfinite(column.numbers)) for column in columns.values()}
    gap = max(lacking, key=lacking.__getitem__) if any(lacking.values()) else ""
    return SampleRows(numbers, written, tuple(notes), found.description, table.n_rows, is_grey, gap=gap)


def _unnamed(table: TextTable, options: TableOptions) -> MeasurementFormatError:
    """Return the error for a table without names of columns, with an example of the option that reads this table."""
    if table.rows and not table.rows[0][0]:
        return MeasurementFormatError(
            "The table looks like a matrix, but its first cell is empty: write the names of the angles down and across "
            "there, such as theta_out / phi_out."
        )
    n_blocks = sum(name.isdecimal() for name in table.names[table.n_cells :])
    between = f", and lines of {n_blocks} between them, which are columns {table.n_cells + 1} and on" * (n_blocks > 0)
    first = ", ".join(table.rows[0])[:60] if table.rows else ""
    remedy = "a sample needs the angles of light and viewer, which a spectrum does not have"
    if table.n_cells > 2 or n_blocks:
        remedy = "name them by their positions with the option columns, as MEANING=POSITION"
    for columns, constants in _examples(table):
        if _is_read(table, replace(options, columns=columns, constants=options.constants or constants or ())):
            held = f" --constants {constants} with the right angle" if constants and not options.constants else ""
            remedy = f"name them by their positions, as in --columns {columns}{held}"
            break
    return MeasurementFormatError(
        f"The table has no line that names its columns; its rows have {table.n_cells} numbers, such as "
        f"{first}{between}: {remedy}."
    )


def _examples(table: TextTable) -> Iterator[tuple[str, str]]:
    """Yield the usual meanings of columns without names, as the option `columns`, and the constants they need."""
    blocks = [name for name in table.names[table.n_cells :] if name.isdecimal()]
    both, viewer = (THETAS, (*THETAS, "phi_out"), SPHERICAL), (("theta_out",), ("theta_out", "phi_out"))
    for angles in (*(() if len(table.names) > table.n_cells else both), *viewer):
        for values in (GREY, CHANNELS):
            if len(angles) + len(values) == table.n_cells:
                names = [*angles, *values, *("theta_in", "phi_in")[: len(blocks)]]
                pairs = ",".join(f"{name}={at}" for at, name in enumerate(names, 1))
                yield pairs, "" if "theta_in" in {*names, *table.names} else "theta_in=30"


def _is_read(table: TextTable, options: TableOptions) -> bool:
    """Return whether a table is read with these options as samples at different directions of an instrument."""
    try:
        numbers = read_columns(table, options).numbers
    except MeasurementFormatError:
        return False
    pairs = np.unique(numbers[:, :6].round(6), axis=0)
    is_above = numbers[:, [2, 5]].min(axis=1) > LOWEST_COSINE
    # An instrument measures at equal angles again and again, and not only near the normal.
    n_angles, is_wide = min(np.unique(pairs[:, at]).size for at in (2, 5)), numbers[:, 5].min() < _WIDE_COSINE
    is_varied = len(pairs) > _MIN_DIFFERENT_FRACTION * len(numbers)
    return bool(is_wide and is_varied and is_above.mean() > _DOUBTFUL_FRACTION and 3 * n_angles < len(pairs))


def in_radians(column: Column) -> Array:
    """Return the angles in a column; raise MeasurementFormatError if its unit is none of angles."""
    unit = "deg" if column.unit in NO_UNIT else column.unit
    if unit == COSINE and np.all(np.abs(column.numbers) <= 1.0):
        return np.asarray(np.arccos(column.numbers))
    if unit not in ANGLE_UNITS:
        raise MeasurementFormatError(f"The column {column.written!r} is in {unit!r}; angles are in deg, rad or gon.")
    angles = np.where(np.isfinite(column.numbers), column.numbers, np.nan) * ANGLE_UNITS[unit]
    return np.pi / 2.0 - angles if column.is_elevation else angles


def _vectors(columns: dict[str, Column], form: Sequence[str]) -> tuple[Array, Array]:
    """Return omega_in and omega_out, (n, 3) each, from the columns that describe directions."""
    if form is VECTORS:
        first, second = (np.stack([columns[name].numbers for name in form[i : i + 3]], axis=-1) for i in (0, 3))
        lowest = np.fmin.reduce(np.vstack([first, second]), axis=0, initial=1.0)
        if lowest[2] < 0.0 < lowest[1]:
            raise MeasurementFormatError(
                "All vectors have y > 0, and some z < 0, as if the normal were y, but it is z: write (z, x, y) for "
                "each (x, y, z)."
            )
        return first, second
    angles = {name: in_radians(column) for name, column in columns.items() if name in (*form, *PHIS, "phase")}
    if angles.keys() >= {*PHIS}:
        _check_not_exchanged(angles, columns)
    _check_sizes(angles, columns)
    _check_stated_once(angles, columns)
    if form is HALF_DIFFERENCE:
        return directions(*(angles[name] for name in form))
    if form is FROM_MIRROR:
        angles["theta_out"] = angles["theta_in"] + angles["theta_from_mirror"]
    if "phase" in angles:
        angles["phi_out"] = _azimuth_of_phase(angles) + angles.get("phi_in", 0.0)
        angles["theta_out"] = np.abs(angles["theta_out"])
    zero = np.zeros_like(angles["theta_in"])
    phi_in = angles.get("phi_in", zero if "phi_out" in angles else zero + np.pi)
    return spherical(angles["theta_in"], phi_in), spherical(angles["theta_out"], angles.get("phi_out", zero))


def _azimuth_of_phase(angles: dict[str, Array]) -> Array:
    """Return the azimuth between light and viewer from the phase angle, by the law of cosines on the sphere."""
    theta_in, theta_out, phase = (np.abs(angles[name]) for name in (*THETAS, "phase"))
    lowest, highest = np.abs(theta_in - theta_out), theta_in + theta_out
    wrong = (phase < lowest - _PHASE_TOLERANCE) | (phase > highest + _PHASE_TOLERANCE)
    if count := np.count_nonzero(wrong):
        raise MeasurementFormatError(
            f"In {count} of {len(phase)} rows the phase angle is not between the difference and the sum of theta_in "
            "and theta_out, as the angle between light and viewer is."
        )
    sines = np.sin(theta_in) * np.sin(theta_out)
    cosine = (np.cos(phase) - np.cos(theta_in) * np.cos(theta_out)) / np.where(sines == 0.0, 1.0, sines)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _check_not_exchanged(angles: dict[str, Array], columns: dict[str, Column]) -> None:
    """Raise MeasurementFormatError if most rows would be above the horizon only with theta and phi exchanged."""
    quarter = np.pi / 2.0 - LOWEST_COSINE
    above, exchanged = (np.all([np.abs(angles[name]) < quarter for name in pair], axis=0) for pair in (THETAS, PHIS))
    if above.size and np.mean(above) < _DOUBTFUL_FRACTION < np.mean(exchanged):
        names = zip((*THETAS, *PHIS), (*PHIS, *THETAS), strict=True)
        pairs = ",".join(f"{name}={columns[other].written}" for name, other in names)
        raise MeasurementFormatError(
            f"{np.count_nonzero(~above)} of {above.size} rows have a direction at or below the horizon, but would not "
            "with theta and phi exchanged: if the names of these columns are exchanged, name them, as in "
            f"--columns {pairs}."
        )


def _check_sizes(angles: dict[str, Array], columns: dict[str, Column]) -> None:
    """Raise MeasurementFormatError if an angle is too large, or angles without a unit look like radians or gradians."""
    azimuths = [name for name in PHIS if name in angles]
    for name, angle in angles.items():
        bound, largest = 180.0 if name.startswith("theta") else 360.0, np.degrees(largest_of(angle))
        column = columns[name].written
        if largest > bound + 1e-4:
            unit = "" if columns[name].unit else f" If it has another unit, name it {name}_rad or {name}_gon."
            raise MeasurementFormatError(
                f"The column {column!r} has an angle of {largest:.6g} degrees; {bound:.0f} is the largest that there "
                f"is.{unit}"
            )
        if name == "theta_out" and "scatter" in column.lower() and not azimuths and largest > _MAX_SCAN_DEG:
            raise MeasurementFormatError(
                f"The column {column!r} has angles up to {largest:.4g} degrees, as between light and viewer: write "
                "theta_out, between the normal and the viewer, and leave out the rows of transmitted light."
            )
    bare = {name: columns[name].numbers for name in angles if not columns[name].unit}
    thetas = {name: largest_of(numbers) for name, numbers in bare.items() if name.startswith("theta")}
    for name in azimuths:
        if name in bare and largest_of(bare[name]) == _HALF_TURN_GON:
            raise MeasurementFormatError(
                f"The largest {name} is 200, half a turn in gradians: name the column {name}_gon, or {name}_deg."
            )
    phis = {name: largest_of(bare[name]) for name in azimuths if name in bare and _are_radians(bare[name])}
    is_small = 0.0 < max(thetas.values(), default=0.0) < _MAX_THETA_RAD
    if wrong := thetas if is_small else phis:
        raise MeasurementFormatError(
            f"The largest {' and '.join(wrong)} is {max(wrong.values()):.3g}, as of angles in radians: write degrees, "
            f"or name the columns {next(iter(wrong))}_rad and so on."
        )


def _check_stated_once(angles: dict[str, Array], columns: dict[str, Column]) -> None:
    """Raise MeasurementFormatError if the sign of theta_out says what the azimuth says: both would cancel out."""
    if not {"theta_out", "phi_out"} <= angles.keys():
        return
    theta, phi = np.degrees(angles["theta_out"]), np.degrees(angles["phi_out"] - angles.get("phi_in", 0.0)) % 360.0
    sides = [np.unique(phi[where].round(6)) for where in (theta < 0.0, theta > 0.0)]
    if all(side.size == 1 for side in sides) and abs(sides[0] - sides[1]).item() == np.degrees(np.pi):
        raise MeasurementFormatError(
            f"The column {columns['theta_out'].written!r} is negative exactly where {columns['phi_out'].written!r} is "
            f"{sides[0].item():g}: the side is stated twice. Write theta_out without a sign, or leave out the azimuth."
        )


def _are_radians(azimuths: Array) -> bool:
    """Return whether azimuths are within a turn of radians, and are whole numbers only in degrees."""
    turns = np.unique(azimuths[np.isfinite(azimuths)])
    is_whole = np.abs(np.degrees(turns) - np.rint(np.degrees(turns))) < _WHOLE_DEG
    return turns.size > _MIN_AZIMUTHS and largest_of(turns) < 2.0 * np.pi + _WHOLE_DEG and bool(is_whole.all())


def _about_directions(found: FoundColumns, *, is_turned: bool) -> Iterator[str]:
    phis = [name for name in PHIS if name in found.columns]
    if found.form is FROM_MIRROR:
        yield f"The angle theta_out is theta_in plus the column {found.columns['theta_from_mirror'].written!r}."
    if "phase" in found.columns:
        yield "The azimuth follows from the phase angle, which is 0 where the viewer looks along the light."
    elif found.form in (THETAS, FROM_MIRROR) and not phis:
        yield (
            "The table has no phi: all directions are taken to lie in one plane, and theta_out = "
            f"{'-' if is_turned else ''}theta_in to be the mirror direction."
        )
    if phis == ["phi_out"]:
        yield f"The table has no phi_in: the mirror direction is taken to have phi_out = {0 if is_turned else 180}."
    elevations = [name for name, column in found.columns.items() if column.is_elevation]
    yield from (f"The elevation is from the horizon: {name} is 90 degrees minus it." for name in elevations)


def _refuse_other_side(table: TextTable, read: Collection[str]) -> None:
    """Raise MeasurementFormatError if a column that is not read divides the rows among both sides of the sample."""
    for at, name in enumerate(table.names):
        words = table.words(at) if name not in read else []
        # All rows may be of the back: nothing is divided then.
        others = [one for one in words if _TRANSMITTED.fullmatch(one) or (len(words) > 1 and _BACK.fullmatch(one))]
        other = "T" if {*words} == {"R", "T"} else next(iter(others), "")
        if other or (_SIDE_NAME.fullmatch(name) and name not in read and table.varies(at)):
            such = f", such as {other!r}" if other else ""
            raise MeasurementFormatError(
                f"The column {name!r} divides the rows among both sides of the sample{such}: leave out the rows of "
                "transmitted light and of the other side, and then the column."
            )


def _about_unread(table: TextTable, columns: dict[str, Column], values: Collection[str]) -> Iterator[str]:
    read = {column.written for column in columns.values()}
    others = [name for name in table.names if name not in read and name]
    angles = np.stack([column.numbers for name, column in columns.items() if name not in (*values, "weight")], axis=1)
    n_pairs = len(np.unique(angles, axis=0)) if others else len(angles)
    if others:
        shown = ", ".join(repr(name) for name in others[:5]) + (" and others" if len(others) > 5 else "")
        yield f"The table has {'a column that was' if len(others) == 1 else 'columns that were'} not read: {shown}."
    for at, name in enumerate(table.names):
        words = table.words(at) if name in others else []
        if name in others and not words and n_pairs < len(angles):  # Numbers may tell rows of equal directions apart.
            numbers = table.numbers(at)
            is_told_apart = len(np.unique(np.column_stack([angles, numbers]), axis=0)) > n_pairs
            words = [f"{number:g}" for number in np.unique(numbers) if is_told_apart]
        if 1 < len(words) <= _MAX_MATERIALS:
            yield (
                f"The column {name!r} has {len(words)} values, such as {words[0][:40]!r} and {words[1][:40]!r}: if "
                "they are several materials, leave out all but one; if they are channels, write a column for each."
            )
