"""What the columns of a table of scattered samples mean: names as they are written -> directions and values.

A direction is a unit vector, or spherical coordinates in degrees, with the normal along z:

    omega = (sin(theta) cos(phi), sin(theta) sin(phi), cos(theta)).

Without any phi both directions lie in one plane, and theta_out = theta_in is the mirror direction: theta_in is on one
side of the normal and theta_out on the other; a negative angle is on the side opposite to its own.
"""

import re
from collections.abc import Iterator

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import directions, spherical
from dsbrdf.data.grid import CHANNELS
from dsbrdf.data.text_table import TextTable
from dsbrdf.errors import MeasurementFormatError

_SIDES = {"in": ("in", "i", "incident"), "out": ("out", "o", "r", "s")}
VECTORS = tuple(f"omega_{side}_{axis}" for side in _SIDES for axis in "xyz")
_THETAS, _PHIS = ("theta_in", "theta_out"), ("phi_in", "phi_out")
_HALF_DIFFERENCE = ("theta_half", "theta_diff", "phi_diff")
_GREY, _WEIGHT = "value", "weight"
_FORMS = (VECTORS, _HALF_DIFFERENCE, _THETAS)  # of directions
_DEGREES, _RADIANS = ("deg", "degree", "degrees", "°"), ("rad", "radian", "radians")
_PER_STERADIAN = ("1/sr", "sr^-1", "sr-1", "sr**-1", "sr⁻¹", "per sr", "1 / sr")
_WAVELENGTHS = ("wavelength", "lambda", "wl", "λ")
_NO_UNIT = ("", "1", "-", "none")
_POSSIBLE = (
    "Directions are theta_in, phi_in, theta_out, phi_out in degrees (without phi: in one plane), or theta_half, "
    "theta_diff, phi_diff, or the unit vectors omega_in_x to omega_out_z; values in 1/sr are red, green, blue, or value"
)
_LONGEST_NAME = 200  # characters of a cell with a name and its unit
_SURELY_DEGREES = 1.6  # theta never gets further than this in radians


def _spellings() -> Iterator[tuple[str, str]]:
    for side, words in _SIDES.items():
        for word in words:
            yield from ((f"{angle}{mark}{word}", f"{angle}_{side}") for angle in ("theta", "phi") for mark in ("_", ""))
        for axis in "xyz":
            yield from ((f"{name}_{axis}", f"omega_{side}_{axis}") for name in (f"omega_{side}", f"omega_{side[0]}"))
            yield f"w{side[0]}_{axis}", f"omega_{side}_{axis}"
    for name in _HALF_DIFFERENCE:
        angle, _, of = name.partition("_")
        yield from ((spelling, name) for spelling in (name, f"{angle}{of}", f"{angle}_{of[0]}"))
    for channel in CHANNELS:
        yield from ((spelling, channel) for spelling in (channel, channel[0], f"brdf_{channel}", f"brdf_{channel[0]}"))
    yield from ((spelling, _GREY) for spelling in (_GREY, "brdf", "bsdf", "luminance", "f_r", "fr"))
    yield _WEIGHT, _WEIGHT


_NAMES = dict(_spellings())


def is_known(cell: str) -> bool:
    """Whether a cell is one of the spellings of a column's name."""
    return _meaning(cell)[0] in _NAMES


def sample_columns(table: TextTable) -> tuple[Array, list[str]]:
    """Return the numbers of a table, and what was decided about them, a sentence each.

    The columns of the numbers (n, 10) are omega_in and omega_out, not yet of unit length, the three values and the
    weight, 1 if the table has none; NaN is where it has no number. Raises MeasurementFormatError if a column is
    missing, is there twice, or has another unit.
    """
    places: dict[str, list[int]] = {}
    for place, name in enumerate(table.names):
        known = _NAMES.get(_meaning(name)[0])
        if known is not None:
            places.setdefault(known, []).append(place)
    form = next((form for form in _FORMS if places.keys() >= {*form}), None)
    if form is None:
        # Those of which the table has most columns; angles if it has none.
        nearest = max((_THETAS, VECTORS, _HALF_DIFFERENCE), key=lambda names: len(places.keys() & {*names}))
        raise _missing("directions", nearest, table, places)
    values = CHANNELS if places.keys() >= {*CHANNELS} else (_GREY,)
    if not places.keys() >= {*values}:
        raise _missing("values", CHANNELS, table, places)
    for name in table.names:
        if _meaning(name)[0] in _WAVELENGTHS:
            raise MeasurementFormatError(
                f"The column {name!r} has wavelengths, which would be averaged to grey: give a table with red, green "
                "and blue in linear sRGB, or one for each wavelength."
            )
    phis = [name for name in _PHIS if form is _THETAS and name in places]
    used = [*form, *phis, *values, *([_WEIGHT] if _WEIGHT in places else [])]
    for name in used:
        if len(places[name]) > 1:
            first, second = (table.names[place] for place in places[name][:2])
            raise MeasurementFormatError(f"The columns {first!r} and {second!r} mean the same; keep one of them.")
    column = {name: table.numbers(places[name][0]) for name in used}
    units = {name: _meaning(table.names[at])[1] or table.units[at].strip().lower() for name, (at, *_) in places.items()}
    for name in values:
        if units[name] not in (*_NO_UNIT, *_PER_STERADIAN):
            raise MeasurementFormatError(
                f"The column {name!r} is in {units[name]!r}; the values of a BRDF are in 1/sr."
            )
    colors = [column[name] for name in (values if len(values) == 3 else values * 3)]
    weight = column.get(_WEIGHT, np.ones(len(table.rows)))
    numbers = np.column_stack([*_vectors(column, form, units), *colors, weight])
    return numbers, [*_notes(table, form, phis, values, {places[name][0] for name in used})]


def _meaning(cell: str) -> tuple[str, str]:
    """Return the name in a cell in lower case, and the unit after it, if any."""
    if len(cell) > _LONGEST_NAME:
        return cell, ""
    text, unit = cell.strip().strip("'\"").strip().lower(), ""
    bracket = min((place for mark in "[(" if (place := text.find(mark)) >= 0), default=-1)
    if bracket >= 0 and text.endswith(("]", ")")):
        text, unit = text[:bracket].rstrip(), text[bracket + 1 : -1].strip()
    name = re.sub(r"[\s.-]+", "_", text)
    base, _, last = name.rpartition("_")
    return (base, last) if last in (*_DEGREES, *_RADIANS) else (name, unit)


def _missing(
    what: str, wanted: tuple[str, ...], table: TextTable, places: dict[str, list[int]]
) -> MeasurementFormatError:
    lacking = ", ".join(name for name in wanted if name not in places)
    found = ", ".join(name or "one without a name" for name in table.names[:20])
    return MeasurementFormatError(f"The table lacks columns for the {what}: {lacking}. It has {found}. {_POSSIBLE}.")


def _vectors(column: dict[str, Array], form: tuple[str, ...], units: dict[str, str]) -> tuple[Array, Array]:
    if form is VECTORS:
        first, second = (np.stack([column[name] for name in form[i : i + 3]], axis=-1) for i in (0, 3))
        return first, second
    angles = {name: _radians(name, column[name], units[name]) for name in (*form, *_PHIS) if name in column}
    thetas = [angle for name, angle in angles.items() if name.startswith("theta") and not units[name]]
    largest = np.degrees(max(map(_largest, thetas), default=0.0))
    if 0.0 < largest < _SURELY_DEGREES:
        raise MeasurementFormatError(
            f"The angles {form[0]} and {form[1]} are at most {largest:.3g}, as angles in radians are: write degrees, "
            f"or name the columns {form[0]}_rad and so on."
        )
    if form is _HALF_DIFFERENCE:
        return directions(*(angles[name] for name in form))
    in_plane = not angles.keys() & {*_PHIS}
    zero = np.zeros_like(angles["theta_in"])
    phi_in = zero + np.pi if in_plane else angles.get("phi_in", zero)
    return spherical(angles["theta_in"], phi_in), spherical(angles["theta_out"], angles.get("phi_out", zero))


def _radians(name: str, angle: Array, unit: str) -> Array:
    if unit not in (*_NO_UNIT, *_DEGREES, *_RADIANS):
        raise MeasurementFormatError(f"The column {name!r} is in {unit!r}; angles are in deg or in rad.")
    radians = angle if unit in _RADIANS else np.radians(angle)
    bound = 180.0 if name.startswith("theta") else 360.0
    if _largest(radians) > np.radians(bound) + 1e-9:
        largest = np.degrees(_largest(radians))
        raise MeasurementFormatError(
            f"The column {name!r} has an angle of {largest:.6g} degrees; {bound:.0f} is the largest that there is."
        )
    return radians


def _largest(angle: Array) -> float:
    return float(np.abs(angle[np.isfinite(angle)]).max(initial=0.0))


def _notes(
    table: TextTable, form: tuple[str, ...], phis: list[str], values: tuple[str, ...], read: set[int]
) -> Iterator[str]:
    if values == (_GREY,):
        yield "The table has one column of values: the material is taken to be grey."
    if form is _THETAS and not phis:
        yield (
            "The table has no phi: all directions are taken to lie in one plane, and theta_out = theta_in to be the "
            "mirror direction."
        )
    if phis == ["phi_out"]:
        yield "The table has no phi_in: it is taken to be 0, so that the mirror direction has phi_out = 180."
    others = [name for place, name in enumerate(table.names) if place not in read]
    if others:
        shown = ", ".join(repr(name) for name in others[:5]) + (" and others" if len(others) > 5 else "")
        yield f"The table has {'a column that was' if len(others) == 1 else 'columns that were'} not read: {shown}."
