"""What the columns of a table of scattered samples mean: names as they are written -> directions and values.

A direction is a unit vector, or spherical coordinates in degrees, with the normal along z:

    omega = (sin(theta) cos(phi), sin(theta) sin(phi), cos(theta)).

Without any phi both directions lie in one plane, and theta_out = theta_in is the mirror direction: theta_in is on one
side of the normal and theta_out on the other; a negative angle is on the side opposite to its own.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import directions, spherical
from dsbrdf.data.grid import CHANNELS
from dsbrdf.errors import MeasurementFormatError
from dsbrdf.samples.cells import TextTable
from dsbrdf.samples.names import (
    ANGLE_UNITS,
    HALF_DIFFERENCE,
    VECTORS,
    WAVELENGTH_UNITS,
    is_factor,
    meaning_of,
    name_and_unit,
    wavelength_of,
)
from dsbrdf.samples.spectra import linear_srgb, of_rows
from dsbrdf.samples.table_options import TableOptions

_THETAS = ("theta_in", "theta_out")
_PHIS = ("phi_in", "phi_out")
_GREY = "value"
_DIRECTION_FORMS = (VECTORS, HALF_DIFFERENCE, _THETAS)
_NO_UNIT = ("", "1", "-", "none")
_VALUE_UNITS = (*_NO_UNIT, "1/sr", "sr^-1", "sr-1", "sr**-1", "per sr", "1 / sr")
# Wavelengths without a unit are in metres, or in micrometres, up to these; larger ones are in nanometres.
_MAX_WAVELENGTH_M = 1e-3
_MAX_WAVELENGTH_UM = 20.0
_MAX_THETA_RAD = 1.6  # Angles theta are in radians if none is larger.
# The names of angles are in doubt if a larger fraction of the rows is at or below the horizon.
_DOUBTFUL_FRACTION = 0.5
_POSSIBLE = (
    "Directions are theta_in, phi_in, theta_out, phi_out in degrees (without phi: in one plane), or theta_half, "
    "theta_diff, phi_diff, or the unit vectors omega_in_x to omega_out_z; values in 1/sr are red, green, blue, or "
    "value; the option columns tells which column is which, as in columns theta_in=AOI,value=BSDF, and the option "
    "constants gives an angle that all rows have, as in constants theta_in=30"
)
LOWEST_COSINE = 1e-6
"""A direction with a smaller cosine is at the horizon: sines and cosines of angles in degrees are rounded."""
# Usual orders of columns without names, by their number.
_ORDERS = {
    3: "theta_in=1,theta_out=2,value=3",
    4: "theta_in=1,theta_out=2,phi_out=3,value=4",
    5: "theta_in=1,phi_in=2,theta_out=3,phi_out=4,value=5",
    6: "theta_in=1,theta_out=2,phi_out=3,red=4,green=5,blue=6",
    7: "theta_in=1,phi_in=2,theta_out=3,phi_out=4,red=5,green=6,blue=7",
}

Description = tuple[tuple[str, str, str], ...]
"""Name as written, meaning and unit of each column; the last two may be empty."""


@dataclass(frozen=True, eq=False)
class SampleRows:
    """Rows of samples, and what the columns of their table are.

    The columns of `numbers` (n, 10) are omega_in and omega_out, not yet of unit length, the three values and the
    weight; NaN is where the table has no number.
    """

    numbers: Array
    written: Array  # Values as they are written, (n, bands).
    notes: tuple[str, ...]  # A sentence on each decision of the reader.
    columns: Description
    n_rows: int  # The number of rows in the file.


@dataclass(frozen=True, eq=False)
class _Column:
    written: str
    unit: str
    numbers: Array


def read_columns(table: TextTable, options: TableOptions) -> SampleRows:
    """Return the numbers of a table, and what its columns are.

    Raises MeasurementFormatError if a column is missing, is there twice, or has another unit.
    """
    table = table.with_columns({name: np.full(table.n_rows, number) for name, number in options.held().items()})
    places, units = _places(table, options)
    elevations = [side for side in ("in", "out") if f"elevation_{side}" in places and f"theta_{side}" not in places]
    places |= {f"theta_{side}": places.pop(f"elevation_{side}") for side in elevations}
    bands = {} if places.keys() & {_GREY, *CHANNELS} else _bands(table)
    places |= {name: [place] for name, (place, _) in bands.items()}
    form, values = _chosen(table, places, bands)
    optional = [name for name in (*_PHIS, "weight", "wavelength") if name in places]
    if form is not _THETAS:
        optional = [name for name in optional if name not in _PHIS]
    if values != (_GREY,):
        optional = [name for name in optional if name != "wavelength"]
    columns = {name: _column(table, name, places[name], units) for name in (*form, *values, *optional)}
    written = _written(columns, values, options)
    wavelengths = np.array([wavelength for _, wavelength in bands.values()])
    colors = linear_srgb(wavelengths, written) if bands else np.broadcast_to(written, (table.n_rows, 3))
    weight = columns["weight"].numbers if "weight" in columns else np.ones(table.n_rows)
    numbers = np.column_stack([*_vectors(columns, form, elevations), colors, weight])
    if "wavelength" in columns:
        numbers, wavelengths = of_rows(numbers, _in_nanometres(columns["wavelength"]))
    notes = (
        *table.notes,
        *_about_directions(form, columns, elevations, is_turned=options.phi == "mirror"),
        *_about_unread(table, {column.written for column in columns.values()}),
        *_about_values(values, columns[values[0]].written, wavelengths, options),
    )
    read = {places[name][0]: name for name in columns}
    described = ((name, read.get(at, ""), _unit(table, at)) for at, name in enumerate(table.names) if name)
    return SampleRows(numbers, written, notes, tuple(described), table.n_rows)


def _places(table: TextTable, options: TableOptions) -> tuple[dict[str, list[int]], dict[str, str]]:
    """Return the places of the columns with each meaning, and the units that the options give.

    A column of the rows counts before a constant of the same meaning.
    """
    named = options.named_columns()
    if table.names[:2] == ("1", "2") and not named:
        raise _unnamed(table)
    chosen = {meaning: _places_of(table, name) for meaning, name in named.items()}
    taken = {at for found in chosen.values() for at in found}
    places: dict[str, list[int]] = {}
    for place, name in enumerate(table.names):
        known = meaning_of(name)
        if known is not None and place not in taken and not (known in places and place >= table.n_cells):
            places.setdefault(known, []).append(place)
    for meaning, found in chosen.items():
        known = meaning_of(meaning)
        if known is None:
            raise MeasurementFormatError(f"The option columns has {meaning!r}, which is no meaning. {_POSSIBLE}.")
        if not found:
            raise MeasurementFormatError(f"The table has no column {named[meaning]!r}; it has {_listed(table.names)}.")
        places[known] = found
    return places, {str(meaning_of(name)): unit for name in named if (unit := name_and_unit(name)[1])}


def _places_of(table: TextTable, name: str) -> list[int]:
    """Return the places of the columns with a name, or with a number as their position, from 1."""
    found = [place for place, written in enumerate(table.names) if written.lower() == name.lower()]
    bare = name_and_unit(name)[0]
    found = found or [place for place, written in enumerate(table.names) if name_and_unit(written)[0] == bare]
    is_position = name.isdecimal() and 1 <= int(name[:9]) <= len(table.names)
    return found or ([int(name) - 1] if is_position else [])


def _unnamed(table: TextTable) -> MeasurementFormatError:
    count, held = table.n_cells, [meaning_of(name) for name in table.names[table.n_cells :]]
    blocks = held.count(None)
    example, between = _ORDERS.get(count, _ORDERS[3]), ""
    if held:
        angles = (f",theta_in={count + 1}", f",phi_in={count + 2}")[:blocks]
        example = "theta_out=1,phi_out=2,value=3" + "".join(angles)
    if blocks:
        between = f", and lines of {blocks} between them, which are columns {count + 1} and on"
    if table.rows and not table.rows[0][0]:
        return MeasurementFormatError(
            "The table looks like a matrix, but its first cell is empty: write the names of the angles down and across "
            "there, such as theta_out / phi_out."
        )
    first = ", ".join(table.rows[0]) if table.rows else ""
    return MeasurementFormatError(
        f"The table has no line that names its columns; its rows have {count} numbers, such as {first[:60]}{between}: "
        f"name them by their positions, as in columns {example}."
    )


def _bands(table: TextTable) -> dict[str, tuple[int, float]]:
    """Return the place and the wavelength [nm] of columns named by wavelengths, ascending, if there are several."""
    found = [(wavelength, place) for place, name in enumerate(table.names) if (wavelength := wavelength_of(name))]
    return {f"{wavelength:g} nm": (place, wavelength) for wavelength, place in sorted(found)} if len(found) > 1 else {}


def _chosen(table: TextTable, places: dict[str, list[int]], bands: Iterable[str]) -> tuple[tuple[str, ...], ...]:
    """Return the names of the columns of directions and of values that a table has."""
    forms = [form for form in _DIRECTION_FORMS if places.keys() >= {*form}]
    # If no form is complete, the table has most columns of the nearest; angles if it has none.
    nearest = max((_THETAS, VECTORS, HALF_DIFFERENCE), key=lambda names: len(places.keys() & {*names}))
    values = CHANNELS if places.keys() >= {*CHANNELS} else tuple(bands) or (_GREY,)
    wanted = {} if forms else {"directions": nearest}
    wanted |= {} if places.keys() >= {*values} else {"values": CHANNELS}
    for kind, names in wanted.items():
        lacking = ", ".join(name for name in names if name not in places)
        known = {at for found in places.values() for at in found}
        unknown = [name for at, name in enumerate(table.names) if name and at not in known and not wavelength_of(name)]
        quoted = f"; not understood are {', '.join(map(repr, unknown[:10]))}" if unknown else ""
        raise MeasurementFormatError(
            f"The table lacks columns for the {kind}: {lacking}. It has {_listed(table.names)}{quoted}. {_POSSIBLE}."
        )
    return forms[0], values


def _column(table: TextTable, name: str, places: Sequence[int], units: dict[str, str]) -> _Column:
    if len(places) > 1:
        first, second = (table.names[place] for place in places[:2])
        raise MeasurementFormatError(f"The columns {first!r} and {second!r} mean the same; keep one of them.")
    unit = units.get(name) or _unit(table, places[0])
    return _Column(table.names[places[0]], unit, table.numbers(places[0]))


def _unit(table: TextTable, place: int) -> str:
    return name_and_unit(table.names[place])[1]


def _listed(names: Iterable[str]) -> str:
    return ", ".join([name for name in names if name][:20])


def _written(columns: dict[str, _Column], values: Sequence[str], options: TableOptions) -> Array:
    """Return the values as they are written, NaN where they stand for a missing value, shape (n, bands)."""
    for name in values:
        unit = columns[name].unit
        allowed = (*_VALUE_UNITS, *(WAVELENGTH_UNITS if wavelength_of(name) else ()))
        if unit not in allowed and options.scale == 1.0:
            raise MeasurementFormatError(
                f"The column {name!r} is in {unit!r}; the values of a BRDF are in 1/sr: if they are "
                "those times a factor, give its inverse as the option scale, which is 0.01 for per cent and 0.003183, "
                "1/(100 pi), for reflectance factors in per cent."
            )
    written = np.stack([columns[name].numbers for name in values], axis=-1)
    return np.where(np.isin(written, options.missing), np.nan, written)


def _in_nanometres(column: _Column) -> Array:
    largest = _largest(column.numbers)
    by_size = "m" if largest < _MAX_WAVELENGTH_M else "um" if largest < _MAX_WAVELENGTH_UM else "nm"
    unit = by_size if column.unit in _NO_UNIT else column.unit
    if unit not in WAVELENGTH_UNITS:
        raise MeasurementFormatError(f"The wavelengths are in {unit!r}; they are in nm, um or m.")
    return column.numbers * WAVELENGTH_UNITS[unit]


def _in_radians(name: str, column: _Column, *, is_elevation: bool) -> Array:
    unit = "deg" if column.unit in _NO_UNIT else column.unit
    if unit not in ANGLE_UNITS:
        raise MeasurementFormatError(f"The column {name!r} is in {unit!r}; angles are in deg or in rad.")
    angles = np.where(np.isfinite(column.numbers), column.numbers, np.nan) * ANGLE_UNITS[unit]
    return np.pi / 2.0 - angles if is_elevation else angles


def _vectors(columns: dict[str, _Column], form: Sequence[str], elevations: Collection[str]) -> tuple[Array, Array]:
    """Return omega_in and omega_out, (n, 3) each, from the columns of one form."""
    if form is VECTORS:
        first, second = (np.stack([columns[name].numbers for name in form[i : i + 3]], axis=-1) for i in (0, 3))
        return first, second
    angles = {
        name: _in_radians(name, column, is_elevation=name.removeprefix("theta_") in elevations)
        for name, column in columns.items()
        if name in (*form, *_PHIS)
    }
    if angles.keys() >= {*_PHIS}:
        _check_not_exchanged(angles, columns)
    _check_sizes(angles, columns)
    if form is HALF_DIFFERENCE:
        return directions(*(angles[name] for name in form))
    zero = np.zeros_like(angles["theta_in"])
    phi_in = angles.get("phi_in", zero if "phi_out" in angles else zero + np.pi)
    return spherical(angles["theta_in"], phi_in), spherical(angles["theta_out"], angles.get("phi_out", zero))


def _check_not_exchanged(angles: dict[str, Array], columns: dict[str, _Column]) -> None:
    """Raise MeasurementFormatError if most rows are below the horizon, and above it with theta and phi exchanged."""
    quarter = np.pi / 2.0 - LOWEST_COSINE
    above, exchanged = (np.all([np.abs(angles[name]) < quarter for name in pair], axis=0) for pair in (_THETAS, _PHIS))
    if above.size and np.mean(above) < _DOUBTFUL_FRACTION < np.mean(exchanged):
        names = zip((*_THETAS, *_PHIS), (*_PHIS, *_THETAS), strict=True)
        pairs = ",".join(f"{name}={columns[other].written}" for name, other in names)
        raise MeasurementFormatError(
            f"{np.count_nonzero(~above)} of {above.size} rows have a direction at or below the horizon as theta and "
            "phi are named, and the columns named phi have angles as those to the normal: if the names are "
            f"exchanged, set columns to {pairs}."
        )


def _check_sizes(angles: dict[str, Array], columns: dict[str, _Column]) -> None:
    """Raise MeasurementFormatError for angles beyond a full turn, or that look like radians without saying so."""
    for name, angle in angles.items():
        bound, largest = 180.0 if name.startswith("theta") else 360.0, np.degrees(_largest(angle))
        if largest > bound + 1e-4:
            raise MeasurementFormatError(
                f"The column {name!r} has an angle of {largest:.6g} degrees; {bound:.0f} is the largest that there is."
            )
    thetas = [name for name in angles if name.startswith("theta") and not columns[name].unit]
    largest = max((_largest(columns[name].numbers) for name in thetas), default=0.0)
    if 0.0 < largest < _MAX_THETA_RAD:
        first, second = [name for name in angles if name.startswith("theta")][:2]
        raise MeasurementFormatError(
            f"The angles {first} and {second} are at most {largest:.3g}, as angles in radians are: write degrees, "
            f"or name the columns {first}_rad and so on."
        )


def _largest(numbers: Array) -> float:
    return float(np.abs(numbers[np.isfinite(numbers)]).max(initial=0.0))


def _about_directions(
    form: Sequence[str], columns: Collection[str], elevations: Sequence[str], *, is_turned: bool
) -> Iterator[str]:
    phis = [name for name in _PHIS if name in columns]
    if form is _THETAS and not phis:
        yield (
            "The table has no phi: all directions are taken to lie in one plane, and theta_out = "
            f"{'-' if is_turned else ''}theta_in to be the mirror direction."
        )
    if phis == ["phi_out"]:
        yield f"The table has no phi_in: the mirror direction is taken to have phi_out = {0 if is_turned else 180}."
    yield from (f"The elevation is from the horizon: theta_{side} is 90 degrees minus it." for side in elevations)


def _about_unread(table: TextTable, read: Collection[str]) -> Iterator[str]:
    others = [name for name in table.names if name not in read and name]
    if others:
        shown = ", ".join(repr(name) for name in others[:5]) + (" and others" if len(others) > 5 else "")
        yield f"The table has {'a column that was' if len(others) == 1 else 'columns that were'} not read: {shown}."


def _about_values(values: Sequence[str], written: str, wavelengths: Array, options: TableOptions) -> Iterator[str]:
    if is_factor(written) and options.scale == 1.0:
        yield (
            f"The column {written!r} has the name of reflectance factors, which are pi times the values of a BRDF in "
            "1/sr: if they are, set scale to 0.3183, or to 0.003183 for per cent."
        )
    if values == CHANNELS:
        return
    if wavelengths.size == 0:
        yield "The table has one column of values: the material is taken to be grey."
    elif wavelengths.size == 1:
        yield f"All values are at {wavelengths[0]:g} nm: the material is taken to be grey."
    else:
        yield (
            f"The {wavelengths.size} wavelengths from {wavelengths[0]:g} to {wavelengths[-1]:g} nm were made linear "
            "sRGB, as the CIE 1931 observer sees them under light of equal energy; a flat spectrum is grey."
        )
