"""Find values of a table that stand for missing measurements.

An instrument that sees nothing, beyond its reach or below its noise, writes 0. Such zeros lie beside values far
above the last digit of the table. True zeros of a black sample lie beside values of a few last digits, or among
values that scatter about 0.
"""

import numpy as np

from dsbrdf.arrays import Array, Mask

# A note on the smallest or largest value needs this many different values, and this many samples that have it.
_MIN_DIFFERENT_VALUES = 10
_MIN_EQUAL_VALUES = 4
# Factor between the extreme value and the next one from which on the extreme one is named.
_FAR_OFF_FACTOR = 3.0
# Noise about zero has values below this fraction of the median.
_CLEARLY_LIT_FRACTION = 0.02
_N_NEIGHBOURS = 4
# Lit samples beside zeros that scatter by more are noise about zero.
_MAX_SCATTER_FACTOR = 4.0
# A zero beside samples of at most so many last digits, or so small a fraction of the median, is a rounded value.
_MAX_ROUNDED_DIGITS = 10.0
_MAX_ROUNDED_FRACTION = 1e-4
_MIN_ZEROS = 3  # Fewer zeros are kept.


def unmeasured_zeros(omega_in: Array, omega_out: Array, values: Array) -> tuple[Mask, list[str]]:
    """Return which samples (n,) are zeros that nobody measured, and a sentence on them."""
    level = np.abs(values).max(axis=1, initial=0.0)
    zero, lit = np.flatnonzero(level == 0.0), np.flatnonzero(level > 0.0)
    empty = np.zeros(len(level), dtype=bool)
    if len(zero) < _MIN_ZEROS or len(lit) <= _N_NEIGHBOURS or values.min() < 0.0:
        return empty, []
    from scipy.spatial import cKDTree  # It takes time to import, and few tables have such zeros.

    places = _places(omega_in, omega_out)
    beside = level[lit][cKDTree(places[lit]).query(places[zero], _N_NEIGHBOURS)[1]]
    darkest = beside.min(axis=1)
    if np.median(beside.max(axis=1) / darkest) > _MAX_SCATTER_FACTOR:
        return empty, []
    rounded = max(_MAX_ROUNDED_DIGITS * _last_digit(level), _MAX_ROUNDED_FRACTION * float(np.median(level[lit])))
    # Zeros beside darker samples are left out with the zeros around them.
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
    """Return sentences on the smallest and the largest of values (n, k) that many rows share, far from all others."""
    values = values[np.isfinite(values).all(axis=1)]
    if not values.size or not values.any(axis=1).all():  # Rows of zeros are the business of `unmeasured_zeros`.
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
    """Return coordinates (n, 3) of pairs of directions in which neighbours of an instrument's grid are near."""
    cosine = np.clip(np.stack([omega_in[:, 2], omega_out[:, 2]]), -1.0, 1.0)
    theta_in, theta_out = np.arccos(cosine)
    turn = np.arctan2(omega_out[:, 1], omega_out[:, 0]) - np.arctan2(omega_in[:, 1], omega_in[:, 0])
    return np.stack([theta_in, theta_out * np.cos(turn), theta_out * np.sin(turn)], axis=1)


def _last_digit(values: Array) -> float:
    """Return the unit of the last decimal that all values have; 0 if they have more than twelve."""
    for digits in range(13):
        scaled = values * 10.0**digits
        if np.all(np.abs(scaled - np.rint(scaled)) < 1e-6 * np.maximum(scaled, 1.0)):
            return float(10.0**-digits)
    return 0.0
