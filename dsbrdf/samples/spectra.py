"""Convert spectra to linear sRGB, for the CIE 1931 observer under light of equal energy at all wavelengths.

The observer is the analytic fit of Wyman, Sloan and Shirley (JCGT 2(2), 2013). White is adapted, by Bradford's matrix,
so that a flat spectrum is grey. A spectrum is linear between its wavelengths, and constant beyond the first and last.
"""

import numpy as np

from dsbrdf.arrays import Array
from dsbrdf.errors import MeasurementFormatError

_NODES_NM = np.arange(360.0, 831.0)
_VISIBLE_NM = (400.0, 700.0)
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
_D65 = np.array([0.95047, 1.0, 1.08883])
_FROM_XYZ = np.array(
    [[3.2404542, -1.5371385, -0.4985314], [-0.9692660, 1.8760108, 0.0415560], [0.0556434, -0.2040259, 1.0572252]]
)
# A table is refused if complete spectra at all pairs of directions would need more than this multiple of its rows.
_MAX_PLACES_PER_ROW = 4


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
    """Return the RGB values (n, 3) of n spectra at increasing wavelengths [nm]; a single wavelength gives grey.

    A negative channel of a colour outside of sRGB is set to 0. Raises MeasurementFormatError if no wavelength is
    visible.
    """
    if len(wavelengths) > 1 and not np.any((wavelengths >= _VISIBLE_NM[0]) & (wavelengths <= _VISIBLE_NM[1])):
        raise MeasurementFormatError(
            f"The wavelengths from {wavelengths[0]:g} to {wavelengths[-1]:g} nm are not visible: write one of them as "
            "the column value, without the others."
        )
    hats = np.stack([np.interp(_NODES_NM, wavelengths, one) for one in np.eye(len(wavelengths))])
    rgb = spectra @ (_sensitivities() @ hats.T).T
    rgb = np.where(spectra.min(axis=1, keepdims=True) >= 0.0, np.maximum(rgb, 0.0), rgb)
    return np.where(np.ptp(spectra, axis=1, keepdims=True) == 0.0, spectra[:, :1], rgb)


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
