"""Find values that stand for missing measurements, and convert spectra to linear sRGB.

An instrument writes 0 for directions outside of its range and for signals below its noise. A zero for a missing
measurement has neighbours far above the resolution of the table, which is the unit of the last digit. A measured zero
of a black sample has neighbours of a few last digits, or neighbours that scatter about 0.

A spectrum is seen by the CIE 1931 observer, in the analytic fit of Wyman, Sloan and Shirley (JCGT 2(2), 2013), under
light of equal energy at all wavelengths. White is adapted, by Bradford's matrix, so that a flat spectrum is grey. A
spectrum is linear between its wavelengths, and constant beyond the first and last.
"""

from collections.abc import Iterator

import numpy as np

from dsbrdf.arrays import Array, Mask
from dsbrdf.data.geometry import CHANNELS
from dsbrdf.errors import MeasurementFormatError
from dsbrdf.samples.columns import GREY, Column, FoundColumns
from dsbrdf.samples.names import (
    RECIPROCAL_UNITS,
    TRISTIMULUS,
    VALUE_UNITS,
    WAVELENGTH_UNITS,
    factor_of,
    name_and_unit,
    wavelength_of,
)
from dsbrdf.samples.table_options import TableOptions

NO_UNIT = ("", "1", "-", "none")
"""Units of a column that has none."""
# Wavelengths without a unit are in metres or micrometres if they are below these limits, otherwise in nanometres.
_MAX_WAVELENGTH_M = 1e-3
_MAX_WAVELENGTH_UM = 20.0

MAX_NOISE_FRACTION = 0.01
"""Negative values are noise up to this fraction of the largest value each, and of the sum of all values together."""
_CERTAIN_CODE = -99.0  # A negative number above this stands for a missing value only if it occurs more than once.
# A repeated extreme value gets a note only if the table has at least this number of different values.
_MIN_DIFFERENT_VALUES = 10
# A repeated extreme value gets a note only if at least this number of rows have the value.
_MIN_EQUAL_VALUES = 4
# A repeated extreme value gets a note only if it differs from the next value by more than this factor.
FAR_OFF_FACTOR = 3.0
# A repeated smallest value gets no note if the next value is below this fraction of the median: both may be noise.
_CLEARLY_LIT_FRACTION = 0.02
_N_NEIGHBOURS = 4
# If nonzero samples beside zeros differ among themselves by more than this factor, the zeros are noise, and are kept.
_MAX_SCATTER_FACTOR = 4.0
# A zero is a rounded value, and kept, if a neighbour is below this number of units of the last digit of the table,
# or below this fraction of the median.
_MAX_ROUNDED_DIGITS = 10.0
_MAX_ROUNDED_FRACTION = 1e-4
_MIN_ZEROS = 3  # If a table has fewer zeros, all are kept as measured values.


def _without_code(values: Array, notes: list[str]) -> Array:
    """Replace a code for missing values, such as -9999, by NaN.

    A code is a negative integer that is the only number clearly below 0 in the table.
    """
    below = values[values < -MAX_NOISE_FRACTION * np.nanmax(values, initial=0.0)]
    if below.size == 0 or np.ptp(below) > 0.0 or below[0] != np.rint(below[0]):
        return values
    count = np.count_nonzero(np.any(values == below[0], axis=1))
    if count == 1 and below[0] > _CERTAIN_CODE:
        return values
    rows = "1 row" if count == 1 else f"{count} rows"
    notes.append(f"The value {below[0]:g}, in {rows}, counts as missing, because a BRDF is not negative.")
    return np.where(values == below[0], np.nan, values)


def unmeasured_zeros(omega_in: Array, omega_out: Array, values: Array) -> tuple[Mask, list[str]]:
    """Return a mask of the samples whose zeros stand for missing measurements, and a sentence on these zeros."""
    level = np.abs(values).max(axis=1, initial=0.0)
    zero, lit = np.flatnonzero(level == 0.0), np.flatnonzero(level > 0.0)
    empty = np.zeros(len(level), dtype=bool)
    if len(zero) < _MIN_ZEROS or len(lit) <= _N_NEIGHBOURS or values.min() < 0.0:
        return empty, []
    from scipy.spatial import cKDTree  # This slow import is here because few tables have zeros.

    places = _places(omega_in, omega_out)
    beside = level[lit][cKDTree(places[lit]).query(places[zero], _N_NEIGHBOURS)[1]]
    darkest = beside.min(axis=1)
    if np.median(beside.max(axis=1) / darkest) > _MAX_SCATTER_FACTOR:
        return empty, []
    rounded = max(_MAX_ROUNDED_DIGITS * _last_digit(level), _MAX_ROUNDED_FRACTION * float(np.median(level[lit])))
    # A zero stands for a missing value if most zeros around it have no nonzero neighbour that may be rounding error.
    alike = cKDTree(places[zero]).query(places[zero], min(_N_NEIGHBOURS, len(zero)))[1]
    empty[zero] = np.mean((darkest > rounded)[alike], axis=1) > 0.5
    count = int(np.count_nonzero(empty))
    if count < _MIN_ZEROS:
        return np.zeros_like(empty), []
    return empty, [
        f"{count} samples have the value 0 beside samples of {np.median(darkest[empty[zero]]):.2g} and more, as "
        "instruments write where they measure nothing; they are left out."
    ]


def about_repeated(values: Array) -> list[str]:
    """Return sentences on a smallest or largest value that many rows have, and that is far from all other values."""
    values = values[np.isfinite(values).all(axis=1)]
    if not values.size or not values.any(axis=1).all():  # Rows of zeros are left out: `unmeasured_zeros` examines them.
        values = values[values.any(axis=1)]
    # A channel with one value throughout is not missing in some rows: `channel_findings` reports it.
    values = values[:, np.any(values != values[:1], axis=0)]
    found = np.unique(values)
    if found.size < _MIN_DIFFERENT_VALUES:
        return []
    least = max(FAR_OFF_FACTOR * found[0], _CLEARLY_LIT_FRACTION * float(np.median(values)))
    extremes = (("smallest", 0, found[1] > least), ("largest", -1, found[-1] > FAR_OFF_FACTOR * found[-2]))
    counts = {place: int(np.count_nonzero(np.any(values == found[place], axis=1))) for place in (0, -1)}
    return [
        f"{counts[place]} samples have the same {which} value, {found[place]:g}, far from all others: if it stands for "
        f"a missing value, set missing to {found[place]:g}."
        for which, place, is_far in extremes
        if is_far and counts[place] >= _MIN_EQUAL_VALUES
    ]


def _places(omega_in: Array, omega_out: Array) -> Array:
    """Return points (n, 3) for n pairs of directions, so that neighbours on an instrument's grid are close points."""
    theta_in, theta_out = np.arccos(np.clip(np.stack([omega_in[:, 2], omega_out[:, 2]]), -1.0, 1.0))
    turn = np.arctan2(omega_out[:, 1], omega_out[:, 0]) - np.arctan2(omega_in[:, 1], omega_in[:, 0])
    return np.stack([theta_in, theta_out * np.cos(turn), theta_out * np.sin(turn)], axis=1)


def _last_digit(values: Array) -> float:
    """Return the unit of the last decimal in the values, such as 0.01; 0 if a value has more than twelve decimals."""
    for digits in range(13):
        scaled = values * 10.0**digits
        if np.all(np.abs(scaled - np.rint(scaled)) < 1e-6 * np.maximum(scaled, 1.0)):
            return float(10.0**-digits)
    return 0.0


_NODES_NM = np.arange(360.0, 831.0)
_VISIBLE_NM = (400.0, 700.0)
# A note names the channels whose sensitivity lies by more than this fraction beyond the wavelengths of the table.
_MAX_EXTRAPOLATED_FRACTION = 0.5
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
_D65 = np.array([0.95047, 1.0, 1.08883])
_FROM_XYZ = np.array(
    [[3.2404542, -1.5371385, -0.4985314], [-0.9692660, 1.8760108, 0.0415560], [0.0556434, -0.2040259, 1.0572252]]
)
# A table is refused if complete spectra at all pairs of directions would need more than this multiple of its rows.
_MAX_PLACES_PER_ROW = 4


def written_values(found: FoundColumns, options: TableOptions, notes: list[str]) -> Array:
    """Return the values as written in the file, shape (rows, bands), with NaN for a missing value."""
    columns = [found.columns[name] for name in found.values]
    for name, column in zip(found.values, columns, strict=True):
        is_band = wavelength_of(name) is not None and column.unit in WAVELENGTH_UNITS
        if column.unit not in (*NO_UNIT, *VALUE_UNITS) and not is_band and options.scale == 1.0:
            raise MeasurementFormatError(
                f"The column {column.written!r} is in {column.unit!r}; the values of a BRDF are in 1/sr. If a factor "
                "makes them a BRDF, set the option scale to it: 0.01 for per cent, and 0.003183, which is 1/(100 pi), "
                "for reflectance factors in per cent."
            )
    written = np.stack([column.numbers for column in columns], axis=-1)
    return _without_code(np.where(np.isin(written, options.missing), np.nan, written), notes)


def rgb_of(found: FoundColumns, written: Array) -> Array:
    """Return the values of a table as RGB (rows, 3)."""
    if found.values == TRISTIMULUS:
        return _in_gamut(written @ _FROM_XYZ.T, written)
    if found.wavelengths.size:
        return linear_srgb(found.wavelengths, written)
    return np.repeat(written, 3 // len(found.values), axis=1)


def in_nanometres(column: Column) -> Array:
    """Return the wavelengths in a column of wavelengths, wavenumbers, frequencies or photon energies."""
    largest, unit = largest_of(column.numbers), column.unit
    if unit in NO_UNIT and "number" in column.written.lower():
        unit = "1/cm"
    elif unit in NO_UNIT:
        unit = "m" if largest < _MAX_WAVELENGTH_M else "um" if largest < _MAX_WAVELENGTH_UM else "nm"
    if unit in RECIPROCAL_UNITS:
        return np.asarray(RECIPROCAL_UNITS[unit] / np.where(column.numbers > 0.0, column.numbers, np.nan))
    if unit not in WAVELENGTH_UNITS:
        raise MeasurementFormatError(
            f"The column {column.written!r} is in {unit!r}; wavelengths are in nm, um or m, wavenumbers in 1/cm, "
            "frequencies in THz, and photon energies in eV."
        )
    return column.numbers * WAVELENGTH_UNITS[unit]


def largest_of(numbers: Array) -> float:
    """Return the largest absolute value of the finite numbers, or 0."""
    return float(np.abs(numbers[np.isfinite(numbers)]).max(initial=0.0))


def about_values(found: FoundColumns, wavelengths: Array, options: TableOptions) -> Iterator[str]:
    """Yield sentences on the unit and the colour of the values."""
    column, light = found.columns[found.values[0]], found.columns.get("theta_in")
    written = column.written
    is_red = found.values == CHANNELS and written in {"R", "r"}
    may_be_factor = options.scale == 1.0 and not is_red and column.unit not in VALUE_UNITS
    factor = factor_of(written, light.written if light else "") if may_be_factor else ""
    if factor:
        yield f"The names suggest that the column {written!r} has reflectance factors, which are {factor}."
    if name_and_unit(written) == ("luminance", "") and options.scale == 1.0:
        yield f"The column {written!r} is a BRDF only if it was divided by the illuminance of the sample."
    if found.values == TRISTIMULUS:
        yield "The colours were converted from CIE XYZ to linear sRGB."
    elif found.values == GREY and wavelengths.size == 0:
        yield "The table has one column of values: the material is taken to be grey."
    elif wavelengths.size == 1:
        yield f"All values are at {wavelengths[0]:g} nm: the material is taken to be grey."
    elif wavelengths.size:
        yield from _about_bands(wavelengths)


def about_gamut(rgb: Array) -> list[str]:
    """Return a sentence about samples (n, 3) in linear sRGB if some have channels that are 0 beside others."""
    outside = (rgb == 0.0) & (rgb.max(axis=1, keepdims=True) > 0.0)
    if not outside.any():
        return []
    names = " and ".join(name for name, of in zip(CHANNELS, outside.T, strict=True) if of.any())
    share = outside.any(axis=1).mean()
    return [f"In {share:.1%} of the rows the colour is outside of sRGB: {names} below 0 count as 0."]


def _about_bands(wavelengths: Array) -> Iterator[str]:
    visible = wavelengths[_is_visible(wavelengths)]
    if visible.size == 1:
        others = ", ".join(f"{one:g}" for one in wavelengths if one != visible[0])
        yield (
            f"Only one of the {wavelengths.size} wavelengths is visible, {visible[0]:g} nm: its values are "
            f"used for a grey material; the values at {others} nm are not used."
        )
        return
    yield (
        f"The {wavelengths.size} wavelengths from {wavelengths[0]:g} to {wavelengths[-1]:g} nm were made linear sRGB, "
        "as the CIE 1931 observer sees them under light of equal energy; a flat spectrum is grey."
    )
    light, beyond = np.abs(_sensitivities()), (_NODES_NM < wavelengths[0]) | (_NODES_NM > wavelengths[-1])
    share = light[:, beyond].sum(axis=1) / light.sum(axis=1)
    if channels := [name for name, part in zip(CHANNELS, share, strict=True) if part > _MAX_EXTRAPOLATED_FRACTION]:
        yield (
            f"Most of {' and '.join(channels)} is extrapolated: beyond the wavelengths of the table, the values "
            "at the nearest wavelength are used."
        )


def _is_visible(wavelengths: Array) -> Mask:
    return np.asarray((wavelengths >= _VISIBLE_NM[0]) & (wavelengths <= _VISIBLE_NM[1]))


def _bell(mean: float, below: float, above: float) -> Array:
    return np.exp(-0.5 * ((_NODES_NM - mean) / np.where(_NODES_NM < mean, below, above)) ** 2)


def _sensitivities() -> Array:
    """Return the sensitivities of red, green and blue at all wavelengths (3, wavelengths); each sums to 1."""
    observer = np.stack(
        [
            1.056 * _bell(599.8, 37.9, 31.0) + 0.362 * _bell(442.0, 16.0, 26.7) - 0.065 * _bell(501.1, 20.4, 26.2),
            0.821 * _bell(568.8, 46.9, 40.5) + 0.286 * _bell(530.9, 16.3, 31.1),
            1.217 * _bell(437.0, 11.8, 36.0) + 0.681 * _bell(459.0, 26.0, 13.8),
        ]
    )
    adapted = np.linalg.inv(_BRADFORD) @ np.diag(_BRADFORD @ _D65 / (_BRADFORD @ observer.sum(axis=1))) @ _BRADFORD
    sensitivities = _FROM_XYZ @ adapted @ observer
    return np.asarray(sensitivities / sensitivities.sum(axis=1, keepdims=True))


def linear_srgb(wavelengths: Array, spectra: Array) -> Array:
    """Return the RGB values (n, 3) of n spectra at increasing wavelengths [nm]; a single visible wavelength gives grey.

    A negative channel of a colour outside of sRGB is set to 0. Raises MeasurementFormatError if no wavelength is
    visible.
    """
    visible = _is_visible(wavelengths)
    if len(wavelengths) > 1 and not visible.any():
        raise MeasurementFormatError(
            f"The wavelengths from {wavelengths[0]:g} to {wavelengths[-1]:g} nm are not visible: write one of them as "
            "the column value, without the others."
        )
    if len(wavelengths) == 1 or np.count_nonzero(visible) == 1:
        return np.repeat(spectra[:, visible] if visible.any() else spectra, 3, axis=1)
    hats = np.stack([np.interp(_NODES_NM, wavelengths, one) for one in np.eye(len(wavelengths))])
    rgb = _in_gamut(spectra @ (_sensitivities() @ hats.T).T, spectra)
    return np.where(np.ptp(spectra, axis=1, keepdims=True) == 0.0, spectra[:, :1], rgb)


def _in_gamut(rgb: Array, written: Array) -> Array:
    """Set negative channels (n, 3) to 0, except those of samples with a negative value in the file."""
    return np.where(written.min(axis=1, keepdims=True) >= 0.0, np.maximum(rgb, 0.0), rgb)


def of_rows(numbers: Array, wavelengths: Array) -> tuple[Array, Array]:
    """Merge rows of single wavelengths into one row for each pair of directions; return the rows and the wavelengths.

    The input `numbers` (n, 10) has the columns of `SampleRows.numbers`, with the value at the wavelength of the row.
    Values at a repeated wavelength are averaged. If a pair of directions lacks a wavelength, its RGB values are NaN.
    """
    used = np.isfinite(wavelengths) & np.isfinite(numbers[:, :6]).all(axis=1)
    numbers, wavelengths = numbers[used], wavelengths[used]
    _, first, row = np.unique(np.round(numbers[:, :6], 6), axis=0, return_index=True, return_inverse=True)
    bands, band = np.unique(wavelengths.round(6), return_inverse=True)
    if first.size * bands.size > _MAX_PLACES_PER_ROW * len(numbers):
        raise MeasurementFormatError("The pairs of directions have different wavelengths; all need the same ones.")
    sums, counts = np.zeros((2, first.size, bands.size))
    np.add.at(sums, (row.ravel(), band), numbers[:, 6])
    np.add.at(counts, (row.ravel(), band), 1.0)
    with np.errstate(invalid="ignore"):
        spectra = sums / counts
    merged = numbers[first]
    merged[:, 6:9] = linear_srgb(bands, spectra) if bands.size else np.nan
    return merged, bands
