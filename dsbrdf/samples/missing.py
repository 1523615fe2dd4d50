"""Find values of a table that stand for missing measurements.

An instrument writes 0 for directions outside of its range and for signals below its noise. A zero for a missing
measurement has neighbours far above the resolution of the table, which is the unit of the last digit. A measured zero
of a black sample has neighbours of a few last digits, or neighbours that scatter about 0.
"""

import numpy as np

from dsbrdf.arrays import Array, Mask

MAX_NOISE_FRACTION = 0.01
"""Negative values are noise up to this fraction of the largest value each, and of the sum of all values together."""
_CERTAIN_CODE = -99.0  # A negative number above this stands for a missing value only if it occurs more than once.
# A repeated extreme value gets a note only if the table has at least this number of different values.
_MIN_DIFFERENT_VALUES = 10
# A repeated extreme value gets a note only if at least this number of rows have the value.
_MIN_EQUAL_VALUES = 4
# A repeated extreme value gets a note only if it differs from the next value by more than this factor.
_FAR_OFF_FACTOR = 3.0
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


def without_code(values: Array, notes: list[str]) -> Array:
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
        "instruments write where they see nothing; they are left out."
    ]


def about_repeated(values: Array) -> list[str]:
    """Return sentences on a smallest or largest value that many rows have, and that is far from all other values."""
    values = values[np.isfinite(values).all(axis=1)]
    if not values.size or not values.any(axis=1).all():  # Rows of zeros are left out: `unmeasured_zeros` examines them.
        values = values[values.any(axis=1)]
    found = np.unique(values)
    if found.size < _MIN_DIFFERENT_VALUES:
        return []
    least = max(_FAR_OFF_FACTOR * found[0], _CLEARLY_LIT_FRACTION * float(np.median(values)))
    extremes = (("smallest", 0, found[1] > least), ("largest", -1, found[-1] > _FAR_OFF_FACTOR * found[-2]))
    counts = {place: int(np.count_nonzero(np.any(values == found[place], axis=1))) for place in (0, -1)}
    return [
        f"{counts[place]} samples have the same {which} value, {found[place]:g}, far from all others: if it stands for "
        f"what is missing, set missing to {found[place]:g}."
        for which, place, is_far in extremes
        if is_far and counts[place] >= _MIN_EQUAL_VALUES
    ]


def _places(omega_in: Array, omega_out: Array) -> Array:
    """Return points (n, 3) for n pairs of directions, so that neighbours on an instrument's grid are close points."""
    cosine = np.clip(np.stack([omega_in[:, 2], omega_out[:, 2]]), -1.0, 1.0)
    theta_in, theta_out = np.arccos(cosine)
    turn = np.arctan2(omega_out[:, 1], omega_out[:, 0]) - np.arctan2(omega_in[:, 1], omega_in[:, 0])
    return np.stack([theta_in, theta_out * np.cos(turn), theta_out * np.sin(turn)], axis=1)


def _last_digit(values: Array) -> float:
    """Return the unit of the last decimal in the values, such as 0.01; 0 if a value has more than twelve decimals."""
    for digits in range(13):
        scaled = values * 10.0**digits
        if np.all(np.abs(scaled - np.rint(scaled)) < 1e-6 * np.maximum(scaled, 1.0)):
            return float(10.0**-digits)
    return 0.0
