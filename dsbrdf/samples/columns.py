"""What the columns of a table of scattered samples mean: names as they are written -> directions and values.

A direction is a unit vector, or spherical coordinates in degrees, with the normal along z:

    omega = (sin(theta) cos(phi), sin(theta) sin(phi), cos(theta)).

Without any phi both directions lie in one plane, and theta_out = theta_in is the mirror direction: theta_in is on one
side of the normal and theta_out on the other; a negative angle is on the side opposite to its own.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import directions, spherical
from dsbrdf.data.grid import CHANNELS
from dsbrdf.errors import MeasurementFormatError
from dsbrdf.samples.cells import TextTable
from dsbrdf.samples.names import (
    DEGREES,
    HALF_DIFFERENCE,
    MEANINGS,
    NANOMETRES,
    RADIANS,
    VECTORS,
    is_factor,
    name_and_unit,
    wavelength_of,
)
from dsbrdf.samples.spectra import linear_srgb, of_rows
from dsbrdf.samples.table_options import TableOptions

_THETAS = ("theta_in", "theta_out")
_PHIS = ("phi_in", "phi_out")
_GREY = "value"
_WEIGHT = "weight"
_WAVELENGTH = "wavelength"
_DIRECTION_FORMS = (VECTORS, HALF_DIFFERENCE, _THETAS)
_PER_STERADIAN = ("1/sr", "sr^-1", "sr-1", "sr**-1", "per sr", "1 / sr")
# Wavelengths without a unit are in metres, or in micrometres, up to these; larger ones are in nanometres.
_MAX_WAVELENGTH_M = 1e-3
_MAX_WAVELENGTH_UM = 20.0
_NO_UNIT = ("", "1", "-", "none")
_POSSIBLE = (
    "Directions are theta_in, phi_in, theta_out, phi_out in degrees (without phi: in one plane), or theta_half, "
    "theta_diff, phi_diff, or the unit vectors omega_in_x to omega_out_z; values in 1/sr are red, green, blue, or "
    "value; the option columns tells which column is which, as in columns theta_in=AOI,value=BSDF, and the option "
    "constants gives an angle that all rows have, as in constants theta_in=30"
)
LOWEST_COSINE = 1e-6
"""Cosine below which a direction is at the horizon: sines and cosines of angles in degrees are rounded."""
_SURELY_DEGREES = 1.6  # theta never gets further than this in radians
# Usual orders of columns without names, by their number.
_ORDERS = {
    3: "theta_in=1,theta_out=2,value=3",
    4: "theta_in=1,theta_out=2,phi_out=3,value=4",
    5: "theta_in=1,phi_in=2,theta_out=3,phi_out=4,value=5",
    7: "theta_in=1,phi_in=2,theta_out=3,phi_out=4,red=5,green=6,blue=7",
}
_MOSTLY = 0.5  # fraction of the rows at or below the horizon from which on the names of angles are in doubt


@dataclass(frozen=True, eq=False)
class SampleColumns:
    """What the columns of a table are.

    The columns of the numbers (n, 10) are omega_in and omega_out, not yet of unit length, the three values and the
    weight, 1 if the table has none; NaN is where it has no number.
    """

    numbers: Array
    written: Array  # values as they are written, (n, bands)
    notes: tuple[str, ...]  # what was decided, a sentence each
    columns: tuple[tuple[str, str, str], ...]  # name as written, what it was read as and its unit, if they say it


def sample_columns(table: TextTable, options: TableOptions) -> SampleColumns:
    """Return the numbers of a table, and what its columns are.

    Raises MeasurementFormatError if a column is missing, is there twice, or has another unit.
    """
    table = table.with_columns(options.held())
    places = _places(table, options)
    from_horizon = [side for side in ("in", "out") if f"elevation_{side}" in places and f"theta_{side}" not in places]
    for side in from_horizon:
        places[f"theta_{side}"] = places.pop(f"elevation_{side}")
    form = next((form for form in _DIRECTION_FORMS if places.keys() >= {*form}), None)
    if form is None:
        # Those of which the table has most columns; angles if it has none.
        nearest = max((_THETAS, VECTORS, HALF_DIFFERENCE), key=lambda names: len(places.keys() & {*names}))
        raise _missing("directions", nearest, table, places)
    bands = {} if places.keys() & {_GREY, *CHANNELS} else _bands(table)
    places |= {name: [place] for name, (place, _) in bands.items()}
    values = CHANNELS if places.keys() >= {*CHANNELS} else tuple(bands) or (_GREY,)
    if not places.keys() >= {*values}:
        raise _missing("values", CHANNELS, table, places)
    by_rows = [_WAVELENGTH] if _WAVELENGTH in places and values == (_GREY,) else []
    phis = [name for name in _PHIS if form is _THETAS and name in places]
    used = [*form, *phis, *values, *by_rows, *([_WEIGHT] if _WEIGHT in places else [])]
    for name in used:
        if len(places[name]) > 1:
            first, second = (table.names[place] for place in places[name][:2])
            raise MeasurementFormatError(f"The columns {first!r} and {second!r} mean the same; keep one of them.")
    column = {name: table.numbers(places[name][0]) for name in used}
    for name in values:
        column[name] = np.where(np.isin(column[name], options.missing), np.nan, column[name])
    units = {name: _unit(table, at) for name, (at, *_) in places.items()}
    for name in values:
        if units[name] not in (*_NO_UNIT, *_PER_STERADIAN, *(NANOMETRES if bands else [])) and options.scale == 1.0:
            raise MeasurementFormatError(
                f"The column {name!r} is in {units[name]!r}; the values of a BRDF are in 1/sr: if they are "
                "those times a factor, give its inverse as the option scale, which is 0.01 for per cent and 0.003183, "
                "1/(100 pi), for reflectance factors in per cent."
            )
    for side in from_horizon:
        quarter = np.pi / 2.0 if units[f"theta_{side}"] in RADIANS else 90.0
        column[f"theta_{side}"] = quarter - column[f"theta_{side}"]
    colors = written = np.stack([column[name] for name in values], axis=-1)
    wavelengths = np.array([wavelength for _, wavelength in bands.values()])
    if bands:
        colors = linear_srgb(wavelengths, colors)
    weight = column.get(_WEIGHT, np.ones(table.n_rows))
    written_as = {name: table.names[places[name][0]] for name in used}
    vectors = _vectors(column, form, units, written_as)
    numbers = np.column_stack([*vectors, np.broadcast_to(colors, (len(colors), 3)), weight])
    if by_rows:
        numbers, wavelengths = of_rows(numbers, _in_nanometres(column[_WAVELENGTH], units[_WAVELENGTH]))
    notes = [*table.notes, *_notes(table, form, phis, {*written_as.values()}, mirror=options.phi == "mirror")]
    notes += _about_values(values, written_as, wavelengths, options)
    notes += [f"The elevation is from the horizon: theta_{side} is 90 degrees minus it." for side in from_horizon]
    read = {places[name][0]: name for name in used}
    columns = tuple((name, read.get(at, ""), _unit(table, at)) for at, name in enumerate(table.names) if name)
    return SampleColumns(numbers, written, tuple(notes), columns)


def _bands(table: TextTable) -> dict[str, tuple[int, float]]:
    """Return the place and the wavelength [nm] of each column of one, in their order; none if there is one alone."""
    found = [(wavelength, place) for place, name in enumerate(table.names) if (wavelength := wavelength_of(name))]
    return {f"{wavelength:g} nm": (place, wavelength) for wavelength, place in sorted(found)} if len(found) > 1 else {}


def _in_nanometres(wavelengths: Array, unit: str) -> Array:
    if unit not in (*_NO_UNIT, *NANOMETRES):
        raise MeasurementFormatError(f"The wavelengths are in {unit!r}; they are in nm, um or m.")
    largest = _largest(wavelengths)
    by_size = "m" if largest < _MAX_WAVELENGTH_M else "um" if largest < _MAX_WAVELENGTH_UM else "nm"
    return wavelengths * NANOMETRES[by_size if unit in _NO_UNIT else unit]


def _about_values(
    values: tuple[str, ...], written_as: dict[str, str], wavelengths: Array, options: TableOptions
) -> Iterator[str]:
    factors = [name for name in values if is_factor(written_as[name])]
    if factors and options.scale == 1.0:
        yield (
            f"The column {written_as[factors[0]]!r} has the name of reflectance factors, which are pi times the values "
            "of a BRDF in 1/sr: if they are, set scale to 0.3183, or to 0.003183 for per cent."
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


def _places(table: TextTable, options: TableOptions) -> dict[str, list[int]]:
    """Return the places of the columns with each meaning; one that the rows have counts, not one for all rows."""
    named = options.named_columns()
    if table.names[:2] == ("1", "2") and not named:
        raise _unnamed(table)
    taken = {at for name in named.values() for at in _places_of(table, name)}
    places: dict[str, list[int]] = {}
    for place, name in enumerate(table.names):
        known = MEANINGS.get(name_and_unit(name)[0])
        if known is not None and place not in taken and not (known in places and place >= table.n_cells):
            places.setdefault(known, []).append(place)
    for meaning, name in named.items():
        known = MEANINGS.get(name_and_unit(meaning)[0])
        if known is None:
            raise MeasurementFormatError(f"The option columns has {meaning!r}, which is no meaning. {_POSSIBLE}.")
        places[known] = _places_of(table, name)
        if not places[known]:
            raise MeasurementFormatError(f"The table has no column {name!r}; it has {_listed(table)}.")
    return places


def _places_of(table: TextTable, name: str) -> list[int]:
    """Return the places of the columns with a name, or with a number as their position, from 1."""
    wanted = name_and_unit(name)
    found = [place for place, written in enumerate(table.names) if written.lower() == name.lower()]
    found = found or [place for place, written in enumerate(table.names) if name_and_unit(written)[0] == wanted[0]]
    is_position = name.isdecimal() and 1 <= int(name[:9]) <= len(table.names)
    return found or ([int(name) - 1] if is_position else [])


def _unnamed(table: TextTable) -> MeasurementFormatError:
    count, blocks = table.n_cells, len(table.names) - table.n_cells
    example = _ORDERS.get(count, _ORDERS[3])
    if blocks:
        example = f"theta_out=1,phi_out=2,value=3,theta_in={count + 1}" + (f",phi_in={count + 2}" if blocks > 1 else "")
    between = f", and lines of {blocks} between them, which are columns {count + 1} and on" if blocks else ""
    first = ", ".join(table.rows[0]) if table.rows else ""
    return MeasurementFormatError(
        f"The table has no line that names its columns; its rows have {count} numbers, such as {first[:60]}{between}: "
        f"name them by their positions, as in columns {example}."
    )


def _unit(table: TextTable, place: int) -> str:
    return name_and_unit(table.names[place])[1] or name_and_unit(f"({table.units[place]})")[1]


def _listed(table: TextTable) -> str:
    return ", ".join([name for name in table.names if name][:20])


def _missing(
    what: str, wanted: tuple[str, ...], table: TextTable, places: dict[str, list[int]]
) -> MeasurementFormatError:
    lacking = ", ".join(name for name in wanted if name not in places)
    known = {at for found in places.values() for at in found}
    unknown = [name for at, name in enumerate(table.names) if name and at not in known and not wavelength_of(name)]
    quoted = f"; not understood are {', '.join(map(repr, unknown[:10]))}" if unknown else ""
    return MeasurementFormatError(
        f"The table lacks columns for the {what}: {lacking}. It has {_listed(table)}{quoted}. {_POSSIBLE}."
    )


def _vectors(
    column: dict[str, Array], form: tuple[str, ...], units: dict[str, str], written_as: dict[str, str]
) -> tuple[Array, Array]:
    if form is VECTORS:
        first, second = (np.stack([column[name] for name in form[i : i + 3]], axis=-1) for i in (0, 3))
        return first, second
    scaled = {name: _in_radians(name, column[name], units[name]) for name in (*form, *_PHIS) if name in column}
    if scaled.keys() >= {*_PHIS}:
        _check_not_exchanged(scaled, written_as)
    angles = {name: _bounded(name, angle) for name, angle in scaled.items()}
    thetas = [angle for name, angle in angles.items() if name.startswith("theta") and not units[name]]
    largest = np.degrees(max(map(_largest, thetas), default=0.0))
    if 0.0 < largest < _SURELY_DEGREES:
        raise MeasurementFormatError(
            f"The angles {form[0]} and {form[1]} are at most {largest:.3g}, as angles in radians are: write degrees, "
            f"or name the columns {form[0]}_rad and so on."
        )
    if form is HALF_DIFFERENCE:
        return directions(*(angles[name] for name in form))
    in_plane = not angles.keys() & {*_PHIS}
    zero = np.zeros_like(angles["theta_in"])
    phi_in = zero + np.pi if in_plane else angles.get("phi_in", zero)
    return spherical(angles["theta_in"], phi_in), spherical(angles["theta_out"], angles.get("phi_out", zero))


def _check_not_exchanged(angles: dict[str, Array], written_as: dict[str, str]) -> None:
    """Raise MeasurementFormatError if most rows are below the horizon, and above it with theta and phi exchanged."""
    quarter = np.pi / 2.0 - LOWEST_COSINE
    above, exchanged = (
        (np.abs(angles[first]) < quarter) & (np.abs(angles[second]) < quarter) for first, second in (_THETAS, _PHIS)
    )
    if above.size and np.mean(above) < _MOSTLY < np.mean(exchanged):
        pairs = ",".join(
            f"{name}={written_as[other]}" for name, other in zip((*_THETAS, *_PHIS), (*_PHIS, *_THETAS), strict=True)
        )
        raise MeasurementFormatError(
            f"{np.count_nonzero(~above)} of {above.size} rows have a direction at or below the horizon as theta and "
            "phi are named, and the columns named phi have angles as those to the normal: if the names are "
            f"exchanged, set columns to {pairs}."
        )


def _in_radians(name: str, angle: Array, unit: str) -> Array:
    if unit not in (*_NO_UNIT, *DEGREES, *RADIANS):
        raise MeasurementFormatError(f"The column {name!r} is in {unit!r}; angles are in deg or in rad.")
    angle = np.where(np.isfinite(angle), angle, np.nan)
    return np.asarray(angle if unit in RADIANS else np.radians(angle))


def _bounded(name: str, radians: Array) -> Array:
    bound = 180.0 if name.startswith("theta") else 360.0
    if _largest(radians) > np.radians(bound) + 1e-6:
        largest = np.degrees(_largest(radians))
        raise MeasurementFormatError(
            f"The column {name!r} has an angle of {largest:.6g} degrees; {bound:.0f} is the largest that there is."
        )
    return radians


def _largest(angle: Array) -> float:
    return float(np.abs(angle[np.isfinite(angle)]).max(initial=0.0))


def _notes(table: TextTable, form: tuple[str, ...], phis: list[str], read: set[str], *, mirror: bool) -> Iterator[str]:
    if form is _THETAS and not phis:
        yield (
            "The table has no phi: all directions are taken to lie in one plane, and theta_out = "
            f"{'-' if mirror else ''}theta_in to be the mirror direction."
        )
    if phis == ["phi_out"]:
        yield f"The table has no phi_in: the mirror direction is taken to have phi_out = {0 if mirror else 180}."
    others = [name for name in table.names if name not in read and name]
    if others:
        shown = ", ".join(repr(name) for name in others[:5]) + (" and others" if len(others) > 5 else "")
        yield f"The table has {'a column that was' if len(others) == 1 else 'columns that were'} not read: {shown}."
