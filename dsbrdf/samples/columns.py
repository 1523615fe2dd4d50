"""Find the columns of a table that contain directions and values, by their names or the option ``columns``."""

import re
from collections.abc import Callable, Container, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.data.geometry import CHANNELS
from dsbrdf.errors import MeasurementFormatError
from dsbrdf.samples.cells import TextTable
from dsbrdf.samples.names import (
    HALF_DIFFERENCE,
    RECIPROCAL_UNITS,
    TRISTIMULUS,
    VECTORS,
    is_logarithm,
    meaning_of,
    meanings_of,
    name_and_unit,
    wavelength_of,
)
from dsbrdf.samples.table_options import TableOptions

THETAS = ("theta_in", "theta_out")
PHIS = ("phi_in", "phi_out")
SPHERICAL = ("theta_in", "phi_in", "theta_out", "phi_out")
GREY = ("value",)
FROM_MIRROR = ("theta_in", "theta_from_mirror")
_DIRECTION_FORMS = (VECTORS, HALF_DIFFERENCE, THETAS, FROM_MIRROR)
# Columns of these names are no values of a BRDF; the sentence says what would be.
_OTHER_VALUES = {
    r"(?i)btdf|transm|absor|emissi?v": "transmitted, absorbed or emitted light is not read, only reflected light",
    r"(?i)\bL\*?\|a\b|\bx\|y\|Y\b": "colours must be linear sRGB or CIE XYZ",
    r"(?i)aspecular": "it is positive towards the light: write theta_out, which is theta_in minus it",
    r"(?i)off.specular|bistatic|beta.?-|delta.theta|theta\S* ?- ?theta|depression|from.(?:the.)?(?:surface|horizon)": (
        "it is no angle to the normal: write theta_in and theta_out, from the normal to the light and to the viewer"
    ),
    r"(?i)normali[sz]ed|\brelative\b|intensity|signal|counts|voltage": (
        "name it with --columns, give the factor to 1/sr with --scale, and add --cosine out for a radiant intensity"
    ),
}
# A column of unknown meaning is refused if its name matches this, because it may be an azimuth that the samples need.
_AZIMUTH = re.compile(r"phi|psi|(?:^|_)az|azi|azm|[rv]aa|phase|rotat|longitude|out_of_plane")
_UNITS_OF_LIGHT = {"nm", *RECIPROCAL_UNITS}  # Lengths in other units may be places on the sample.
_PLAIN = re.compile(r"[\w=.,/%:+-]+")  # A shell needs quotation marks around other texts.
_MEANINGS = (
    "theta_in, phi_in, theta_out, phi_out [degrees], theta_half, theta_diff, phi_diff, omega_in_x to omega_out_z, red, "
    "green, blue or value [1/sr], weight and wavelength"
)

Description = tuple[tuple[str, str, str], ...]
"""The name as written, the meaning and the unit of each column; meaning and unit may be empty."""


@dataclass(frozen=True, eq=False)
class Column:
    """A column of a table: its name and unit as written in the file, and its numbers (n,)."""

    written: str
    unit: str
    numbers: Array
    is_elevation: bool = False


@dataclass(frozen=True, eq=False)
class FoundColumns:
    """The columns of a table by their meaning, such as theta_in.

    `form` lists the meanings of the columns for directions, and `values` the meanings of the columns for values. If the
    values are spectra, `wavelengths` [nm] has the wavelength of each column of values; otherwise it is empty.
    """

    columns: dict[str, Column]
    form: tuple[str, ...]
    values: tuple[str, ...]
    wavelengths: Array
    description: Description


def find_columns(table: TextTable, options: TableOptions) -> FoundColumns:
    """Find the columns of a table that contain directions, values, weights and wavelengths.

    Raises MeasurementFormatError if a column is missing or occurs twice.
    """
    places, units = _places(table, options)
    elevations = {f"theta_{side}" for side in ("in", "out") if f"elevation_{side}" in places} - places.keys()
    places |= {name: places[name.replace("theta", "elevation")] for name in elevations}
    bands = {} if places.keys() & {*GREY, *CHANNELS} else _bands(table)
    places |= {name: [place] for name, (place, _) in bands.items()}
    form, values = _chosen(table, places, bands)
    azimuths = () if form in (VECTORS, HALF_DIFFERENCE) else PHIS if "phi_out" in places else (PHIS[0], "phase")
    read = (*form, *values, *azimuths, "weight", *(("wavelength",) if values == GREY else ()))
    columns = {}
    for name in [name for name in read if name in places]:
        place, *others = places[name]
        written, unit = table.names[place], name_and_unit(table.names[place])[1]
        if others:
            # Columns of the same name are told apart by their positions.
            chosen = str(place + 1) if written == table.names[others[0]] else written
            raise MeasurementFormatError(
                f"The columns {written!r} and {table.names[others[0]]!r} both seem to be {name}: leave one of them "
                f"out, or choose, as in {_option(name, chosen)}."
            )
        if name in (*GREY, *CHANNELS, *TRISTIMULUS) and is_logarithm(written):
            raise _logarithm(written)
        columns[name] = Column(written, units.get(name) or unit, table.numbers(place), name in elevations)
    at = {places[name][0]: name for name in columns}
    if azimuths and not columns.keys() & {*azimuths}:
        _refuse_unread(table, at, "phi_out", "an azimuth", lambda name: _AZIMUTH.search(name_and_unit(name)[0]))
    if "wavelength" not in columns and not bands:
        _refuse_unread(table, at, "wavelength", "a wavelength", lambda name: name_and_unit(name)[1] in _UNITS_OF_LIGHT)
    described = ((name, at.get(place, ""), name_and_unit(name)[1]) for place, name in enumerate(table.names) if name)
    wavelengths = np.array([wavelength for _, wavelength in bands.values()])
    return FoundColumns(columns, form, values, wavelengths, tuple(described))


def _places(table: TextTable, options: TableOptions) -> tuple[dict[str, list[int]], dict[str, str]]:
    """Return the indices of the columns with each meaning, and the units that the option `columns` gives.

    A column of the table takes precedence over a constant with the same meaning.
    """
    named = options.named_columns()
    chosen = {meaning: _places_of(table, name) for meaning, name in named.items()}
    taken = {at for found in chosen.values() for at in found}
    places: dict[str, list[int]] = {}
    for place, known in enumerate(meanings_of(table.names)):
        if known is not None and place not in taken and not (known in places and place >= table.n_cells):
            places.setdefault(known, []).append(place)
    for meaning, found in chosen.items():
        known = meaning_of(meaning)
        if known is None:
            raise MeasurementFormatError(f"The option columns has {meaning!r}; the meanings are {_MEANINGS}.")
        if not found:
            raise MeasurementFormatError(
                f"The table has no column {named[meaning]!r}; it has {_listed(filter(None, table.names))}."
            )
        places[known] = found
    return places, {str(meaning_of(name)): unit for name in named if (unit := name_and_unit(name)[1])}


def _refuse_unread(
    table: TextTable, read: Container[int], meaning: str, kind: str, is_alike: Callable[[str], Any]
) -> None:
    """Raise MeasurementFormatError if a varying column is alike, by name and unit, to one that the table lacks."""
    for at, name in enumerate(table.names):
        if at not in read and is_alike(name) and table.varies(at):
            raise MeasurementFormatError(
                f"The column {name!r} is not understood, and may be {kind}, which the table lacks otherwise: name "
                f"it, as in {_option(meaning, name)}, or leave it out."
            )


def _places_of(table: TextTable, name: str) -> list[int]:
    """Return the indices of the columns with a name; if no column has the name, a number is a position from 1."""
    found = [place for place, written in enumerate(table.names) if written.lower() == name.lower()]
    bare = name_and_unit(name)[0]
    found = found or [place for place, written in enumerate(table.names) if name_and_unit(written)[0] == bare]
    is_position = name.isdecimal() and 1 <= int(name[:9]) <= len(table.names)
    return found or ([int(name) - 1] if is_position else [])


def _bands(table: TextTable) -> dict[str, tuple[int, float]]:
    """Return index and wavelength [nm] of the columns named by wavelengths; a bare number alone is no wavelength."""
    found = sorted((wavelength, at) for at, name in enumerate(table.names) if (wavelength := wavelength_of(name)))
    for (wavelength, first), (following, second) in pairwise(found):
        if wavelength == following:
            raise MeasurementFormatError(
                f"The columns {table.names[first]!r} and {table.names[second]!r} both seem to be at {wavelength:g} nm: "
                "leave one of them out."
            )
    is_band = len(found) > 1 or (found and not table.names[found[0][1]].isdecimal())
    return {f"{wavelength:g} nm": (place, wavelength) for wavelength, place in found} if is_band else {}


def _chosen(table: TextTable, places: dict[str, list[int]], bands: Iterable[str]) -> tuple[tuple[str, ...], ...]:
    """Return the meanings of the columns of directions and of values in a table."""
    forms = [form for form in _DIRECTION_FORMS if places.keys() >= {*form}]
    values = tuple(bands) or GREY
    values = next((names for names in (CHANNELS, TRISTIMULUS) if places.keys() >= {*names}), values)
    if not forms:
        # The error names the missing columns of the nearest form: angles, vectors, or half and difference angles.
        nearest = max((THETAS, VECTORS, HALF_DIFFERENCE), key=lambda names: len(places.keys() & {*names}))
        raise _missing(nearest, table, places)
    if not places.keys() >= {*values}:
        if logarithms := [name for name in table.names if is_logarithm(name)]:
            raise _logarithm(logarithms[0])
        raise _missing(CHANNELS if places.keys() & {*CHANNELS} else GREY, table, places)
    return forms[0], values


def _missing(wanted: Sequence[str], table: TextTable, places: dict[str, list[int]]) -> MeasurementFormatError:
    lacking = [name for name in wanted if name not in places]
    known = {at for found in places.values() for at in found}
    unknown = [name for at, name in enumerate(table.names) if name and at not in known and not wavelength_of(name)]
    understood = [name for name in table.names if name and name not in unknown]
    found = f"not understood are its columns {_listed(unknown)}" if unknown else f"it has only {_listed(understood)}"
    rest = f"; understood are {_listed(understood)}" if unknown and understood else ""
    remedy = "a spectrum alone has no directions" if "wavelength" in places else "add what is missing"
    if others := [kind for pattern, kind in _OTHER_VALUES.items() if re.search(pattern, "|".join(unknown))]:
        remedy = others[0]
    elif unknown:
        # An example with columns of this table might be wrong, unless only one is left.
        named = _option(lacking[0], unknown[0]) if len(lacking) == len(unknown) == 1 else f"--columns {lacking[0]}=NAME"
        remedy = f"say which column is which, as in {named}"
    held = ", or give an angle that all rows have, as in --constants theta_in=30" if "theta_in" in lacking else ""
    if lacking == [*GREY] and "cos" in "".join(unknown).lower():
        held = ", with --cosine out if the values are the BRDF times the cosine of theta_out, or --cosine in"
    return MeasurementFormatError(f"The table lacks {' and '.join(lacking)}: {found}{rest}; {remedy}{held}.")


def _option(meaning: str, name: str) -> str:
    """Return the option that names a column, as it is written on the command line."""
    option = f"{meaning}={name}"
    return f"--columns {option}" if _PLAIN.fullmatch(option) else f'--columns "{option}"'


def _logarithm(written: str) -> MeasurementFormatError:
    return MeasurementFormatError(
        f"The column {written!r} has logarithms of the values, as decibels or log10 are: write the values themselves, "
        "10^(v/10) for decibels, 10^v for log10, or 10^-v for densities."
    )


def _listed(names: Iterable[str]) -> str:
    """Return at most ten names in quotation marks."""
    return ", ".join([repr(name) for name in names][:10])
